//! Samples quantities that must not keep growing: the coordinator's memory, file descriptors, log
//! and database, and the latencies of calls.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::{Result, bail};
use proto::coordinator as wire;
use proto::coordinator::operator_service_client::OperatorServiceClient;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::task::JoinSet;
use tonic::transport::Endpoint;

use super::Shared;
use super::crowd::Crowd;
use super::server::CoordinatorAccess;

/// Interval between two samples.
const INTERVAL: Duration = Duration::from_secs(5);
/// Interval between two requests for pages, for metrics or for the status. It is short, to simulate
/// many browsers.
const REQUEST_INTERVAL: Duration = Duration::from_millis(500);
/// Pages that are requested in turn.
const PAGES: [&str; 4] = ["/", "/campaigns/measured", "/campaigns/filmed", "/workers"];

/// Measurements of the coordinator and of the calls since the previous sample.
#[derive(Clone, Debug, Default)]
pub(crate) struct Sample {
    /// Time since the start, seconds.
    pub(crate) at: f64,
    /// Event since the previous sample.
    pub(crate) event: Option<&'static str>,
    pub(crate) accepted: u64,
    /// Median latency of the claims since the previous sample, seconds; `None` without claims.
    pub(crate) claim_p50: Option<f64>,
    pub(crate) claim_p99: Option<f64>,
    /// Longest latencies of page, metrics and status since the previous sample, seconds.
    pub(crate) page: Option<f64>,
    pub(crate) metrics: Option<f64>,
    pub(crate) status: Option<f64>,
    pub(crate) resident_mib: f64,
    pub(crate) descriptors: usize,
    pub(crate) log_kib: f64,
    pub(crate) database_mib: f64,
    pub(crate) wal_mib: f64,
}

/// Process whose resources are sampled.
#[derive(Default)]
struct FollowedProcess {
    process: u32,
    log: PathBuf,
    /// Total size of the logs of earlier processes, bytes.
    earlier_logs: u64,
    event: Option<&'static str>,
}

/// Longest latencies of page, metrics and status since the last sample, seconds.
type LongestLatencies = Shared<[Option<f64>; 3]>;

pub(crate) struct Watch {
    followed: Shared<FollowedProcess>,
    samples: Shared<Vec<Sample>>,
    tasks: JoinSet<()>,
}

impl Watch {
    pub(crate) fn start(coordinator: CoordinatorAccess, crowd: Arc<Crowd>) -> Watch {
        let (followed, samples) =
            (Shared::<FollowedProcess>::default(), Shared::<Vec<Sample>>::default());
        let longest = LongestLatencies::default();
        let mut tasks = JoinSet::new();
        tasks.spawn(request_pages(coordinator.clone(), longest.clone(), 0));
        tasks.spawn(request_pages(coordinator.clone(), longest.clone(), 1));
        tasks.spawn(request_status(coordinator.clone(), longest.clone()));
        let (sampled, collected) = (followed.clone(), samples.clone());
        tasks.spawn(async move {
            let began = Instant::now();
            println!("{HEADINGS}");
            loop {
                tokio::time::sleep(INTERVAL).await;
                let sample = sample(began, &coordinator.data, &sampled, &longest, &crowd);
                println!("{}", sample.line(crowd.other_counts()));
                collected.lock().expect("no panic").push(sample);
            }
        });
        Watch { followed, samples, tasks }
    }

    /// Switches the sampling to a restarted process.
    pub(crate) fn follow(&self, process: u32, log: &Path) {
        let mut followed = self.followed.lock().expect("no panic");
        followed.earlier_logs += size(&followed.log);
        followed.process = process;
        followed.log = log.to_owned();
    }

    pub(crate) fn record_event(&self, event: &'static str) {
        self.followed.lock().expect("no panic").event = Some(event);
    }

    pub(crate) async fn stop(mut self) -> Vec<Sample> {
        self.tasks.shutdown().await;
        std::mem::take(&mut *self.samples.lock().expect("no panic"))
    }
}

