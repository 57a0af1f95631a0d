//! Repeats calls whose connection ended before the answer came.
//!
//! A server or proxy that retires a connection (GOAWAY, a maximum age) refuses some of the calls in
//! flight, and may end others. Every call of our protocols may be repeated: a policy answers its
//! session's last query from memory, a claim has an id, a result is committed once.

use std::error::Error as StdError;
use std::future::poll_fn;
use std::pin::Pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll, ready};
use std::{iter, mem};

use http_body::{Body as HttpBody, Frame};
use tonic::body::Body;
use tonic::codegen::http::{Request, Response};
use tonic::codegen::{BoxFuture, Bytes, Service};
use tonic::transport::{Channel, Error};
use tonic::{Code, ConnectError, Status};

/// Number of tries of a call. A call may be sent over a connection that is being retired more than
/// once, since its end is noticed only later.
const TRIES: u32 = 4;
/// Answer of gRPC's C core, which serves Python policies, to calls that outlive their connection.
const AGED: &str = "max connection age";

/// A channel that repeats a call on a new connection if its connection ended before the answer
/// came. A call that streams several messages is not repeated, since the channel keeps only the
/// first, and neither is one that finds no server.
#[derive(Clone, Debug)]
pub struct Repeating(pub(crate) Channel);

impl Service<Request<Body>> for Repeating {
    type Response = Response<Body>;
    type Error = Error;
    type Future = BoxFuture<Self::Response, Self::Error>;

    fn poll_ready(&mut self, context: &mut Context<'_>) -> Poll<Result<(), Self::Error>> {
        self.0.poll_ready(context)
    }

    fn call(&mut self, request: Request<Body>) -> Self::Future {
        let unready = self.0.clone();
        let mut channel = mem::replace(&mut self.0, unready);
        Box::pin(async move {
            let (head, body) = request.into_parts();
            let body = Arc::new(Mutex::new(Sent { first: None, is_longer: false, rest: body }));
            for _ in 1..TRIES {
                let answer = channel.call(Request::from_parts(head.clone(), replay(&body))).await;
                if !has_ended(&answer) || lock(&body).is_longer {
                    return answer;
                }
                poll_fn(|context| channel.poll_ready(context)).await?;
            }
            channel.call(Request::from_parts(head, replay(&body))).await
        })
    }
}

/// Returns true if a call has no answer because its connection ended.
fn has_ended(answer: &Result<Response<Body>, Error>) -> bool {
    match answer {
        Ok(answer) => Status::from_header_map(answer.headers())
            .is_some_and(|status| status.code() == Code::Unavailable && status.message() == AGED),
        Err(error) => {
            let mut causes = iter::successors(error.source(), |&error| error.source());
            !causes.any(|error| error.is::<ConnectError>())
        }
    }
}

/// A call's messages: the first, once it was sent, and those not yet sent.
struct Sent {
    first: Option<Bytes>,
    /// True if a second message was sent.
    is_longer: bool,
    rest: Body,
}

fn lock(body: &Mutex<Sent>) -> std::sync::MutexGuard<'_, Sent> {
    body.lock().unwrap_or_else(PoisonError::into_inner)
}

fn replay(body: &Arc<Mutex<Sent>>) -> Body {
    let again = lock(body).first.clone();
    Body::new(Replay { again, body: Arc::clone(body) })
}

struct Replay {
    /// First message, if an earlier try has sent it.
    again: Option<Bytes>,
    body: Arc<Mutex<Sent>>,
}

impl HttpBody for Replay {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        if let Some(first) = self.again.take() {
            return Poll::Ready(Some(Ok(Frame::data(first))));
        }
        let mut body = lock(&self.body);
        let frame = ready!(Pin::new(&mut body.rest).poll_frame(context));
        if let Some(Ok(frame)) = &frame
            && let Some(data) = frame.data_ref()
        {
            body.is_longer = body.first.is_some();
            body.first.get_or_insert_with(|| data.clone());
        }
        Poll::Ready(frame)
    }
}
