//! gRPC calls without a socket: message frames are passed directly to a service, which bypasses the
//! access checks, and the whole answer is read.

use http_body_util::{BodyExt, Full};
use tonic::body::Body;
use tonic::codegen::http::Request;
use tonic::codegen::{Bytes, Service};
use tonic::service::Routes;
use tonic::{Code, Status};

/// Length of a gRPC frame header: the compression flag and the message length.
const FRAME_HEAD_BYTES: usize = 5;

/// Returns the methods of a proto file, each as `Service/Method`.
pub(crate) fn methods(proto: &str) -> Vec<String> {
    let mut service = "";
    let mut methods = Vec::new();
    for line in proto.lines() {
        let mut words = line.trim().split([' ', '(']);
        match (words.next(), words.next()) {
            (Some("service"), Some(name)) => service = name,
            (Some("rpc"), Some(name)) => methods.push(format!("{service}/{name}")),
            _ => {}
        }
    }
    methods
}

/// Calls the method at `path` and returns the messages of its answer.
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

pub(crate) fn is_internal_fault(refusal: &Status) -> bool {
    match refusal.code() {
        // tonic uses this code also for bytes that cannot be decoded.
        Code::Internal => !refusal.message().starts_with("failed to decode Protobuf message"),
        code => matches!(code, Code::Unknown | Code::DataLoss),
    }
}

/// Runs `future` to completion; drops the tasks that it spawned and that have not ended by then.
pub(crate) fn block_on<T>(future: impl Future<Output = T>) -> T {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    runtime.expect("a runtime").block_on(future)
}

/// Encodes messages as gRPC frames, uncompressed, each with a length of four bytes.
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

fn unframed(mut frames: Bytes) -> Vec<Bytes> {
    let mut messages = Vec::new();
    while !frames.is_empty() {
        let head = frames.split_to(FRAME_HEAD_BYTES);
        let length: [u8; 4] = head[1..].try_into().expect("four bytes");
        let length = u32::from_be_bytes(length);
        messages.push(frames.split_to(usize::try_from(length).expect("a length in memory")));
    }
    messages
}
