//! Files named on the command line: size-limited reads and atomic writes.

use std::fs::{File, Permissions};
use std::io::{BufWriter, Read, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, anyhow};
use benchmark::{CampaignSpec, ManifestRow, SuiteFile, manifest};
use report::figures::Figure;
use tempfile::NamedTempFile;
use terminal::counted;

use super::command::{CommandError, usage};

/// Largest accepted specification, manifest or suite file, bytes: it must fit into one gRPC message
/// to the coordinator.
const MAX_INPUT_BYTES: u64 = 24 << 20;

/// Reads a text file; `-` is standard input.
fn read_text(path: &Path) -> Result<String, CommandError> {
    let mut text = String::new();
    let read = match is_standard_input(path) {
        true => read_bounded(std::io::stdin(), &mut text),
        false => File::open(path).and_then(|file| read_bounded(file, &mut text)),
    };
    let checked = match read {
        Ok(size) if size <= MAX_INPUT_BYTES as usize => Ok(text),
        Ok(_) => Err(anyhow!("it is larger than {} MiB: divide it", MAX_INPUT_BYTES >> 20)),
        Err(error) => Err(error.into()),
    };
    checked.map_err(|error| usage(error.context(format!("read {}", input_name(path)))))
}

/// Reads a specification; an invalid one is a usage error.
pub(super) fn read_spec(path: &Path) -> Result<CampaignSpec, CommandError> {
    let spec = CampaignSpec::from_json(&read_text(path)?);
    spec.with_context(|| format!("use {}", input_name(path))).map_err(usage)
}

/// Reads a suite file; an invalid one is a usage error.
pub(super) fn read_suite_file(path: &Path) -> Result<SuiteFile, CommandError> {
    let file = SuiteFile::from_json(&read_text(path)?);
    file.with_context(|| format!("use {}", input_name(path))).map_err(usage)
}

/// Reads a manifest. An invalid one is a failure, not a usage error, since the command was valid.
pub(super) fn read_manifest(path: &Path) -> Result<Vec<ManifestRow>, CommandError> {
    let text = read_text(path)?;
    let rows = manifest::parse(&text).with_context(|| format!("use {}", input_name(path)));
    Ok(rows?)
}

/// Returns the name of an input for messages.
pub(super) fn input_name(path: &Path) -> String {
    if is_standard_input(path) { "standard input".to_owned() } else { path.display().to_string() }
}

/// Writes a file atomically.
pub(super) fn write_atomically(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    let mut file = AtomicFile::create(path)?;
    let written = file.writer().write_all(bytes);
    written.with_context(|| format!("write {}", path.display()))?;
    file.finish()
}

/// Writes figures as SVG files into a folder, which is created if missing, and as PDF files if
/// `rsvg-convert` is installed.
pub(super) fn write_figures(figures: &[Figure], folder: &Path) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder).with_context(|| format!("make {}", folder.display()))?;
    let mut form = "SVG and PDF";
    for figure in figures {
        let path = folder.join(format!("{}.svg", figure.name));
        write_atomically(&path, figure.standalone().as_bytes())?;
        let mut converter = Command::new("rsvg-convert");
        converter.args(["--format=pdf", "--output"]).arg(path.with_extension("pdf")).arg(&path);
        match converter.status() {
            Ok(status) if status.success() => {}
            Ok(status) => {
                let path = path.display();
                return Err(anyhow!("convert {path} to PDF: `rsvg-convert` ended with {status}"));
            }
            Err(_) => form = "SVG (for PDF, install `rsvg-convert`)",
        }
    }
    let count = counted(figures.len() as u64, "figure");
    eprintln!("wrote {count} as {form} to {}", folder.display());
    Ok(())
}

/// Atomic writer: [`AtomicFile::finish`] renames a temporary file beside the path to the path.
/// Dropping an unfinished writer deletes the temporary file.
pub(super) struct AtomicFile {
    path: PathBuf,
    file: BufWriter<NamedTempFile>,
}

impl AtomicFile {
    pub(super) fn create(path: &Path) -> anyhow::Result<AtomicFile> {
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
        // Reports are for others to read, too, as far as the user's mask allows.
        let readable = Permissions::from_mode(0o666);
        let file = tempfile::Builder::new()
            .permissions(readable)
            .tempfile_in(folder.unwrap_or(Path::new(".")))
            // The error itself names the temporary file.
            .map_err(|error| std::io::Error::from(error.kind()))
            .with_context(|| {
                let path = path.display();
                format!("write {path}: is its folder there, and may this user write to it?")
            })?;
        Ok(AtomicFile { path: path.to_owned(), file: BufWriter::new(file) })
    }

    pub(super) fn writer(&mut self) -> &mut (impl Write + Send) {
        &mut self.file
    }

    /// Syncs the temporary file to disk and renames it to its final path.
    pub(super) fn finish(self) -> anyhow::Result<()> {
        let AtomicFile { path, file } = self;
        let finish = || -> std::io::Result<()> {
            let file = file.into_inner()?;
            file.as_file().sync_all()?;
            file.persist(&path)?;
            Ok(())
        };
        finish().with_context(|| format!("write the end of {}", path.display()))
    }
}

fn is_standard_input(path: &Path) -> bool {
    path.as_os_str() == "-"
}

fn read_bounded(source: impl Read, text: &mut String) -> std::io::Result<usize> {
    source.take(MAX_INPUT_BYTES + 1).read_to_string(text)
}