const HEADINGS: &str = " secs  results  claim p50/p99 ms  page/metrics/status ms   memory MiB  files  \
                        log KiB  database MiB  wal MiB  refused failed films";

impl Sample {
    fn line(&self, [refused, failed, films]: [u64; 3]) -> String {
        let ms =
            |secs: Option<f64>| secs.map_or("-".to_owned(), |secs| format!("{:.1}", secs * 1e3));
        format!(
            "{:5.0} {:8} {:>8}/{:<8} {:>8}/{}/{:<8} {:10.1} {:6} {:8.1} {:13.1} {:8.1} {:8} {:6} \
             {:5} {}",
            self.at,
            self.accepted,
            ms(self.claim_p50),
            ms(self.claim_p99),
            ms(self.page),
            ms(self.metrics),
            ms(self.status),
            self.resident_mib,
            self.descriptors,
            self.log_kib,
            self.database_mib,
            self.wal_mib,
            refused,
            failed,
            films,
            self.event.unwrap_or_default()
        )
    }
}

fn sample(
    began: Instant,
    data: &Path,
    followed: &Shared<FollowedProcess>,
    longest: &LongestLatencies,
    crowd: &Crowd,
) -> Sample {
    let mut claims = crowd.take_claims();
    claims.sort_by(f64::total_cmp);
    let quantile = |share: f64| {
        let index = (claims.len() as f64 * share) as usize;
        claims.get(index.min(claims.len().saturating_sub(1))).copied()
    };
    let mut followed = followed.lock().expect("no panic");
    let process = format!("/proc/{}", followed.process);
    let status = std::fs::read_to_string(format!("{process}/status")).unwrap_or_default();
    let resident = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let resident = resident.and_then(|text| text.trim().strip_suffix(" kB")?.parse::<f64>().ok());
    let descriptors = std::fs::read_dir(format!("{process}/fd"));
    let mib = |name: &str| size(&data.join(name)) as f64 / f64::from(1 << 20);
    let [page, metrics, status] = std::mem::take(&mut *longest.lock().expect("no panic"));
    Sample {
        at: began.elapsed().as_secs_f64(),
        event: followed.event.take(),
        accepted: crowd.accepted(),
        claim_p50: quantile(0.5),
        claim_p99: quantile(0.99),
        page,
        metrics,
        status,
        resident_mib: resident.unwrap_or_default() / 1024.0,
        descriptors: descriptors.map_or(0, Iterator::count),
        log_kib: (followed.earlier_logs + size(&followed.log)) as f64 / 1024.0,
        database_mib: mib("coordinator.sqlite"),
        wal_mib: mib("coordinator.sqlite-wal"),
    }
}

fn size(file: &Path) -> u64 {
    std::fs::metadata(file).map_or(0, |metadata| metadata.len())
}

fn record_latency(longest: &LongestLatencies, kind: usize, took: Duration) {
    let longest = &mut longest.lock().expect("no panic")[kind];
    *longest = Some(longest.unwrap_or_default().max(took.as_secs_f64()));
}

/// Requests the pages in turn (kind 0) or the metrics (kind 1).
async fn request_pages(coordinator: CoordinatorAccess, longest: LongestLatencies, kind: usize) {
    for turn in 0_usize.. {
        tokio::time::sleep(REQUEST_INTERVAL).await;
        let path = match kind {
            0 => PAGES[turn % PAGES.len()],
            _ => "/metrics",
        };
        let sent_at = Instant::now();
        // Failed requests are not counted, since the coordinator is down at times.
        if get(&coordinator, path).await.is_ok() {
            record_latency(&longest, kind, sent_at.elapsed());
        }
    }
}

