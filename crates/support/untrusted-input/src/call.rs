//! A call without a socket: the frames of its messages go to a service as they
//! would behind the gate, and its answer is read to the end.

use http_body_util::{BodyExt, Full};
use tonic::body::Body;
use tonic::codegen::http::Request;
use tonic::codegen::{Bytes, Service};
use tonic::service::Routes;
use tonic::{Code, Status};

/// Bytes before a message: whether it is compressed, and its length.
const FRAME_HEAD_BYTES: usize = 5;

/// Calls the method at `path`; returns the messages of its answer.
///
/// # Errors
/// With which the service refuses.
///
/// # Panics
/// If it does not answer as gRPC does.
pub(crate) async fn call(
    routes: &mut Routes,
    path: &str,
    messages: &[&[u8]],
) -> Result<Vec<Bytes>, Status> {
    let Ok(response) = routes.call(request(path, messages)).await;
    let (head, body) = response.into_parts();
    let answer = body.collect().await.expect("a body in memory");
    let trailers = answer.trailers().unwrap_or(&head.headers);
    let status = Status::from_header_map(trailers).expect("a status");
    match status.code() {
        Code::Ok => Ok(unframed(answer.to_bytes())),
        _ => Err(status),
    }
}

/// Returns true if a service says that it is at fault itself.
pub(crate) fn blames_itself(refusal: &Status) -> bool {
    match refusal.code() {
        // tonic's code for bytes that do not decode as a message.
        Code::Internal => !refusal
            .message()
            .starts_with("failed to decode Protobuf message"),
        code => matches!(code, Code::Unknown | Code::DataLoss),
    }
}

/// Finishes `future`, and with it everything that it began.
pub(crate) fn block_on<T>(future: impl Future<Output = T>) -> T {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build();
    runtime.expect("a runtime").block_on(future)
}

/// Messages in gRPC's frames: no compression, the length in four bytes.
fn request(path: &str, messages: &[&[u8]]) -> Request<Body> {
    let mut frames = Vec::new();
    for message in messages {
        let length = u32::try_from(message.len()).expect("a short message");
        frames.push(0);
        frames.extend(length.to_be_bytes());
        frames.extend(*message);
    }
    Request::post(path)
        .header("content-type", "application/grpc")
        .header("te", "trailers")
        .body(Body::new(Full::new(Bytes::from(frames))))
        .expect("a request")
}

/// The messages in gRPC's frames.
fn unframed(mut frames: Bytes) -> Vec<Bytes> {
    let mut messages = Vec::new();
    while !frames.is_empty() {
        let head = frames.split_to(FRAME_HEAD_BYTES);
        let length: [u8; 4] = head[1..].try_into().expect("four bytes");
        let length = u32::from_be_bytes(length);
        messages.push(frames.split_to(usize::try_from(length).expect("it fits")));
    }
    messages
}
