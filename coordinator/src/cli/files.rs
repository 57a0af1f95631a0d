//! Files named on the command line: size-limited reads and atomic writes.

use std::fs::File;
use std::io::{BufWriter, Read, Write};
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, anyhow};
use benchmark::{CampaignSpec, ManifestRow, SuiteFile, manifest};
use report::figures::Figure;
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
    match is_standard_input(path) {
        true => "standard input".to_owned(),
        false => path.display().to_string(),
    }
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

/// Atomic writer: the data goes to `<path>.partial`, which [`AtomicFile::finish`] renames to the
/// path. Dropping an unfinished writer deletes the partial file.
pub(super) struct AtomicFile {
    path: PathBuf,
    partial: PathBuf,
    file: Option<BufWriter<File>>,
}

impl AtomicFile {
    pub(super) fn create(path: &Path) -> anyhow::Result<AtomicFile> {
        let mut partial = path.to_owned();
        partial.as_mut_os_string().push(".partial");
        // Removes the file of a killed command, or a link, which must not be written through.
        let _ = std::fs::remove_file(&partial);
        let file = File::create_new(&partial)
            .with_context(|| format!("write {}: may this user write there?", partial.display()))?;
        Ok(AtomicFile { path: path.to_owned(), partial, file: Some(BufWriter::new(file)) })
    }

    pub(super) fn writer(&mut self) -> &mut (impl Write + Send) {
        self.file.as_mut().expect("taken only when finished")
    }

    /// Syncs the partial file to disk and renames it to its final path.
    pub(super) fn finish(mut self) -> anyhow::Result<()> {
        let (path, partial) = (self.path.display(), self.partial.display());
        let file = self.file.take().expect("finished once");
        let file = file.into_inner();
        let file = file.with_context(|| format!("write the end of {partial}"))?;
        let synced = file.sync_all();
        synced.with_context(|| format!("write {partial} to the disk"))?;
        std::fs::rename(&self.partial, &self.path)
            .with_context(|| format!("move {partial} to {path}"))
    }
}

impl Drop for AtomicFile {
    fn drop(&mut self) {
        // After `finish` no partial file exists; before it, the earlier error matters more than a
        // failed deletion.
        let _ = std::fs::remove_file(&self.partial);
    }
}

fn is_standard_input(path: &Path) -> bool {
    path.as_os_str() == "-"
}

fn read_bounded(source: impl Read, text: &mut String) -> std::io::Result<usize> {
    source.take(MAX_INPUT_BYTES + 1).read_to_string(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_link_in_place_of_a_partial_file_is_replaced_and_not_followed() {
        let folder = tempfile::tempdir().expect("a folder");
        let linked = folder.path().join("linked");
        std::fs::write(&linked, "another program's").expect("written");
        let path = folder.path().join("report.json");
        let partial = folder.path().join("report.json.partial");
        std::os::unix::fs::symlink(&linked, &partial).expect("a link");
        write_atomically(&path, b"{}").expect("written");
        assert_eq!(std::fs::read(&path).expect("read"), b"{}");
        assert!(!path.is_symlink() && !partial.exists());
        let linked = std::fs::read(&linked).expect("read");
        assert_eq!(linked, b"another program's");
    }
}
