//! Sources that files can be fetched from: a package index, or a folder of wheels. A wheel has the
//! files at known positions.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::PathBuf;

use crate::assets::error::AssetsError;
use crate::assets::http::{Address, Client, Deadlines, OTHER_INDEX, RequestError};
use crate::assets::index::{find_wheel, index_of_environment};
use crate::assets::table::{FileFacts, Table};

const WHEELS_VARIABLE: &str = "ROLLOUT_WHEELS";
pub struct Origin(Kind);

enum Kind {
    Index { client: Client, index: Address },
    Wheels(PathBuf),
}

/// A wheel, and the files in it that are requested.
pub(crate) struct Parcel<'a> {
    pub(crate) name: String,
    location: Location,
    pub(crate) bytes: u64,
    /// Requested files, sorted by position.
    pub(crate) members: Vec<Member<'a>>,
}

enum Location {
    Address(Address),
    File(PathBuf),
}

#[derive(Clone, Copy)]
pub(crate) struct Member<'a> {
    pub(crate) file: &'a FileFacts,
    pub(crate) offset: u64,
    pub(crate) stored: u64,
    pub(crate) is_deflated: bool,
}

pub(crate) struct Stream {
    pub(crate) position: u64,
    pub(crate) reader: Box<dyn Read>,
}

impl Origin {
    /// Creates a source from a package index. The URL may contain credentials.
    pub fn index(url: &str, deadlines: Deadlines) -> Result<Self, AssetsError> {
        let client = Client::new(deadlines)?;
        let index = address("package index", url)?;
        Ok(Self(Kind::Index { client, index }))
    }

    pub fn wheels(folder: PathBuf) -> Self {
        Self(Kind::Wheels(folder))
    }

    /// Returns the source that is set in the environment variables: the folder `$ROLLOUT_WHEELS`,
    /// else the package index `$ROLLOUT_INDEX_URL`, else the index of pip or uv, else PyPI.
    pub fn of_environment() -> Result<Self, AssetsError> {
        match std::env::var_os(WHEELS_VARIABLE).filter(|folder| !folder.is_empty()) {
            Some(folder) => Ok(Self::wheels(folder.into())),
            None => Self::index(&index_of_environment(), Deadlines::default()),
        }
    }

    /// Returns the name of the source for messages, without credentials.
    pub fn name(&self) -> String {
        match &self.0 {
            Kind::Index { index, .. } => format!("the package index at {}", index.as_str()),
            Kind::Wheels(folder) => format!("the wheels in {}", folder.display()),
        }
    }

    pub(crate) fn group_by_parcel<'a>(files: &[&'a FileFacts]) -> Vec<Vec<&'a FileFacts>> {
        let mut files = files.to_vec();
        files.sort_by_key(|file| (file.wheel, file.offset));
        let groups = files.chunk_by(|a, b| a.wheel == b.wheel);
        groups.map(<[_]>::to_vec).collect()
    }

    pub(crate) fn locate<'a>(
        &self,
        table: &Table,
        group: &[&'a FileFacts],
    ) -> Result<Parcel<'a>, RequestError> {
        let wheel = table.wheels[group[0].wheel];
        let location = match &self.0 {
            Kind::Index { client, index } => Location::Address(find_wheel(client, index, &wheel)?),
            Kind::Wheels(folder) => Location::File(folder.join(wheel.file)),
        };
        let members = group.iter().map(|file| Member {
            file,
            offset: file.offset,
            stored: file.stored,
            is_deflated: !file.is_a_wheel(),
        });
        Ok(Parcel {
            name: match &location {
                Location::Address(address) => address.as_str().to_owned(),
                Location::File(path) => path.display().to_string(),
            },
            location,
            bytes: wheel.bytes,
            members: members.collect(),
        })
    }

    /// The stream starts at the first byte if the server does not support ranges.
    pub(crate) fn open(
        &self,
        parcel: &Parcel<'_>,
        range: Range<u64>,
    ) -> Result<Stream, RequestError> {
        let address = match &parcel.location {
            Location::Address(address) => address,
            Location::File(path) => return open_file(path, range),
        };
        let Kind::Index { client, .. } = &self.0 else { unreachable!("a folder has no addresses") };
        let from = range.start;
        let response = client.get_range(address, range)?;
        let header = |name: &str| {
            let value = response.headers().get(name)?.to_str().ok()?;
            Some(value.to_owned())
        };
        let (position, total) = match response.status().as_u16() {
            206 => {
                let content_range = header("content-range").unwrap_or_default();
                if !content_range.starts_with(&format!("bytes {from}-")) {
                    return Err(RequestError::Transient {
                        url: parcel.name.clone(),
                        problem: format!(
                            "the server sent `{content_range}` instead of a range from byte {from}"
                        ),
                    });
                }
                (from, content_range.rsplit('/').next().map(str::to_owned))
            }
            200 => (0, header("content-length")),
            // 416: the range begins after the file's end.
            _ => (0, Some(format!("at most {from}"))),
        };
        let expected = parcel.bytes.to_string();
        if let Some(found) = total.filter(|total| *total != "*" && *total != expected) {
            return Err(RequestError::Permanent(AssetsError::Answer {
                url: parcel.name.clone(),
                problem: format!("the file has {found} bytes and should have {expected}"),
                remedy: OTHER_INDEX,
            }));
        }
        let reader = Box::new(client.reader(response));
        Ok(Stream { position, reader })
    }

    pub(crate) fn is_remote(&self) -> bool {
        !matches!(self.0, Kind::Wheels(_))
    }
}

fn open_file(path: &PathBuf, range: Range<u64>) -> Result<Stream, RequestError> {
    let open = || {
        let mut file = File::open(path)?;
        file.seek(SeekFrom::Start(range.start))?;
        Ok(file)
    };
    let file = open().map_err(|source: std::io::Error| {
        RequestError::Permanent(match source.kind() {
            std::io::ErrorKind::NotFound => AssetsError::NoWheel { path: path.clone() },
            _ => AssetsError::Read { path: path.clone(), source },
        })
    })?;
    Ok(Stream { position: range.start, reader: Box::new(file) })
}

fn address(what: &'static str, url: &str) -> Result<Address, AssetsError> {
    Address::parse(url).map_err(|remedy| AssetsError::Url { what, remedy })
}
