//! The hub that LIBERO's assets are published on, over its HTTP API: which
//! commit is the latest, which files it has, and their contents from any byte
//! on. Responsible for single requests; trying again is `download`'s.

use std::path::{Component, Path};
use std::time::Duration;

use serde::Deserialize;
use serde::de::DeserializeOwned;
use ureq::http::Response;
use ureq::{Agent, Body};

use crate::error::AssetsError;

/// The data set that hf-libero 0.1.4 takes its assets from
/// (`HF_ASSETS_REPO_ID` in `utils/download_utils.py`), and the branch that it
/// takes by default.
const REPOSITORY: &str = "lerobot/libero-assets";
const BRANCH: &str = "main";
/// The hub that hf-libero 0.1.4 asks.
pub const HUB: &str = "https://huggingface.co";
/// Longest wait for a connection.
const CONNECT_DEADLINE: Duration = Duration::from_secs(10);
/// Longest wait for an answer, and for the next bytes of one.
const READ_DEADLINE: Duration = Duration::from_secs(30);
/// Longest answer of the API, bytes; a thousand files take some 300 kB.
const MAX_ANSWER_BYTES: u64 = 16 << 20;
/// Most pages of a listing, of some thousand files each.
const MAX_PAGES: usize = 50;

/// Why one request failed.
#[derive(Debug)]
pub(crate) enum RequestError {
    /// Another one may succeed.
    Passing {
        /// What was asked for.
        url: String,
        /// What happened.
        problem: String,
    },
    /// Another one would end the same.
    Final(AssetsError),
}

/// What messages tell users of the program that fetches.
#[derive(Clone, Copy, Debug)]
pub struct Program {
    /// What to do where a pack is already, as an imperative.
    pub occupied: &'static str,
    /// What a pack is given with: an option or a variable.
    pub assets: &'static str,
}

/// A hub.
pub struct Hub {
    base: String,
    program: Program,
    agent: Agent,
}

/// A file on the hub.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct RemoteFile {
    /// In the pack's folder, with `/`; never leads out of it.
    pub(crate) path: String,
    pub(crate) bytes: u64,
    /// Hex; the hub knows it of large files only.
    pub(crate) sha256: Option<String>,
}

#[derive(Deserialize)]
struct Revision {
    sha: String,
}

#[derive(Deserialize)]
struct Entry {
    r#type: String,
    path: String,
    #[serde(default)]
    size: u64,
    lfs: Option<Lfs>,
}

#[derive(Deserialize)]
struct Lfs {
    oid: String,
}

impl Hub {
    /// The hub at a base URL, as [`hub_url`] returns it.
    pub fn new(base: &str, program: Program) -> Self {
        let config = Agent::config_builder()
            .timeout_connect(Some(CONNECT_DEADLINE))
            .timeout_recv_response(Some(READ_DEADLINE))
            .timeout_per_read(Some(READ_DEADLINE))
            .http_status_as_error(false)
            .build();
        Self {
            base: base.to_owned(),
            program,
            agent: config.into(),
        }
    }

    /// Who asks.
    pub(crate) fn program(&self) -> Program {
        self.program
    }

    /// The latest commit, so that all files are of one.
    pub(crate) fn latest_commit(&self) -> Result<String, RequestError> {
        let url = format!("{}/api/datasets/{REPOSITORY}/revision/{BRANCH}", self.base);
        let (revision, _) = self.json::<Revision>(&url)?;
        let is_hash = revision.sha.bytes().all(|byte| byte.is_ascii_hexdigit());
        if !is_hash || revision.sha.len() < 12 {
            let problem = format!("`{}` is no commit", revision.sha);
            return Err(RequestError::Final(AssetsError::Answer { url, problem }));
        }
        Ok(revision.sha)
    }

    /// The first page of a commit's listing.
    pub(crate) fn listing(&self, commit: &str) -> Listing {
        Listing {
            next: Some(format!(
                "{}/api/datasets/{REPOSITORY}/tree/{commit}?recursive=true",
                self.base
            )),
            files: Vec::new(),
            pages: 0,
        }
    }

