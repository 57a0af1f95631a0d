//! Artifact storage for films and archives outside the data folder: another folder, or a bucket of
//! S3-compatible object storage.
//!
//! Films are always received into the data folder first, so that an outage of the storage affects
//! no rollout; `mirror` then moves them.

use std::io;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::sync::Arc;

use futures_util::stream::BoxStream;
use futures_util::{StreamExt, TryStreamExt};
#[cfg(feature = "s3")]
use object_store::RetryConfig;
#[cfg(feature = "s3")]
use object_store::aws::AmazonS3Builder;
use object_store::buffered::BufWriter;
use object_store::local::LocalFileSystem;
use object_store::path::Path as Key;
use object_store::{GetOptions, GetRange, ObjectStore, ObjectStoreExt};
use queue::ids::shortened;
use tokio::io::{AsyncReadExt, AsyncWriteExt};

const S3: &str = "s3://";
/// Size of the parts in which a file is read and passed on, bytes.
const COPIED_BYTES: usize = 64 * 1024;
/// Longest quotation of the storage's error message, bytes; responses may have any length.
const QUOTED_BYTES: usize = 500;

/// Storage of films and archives: a folder, or a bucket with a key prefix.
#[derive(Clone, Debug)]
pub struct Storage {
    store: Arc<dyn ObjectStore>,
    prefix: Key,
    /// Address of the storage as given by the operator, for messages.
    location: String,
}

/// Object, or byte range of an object, that is being read.
#[derive(Debug)]
pub struct ObjectRange {
    /// Byte range within the object.
    pub range: Range<u64>,
    /// Size of the whole object, bytes.
    pub size_bytes: u64,
    pub bytes: BoxedBytes,
}

pub struct BoxedBytes(pub BoxStream<'static, Result<axum::body::Bytes, StorageError>>);

impl std::fmt::Debug for BoxedBytes {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("BoxedBytes")
    }
}

#[derive(Debug, thiserror::Error)]
pub enum StorageError {
    #[error(
        "use storage {location}: write a folder, or s3://BUCKET/FOLDER with the bucket's region and credentials in AWS_REGION, AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, and AWS_ENDPOINT_URL for a server other than AWS"
    )]
    Location { location: String },
    #[cfg(not(feature = "s3"))]
    #[error("use storage {location}: this program was built without the feature `s3`")]
    NoS3 { location: String },
    #[error("make folder {}: may this user write there?", path.display())]
    Folder { path: PathBuf, source: io::Error },
    #[error("{verb} {key} at storage {location}: {problem}")]
    Remote {
        /// Verb of the failed action, such as `fetch`.
        verb: &'static str,
        key: String,
        location: String,
        problem: String,
    },
    #[error("copy {}: make room on the disk, and make the folder readable and writable for this user", path.display())]
    File { path: PathBuf, source: io::Error },
}

impl Storage {
    /// Returns true if the argument is an `s3://` address rather than a local path.
    pub fn is_remote(location: &str) -> bool {
        location.starts_with(S3)
    }

    /// Opens `s3://BUCKET/FOLDER`, or a local folder, which is created if missing. Does not contact
    /// the bucket. Credentials, region and endpoint come from the usual `AWS_…` variables.
    pub fn open(location: &str) -> Result<Storage, StorageError> {
        let unusable = || StorageError::Location { location: location.to_owned() };
        let Some(address) = location.strip_prefix(S3) else {
            let path = PathBuf::from(location);
            let failed = |source| StorageError::Folder { path: path.clone(), source };
            std::fs::create_dir_all(&path).map_err(failed)?;
            let folder = path.canonicalize().map_err(failed)?;
            let store = LocalFileSystem::new_with_prefix(folder)
                .map_err(|_| unusable())?
                .with_automatic_cleanup(true);
            return Ok(Storage {
                store: Arc::new(store),
                prefix: Key::default(),
                location: location.to_owned(),
            });
        };
        let (bucket, prefix) = address.split_once('/').unwrap_or((address, ""));
        if bucket.is_empty() {
            return Err(unusable());
        }
        Ok(Storage {
            store: bucket_store(bucket, location)?,
            prefix: Key::parse(prefix.trim_matches('/')).map_err(|_| unusable())?,
            location: location.to_owned(),
        })
    }

