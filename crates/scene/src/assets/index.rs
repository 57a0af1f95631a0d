//! Package index: finds the address of a wheel (PEP 503 and PEP 691).

use serde::Deserialize;

use crate::assets::error::AssetsError;
use crate::assets::http::{Address, Client, OTHER_INDEX, RequestError};
use crate::assets::table::Wheel;

pub const INDEX: &str = "https://pypi.org/simple";
/// Environment variables with the URL of a package index: of this project, pip and uv.
const VARIABLES: [&str; 4] =
    ["ROLLOUT_INDEX_URL", "PIP_INDEX_URL", "UV_DEFAULT_INDEX", "UV_INDEX_URL"];
/// JSON is preferred; mirrors often have only HTML.
const ACCEPT: &str = "application/vnd.pypi.simple.v1+json, \
                      application/vnd.pypi.simple.v1+html;q=0.2, text/html;q=0.1";

pub fn index_of_environment() -> String {
    let values = VARIABLES.iter().filter_map(|name| std::env::var(name).ok());
    let trimmed = values.map(|value| value.trim().to_owned());
    let first = trimmed.into_iter().find(|value| !value.is_empty());
    let url = first.unwrap_or_else(|| INDEX.to_owned());
    // uv allows a name before the URL: `NAME=URL`.
    match url.split_once('=') {
        Some((name, url)) if !name.contains("://") => url.to_owned(),
        _ => url,
    }
}

#[derive(Deserialize)]
struct Project {
    files: Vec<ProjectFile>,
}

#[derive(Deserialize)]
struct ProjectFile {
    filename: String,
    url: String,
}

pub(crate) fn find_wheel(
    client: &Client,
    index: &Address,
    wheel: &Wheel,
) -> Result<Address, RequestError> {
    let page = index.below(&format!("{}/", wheel.project));
    let not_in_index = |problem: String| {
        RequestError::Permanent(AssetsError::NotInIndex {
            index: index.as_str().to_owned(),
            project: wheel.project.to_owned(),
            problem,
        })
    };
    let (text, kind) = match client.text(&page, ACCEPT) {
        Err(RequestError::Permanent(AssetsError::Refused { status, .. })) => {
            return Err(not_in_index(format!("the server answers {status}")));
        }
        other => other?,
    };
    let files: Vec<(String, String)> = if kind.contains("json") {
        let read: Project = serde_json::from_str(&text).map_err(|error| {
            RequestError::Permanent(AssetsError::Answer {
                url: page.as_str().to_owned(),
                problem: benchmark::JsonError::from(error).to_string(),
                remedy: OTHER_INDEX,
            })
        })?;
        let files = read.files.into_iter();
        files.map(|file| (file.filename, file.url)).collect()
    } else {
        links(&text)
    };
    let mut files = files.into_iter();
    let found = files.find(|(name, _)| name == wheel.file);
    let address = found.and_then(|(_, url)| page.resolve(&url));
    address.ok_or_else(|| not_in_index(format!("the project has no file {}", wheel.file)))
}

/// Returns the links of an HTML page: the last part of each path, and the address.
fn links(page: &str) -> Vec<(String, String)> {
    let mut links = Vec::new();
    for part in page.split("href=").skip(1) {
        let Some(quote) = part.chars().next().filter(|c| matches!(c, '"' | '\'')) else {
            continue;
        };
        let Some(target) = part[1..].split(quote).next() else {
            continue;
        };
        let target = target.replace("&amp;", "&");
        let path = target.split(['#', '?']).next().unwrap_or_default();
        let name = path.rsplit('/').next().unwrap_or_default().to_owned();
        links.push((name, target));
    }
    links
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_are_read_from_html() {
        let page = "<a href=\"../../packages/a-1.whl#sha256=12\" data-x='1'>a</a>\
                    <a class=b href='https://h/b-1.whl?x=1&amp;y=2'>b</a><a href=>none</a>";
        let expected = [
            ("a-1.whl", "../../packages/a-1.whl#sha256=12"),
            ("b-1.whl", "https://h/b-1.whl?x=1&y=2"),
        ];
        let expected = expected.map(|(name, url)| (name.to_owned(), url.to_owned()));
        assert_eq!(links(page), expected);
    }
}
