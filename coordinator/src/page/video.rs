//! Videos, whole or in ranges: a browser that seeks asks for the middle.

use std::io::SeekFrom;
use std::path::{Component, Path};

use axum::body::Body;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use tokio::fs::File;
use tokio::io::{AsyncReadExt, AsyncSeekExt};
use tokio_util::io::ReaderStream;

use super::Page;
use super::configuration::replicate;
use super::problem::Problem;
use crate::artifacts::ARTIFACTS_FOLDER;

/// Bytes from first to last, both included.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Range {
    first: u64,
    last: u64,
}

/// What a request wants of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Wanted {
    Whole,
    Part(Range),
    /// Bytes that the file does not have.
    Nothing,
}

/// The video of a rollout.
pub(super) async fn answer(
    page: &Page,
    name: &str,
    rollout: &str,
    query: &str,
    headers: &HeaderMap,
) -> Result<Response, Problem> {
    let replicate = replicate(query)?;
    let (_, row, mut view) = page.campaign(name).await?;
    let video = crate::store::page::video(&mut view, row.id, rollout, replicate).await?;
    drop(view);
    let video = video.ok_or(Problem::Video)?;
    let path = Path::new(&video.path);
    // What is stored was made by this program; a database from elsewhere must
    // not lead out of its folder all the same.
    let mut parts = path.components();
    let is_below = parts.next() == Some(Component::Normal(ARTIFACTS_FOLDER.as_ref()))
        && parts.all(|part| matches!(part, Component::Normal(_)));
    if !is_below {
        return Err(Problem::Video);
    }
    let path = page.queue.store().folder().join(path);
    let mut file = File::open(&path).await.map_err(|_| Problem::Video)?;
    let meta = file.metadata().await.map_err(|_| Problem::Video)?;
    let size = meta.len();
    let common = [
        (header::CONTENT_TYPE, "video/mp4".to_owned()),
        (header::ACCEPT_RANGES, "bytes".to_owned()),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff".to_owned()),
        (header::CACHE_CONTROL, "private, max-age=60".to_owned()),
        // A later attempt's video replaces an earlier one's.
        (header::ETAG, format!("\"{}-{size}\"", video.attempt)),
    ];
    let range = headers
        .get(header::RANGE)
        .map(|range| range.to_str().unwrap_or_default());
    let (code, part) = match wanted(range, size) {
        Wanted::Whole => (
            StatusCode::OK,
            Range {
                first: 0,
                last: size.saturating_sub(1),
            },
        ),
        Wanted::Part(part) => (StatusCode::PARTIAL_CONTENT, part),
        Wanted::Nothing => {
            let of = [(header::CONTENT_RANGE, format!("bytes */{size}"))];
            return Ok((StatusCode::RANGE_NOT_SATISFIABLE, common, of).into_response());
        }
    };
    let length = if size == 0 {
        0
    } else {
        part.last - part.first + 1
    };
    let sought = file.seek(SeekFrom::Start(part.first)).await;
    sought.map_err(|error| Problem::failed(&error))?;
    let body = Body::from_stream(ReaderStream::new(file.take(length)));
    let length = [(header::CONTENT_LENGTH, length.to_string())];
    let of = (code == StatusCode::PARTIAL_CONTENT).then(|| {
        let of = format!("bytes {}-{}/{size}", part.first, part.last);
        [(header::CONTENT_RANGE, of)]
    });
    Ok(match of {
        Some(of) => (code, common, length, of, body).into_response(),
        None => (code, common, length, body).into_response(),
    })
}

/// Reads a `Range`. Several ranges at once, and what is no range of bytes, give
/// the whole file, as RFC 9110 allows.
fn wanted(range: Option<&str>, size: u64) -> Wanted {
    let Some(range) = range.and_then(|range| range.strip_prefix("bytes=")) else {
        return Wanted::Whole;
    };
    let Some((first, last)) = range.split_once('-') else {
        return Wanted::Whole;
    };
    let end = size.saturating_sub(1);
    let range = match (first.parse::<u64>(), last.parse::<u64>()) {
        (Ok(first), Ok(last)) if first > last => return Wanted::Whole,
        (Ok(first), Ok(last)) => Range {
            first,
            last: last.min(end),
        },
        (Ok(first), Err(_)) if last.is_empty() => Range { first, last: end },
        (Err(_), Ok(0)) if first.is_empty() => return Wanted::Nothing,
        (Err(_), Ok(length)) if first.is_empty() => Range {
            first: size.saturating_sub(length),
            last: end,
        },
        _ => return Wanted::Whole,
    };
    match range.first < size {
        true => Wanted::Part(range),
        false => Wanted::Nothing,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_cut_to_the_file_and_nonsense_gives_all_of_it() {
        let part = |first, last| Wanted::Part(Range { first, last });
        let check = |range, expected| assert_eq!(wanted(Some(range), 100), expected, "{range}");
        check("bytes=0-", part(0, 99));
        check("bytes=10-19", part(10, 19));
        check("bytes=90-1000", part(90, 99));
        check("bytes=-10", part(90, 99));
        check("bytes=-1000", part(0, 99));
        check("bytes=100-", Wanted::Nothing);
        check("bytes=-0", Wanted::Nothing);
        for nonsense in [
            "bytes=5-4",
            "bytes=a-b",
            "bytes=1-2,4-5",
            "bytes=-",
            "lines=1-2",
            "",
        ] {
            check(nonsense, Wanted::Whole);
        }
        assert_eq!(wanted(Some("bytes=0-"), 0), Wanted::Nothing);
        assert_eq!(wanted(None, 100), Wanted::Whole);
    }
}
