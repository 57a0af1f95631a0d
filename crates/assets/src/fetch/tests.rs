//! Fetches from a hub on this machine, over real sockets.

mod test_hub;

use std::fs;
use std::net::TcpListener;
use std::path::{Path, PathBuf};

use tempfile::TempDir;

use super::*;
use crate::hub::Program;
use test_hub::{COMMIT, Fault, LARGE, SMALL, TestHub, content};

/// What a fetch did.
struct Fetched {
    outcome: Result<Manifest, AssetsError>,
    pauses: usize,
    last: Option<Progress>,
}

const PROGRAM: Program = Program {
    occupied: "look whether it is whole",
    assets: "--assets",
};

fn fetch(hub: &str, into: &Path) -> Fetched {
    fetch_while(hub, into, |_| true)
}

fn fetch_while(hub: &str, into: &Path, mut goes_on: impl FnMut(Progress) -> bool) -> Fetched {
    let (mut pauses, mut last) = (0, None);
    let hub = Hub::new(hub, PROGRAM);
    let mut fetch = Fetch {
        hub: &hub,
        into,
        pause: &mut |_| pauses += 1,
        progress: &mut |progress| {
            last = Some(progress);
            match goes_on(progress) {
                true => ControlFlow::Continue(()),
                false => ControlFlow::Break(()),
            }
        },
    };
    let outcome = fetch.run();
    Fetched {
        outcome,
        pauses,
        last,
    }
}

fn place() -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("a folder");
    let into = folder.path().join("packs/libero");
    (folder, into)
}

fn check_whole(into: &Path) {
    for path in [LARGE, SMALL] {
        let found = fs::read(into.join(path)).expect("is there");
        assert!(found == content(path), "{path}");
    }
    let entries = fs::read_dir(into.join("scenes")).expect("a folder");
    assert_eq!(entries.count(), 2, "nothing is left over");
    let recorded = fs::read_to_string(Manifest::beside(into)).expect("is there");
    let recorded: Manifest = recorded.parse().expect("a manifest");
    let found = Manifest::of_folder(into).expect("reads");
    assert_eq!(recorded.compare(&found), Vec::<String>::new());
}

fn error_of(fetched: Fetched) -> String {
    let error = fetched.outcome.expect_err("no pack");
    error.to_string()
}

#[test]
fn a_pack_is_fetched_whole_with_its_manifest_beside_it() {
    let (_folder, into) = place();
    let hub = TestHub::start(Fault::None);
    let fetched = fetch(&hub.url(), &into);
    assert_eq!(fetched.outcome.expect("a pack").count(), 2);
    assert_eq!(fetched.pauses, 0);
    let last = fetched.last.expect("progress");
    assert_eq!((last.files, last.bytes), (2, last.of_bytes));
    check_whole(&into);
    let again = error_of(fetch(&hub.url(), &into));
    assert!(
        again.ends_with("there already; look whether it is whole"),
        "{again}"
    );
}

#[test]
fn what_a_cut_connection_has_brought_is_not_asked_for_again() {
    let (_folder, into) = place();
    let hub = TestHub::start(Fault::CutsMidway);
    let fetched = fetch(&hub.url(), &into);
    fetched.outcome.expect("a pack");
    assert_eq!(fetched.pauses, 2);
    check_whole(&into);
    let seen = hub.seen();
    let large: Vec<&String> = seen.iter().filter(|path| path.contains("store")).collect();
    assert_eq!(
        large,
        [
            "/store/large",
            "/store/large from 200000",
            "/store/large from 300000"
        ]
    );
}

#[test]
fn a_hub_without_ranges_sends_the_file_again() {
    let (_folder, into) = place();
    let hub = TestHub::start(Fault::CutsOnceWithoutRanges);
    let fetched = fetch(&hub.url(), &into);
    fetched.outcome.expect("a pack");
    assert_eq!(fetched.pauses, 1);
    check_whole(&into);
}

