//! Throughput, latency and memory use of the gateway: simulated slots query a simulated policy
//! server through a gateway, each in a process of its own, over loopback sockets. Prints one JSON
//! object; `cargo xtask bench gateway` runs it. The command `slots` puts the same load on any
//! policy server.

use anyhow::Result;
use clap::{Args, Parser, Subcommand};
use serde_json::json;

mod capacity;
mod latency;
mod load;
mod memory;
mod programs;
mod simulated;

/// Time the gateway with a simulated server and simulated slots.
#[derive(Parser)]
#[command(args_conflicts_with_subcommands = true)]
struct Arguments {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    measure: Measure,
}

#[derive(Subcommand)]
enum Command {
    /// Run a closed loop of slots against a policy server or gateway
    Slots(capacity::Slots),
    /// Serve a simulated policy
    ServeSimulated(simulated::Options),
}

#[derive(Args)]
struct Measure {
    /// Slots in a closed loop
    #[arg(long, default_value_t = 64)]
    slots: u32,
    /// Milliseconds that the simulated server takes for one batch
    #[arg(long, default_value_t = 20)]
    batch_millis: u64,
    /// Largest batch of the simulated server
    #[arg(long, default_value_t = 16)]
    max_batch: u32,
    /// Observations per second while the latency is measured
    #[arg(long, default_value_t = 500)]
    rate: u32,
    /// Seconds of every measurement
    #[arg(long, default_value_t = 8)]
    secs: u64,
    /// Rounds of the latency measurement, each directly and then through the gateway
    #[arg(long, default_value_t = 5)]
    rounds: u32,
    /// Queries that wait at once while the server is stalled
    #[arg(long, default_value_t = 2_000)]
    stalled_queries: u32,
}

#[tokio::main]
async fn main() -> Result<()> {
    let arguments = Arguments::parse();
    let report = match arguments.command {
        Some(Command::ServeSimulated(options)) => return simulated::serve(options).await,
        Some(Command::Slots(slots)) => capacity::run_slots(&slots).await?,
        None => {
            let measure = arguments.measure;
            json!({
                "build": if cfg!(debug_assertions) { "dev" } else { "release" },
                "cores": std::thread::available_parallelism()?.get(),
                "observation_bytes": simulated::observation_bytes(),
                "capacity": capacity::measure(&measure).await?,
                "latency": latency::measure(&measure).await?,
                "memory": memory::measure(&measure).await?,
            })
        }
    };
    println!("{}", serde_json::to_string_pretty(&report)?);
    Ok(())
}
