//! Processes of a measurement: they listen on free ports, print their addresses, and are killed
//! when the measurement drops them.

use std::{path::PathBuf, process::Stdio};

use anyhow::{Context, Result};
use tokio::{
    io::{AsyncBufReadExt, BufReader},
    process::{Child, Command},
};

use crate::simulated;

/// A server process, killed when dropped.
pub(crate) struct Running {
    child: Child,
    /// `host:port`.
    pub(crate) address: String,
}

impl Running {
    async fn start(mut command: Command) -> Result<Self> {
        let program = format!("{:?}", command.as_std());
        let mut child = command
            .stdout(Stdio::piped())
            .kill_on_drop(true)
            .spawn()
            .with_context(|| format!("start {program}"))?;
        let stdout = child.stdout.take().context("its output is piped")?;
        let line = BufReader::new(stdout).lines().next_line().await?;
        let line = line.with_context(|| format!("read an address: {program} ended"))?;
        let address = line.strip_prefix("listening on ").unwrap_or(&line);
        Ok(Self { address: address.to_owned(), child })
    }

    /// Starts this program as a simulated server.
    pub(crate) async fn simulated(options: &simulated::Options) -> Result<Self> {
        let mut command = Command::new(std::env::current_exe()?);
        command.arg("serve-simulated");
        command.args(["--batch-millis", &options.batch_millis.to_string()]);
        command.args(["--max-batch", &options.max_batch.to_string()]);
        if options.stalled {
            command.arg("--stalled");
        }
        Self::start(command).await
    }

    /// Starts the gateway that was built with this program, in front of `server`.
    pub(crate) async fn gateway(server: &Self) -> Result<Self> {
        let mut command = Command::new(gateway_program()?);
        command.args(["--listen", "127.0.0.1:0", "--route"]);
        command.arg(format!("simulated=grpc://{}", server.address));
        command.env("RUST_LOG", "error");
        Self::start(command).await
    }

    /// Returns a memory size of the process from `/proc`, MiB: `VmRSS`, the current size, or
    /// `VmHWM`, the peak.
    pub(crate) fn memory_mib(&self, size: &str) -> Result<f64> {
        let pid = self.child.id().context("find the process id: the process has ended")?;
        let path = format!("/proc/{pid}/status");
        let status = std::fs::read_to_string(&path).with_context(|| format!("read {path}"))?;
        let mut lines = status.lines().filter_map(|line| line.split_once(':'));
        let (_, value) = lines
            .find(|(name, _)| *name == size)
            .with_context(|| format!("find {size} in {path}"))?;
        let kib = value.split_whitespace().next().unwrap_or_default();
        Ok(kib.parse::<f64>()? / 1024.0)
    }
}

/// Returns the path of the gateway: in the parent folder, since examples are built in a subfolder,
/// or in this program's own folder.
fn gateway_program() -> Result<PathBuf> {
    let this_program = std::env::current_exe()?;
    let mut folders = this_program.ancestors().skip(1).take(2);
    let program = folders.find_map(|folder| {
        let program = folder.join("policy-gateway");
        program.exists().then_some(program)
    });
    program.context("find policy-gateway: run `cargo xtask bench gateway`, which builds it")
}
