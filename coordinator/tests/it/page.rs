//! The live page and the metrics over HTTP: their content, access to them, and the answers to
//! hostile addresses. Layout and scripts are tested in a browser, in `tests/tests/page.rs` of the
//! package `tests`.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::Duration;

use proto::coordinator::release_request::Reason;

use crate::access::{GuardedCoordinator, OPERATOR, VIEWER, WORKER};
use crate::artifacts::put;
use crate::assertions::assert_contains;
use crate::harness::{Bench, small_spec};
use crate::process::{coordinator, text};

const READ_TIMEOUT: Duration = Duration::from_secs(30);

/// An answer over HTTP/1.1.
pub(crate) struct Answer {
    pub(crate) code: u16,
    head: String,
    pub(crate) body: Vec<u8>,
}

impl Answer {
    pub(crate) fn text(&self) -> String {
        String::from_utf8_lossy(&self.body).into_owned()
    }

    pub(crate) fn header(&self, name: &str) -> Option<&str> {
        let mut lines = self.head.lines().filter_map(|line| line.split_once(": "));
        let header = lines.find(|(key, _)| key.eq_ignore_ascii_case(name));
        header.map(|(_, value)| value)
    }
}

/// Sends a request unchanged, since a client that normalises addresses would hide the tested cases.
/// The chunks of a chunked answer are joined.
pub(crate) fn send(url: &str, request: &str) -> Answer {
    let address = url.strip_prefix("http://").expect("a URL");
    let mut stream = TcpStream::connect(address).expect("a connection");
    stream.set_read_timeout(Some(READ_TIMEOUT)).expect("set");
    let (head, body) = request.split_once("\n\n").unwrap_or((request, ""));
    let (request_line, header_lines) = head.split_once('\n').unwrap_or((head, ""));
    let host = match header_lines.contains("host: ") {
        true => String::new(),
        false => format!("host: {address}\r\n"),
    };
    let mut headers = String::new();
    for line in header_lines.lines().filter(|line| !line.is_empty()) {
        headers.push_str(&format!("{line}\r\n"));
    }
    let length = body.len();
    let text = format!(
        "{request_line} HTTP/1.1\r\n{host}{headers}content-length: {length}\r\nconnection: close\r\n\r\n{body}"
    );
    stream.write_all(text.as_bytes()).expect("sent");
    let mut bytes = Vec::new();
    stream.read_to_end(&mut bytes).expect("an answer");
    let end = bytes.windows(4).position(|w| w == b"\r\n\r\n").expect("a head");
    let head = String::from_utf8_lossy(&bytes[..end]).into_owned();
    let code = head.split(' ').nth(1).and_then(|code| code.parse().ok());
    let mut answer =
        Answer { code: code.expect("a status"), head, body: bytes[end + 4..].to_vec() };
    if answer.header("transfer-encoding") == Some("chunked") {
        answer.body = join_chunks(&answer.body);
    }
    answer
}

fn join_chunks(mut chunks: &[u8]) -> Vec<u8> {
    let mut body = Vec::new();
    while let Some(end) = chunks.windows(2).position(|w| w == b"\r\n") {
        let length = std::str::from_utf8(&chunks[..end]).expect("a length");
        let length = usize::from_str_radix(length, 16).expect("a length");
        body.extend_from_slice(&chunks[end + 2..end + 2 + length]);
        chunks = &chunks[end + 4 + length..];
    }
    body
}

/// Like [`send`], on a blocking thread; waits for the figures of a page.
pub(crate) async fn http(url: &str, request: &str) -> Answer {
    loop {
        let (url, request) = (url.to_owned(), request.to_owned());
        let answer = tokio::task::spawn_blocking(move || send(&url, &request));
        let answer = answer.await.expect("an answer");
        if !answer.text().contains("figures are being computed") {
            return answer;
        }
    }
}

/// Starts a coordinator with a campaign that has two results and two queued jobs.
async fn half_finished() -> Bench {
    let bench = Bench::with(&small_spec("begun")).await;
    let mut worker = bench.worker("w").await;
    for success in [true, false] {
        let lease = worker.claim_one().await;
        worker.commit(&lease, success).await;
    }
    bench
}

