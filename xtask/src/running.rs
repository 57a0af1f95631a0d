//! Background programs with automatic shutdown.

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};

use crate::process::command_line;

/// Longest wait for a program to announce its address.
const START_LIMIT: Duration = Duration::from_secs(30);
/// Interval between two checks of a program's state.
const CHECK_INTERVAL: Duration = Duration::from_millis(50);
/// Longest wait for a program to end after SIGTERM.
const END_LIMIT: Duration = Duration::from_secs(20);

/// Background program. Dropping it ends the program.
pub(crate) struct Running {
    name: String,
    child: Child,
    log: PathBuf,
    /// Listening address as a URL; empty for a worker.
    pub(crate) url: String,
}

impl Running {
    /// Starts a program with its output in a log file in `dir`, and waits until it announces its
    /// address or, for a worker, prints a line.
    pub(crate) fn start(name: &str, command: &mut Command, dir: &Path) -> Result<Self> {
        let log = dir.join(format!("{name}.log"));
        let file = File::create(&log).with_context(|| format!("write {}", log.display()))?;
        let child = command
            .stdin(Stdio::null())
            .stdout(file.try_clone()?)
            .stderr(file)
            .spawn()
            .with_context(|| format!("start {name}"))?;
        let mut running = Self { name: name.to_owned(), child, log, url: String::new() };
        let start = Instant::now();
        loop {
            if let Some(url) = announced_url(&running.log, name)? {
                running.url = url;
                return Ok(running);
            }
            running.check()?;
            if start.elapsed() > START_LIMIT {
                let (secs, log) = (START_LIMIT.as_secs(), running.log.display());
                bail!("start {name}: it did not announce itself within {secs} s; see {log}");
            }
            std::thread::sleep(CHECK_INTERVAL);
        }
    }

    /// Runs a command with its output on this terminal.
    pub(crate) fn run_while_alive(&mut self, command: &mut Command) -> Result<()> {
        let mut running_command =
            command.spawn().with_context(|| format!("start `{}`", command_line(command)))?;
        loop {
            if let Some(status) = running_command.try_wait()? {
                ensure!(status.success(), "run `{}`: {status}", command_line(command));
                return Ok(());
            }
            if let Err(error) = self.check() {
                let _ = running_command.kill();
                let _ = running_command.wait();
                return Err(error);
            }
            std::thread::sleep(CHECK_INTERVAL);
        }
    }

    /// Returns an error with the program's log if the program has ended.
    fn check(&mut self) -> Result<()> {
        if let Some(status) = self.child.try_wait()? {
            let log_text = std::fs::read_to_string(&self.log).unwrap_or_default();
            bail!("keep {} running: {status}\n{}", self.name, log_text.trim_end());
        }
        Ok(())
    }
}

impl std::fmt::Display for Running {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(if self.url.is_empty() { "started" } else { &self.url })
    }
}

/// Returns the address announced in a program's log. A worker announces no address, and counts as
/// started at its first line.
fn announced_url(log: &Path, name: &str) -> Result<Option<String>> {
    for line in BufReader::new(File::open(log)?).lines() {
        let line = line?;
        if name == "worker" {
            return Ok(Some(String::new()));
        }
        if let Some((_, address)) = line.split_once("listening on ") {
            let address = address.split([' ', ',']).next().unwrap_or_default();
            let bare = address.strip_prefix("http://").unwrap_or(address);
            return Ok(Some(format!("http://{bare}")));
        }
    }
    Ok(None)
}

impl Drop for Running {
    /// Sends SIGTERM, and kills the program if it does not end in time.
    fn drop(&mut self) {
        if matches!(self.child.try_wait(), Ok(Some(_))) {
            return;
        }
        let _ = Command::new("kill").arg(self.child.id().to_string()).status();
        let start = Instant::now();
        while start.elapsed() < END_LIMIT {
            if matches!(self.child.try_wait(), Ok(Some(_)) | Err(_)) {
                return;
            }
            std::thread::sleep(CHECK_INTERVAL);
        }
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