#[test]
fn an_interrupted_fetch_goes_on_with_what_is_there() {
    let (_folder, into) = place();
    let gathering = into.with_file_name(format!("libero.fetching-{}", &COMMIT[..SHORT_COMMIT]));
    fs::create_dir_all(gathering.join("scenes")).expect("makes");
    let half = &content(LARGE)[..123_456];
    fs::write(gathering.join(format!("{LARGE}.part")), half).expect("writes");
    fs::write(gathering.join(SMALL), content(SMALL)).expect("writes");
    let hub = TestHub::start(Fault::None);
    fetch(&hub.url(), &into).outcome.expect("a pack");
    check_whole(&into);
    let seen = hub.seen();
    assert!(
        seen.contains(&"/store/large from 123456".to_owned()),
        "{seen:?}"
    );
    assert!(!seen.iter().any(|path| path.ends_with(SMALL)), "{seen:?}");
}

#[test]
fn a_fetch_that_is_stopped_keeps_what_has_arrived_for_the_next_one() {
    let (_folder, into) = place();
    let hub = TestHub::start(Fault::None);
    let mut arrived = 0;
    let stopped = fetch_while(&hub.url(), &into, |progress| {
        arrived = progress.bytes;
        arrived < 100_000
    });
    let error = stopped.outcome.expect_err("stopped");
    assert!(matches!(error, AssetsError::Interrupted), "{error}");
    assert!(!into.exists());
    fetch(&hub.url(), &into).outcome.expect("a pack");
    check_whole(&into);
    let seen = hub.seen();
    let rest = format!("/store/large from {arrived}");
    assert!(seen.contains(&rest), "{arrived}: {seen:?}");
}

#[test]
fn two_fetches_into_one_folder_do_not_mix_their_bytes() {
    let (_folder, into) = place();
    let hub = TestHub::start(Fault::None);
    let mut second = None;
    let first = fetch_while(&hub.url(), &into, |_| {
        second.get_or_insert_with(|| error_of(fetch(&hub.url(), &into)));
        true
    });
    first.outcome.expect("a pack");
    let second = second.expect("was tried");
    assert!(second.contains("under way"), "{second}");
    check_whole(&into);
}

#[test]
fn a_file_with_another_checksum_never_becomes_part_of_a_pack() {
    let (_folder, into) = place();
    let hub = TestHub::start(Fault::WrongBytes);
    let error = error_of(fetch(&hub.url(), &into));
    assert!(error.contains("large%20texture.png"), "{error}");
    assert!(
        error.contains("SHA-256") && error.contains("5 times"),
        "{error}"
    );
    assert!(!into.exists());
    let kept = into.with_file_name(format!("libero.fetching-{}", &COMMIT[..SHORT_COMMIT]));
    assert!(!kept.join(LARGE).exists() && !kept.join(format!("{LARGE}.part")).exists());
}

#[test]
fn a_busy_hub_is_asked_again_and_one_that_refuses_is_not() {
    let (_folder, into) = place();
    let busy = TestHub::start(Fault::BusyAtFirst);
    let fetched = fetch(&busy.url(), &into);
    fetched.outcome.expect("a pack");
    assert_eq!(fetched.pauses, 2);

    let (_folder, into) = place();
    let refusing = TestHub::start(Fault::Forbidden);
    let fetched = fetch(&refusing.url(), &into);
    assert_eq!(fetched.pauses, 0);
    let error = error_of(fetched);
    assert!(
        error.contains("403") && error.contains("--assets"),
        "{error}"
    );
}

#[test]
fn a_hub_that_cannot_be_reached_is_named_with_what_to_do_instead() {
    let (_folder, into) = place();
    let port = {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        listener.local_addr().expect("an address").port()
    };
    let url = format!("http://127.0.0.1:{port}");
    let fetched = fetch(&url, &into);
    assert_eq!(fetched.pauses, 4);
    let error = error_of(fetched);
    for words in [&url, "tried 5 times", "--hub", "copy the assets folder"] {
        assert!(error.contains(words), "{error}");
    }
    assert!(!into.exists());
}

#[test]
fn a_listing_that_leads_out_of_the_pack_is_refused() {
    let (_folder, into) = place();
    let hub = TestHub::start(Fault::LeadsOut);
    let error = error_of(fetch(&hub.url(), &into));
    assert!(error.contains("scenes/../../room.xml"), "{error}");
}
