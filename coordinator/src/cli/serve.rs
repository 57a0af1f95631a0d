//! `coordinator serve`.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context;
use clap::Args;
use coordinator::disk::DEFAULT_MIN_FREE_MIB;
use coordinator::storage::Storage;
use coordinator::{Config, Coordinator};
use queue::Timing;
use queue::clock::SystemClock;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use terminal::{number, reader_is_gone};
use tokio::net::TcpSocket;
use tokio::signal::unix::{SignalKind, signal};
use transport::{Security, SecurityError, ServerArguments};

use super::command::{CommandError, failure, print_line, usage};

/// Heartbeats per lease duration, so that a lease survives a few lost heartbeats.
const HEARTBEATS_PER_LEASE: u32 = 6;

/// Most connections that wait to be accepted.
const BACKLOG: u32 = 1024;

#[derive(Args, Debug)]
pub(super) struct ServeArguments {
    /// Folder of the database and the artifacts; created if missing.
    #[arg(long, value_name = "DIR")]
    data: PathBuf,
    /// Address to listen on; port 0 selects a free port.
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:7411",
        value_parser = terminal::address)]
    listen: SocketAddr,
    /// Seconds that a lease lasts without a heartbeat.
    #[arg(long, value_name = "SECS", default_value_t = 30,
        value_parser = number(1..=3600_u32, "seconds"))]
    lease_secs: u32,
    /// Seconds without progress after which a worker kills a rollout.
    #[arg(long, value_name = "SECS", default_value_t = 180,
        value_parser = number(1..=86_400_u32, "seconds"))]
    progress_timeout_secs: u32,
    /// Seconds that an attempt may take for each control step of its budget, settling included; its
    /// lease then ends even if heartbeats continue.
    #[arg(long, value_name = "SECS", default_value_t = 10,
        value_parser = number(1..=86_400_u32, "seconds"))]
    step_ceiling_secs: u32,
    /// MiB that must be free on the data folder's disk; with less free space, nothing is leased.
    #[arg(long, value_name = "MIB", default_value_t = DEFAULT_MIN_FREE_MIB,
        value_parser = number(0..=1_u64 << 40, "MiB"))]
    min_free_mib: u64,
    /// Storage of finished films: a folder, or s3://BUCKET/FOLDER of S3-compatible storage, with
    /// region, credentials and endpoint from the usual AWS_… variables; the data folder if omitted.
    #[arg(long, value_name = "PLACE")]
    artifacts: Option<String>,
    #[command(flatten)]
    security: ServerArguments,
}

pub(super) async fn serve(arguments: ServeArguments) -> Result<(), CommandError> {
    let security = arguments.security.security(arguments.listen);
    let security = security.map_err(|error| match error {
        SecurityError::Unguarded { .. } => usage(error),
        error => failure(error),
    })?;
    Ok(run(arguments, security).await?)
}

async fn run(arguments: ServeArguments, security: Security) -> anyhow::Result<()> {
    // Signal handlers are installed before the first line is printed, since a reader of that line
    // may send a signal at once.
    let mut terminate = signal(SignalKind::terminate()).context("listen for SIGTERM")?;
    let mut interrupt = signal(SignalKind::interrupt()).context("listen for SIGINT")?;
    transport::raise_file_limit();
    let place = arguments.listen;
    let unusable = || format!("listen on {place}: choose another address with --listen");
    let socket = bind(place).with_context(unusable)?;
    let (tls_note, scheme) = match security.is_encrypted() {
        true => (" over TLS", "https"),
        false => ("", "http"),
    };
    let coordinator = Coordinator::open(config(&arguments, security)?).await?;
    // The socket listens only once the coordinator is ready, which orchestrators infer from an open
    // port.
    let listener = socket.listen(BACKLOG).with_context(unusable)?;
    let address = listener.local_addr().context("read the listening address")?;
    if arguments.security.insecure && !address.ip().is_loopback() {
        tracing::warn!(
            "--insecure: every machine that reaches {address} can read its traffic, lease jobs and \
             report outcomes"
        );
    }
    let data = arguments.data.display();
    let page_url = page_url(scheme, address);
    let printed = print_line(&format!(
        "listening on {address}{tls_note}, page at {page_url}, data in {data}"
    ));
    // A closed standard output is no error: the parent process may have exited.
    if let Err(error) = printed
        && !reader_is_gone(&*error)
    {
        return Err(error);
    }
    let shutdown = async move {
        tokio::select! {
            _ = terminate.recv() => {}
            _ = interrupt.recv() => {}
        }
    };
    coordinator.serve(listener, shutdown).await?;
    // A closed standard output does not turn a clean shutdown into a failure.
    let _ = print_line("stopped");
    Ok(())
}

/// Binds a socket that does not listen yet, so that an address in use is reported before a database
/// is created.
fn bind(address: SocketAddr) -> std::io::Result<TcpSocket> {
    let socket = if address.is_ipv4() { TcpSocket::new_v4()? } else { TcpSocket::new_v6()? };
    // Without this option, a restarted coordinator is refused its address until earlier
    // connections have left the state TIME_WAIT.
    socket.set_reuseaddr(true)?;
    socket.bind(address)?;
    Ok(socket)
}

/// Returns the page's URL. An unspecified address such as 0.0.0.0 is replaced by `HOST`, since a
/// browser cannot open it.
fn page_url(scheme: &str, address: SocketAddr) -> String {
    match (address.ip().is_unspecified(), address.port()) {
        (true, port) => format!("{scheme}://HOST:{port}/ where HOST is this machine's name"),
        (false, _) => format!("{scheme}://{address}/"),
    }
}

fn config(arguments: &ServeArguments, security: Security) -> anyhow::Result<Config> {
    let lease = Duration::from_secs(arguments.lease_secs.into());
    let heartbeat = lease / HEARTBEATS_PER_LEASE;
    let storage = arguments.artifacts.as_deref().map(Storage::open);
    let storage = storage.transpose()?;
    Ok(Config {
        data: arguments.data.clone(),
        timing: Timing {
            lease,
            heartbeat,
            progress_timeout: Duration::from_secs(arguments.progress_timeout_secs.into()),
            ceiling_per_step: Duration::from_secs(arguments.step_ceiling_secs.into()),
            worker_alive: lease,
            // If two successive sweeps are half a lease or more apart, the queue concludes that the
            // coordinator was suspended. Sweeps are therefore far more frequent.
            sweep: heartbeat.min(Timing::default().sweep),
        },
        clock: Arc::new(SystemClock::start()),
        rng: ChaCha8Rng::from_seed(random_seed()?),
        security,
        min_free_bytes: arguments.min_free_mib << 20,
        storage: storage.map(Arc::new),
    })
}

/// Returns a seed from the operating system. Attempt ids derive from it, so no two coordinators may
/// share a seed.
fn random_seed() -> anyhow::Result<[u8; 32]> {
    let mut seed = [0; 32];
    let read = rustix::rand::getrandom(&mut seed, rustix::rand::GetRandomFlags::empty());
    read.context("ask the system for randomness")?;
    Ok(seed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_url_has_no_unspecified_address() {
        let url = |address: &str| page_url("https", address.parse().expect("an address"));
        assert_eq!(url("127.0.0.1:7411"), "https://127.0.0.1:7411/");
        assert_eq!(url("[::1]:7411"), "https://[::1]:7411/");
        for unspecified in ["0.0.0.0:7511", "[::]:7511"] {
            assert_eq!(url(unspecified), "https://HOST:7511/ where HOST is this machine's name");
        }
    }
}
