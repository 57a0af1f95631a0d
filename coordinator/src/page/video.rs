//! Videos, whole or in ranges: a browser that seeks asks for the middle.

use std::path::{Component, Path};

use axum::extract::Request;
use axum::http::{HeaderValue, header};
use axum::response::{IntoResponse, Response};
use queue::ARTIFACTS_FOLDER;
use tower_http::services::ServeFile;

use super::configuration::replicate;
use super::problem::Problem;
use super::state::Page;

/// The video of a rollout.
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
    // What is stored was made by this program; a database from elsewhere must
    // not lead out of its folder all the same.
    let mut parts = path.components();
    let is_below = parts.next() == Some(Component::Normal(ARTIFACTS_FOLDER.as_ref()))
        && parts.all(|part| matches!(part, Component::Normal(_)));
    let path = page.queue.store().folder().join(path);
    if !is_below || !path.is_file() {
        return Err(Problem::Video);
    }
    let served = ServeFile::new(path).try_call(request).await;
    let mut response = served
        .map_err(|error| Problem::failed(&error))?
        .into_response();
    for (name, value) in [
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::CACHE_CONTROL, "private, max-age=60"),
    ] {
        response
            .headers_mut()
            .insert(name, HeaderValue::from_static(value));
    }
    Ok(response)
}
