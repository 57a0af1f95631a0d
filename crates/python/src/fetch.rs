//! Fetching LIBERO's assets.

use std::ops::ControlFlow;
use std::panic::resume_unwind;
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use assets::{AssetsError, Bar, Fetch, HUB, Hub, Program, Progress, hub_url};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::error;

/// What messages of a fetch say to users of Python.
const PROGRAM: Program = Program {
    occupied: "give another folder, or move it away to fetch again",
    assets: "ROLLOUT_ASSETS",
};
/// Longest time without a look at Python's signals.
const LOOK: Duration = Duration::from_millis(100);
/// Longest wait for an interrupted fetch to end. It may hang on a hub that sends
/// nothing; then it ends by itself, a while after.
const FAREWELL: Duration = Duration::from_secs(2);

/// Fetches LIBERO's assets from the hub, or from a mirror of it, into a folder that is
/// not there yet, and checks them; shows on standard error how far it is. Ctrl-C ends it.
/// What has arrived is kept, and the next fetch goes on with it.
///
/// # Errors
/// `FilesError` if they cannot be had or written; `ValueError` if the hub is no URL.
#[pyfunction]
#[pyo3(signature = (into, hub = None))]
pub(crate) fn fetch_assets(py: Python<'_>, into: PathBuf, hub: Option<&str>) -> PyResult<()> {
    let hub = match hub {
        None => HUB.to_owned(),
        Some(text) => hub_url(text).map_err(|remedy| {
            PyValueError::new_err(format!("read the hub's address `{text}`: {remedy}"))
        })?,
    };
    let (sender, mut receiver) = channel();
    // Python sees signals on its own thread only, and must not wait for the hub.
    let fetch = thread::spawn(move || fetch(into, &hub, &sender));
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
    fetched.map_err(error::assets)
}

/// Fetches for as long as somebody listens.
fn fetch(into: PathBuf, hub: &str, listener: &Sender<Progress>) -> Result<(), AssetsError> {
    let mut fetch = Fetch {
        hub: &Hub::new(hub, PROGRAM),
        into: &into,
        pause: &mut thread::sleep,
        progress: &mut |progress| match listener.send(progress) {
            Ok(()) => ControlFlow::Continue(()),
            Err(_) => ControlFlow::Break(()),
        },
    };
    fetch.run().map(drop)
}

/// Shows how far it is now; true once it has ended.
fn show(progress: &mut Receiver<Progress>, bar: &mut Bar) -> bool {
    match progress.recv_timeout(LOOK) {
        Ok(first) => bar.show(progress.try_iter().last().unwrap_or(first)),
        Err(RecvTimeoutError::Timeout) => {}
        Err(RecvTimeoutError::Disconnected) => return true,
    }
    false
}

fn wait(fetch: &JoinHandle<Result<(), AssetsError>>) {
    let until = Instant::now() + FAREWELL;
    while !fetch.is_finished() && Instant::now() < until {
        thread::sleep(Duration::from_millis(10));
    }
}
