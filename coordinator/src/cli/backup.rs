//! `coordinator backup`.

use std::io::Write;
use std::path::PathBuf;

use anyhow::Context;
use clap::Args;
use coordinator::client::Service;
use proto::coordinator::BackupRequest;

use super::command::{CommandError, Connection, print_line};
use super::files::AtomicFile;

/// Copies the current database while the coordinator runs. To restore the copy, put it as
/// `coordinator.sqlite` into an empty folder and start `coordinator serve --data` there. Films,
/// which are files below the data folder's `artifacts`, are not included.
#[derive(Args, Debug)]
pub(super) struct BackupArguments {
    /// File to write, on this machine; an existing file is replaced only by a complete copy.
    #[arg(long, value_name = "FILE")]
    output: PathBuf,
    #[command(flatten)]
    connection: Connection,
}

pub(super) async fn backup(arguments: BackupArguments) -> Result<(), CommandError> {
    let client = arguments.connection.client()?;
    let mut chunks = client.call(BackupRequest {}, Service::backup).await?;
    let mut file = AtomicFile::create(&arguments.output)?;
    let mut size_bytes = 0;
    while let Some(chunk) = client.next(&mut chunks).await? {
        let written = file.writer().write_all(&chunk.data);
        written.with_context(|| format!("write {}", arguments.output.display()))?;
        size_bytes += chunk.data.len();
    }
    file.finish()?;
    let path = arguments.output.display();
    Ok(print_line(&format!("wrote {size_bytes} bytes to {path}"))?)
}