    /// Opens the storage that holds the object at `address`; returns the storage and the object's
    /// key.
    pub fn of_object(address: &str) -> Result<(Storage, String), StorageError> {
        let unusable = || StorageError::Location { location: address.to_owned() };
        let (folder, name) = address.rsplit_once('/').ok_or_else(unusable)?;
        if name.is_empty() || folder.len() <= S3.len() {
            return Err(unusable());
        }
        Ok((Storage::open(folder)?, name.to_owned()))
    }

    pub fn location(&self) -> &str {
        &self.location
    }

    /// Uploads a file atomically and verifies the size of the stored object.
    pub async fn put(&self, key: &str, file: &Path) -> Result<(), StorageError> {
        let unreadable = |source| StorageError::File { path: file.to_owned(), source };
        let mut from = tokio::fs::File::open(file).await.map_err(unreadable)?;
        let full_key = self.key(key);
        let mut to = BufWriter::new(self.store.clone(), full_key.clone());
        let mut part = vec![0; COPIED_BYTES];
        let mut bytes = 0;
        let copied = loop {
            // Unlike `tokio::io::copy`, tells errors of the file from those of the storage.
            let length = match from.read(&mut part).await {
                Ok(0) => break Ok(()),
                Ok(length) => length,
                Err(error) => break Err(unreadable(error)),
            };
            if let Err(error) = to.write_all(&part[..length]).await {
                break Err(self.failed("store", key, &error));
            }
            bytes += length as u64;
        };
        if let Err(error) = copied {
            // An error of the abort is ignored; the copy's error is reported.
            let _ = to.abort().await;
            return Err(error);
        }
        let completed = to.shutdown().await;
        completed.map_err(|error| self.failed("store", key, &error))?;
        let stored = self.store.head(&full_key).await;
        let stored = stored.map_err(|error| self.failed("find", key, &error))?;
        match stored.size == bytes {
            true => Ok(()),
            false => {
                let problem = format!("{} of {bytes} bytes are there", stored.size);
                Err(self.failed("store", key, &io::Error::other(problem)))
            }
        }
    }

    /// Downloads an object into a file; returns false if the object does not exist. If `size_bytes`
    /// is given, an object of another size is refused before anything is written, since it might
    /// fill the disk.
    pub async fn fetch(
        &self,
        key: &str,
        size_bytes: Option<u64>,
        into: &Path,
    ) -> Result<bool, StorageError> {
        let Some(object) = self.read(key, None).await? else {
            return Ok(false);
        };
        if let Some(expected) = size_bytes.filter(|size| *size != object.size_bytes) {
            let problem = format!("{} bytes are there, not {expected}", object.size_bytes);
            return Err(self.failed("fetch", key, &io::Error::other(problem)));
        }
        let unwritable = |source| StorageError::File { path: into.to_owned(), source };
        let mut file = tokio::fs::File::create(into).await.map_err(unwritable)?;
        let mut bytes = object.bytes.0;
        while let Some(data) = bytes.try_next().await? {
            file.write_all(&data).await.map_err(unwritable)?;
        }
        file.flush().await.map_err(unwritable)?;
        Ok(true)
    }

    /// Reads an object, or a range of it; `None` if the object does not exist.
    pub async fn read(
        &self,
        key: &str,
        range: Option<GetRange>,
    ) -> Result<Option<ObjectRange>, StorageError> {
        let options = GetOptions { range, ..GetOptions::default() };
        let response = match self.store.get_opts(&self.key(key), options).await {
            Ok(response) => response,
            Err(object_store::Error::NotFound { .. }) => return Ok(None),
            Err(error) => return Err(self.failed("fetch", key, &error)),
        };
        let (range, size_bytes) = (response.range.clone(), response.meta.size);
        let (storage, key) = (self.clone(), key.to_owned());
        let bytes =
            response.into_stream().map_err(move |error| storage.failed("fetch", &key, &error));
        Ok(Some(ObjectRange { range, size_bytes, bytes: BoxedBytes(bytes.boxed()) }))
    }

    /// Returns the number of bytes of an object; `None` if the object does not exist.
    pub async fn size_bytes(&self, key: &str) -> Result<Option<u64>, StorageError> {
        match self.store.head(&self.key(key)).await {
            Ok(object) => Ok(Some(object.size)),
            Err(object_store::Error::NotFound { .. }) => Ok(None),
            Err(error) => Err(self.failed("find", key, &error)),
        }
    }