    /// Adds the next page to a listing; false after the last one.
    pub(crate) fn list_more(&self, listing: &mut Listing) -> Result<bool, RequestError> {
        let Some(url) = listing.next.clone() else {
            return Ok(false);
        };
        let (entries, next) = self.json::<Vec<Entry>>(&url)?;
        let failed = |problem: String| {
            let url = url.clone();
            RequestError::Final(AssetsError::Answer { url, problem })
        };
        for entry in entries {
            // What begins with a dot is for the hub itself.
            if entry.r#type != "file" || entry.path.starts_with('.') {
                continue;
            }
            if !stays_inside(&entry.path) {
                return Err(failed(format!("`{}` leads out of the pack", entry.path)));
            }
            listing.files.push(RemoteFile {
                path: entry.path,
                bytes: entry.size,
                sha256: entry.lfs.map(|lfs| lfs.oid),
            });
        }
        listing.pages += 1;
        if listing.pages == MAX_PAGES && next.is_some() {
            return Err(failed(format!("it has more than {MAX_PAGES} pages")));
        }
        listing.next = next.map(|next| match next.strip_prefix('/') {
            Some(path) => format!("{}/{path}", self.base),
            None => next,
        });
        Ok(true)
    }

    /// Where a file of a commit is.
    pub(crate) fn file_url(&self, commit: &str, file: &RemoteFile) -> String {
        let path = in_url(&file.path);
        format!(
            "{}/datasets/{REPOSITORY}/resolve/{commit}/{path}",
            self.base
        )
    }

    /// The contents from a byte on, or from the first where the hub knows no
    /// ranges: the status says which. Fails at any status but 200, 206 and 416.
    pub(crate) fn get(&self, url: &str, from: u64) -> Result<Response<Body>, RequestError> {
        let mut request = self.agent.get(url);
        if from > 0 {
            request = request.header("Range", format!("bytes={from}-"));
        }
        let passing = |problem: String| RequestError::Passing {
            url: url.to_owned(),
            problem,
        };
        let response = request.call().map_err(|error| match error {
            ureq::Error::BadUri(problem) => RequestError::Final(AssetsError::Answer {
                url: url.to_owned(),
                problem,
            }),
            other => passing(in_words(&other)),
        })?;
        match response.status().as_u16() {
            200 | 206 | 416 => Ok(response),
            status @ (408 | 429 | 500..) => Err(passing(format!("it answers {status}"))),
            status => Err(RequestError::Final(AssetsError::Refused {
                url: url.to_owned(),
                status,
                assets: self.program.assets,
            })),
        }
    }

    /// An answer of the API, and the URL of its next page.
    fn json<T: DeserializeOwned>(&self, url: &str) -> Result<(T, Option<String>), RequestError> {
        let mut response = self.get(url, 0)?;
        let next = response.headers().get("link").and_then(|link| {
            let link = link.to_str().ok()?;
            next_page(link).map(str::to_owned)
        });
        let body = response.body_mut().with_config().limit(MAX_ANSWER_BYTES);
        let text = body.read_to_string().map_err(|error| {
            let url = url.to_owned();
            let problem = in_words(&error);
            RequestError::Passing { url, problem }
        })?;
        let read = serde_json::from_str(&text).map_err(|error| {
            let url = url.to_owned();
            let problem = protocol::JsonError::from(error).to_string();
            RequestError::Final(AssetsError::Answer { url, problem })
        });
        Ok((read?, next))
    }
}

/// The base URL of a hub, without slashes at its end.
///
/// # Errors
/// What to write instead, where it is none.
pub fn hub_url(text: &str) -> Result<String, &'static str> {
    match text.split_once("://") {
        Some(("http" | "https", host)) if !host.is_empty() => {
            Ok(text.trim_end_matches('/').to_owned())
        }
        _ => Err("write https://HOST, or http://HOST:PORT for a local mirror"),
    }
}

/// What keeps a hub from answering.
fn in_words(error: &ureq::Error) -> String {
    match error {
        ureq::Error::Io(error) => error.to_string(),
        ureq::Error::HostNotFound => "no address is known for its name".to_owned(),
        ureq::Error::Timeout(_) => "it does not answer in time".to_owned(),
        other => other.to_string(),
    }
}

/// The files of a commit, as far as they are known.
pub(crate) struct Listing {
    pub(crate) files: Vec<RemoteFile>,
    next: Option<String>,
    pages: usize,
}

/// The target of `<URL>; rel="next"` among a header's links.
fn next_page(link: &str) -> Option<&str> {
    let mut links = link.split(',');
    let next = links.find(|link| link.contains("rel=\"next\""))?;
    let (_, rest) = next.split_once('<')?;
    Some(rest.split_once('>')?.0)
}

fn stays_inside(path: &str) -> bool {
    let parts = Path::new(path).components();
    let all_normal = parts
        .into_iter()
        .all(|part| matches!(part, Component::Normal(_)));
    all_normal && !path.is_empty() && !path.contains(['\\', '\0', '\n'])
}

/// A path with everything escaped that means something in a URL.
fn in_url(path: &str) -> String {
    let mut url = String::new();
    for byte in path.bytes() {
        match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'/' | b'-' | b'_' | b'.' | b'~' => {
                url.push(char::from(byte));
            }
            other => url.push_str(&format!("%{other:02X}")),
        }
    }
    url
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_of_a_listing_stay_inside_the_pack() {
        for path in ["scenes/a.xml", "textures/a b.png", "LICENSE"] {
            assert!(stays_inside(path), "{path}");
        }
        for path in ["", "/etc/passwd", "../a", "a/../../b", "a\\..\\b"] {
            assert!(!stays_inside(path), "{path}");
        }
        assert_eq!(in_url("a b/ü#?.png"), "a%20b/%C3%BC%23%3F.png");
    }

    #[test]
    fn the_next_page_is_found_among_the_links() {
        let link = "<https://h/a>; rel=\"first\", <https://h/b?cursor=x>; rel=\"next\"";
        assert_eq!(next_page(link), Some("https://h/b?cursor=x"));
        assert_eq!(next_page("<https://h/a>; rel=\"first\""), None);
    }
}
