//! Videos, with range requests for seeking. A video may stem from an untrusted archive, so it is
//! always served as `video/mp4` without content sniffing, and sandboxed: a browser that opens it as
//! a page gives it neither scripts nor an origin.

use std::path::{Component, Path};

use axum::body::Body;
use axum::extract::Request;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use http_range_header::{EndPosition, StartPosition, parse_range_header};
use object_store::GetRange;
use queue::ARTIFACTS_FOLDER;
use tower_http::services::ServeFile;

use super::configuration::replicate;
use super::problem::Problem;
use super::state::Page;
use crate::storage::Storage;

/// Content security policy for a video that is opened as a page: the page may only play the video.
const CONTENT_POLICY: &str =
    "sandbox; default-src 'none'; media-src 'self'; style-src 'unsafe-inline'";

/// Serves the video of a rollout from the data folder or the artifact storage.
pub(super) async fn answer(
    page: &Page,
    name: &str,
    rollout: &str,
    request: Request,
) -> Result<Response, Problem> {
    let replicate = replicate(request.uri().query().unwrap_or_default())?;
    let (campaign, mut view) = page.campaign(name).await?;
    let video = view.video(campaign.id, rollout, replicate).await?;
    drop(view);
    let video = video.ok_or(Problem::Video)?;
    let path = Path::new(&video);
    // This program only stores paths below the artifacts folder, but a database from another source
    // could hold a path traversal.
    let mut parts = path.components();
    let is_below = parts.next() == Some(Component::Normal(ARTIFACTS_FOLDER.as_ref()))
        && parts.all(|part| matches!(part, Component::Normal(_)));
    let is_film = path.extension().is_some_and(|ending| ending == "mp4");
    if !is_below || !is_film {
        return Err(Problem::Video);
    }
    let file = page.queue.store().folder().join(path);
    let mut response = match (&page.storage, file.is_file()) {
        (_, true) => {
            let served = ServeFile::new(file).try_call(request).await;
            served.map_err(|error| Problem::failed(&error))?.into_response()
        }
        (Some(storage), false) => from_storage(storage, &video, request.headers()).await?,
        (None, false) => return Err(Problem::Video),
    };
    if response.status().is_success() {
        let kind = HeaderValue::from_static("video/mp4");
        response.headers_mut().insert(header::CONTENT_TYPE, kind);
    }
    for (name, value) in [
        (header::CONTENT_SECURITY_POLICY, CONTENT_POLICY),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::CACHE_CONTROL, "private, max-age=60"),
    ] {
        response.headers_mut().insert(name, HeaderValue::from_static(value));
    }
    Ok(response)
}

/// Serves a video, or its requested byte range, from the artifact storage.
async fn from_storage(
    storage: &Storage,
    video: &str,
    headers: &HeaderMap,
) -> Result<Response, Problem> {
    let range = headers.get(header::RANGE).and_then(requested_range);
    let is_part = range.is_some();
    let object = match storage.read(video, range.clone()).await {
        Ok(object) => object.ok_or(Problem::Video)?,
        // Storages report a range beyond the end like any other failure.
        Err(error) => match (range, storage.size_bytes(video).await) {
            (Some(range), Ok(Some(size))) if range.as_range(size).is_err() => {
                return Ok(unsatisfiable(size));
            }
            _ => return Err(Problem::failed(&error)),
        },
    };
    let size = object.size_bytes;
    let mut answer = Response::builder()
        .header(header::CONTENT_TYPE, "video/mp4")
        .header(header::ACCEPT_RANGES, "bytes")
        .header(header::CONTENT_LENGTH, object.range.end - object.range.start);
    if is_part {
        let (first, last) = (object.range.start, object.range.end.saturating_sub(1));
        answer = answer
            .status(StatusCode::PARTIAL_CONTENT)
            .header(header::CONTENT_RANGE, format!("bytes {first}-{last}/{size}"));
    }
    let answer = answer.body(Body::from_stream(object.bytes.0));
    answer.map_err(|error| Problem::failed(&error))
}

/// Answers a request for a range that begins at or beyond the end of a video.
fn unsatisfiable(size_bytes: u64) -> Response {
    let size = [(header::CONTENT_RANGE, format!("bytes */{size_bytes}"))];
    (StatusCode::RANGE_NOT_SATISFIABLE, size).into_response()
}

/// Returns the requested range; `None`, for which the whole video is served, if several ranges are
/// requested or the header is invalid.
fn requested_range(header: &HeaderValue) -> Option<GetRange> {
    let ranges = parse_range_header(header.to_str().ok()?).ok()?.ranges;
    let [range] = ranges.as_slice() else {
        return None;
    };
    Some(match (range.start, range.end) {
        (StartPosition::FromLast(count), _) => GetRange::Suffix(count),
        (StartPosition::Index(first), EndPosition::LastByte) => GetRange::Offset(first),
        (StartPosition::Index(first), EndPosition::Index(last)) => {
            GetRange::Bounded(first..last.checked_add(1)?)
        }
    })
}
