//! gRPC calls with a deadline, for the clients of the coordinator and of policies.

use std::time::Duration;

use tonic::{Response, Status};

pub(crate) async fn with_deadline<T>(
    deadline: Duration,
    call: impl Future<Output = Result<Response<T>, Status>>,
) -> Result<T, Status> {
    match tokio::time::timeout(deadline, call).await {
        Ok(answer) => answer.map(Response::into_inner),
        Err(_) => Err(Status::deadline_exceeded(format!(
            "no answer within {:.0} s",
            deadline.as_secs_f64()
        ))),
    }
}