async fn get(coordinator: &CoordinatorAccess, path: &str) -> Result<()> {
    let uri: tonic::codegen::http::Uri = coordinator.url.parse()?;
    let authority = uri.authority().map(ToString::to_string).unwrap_or_default();
    let stream = TcpStream::connect(&authority).await?;
    let mut stream = coordinator.viewer.encrypt(stream, "localhost").await?;
    let token = coordinator.viewer.authorization(&uri, "Bearer");
    let token = token.as_ref().and_then(|value| value.to_str().ok()).unwrap_or_default();
    let request = format!(
        "GET {path} HTTP/1.1\r\nHost: {authority}\r\nAuthorization: {token}\r\nConnection: close\r\n\r\n"
    );
    stream.write_all(request.as_bytes()).await?;
    let mut answer = Vec::new();
    // A server that closes immediately may omit TLS's close_notify, whose absence fails the read.
    let _ = stream.read_to_end(&mut answer).await;
    match answer.starts_with(b"HTTP/1.1 200") {
        true => Ok(()),
        false => bail!("{}", String::from_utf8_lossy(&answer[..answer.len().min(60)])),
    }
}

async fn request_status(coordinator: CoordinatorAccess, longest: LongestLatencies) {
    let endpoint = Endpoint::from_shared(coordinator.url.clone()).expect("a URL");
    let connection = coordinator.operator.connect_lazy(endpoint).expect("a host");
    let mut client = OperatorServiceClient::new(connection);
    loop {
        tokio::time::sleep(REQUEST_INTERVAL).await;
        let sent_at = Instant::now();
        let listed = client.list_campaigns(wire::ListCampaignsRequest::default()).await;
        if listed.is_ok() {
            record_latency(&longest, 2, sent_at.elapsed());
        }
    }
}

/// Compares the last third of the samples with the second third: a quantity that still grows in the
/// last third is assumed to grow without bound.
///
/// # Errors
/// If a quantity grew beyond its tolerance.
pub(crate) fn check_growth(samples: &[Sample]) -> Result<()> {
    let third = samples.len() / 3;
    if third < 3 {
        println!("too few samples to detect growth");
        return Ok(());
    }
    let (before, last) = (&samples[third..2 * third], &samples[2 * third..]);
    let most =
        |part: &[Sample], value: fn(&Sample) -> f64| part.iter().map(value).fold(0.0, f64::max);
    let median = |part: &[Sample], value: fn(&Sample) -> Option<f64>| {
        let mut values: Vec<f64> = part.iter().filter_map(value).collect();
        values.sort_by(f64::total_cmp);
        values.get(values.len() / 2).copied().unwrap_or_default()
    };
    let growth_per_result = |part: &[Sample], value: fn(&Sample) -> f64| {
        let results = |sample: &Sample| sample.accepted as f64;
        let result_count = results(&part[part.len() - 1]) - results(&part[0]);
        (value(&part[part.len() - 1]) - value(&part[0])) / result_count.max(1.0)
    };
    let (memory, files) =
        (|sample: &Sample| sample.resident_mib, |sample: &Sample| sample.descriptors as f64);
    let (log, wal) = (|sample: &Sample| sample.log_kib, |sample: &Sample| sample.wal_mib);
    let claims =
        (median(before, |sample| sample.claim_p99), median(last, |sample| sample.claim_p99));
    // Name, value in the second third, value in the last third, and the factor and the addend that
    // give the largest allowed value.
    let rows = [
        ("memory, MiB", most(before, memory), most(last, memory), 1.25, 64.0),
        ("open files", most(before, files), most(last, files), 1.1, 16.0),
        (
            "log, KiB a result",
            growth_per_result(before, log),
            growth_per_result(last, log),
            2.0,
            0.01,
        ),
        ("write-ahead log, MiB", most(before, wal), most(last, wal), 1.5, 64.0),
        ("claims' p99, ms", claims.0 * 1e3, claims.1 * 1e3, 2.0, 50.0),
    ];
    let mut has_grown = Vec::new();
    println!("\n{:24} {:>12} {:>12} {:>12}", "", "before", "at the end", "allowed");
    for (name, before, last, factor, addend) in rows {
        let allowed = before * factor + addend;
        println!("{name:24} {before:12.3} {last:12.3} {allowed:12.3}");
        if last > allowed {
            has_grown.push(name);
        }
    }
    match has_grown.is_empty() {
        true => Ok(()),
        false => bail!("bound the resources: {} grew in the last third", has_grown.join(", ")),
    }
}
