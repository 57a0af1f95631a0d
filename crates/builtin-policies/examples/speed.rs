//! Time of a query on one core: `cargo run --release -p student --example speed [weights
//! file]`. Without a file the weights are random.

#[path = "../tests/support/mod.rs"]
mod support;

use std::time::Instant;

use builtin_policies::student::{Network, Query};
use rustix::time::{ClockId, clock_gettime};
use support::{OwnedQuery, Weights};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let bytes = match std::env::args_os().nth(1) {
        Some(path) => std::fs::read(path)?,
        None => Weights::random(1).bytes(),
    };
    let network = Network::from_safetensors(&bytes)?;
    println!(
        "{}: {} parameters, products: {:?}",
        network.name(),
        network.parameters(),
        network.products()
    );
    let owned_queries: Vec<OwnedQuery> = (0..8).map(OwnedQuery::random).collect();
    let queries: Vec<Query<'_>> = owned_queries.iter().map(OwnedQuery::query).collect();
    for batch in [1, 2, 8] {
        measure(&network, &queries[..batch], 200)?;
    }
    measure(&network.with_plain_products(), &queries[..1], 5)?;
    Ok(())
}

/// Prints the time per query in batches of the given size, over `calls` calls: CPU time of
/// the thread, which excludes other programs, and wall time.
fn measure(
    network: &Network,
    queries: &[Query<'_>],
    calls: usize,
) -> Result<(), builtin_policies::student::QueryError> {
    // Caches and the allocator are warm from the second call on.
    network.act(queries)?;
    let (mut cpu_times, mut wall_times) = (Vec::new(), Vec::new());
    let ms_per_query = 1e3 / queries.len() as f64;
    for _ in 0..calls {
        let (start, wall) = (processor_seconds(), Instant::now());
        network.act(queries)?;
        wall_times.push(wall.elapsed().as_secs_f64() * ms_per_query);
        cpu_times.push((processor_seconds() - start) * ms_per_query);
    }
    println!(
        "{:?} products, batch of {}, CPU time per query, ms: {}; wall time: {}",
        network.products(),
        queries.len(),
        spread(cpu_times),
        spread(wall_times)
    );
    Ok(())
}

fn processor_seconds() -> f64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

fn spread(mut times: Vec<f64>) -> String {
    times.sort_by(f64::total_cmp);
    let quantile = |share: f64| times[((times.len() - 1) as f64 * share) as usize];
    format!(
        "median {:.2} (least {:.2}, 5 % {:.2}, 95 % {:.2}, most {:.2})",
        quantile(0.5),
        quantile(0.0),
        quantile(0.05),
        quantile(0.95),
        quantile(1.0)
    )
}