#[tokio::test(flavor = "multi_thread")]
async fn every_page_shows_its_content_and_loads_nothing_external() {
    let bench = half_finished().await;
    let configuration = "/campaigns/begun/configurations/object/t0/simultaneous/L1/c00";
    for (address, words) in [
        ("/", &["Campaigns", "begun", "50 %", "2 of 4 rollouts", "expert"][..]),
        (
            "/campaigns/begun",
            &["Success by suite", "camera", "sensor", "simultaneous", "nominal", "1 missing"],
        ),
        (
            configuration,
            &[
                "✓ success",
                "hand from above",
                "✗ failure",
                "waiting",
                "azimuth",
                "JPEG quality",
                "policy seed",
                "llvmpipe",
            ],
        ),
        ("/campaigns/begun/rollouts?state=committed", &["object/t0/", "success after 120 steps"]),
        ("/campaigns/begun/rollouts?id=object/t0/camera/L1/c00", &["object/t0/camera/L1/c00"]),
        ("/workers", &["bench", "0 of 2", "primitives", "MuJoCo 3.3.7"]),
        ("/policies", &["expert", "available", "http://127.0.0.1:50051", "begun"]),
        ("/quarantine", &["Nothing is in quarantine"]),
    ] {
        let answer = http(&bench.url, &format!("GET {address}")).await;
        assert_eq!(answer.code, 200, "{address}: {}", answer.text());
        for word in words {
            assert!(answer.text().contains(word), "no `{word}` in {address}:\n{}", answer.text());
        }
        let policy = answer.header("content-security-policy").expect("a policy");
        assert!(policy.starts_with("default-src 'none'"), "{policy}");
        assert_eq!(answer.header("cache-control"), Some("no-store"));
        // A browser that already has the page does not get it again.
        let tag = answer.header("etag").expect("a tag");
        let second = http(&bench.url, &format!("GET {address}\nif-none-match: {tag}")).await;
        assert_eq!((second.code, second.body.len()), (304, 0), "{address}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn pages_describe_outages_and_quarantine() {
    let bench = half_finished().await;
    let (mut worker, lease) = bench.worker_with_lease("w").await;
    worker.release(&lease, Reason::PolicyUnavailable).await;
    let page = http(&bench.url, "GET /policies").await.text();
    assert_contains(&page, &["paused", "is tried again", "simulated failure"]);
    let page = http(&bench.url, "GET /campaigns/begun").await.text();
    assert!(page.contains("Policy expert is paused"), "{page}");
}

/// Regression: the page showed "no attempt is charged" where `jobs` printed "1 charged".
#[tokio::test(flavor = "multi_thread")]
async fn page_and_command_line_agree_on_charges_for_invalid_answers() {
    let bench = half_finished().await;
    let mut worker = bench.worker("w").await;
    for attempt in 1..=5 {
        // Waits longer than the back-off of a failed rollout.
        bench.advance(10).await;
        let lease = worker.claim_one().await;
        worker.release(&lease, Reason::PolicyMisbehaved).await;
        let page = http(&bench.url, "GET /policies").await.text();
        assert!(attempt == 5 || !page.contains(">paused<"), "{page}");
    }
    let listed = coordinator(&["jobs", "begun", "--connect", &bench.url]);
    let listed = text(&listed.stdout).to_owned();
    assert!(listed.contains("2 charged"), "{listed}");
    // A page is cached for a second.
    tokio::time::sleep(Duration::from_millis(1100)).await;
    let page = http(&bench.url, "GET /policies").await.text();
    assert!(!page.contains("no attempt is charged"), "{page}");
    let words = "broke the protocol in 5 attempts since its last result, each of which is charged";
    assert!(page.contains(words), "{page}");
}

#[tokio::test(flavor = "multi_thread")]
async fn invalid_addresses_give_error_pages_with_a_remedy() {
    let bench = half_finished().await;
    std::fs::write(bench.folder.path().join("secret"), "hunter2").expect("written");
    let long = "x".repeat(4_000);
    for (address, code) in [
        ("/nowhere", 404),
        ("/campaigns/deleted", 404),
        ("/campaigns/..%2f..%2fsecret", 404),
        ("/campaigns/%3Cscript%3E", 404),
        ("/campaigns/begun/configurations/object/t0/camera/L1/c99", 404),
        ("/campaigns/begun/configurations/%00", 404),
        ("/campaigns/begun/configurations/object/t0/camera/L1/c00?replicate=-1", 400),
        ("/campaigns/begun/configurations/object/t0/camera/L1/c00?replicate=7", 404),
        ("/campaigns/begun/rollouts?state=all&after=x", 400),
        ("/campaigns/begun/rollouts?state=committed'--", 400),
        ("/campaigns/begun/videos/object/t0/camera/L1/c00", 404),
        ("/campaigns/begun/videos/../../../secret", 404),
        ("/campaigns/begun/videos/..%2f..%2f..%2fsecret", 404),
        (&format!("/campaigns/begun?{long}"), 400),
        (&format!("/campaigns/{long}"), 400),
    ] {
        let answer = http(&bench.url, &format!("GET {address}")).await;
        let text = answer.text();
        assert_eq!(answer.code, code, "{address}: {text}");
        assert!(text.contains("All campaigns"), "{address}: {text}");
        assert!(!text.contains("<script>") && !text.contains("hunter2"), "{text}");
        assert!(text.len() < 4_000, "{address} is echoed");
    }
    let posted = http(&bench.url, "POST /campaigns/begun\n\nstate=cancelled").await;
    assert_eq!(posted.code, 405);
}

#[tokio::test(flavor = "multi_thread")]
async fn text_from_workers_is_escaped_in_pages() {
    let bench = Bench::with(&small_spec("tricked")).await;
    let mut worker = bench.worker("<script>alert(1)</script>").await;
    let lease = worker.claim_one().await;
    worker.release(&lease, Reason::SimulatorError).await;
    for address in ["/workers", "/campaigns/tricked/configurations/object/t0/nominal/i16"] {
        let page = http(&bench.url, &format!("GET {address}")).await.text();
        assert!(page.contains("&lt;script&gt;alert"), "{page}");
        assert!(!page.contains("<script>alert"), "{page}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_video_is_sent_whole_and_in_ranges() {
    let bench = Bench::with(&small_spec("filmed")).await;
    let (mut worker, lease) = bench.worker_with_lease("w").await;
    worker.commit(&lease, true).await;
    let film: Vec<u8> = (0..200_000_u32).map(|n| n.to_le_bytes()[0]).collect();
    put(&mut worker, &lease, "video.mp4", std::slice::from_ref(&film)).await.expect("stored");
    let address = "/campaigns/filmed/videos/object/t0/nominal/i16?replicate=0";
    let whole = http(&bench.url, &format!("GET {address}")).await;
    assert_eq!((whole.code, whole.header("accept-ranges")), (200, Some("bytes")));
    assert_eq!(whole.header("content-type"), Some("video/mp4"));
    assert_eq!(whole.header("x-content-type-options"), Some("nosniff"));
    let policy = whole.header("content-security-policy").expect("a policy");
    assert!(policy.starts_with("sandbox; default-src 'none'"), "{policy}");
    assert_eq!(whole.body, film);
    let part = http(&bench.url, &format!("GET {address}\nrange: bytes=100000-100009")).await;
    assert_eq!(part.code, 206);
    assert_eq!(part.header("content-range"), Some("bytes 100000-100009/200000"));
    assert_eq!(part.body, film[100_000..100_010]);
    let beyond_end = http(&bench.url, &format!("GET {address}\nrange: bytes=200000-")).await;
    assert_eq!(
        (beyond_end.code, beyond_end.header("content-range")),
        (416, Some("bytes */200000"))
    );

    // Paths in the database that lead out of the artifacts folder are not served.
    let database = bench.database().await;
    std::fs::write(bench.folder.path().join("outside"), "outside").expect("written");
    std::fs::write(bench.folder.path().join("artifacts/page.html"), "<p>").expect("written");
    for path in [
        "artifacts/../outside",
        "/etc/passwd",
        "outside",
        // Only videos are served: a page from this server could read all other pages.
        "artifacts/page.html",
    ] {
        let update = sqlx::query("UPDATE artifact SET path = ?").bind(path);
        update.execute(&database).await.expect("altered");
        let answer = http(&bench.url, &format!("GET {address}")).await;
        assert_eq!(answer.code, 404, "{path}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn metrics_are_valid_prometheus_text() {
    let bench = half_finished().await;
    let answer = http(&bench.url, "GET /metrics").await;
    assert_eq!(answer.header("content-type"), Some("text/plain; version=0.0.4; charset=utf-8"));
    let text = answer.text();
    for line in [
        "rollout_jobs{campaign=\"begun\",state=\"committed\"} 2",
        "rollout_jobs{campaign=\"begun\",state=\"queued\"} 2",
        "rollout_commits_total{campaign=\"begun\",outcome=\"success\"} 1",
        "rollout_attempts_ended_total{ending=\"committed\"} 2",
        "rollout_policy_state{policy=\"expert\",endpoint=\"http://127.0.0.1:50051\",state=\"available\"} 1",
        "rollout_claims_waiting 0",
        "rollout_workers_alive 1",
        "rollout_worker_slots_alive 2",
        "rollout_page_streams 0",
    ] {
        assert!(text.lines().any(|found| found == line), "no {line}\n{text}");
    }
    // Every sample belongs to the family announced before it, and each family occurs once.
    let mut family = "";
    let mut families = Vec::new();
    for line in text.lines() {
        match line.strip_prefix("# TYPE ").and_then(|line| line.split(' ').next()) {
            Some(name) => {
                family = name;
                families.push(name);
            }
            None if line.starts_with('#') => {}
            None => assert!(line.starts_with(family), "{line} under {family}"),
        }
    }
    let count = families.len();
    families.sort_unstable();
    families.dedup();
    assert_eq!(families.len(), count);
}

#[tokio::test(flavor = "multi_thread")]
async fn the_stream_reports_a_commit_and_ends_with_the_coordinator() {
    let bench = half_finished().await;
    let address = bench.url.strip_prefix("http://").expect("a URL").to_owned();
    let (sender, receiver) = std::sync::mpsc::channel();
    let reader = std::thread::spawn(move || {
        let mut stream = TcpStream::connect(&address).expect("a connection");
        stream.set_read_timeout(Some(READ_TIMEOUT)).expect("set");
        let request = format!("GET /events HTTP/1.1\r\nhost: {address}\r\n\r\n");
        stream.write_all(request.as_bytes()).expect("sent");
        let mut buffer = [0; 4_096];
        loop {
            let count = stream.read(&mut buffer).expect("an event or the end of the stream");
            let text = String::from_utf8_lossy(&buffer[..count]).into_owned();
            if count == 0 || sender.send(text).is_err() {
                return;
            }
        }
    });
    let until = |word: &str| {
        let mut text = String::new();
        while !text.contains(word) {
            text.push_str(&receiver.recv_timeout(READ_TIMEOUT).expect(word));
        }
    };
    until("data: 0");
    let (mut worker, lease) = bench.worker_with_lease("another").await;
    worker.commit(&lease, true).await;
    tokio::task::block_in_place(|| until("data: 1"));
    bench.stop().await;
    reader.join().expect("the stream ended");
}

#[tokio::test(flavor = "multi_thread")]
async fn streams_are_bounded_and_closing_one_admits_another() {
    let bench = half_finished().await;
    let address = bench.url.strip_prefix("http://").expect("a URL");
    let follow = || {
        let mut stream = TcpStream::connect(address).expect("a connection");
        stream.set_read_timeout(Some(READ_TIMEOUT)).expect("set");
        let request = format!("GET /events HTTP/1.1\r\nhost: {address}\r\n\r\n");
        stream.write_all(request.as_bytes()).expect("sent");
        let mut status = [0; 12];
        stream.read_exact(&mut status).expect("a status");
        (stream, status == *b"HTTP/1.1 200")
    };
    let mut open_streams: Vec<TcpStream> = Vec::new();
    for _ in 0..128 {
        let (stream, is_open) = follow();
        assert!(is_open, "only {} streams are open", open_streams.len());
        open_streams.push(stream);
    }
    assert!(!follow().1, "the 129th stream is refused");
    open_streams.clear();
    // The server notices that streams have closed only when it sends something to them.
    let mut tries = 0;
    while !follow().1 {
        tries += 1;
        assert!(tries < 100, "no stream was freed");
        tokio::time::sleep(Duration::from_millis(200)).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn pages_need_a_login_and_refuse_worker_tokens() {
    let guarded = GuardedCoordinator::start(&[]);
    let url = guarded.url();
    let redirected = http(url, "GET /campaigns/a?b=c\naccept: text/html").await;
    assert_eq!(redirected.code, 303);
    assert_eq!(redirected.header("location"), Some("/login?next=/campaigns/a%3Fb%3Dc"));
    let form = http(url, "GET /login?next=/workers\naccept: text/html").await;
    assert!(form.code == 200 && form.text().contains("value=\"/workers\""), "{}", form.text());

    let log_in = |token: &str| format!("POST /login\n\nnext=%2Fworkers&token={token}");
    for refused in ["wrong-secret-0123456789", WORKER, ""] {
        let answer = http(url, &log_in(refused)).await;
        assert_eq!((answer.code, answer.header("set-cookie")), (401, None));
        assert!(answer.text().contains("no token of a viewer"), "{}", answer.text());
    }
    let answer = http(url, &log_in(VIEWER)).await;
    assert_eq!((answer.code, answer.header("location")), (303, Some("/workers")));
    let cookie = answer.header("set-cookie").expect("a cookie");
    assert!(cookie.contains("HttpOnly; SameSite=Strict"), "{cookie}");
    assert!(cookie.contains("Max-Age=43200"), "{cookie}");
    let cookie = cookie.split(';').next().expect("a pair");
    let hex = hex::encode(VIEWER);
    assert!(!cookie.contains(VIEWER) && !cookie.contains(&hex), "{cookie}");
    let page = http(url, &format!("GET /workers\ncookie: {cookie}")).await;
    assert!(page.code == 200 && page.text().contains("Log out"), "{}", page.text());

    // A client that may not read pages is refused. A token in a header replaces the login.
    for (token, code) in
        [(None, 401), (Some(WORKER), 403), (Some(VIEWER), 200), (Some(OPERATOR), 200)]
    {
        let bearer = token.map(|token| format!("\nauthorization: Bearer {token}"));
        let answer = http(url, &format!("GET /metrics{}", bearer.unwrap_or_default())).await;
        assert_eq!(answer.code, code, "{token:?}");
    }
    // A cookie gives access to no call.
    let call = "/rollout.coordinator.v1.OperatorService/ListCampaigns";
    let call = format!("POST {call}\ncontent-type: application/grpc\ncookie: {cookie}");
    let answer = http(url, &call).await;
    assert_ne!(answer.header("grpc-status"), Some("0"));
    let logout = http(url, &format!("POST /logout\ncookie: {cookie}\n\n")).await;
    assert!(logout.header("set-cookie").is_some_and(|set| set.contains("Max-Age=0")));
    // The session has ended, even for a client that kept its id.
    let page = http(url, &format!("GET /workers\ncookie: {cookie}")).await;
    assert_eq!(page.code, 401, "{}", page.text());
    // Refusals: a missing or wrong token, a token of another role, and a call by a browser.
    assert_eq!(guarded.logged("was refused"), 3, "each kind is logged once");
}

#[tokio::test(flavor = "multi_thread")]
async fn pages_of_other_sites_can_neither_read_nor_call() {
    let bench = half_finished().await;
    // A DNS name of another site that resolves to this machine.
    let rebound = http(&bench.url, "GET /\nhost: evil.example:7411").await;
    assert_eq!(rebound.code, 403);
    assert!(!rebound.text().contains("begun"), "{}", rebound.text());
    let delete = "POST /rollout.coordinator.v1.OperatorService/DeleteCampaign";
    let call = http(&bench.url, &format!("{delete}\ncontent-type: application/grpc")).await;
    assert_eq!(call.header("grpc-status"), Some("3"), "{}", call.head);
    // A body that a page may send without a preflight request: a complete message as plain text.
    let message = "\0\0\0\0\x0e\n\x05begun\x12\x05begun";
    for headers in [
        "content-type: text/plain\nsec-fetch-site: cross-site\norigin: https://evil.example",
        "content-type: text/plain\nsec-fetch-site: same-site\norigin: http://127.0.0.1:8888",
        "content-type: text/plain",
        "content-type: application/x-www-form-urlencoded",
    ] {
        let answer = http(&bench.url, &format!("{delete}\n{headers}\n\n{message}")).await;
        assert_ne!(answer.code, 200, "{headers}: {}", answer.head);
    }
    assert_eq!(bench.status("begun").await.rollouts.total(), 4);
    // The other site's page can neither read a page nor send a form.
    for request in [
        "GET /campaigns/begun\nsec-fetch-site: cross-site\nsec-fetch-mode: no-cors",
        "POST /login\norigin: https://evil.example\n\ntoken=x",
        "POST /logout\norigin: null\n\n",
    ] {
        let answer = http(&bench.url, request).await;
        assert_eq!(answer.code, 403, "{request}: {}", answer.text());
    }
    let link = "GET /campaigns/begun\nsec-fetch-site: cross-site\n\
        sec-fetch-mode: navigate\nsec-fetch-dest: document";
    assert_eq!(http(&bench.url, link).await.code, 200);
}

/// Regression: a page held one of four database connections while it requested two more,
/// so that a few tabs that refreshed together blocked each other.
#[tokio::test(flavor = "multi_thread")]
async fn concurrent_page_requests_do_not_block_each_other() {
    const TABS: usize = 24;
    let bench = half_finished().await;
    let addresses = [
        "/",
        "/campaigns/begun",
        "/campaigns/begun/configurations/object/t0/simultaneous/L1/c00",
        "/campaigns/begun/rollouts?state=committed",
        "/workers",
        "/policies",
    ];
    for _ in 0..4 {
        let tabs = addresses.iter().cycle().take(TABS);
        let requests = tabs.map(|address| {
            let url = bench.url.clone();
            async move { http(&url, &format!("GET {address}")).await.code }
        });
        // Waiting for a connection fails after 30 s.
        let answers =
            tokio::time::timeout(READ_TIMEOUT / 2, futures_util::future::join_all(requests));
        let codes = answers.await.expect("requests that do not block each other");
        assert_eq!(codes, [200; TABS]);
    }
}