    pub async fn remove(&self, folder: &str) -> Result<(), StorageError> {
        let prefix = self.key(folder);
        let all = self.store.list(Some(&prefix)).map_ok(|object| object.location).boxed();
        let removed = self.store.delete_stream(all).try_for_each(|_| async { Ok(()) });
        match removed.await {
            Ok(()) | Err(object_store::Error::NotFound { .. }) => Ok(()),
            Err(error) => Err(self.failed("remove", folder, &error)),
        }
    }

    /// Removes an object; a missing object is no error.
    pub async fn delete(&self, key: &str) -> Result<(), StorageError> {
        match self.store.delete(&self.key(key)).await {
            Ok(()) | Err(object_store::Error::NotFound { .. }) => Ok(()),
            Err(error) => Err(self.failed("remove", key, &error)),
        }
    }

    fn key(&self, path: &str) -> Key {
        let parts = path.split('/').filter(|part| !part.is_empty());
        parts.fold(self.prefix.clone(), |key, part| key.join(part))
    }

    fn failed(
        &self,
        verb: &'static str,
        key: &str,
        error: &(dyn std::error::Error + 'static),
    ) -> StorageError {
        StorageError::Remote {
            verb,
            key: key.to_owned(),
            location: self.location.clone(),
            problem: shortened(&transport::innermost(error), QUOTED_BYTES).to_owned(),
        }
    }
}

#[cfg(feature = "s3")]
fn bucket_store(bucket: &str, location: &str) -> Result<Arc<dyn ObjectStore>, StorageError> {
    // Installs the crypto provider that tonic uses, too; an error means that it is installed
    // already.
    let _ = tokio_rustls::rustls::crypto::ring::default_provider().install_default();
    let retry = RetryConfig {
        max_retries: 3,
        // For all retries together.
        retry_timeout: std::time::Duration::from_secs(20),
        ..RetryConfig::default()
    };
    let store = AmazonS3Builder::from_env().with_bucket_name(bucket).with_retry(retry).build();
    let store = store.map_err(|_| StorageError::Location { location: location.to_owned() })?;
    Ok(Arc::new(store))
}

#[cfg(not(feature = "s3"))]
fn bucket_store(_: &str, location: &str) -> Result<Arc<dyn ObjectStore>, StorageError> {
    Err(StorageError::NoS3 { location: location.to_owned() })
}

impl queue::RemoteStorage for Storage {
    fn remove<'a>(
        &'a self,
        folder: &'a str,
    ) -> Pin<Box<dyn Future<Output = Result<(), String>> + Send + 'a>> {
        Box::pin(async move {
            let removed = Storage::remove(self, folder).await;
            removed.map_err(|error| transport::chain(&error))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn an_object_of_another_size_is_refused_before_it_is_written() {
        let folder = tempfile::tempdir().expect("a folder");
        let storage_folder = folder.path().join("storage");
        let storage = Storage::open(&storage_folder.display().to_string()).expect("opens");
        let film = std::fs::File::create(storage_folder.join("a.mp4")).expect("a file");
        film.set_len(1 << 20).expect("a sparse file");
        let into = folder.path().join("fetched");
        let refused = storage.fetch("a.mp4", Some(7), &into).await;
        let refused = refused.expect_err("another size").to_string();
        assert!(refused.contains("1048576 bytes are there, not 7"), "{refused}");
        assert!(!into.exists());
        let fetched = storage.fetch("a.mp4", Some(1 << 20), &into).await;
        assert!(fetched.expect("an object of this size") && into.exists());
    }

    #[tokio::test]
    async fn an_unreadable_file_is_no_error_of_the_storage() {
        let folder = tempfile::tempdir().expect("a folder");
        let storage_folder = folder.path().join("storage");
        let storage = Storage::open(&storage_folder.display().to_string()).expect("opens");
        // A folder can be opened as a file, but not read.
        let error = storage.put("a.mp4", folder.path()).await;
        let error = error.expect_err("a folder is not a file");
        assert!(matches!(error, StorageError::File { .. }), "{error}");
        let stored = storage.read("a.mp4", None).await;
        assert!(stored.expect("the storage works").is_none());
    }

    #[test]
    fn a_long_storage_error_is_truncated() {
        let folder = tempfile::tempdir().expect("a folder");
        let storage = Storage::open(&folder.path().display().to_string()).expect("opens");
        let words = io::Error::other("w".repeat(1 << 20));
        let message = storage.failed("store", "a.mp4", &words).to_string();
        assert!(message.contains("www") && message.len() < 1_000, "{}", message.len());
    }
}
