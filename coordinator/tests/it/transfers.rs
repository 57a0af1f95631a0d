//! Transfer of campaigns between coordinators, and the refusal of invalid archives.

use std::fs::File;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use flate2::Compression;
use flate2::read::GzDecoder;
use flate2::write::GzEncoder;
use proto::coordinator::Lease;
use proto::coordinator::commit_response::Verdict;
use proto::coordinator::release_request::Reason;
use queue::invariants::check;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use tempfile::TempDir;

use crate::artifacts::put;
use crate::harness::{Worker, rollout_id, rows, small_spec, with};
use crate::imports::alter;
use crate::process::{Serve, succeed, text};

static WORKERS: AtomicU32 = AtomicU32::new(0);

/// Three axes, alone and simultaneous, at three levels, and one nominal rollout: 13 rollouts.
pub(crate) fn spec() -> Value {
    with(
        small_spec("moved"),
        json!({"axes": ["camera", "sensor", "robot"], "levels": ["L1", "L2", "L3"]}),
    )
}

/// Returns the outcome of a rollout, which is the same on every machine.
pub(crate) fn succeeds(rollout: &str) -> bool {
    !rollout.contains("sensor/L2")
}

/// A running coordinator with its data folder and one worker.
pub(crate) struct Bench {
    pub(crate) folder: TempDir,
    pub(crate) serve: Serve,
    pub(crate) worker: Worker,
}

impl Bench {
    pub(crate) async fn empty() -> Bench {
        let (folder, serve) = Serve::anew();
        // Worker ids must be unique.
        let number = WORKERS.fetch_add(1, Ordering::Relaxed);
        let worker = serve.worker(&format!("w{number}")).await;
        Bench { folder, serve, worker }
    }

    pub(crate) async fn with(spec: &Value) -> Bench {
        let bench = Bench::empty().await;
        let file = bench.folder.path().join("spec.json");
        std::fs::write(&file, spec.to_string()).expect("written");
        let path = file.display().to_string();
        bench.succeed(&["campaign", "create", "--spec", &path]);
        bench
    }

    /// Commits at most `rollouts` rollouts, except those whose id contains `leave_out`.
    pub(crate) async fn run(&mut self, rollouts: usize, leave_out: &str) {
        let mut left_out = Vec::new();
        let mut committed = 0;
        while committed < rollouts {
            let leases = self.worker.claim(1).await;
            let [lease] = leases.as_slice() else { break };
            let id = rollout_id(lease);
            if !leave_out.is_empty() && id.contains(leave_out) {
                left_out.push(lease.clone());
                continue;
            }
            let verdict = self.worker.commit(lease, succeeds(&id)).await;
            assert_eq!(verdict, Verdict::Accepted);
            committed += 1;
        }
        for lease in left_out {
            self.worker.release(&lease, Reason::Draining).await;
        }
    }

    /// Runs a search until it has added rollouts. Returns the lease of one.
    pub(crate) async fn begin(&mut self, search: &[&str]) -> Lease {
        let mut command = Command::new(env!("CARGO_BIN_EXE_coordinator"));
        let command = command.args(search).args(["--connect", &self.serve.url]);
        let mut command = command.stdout(Stdio::null()).spawn().expect("starts");
        let claim = self.worker.try_claim(30.0, "").await.expect("an answer");
        command.kill().expect("a child");
        command.wait().expect("a child");
        claim.lease.expect("a rollout was added")
    }

    pub(crate) fn succeed(&self, arguments: &[&str]) -> String {
        succeed(self.serve.command(arguments))
    }

    pub(crate) fn refused(&self, arguments: &[&str]) -> String {
        let output = self.serve.command(arguments);
        assert!(!output.status.success(), "{}", text(&output.stdout));
        text(&output.stderr).to_owned()
    }

    pub(crate) fn archive(&self, name: &str) -> PathBuf {
        let file = self.folder.path().join(format!("{name}.tar.gz"));
        let path = file.display().to_string();
        self.succeed(&["campaign", "archive", name, "--output", &path]);
        file
    }

    pub(crate) fn import(&self, file: &Path) -> String {
        self.succeed(&["campaign", "import", &file.display().to_string()])
    }

    pub(crate) fn report(&self, name: &str) -> String {
        self.succeed(&["report", name, "--json"])
    }

    /// Returns all rows of the database except those of workers, which change with every call.
    pub(crate) async fn rows(&self) -> Vec<String> {
        let mut rows = rows(self.folder.path()).await;
        rows.retain(|row| !row.starts_with("worker: "));
        rows
    }

    pub(crate) async fn assert_invariants(&self) {
        let violations = check(self.folder.path()).await.expect("a database");
        assert_eq!(violations, []);
    }
}

/// Returns the members of an archive, in order.
pub(crate) fn members(file: &Path) -> Vec<(String, Vec<u8>)> {
    let mut tar = tar::Archive::new(GzDecoder::new(File::open(file).expect("an archive")));
    let entries = tar.entries().expect("members");
    let member = |entry: std::io::Result<tar::Entry<'_, _>>| {
        let mut entry = entry.expect("a member");
        let name = entry.path().expect("a name").display().to_string();
        let mut bytes = Vec::new();
        entry.read_to_end(&mut bytes).expect("its bytes");
        (name, bytes)
    };
    entries.map(member).collect()
}

/// Writes an archive of `members`. With `recompute_contents`, the table of contents is computed
/// from the members.
pub(crate) fn write(file: &Path, members: &[(String, Vec<u8>)], recompute_contents: bool) {
    let mut members = members.to_vec();
    if recompute_contents {
        let mut list: Value = serde_json::from_slice(&members[0].1).expect("a list");
        let named = |(name, bytes): &(String, Vec<u8>)| {
            let digest = hex::encode(Sha256::digest(bytes));
            json!({"name": name, "bytes": bytes.len(), "sha256": digest})
        };
        list["members"] = members[1..].iter().map(named).collect();
        members[0].1 = list.to_string().into_bytes();
    }
    let out = GzEncoder::new(File::create(file).expect("a file"), Compression::fast());
    let mut tar = tar::Builder::new(out);
    for (name, bytes) in &members {
        let mut header = tar::Header::new_gnu();
        header.set_size(bytes.len() as u64);
        header.set_mode(0o644);
        // The name is written unchanged: `append_data` would refuse some of these names.
        header.as_old_mut().name[..name.len()].copy_from_slice(name.as_bytes());
        header.set_cksum();
        tar.append(&header, bytes.as_slice()).expect("written");
    }
    let mut out = tar.into_inner().expect("finished").finish().expect("finished");
    out.flush().expect("written");
}

/// Returns the name of a film of no attempt of the campaign.
fn film() -> String {
    format!("artifacts/moved/film.{:032x}.mp4", 1)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_moved_campaign_continues_at_another_coordinator_to_the_same_report() {
    let mut source = Bench::with(&spec()).await;
    source.run(5, "").await;
    let filmed = source.worker.claim_one().await;
    let success = succeeds(&rollout_id(&filmed));
    assert_eq!(source.worker.commit(&filmed, success).await, Verdict::Accepted);
    let film = [vec![7; 1_500_000]];
    put(&mut source.worker, &filmed, "video.mp4", &film).await.expect("stored");
    let failed = source.worker.claim_one().await;
    source.worker.release(&failed, Reason::SimulatorError).await;
    // One rollout is in progress while the campaign is archived.
    let held = source.worker.claim_one().await;
    source.succeed(&["campaign", "set", "moved", "--priority", "7"]);
    let before = source.rows().await;
    let file = source.archive("moved");
    assert_eq!(source.rows().await, before, "archiving changed rows");
    let first = (members(&file), std::fs::read(&file).expect("an archive"));
    source.archive("moved");
    for (before, after) in first.0.iter().zip(members(&file)) {
        assert!(*before == after, "{} has other bytes", before.0);
    }
    assert!(std::fs::read(&file).expect("an archive") == first.1);
    let entries = std::fs::read_dir(source.folder.path()).expect("a folder");
    let temporary_folders: Vec<_> = entries
        .map(|entry| entry.expect("an entry").file_name())
        .filter(|name| name.to_string_lossy().starts_with("moving-"))
        .collect();
    assert!(temporary_folders.is_empty(), "{temporary_folders:?}");

    let mut target = Bench::empty().await;
    let message = target.import(&file);
    assert!(message.contains("13 rollouts, 6 results and 1 film"), "{message}");
    target.assert_invariants().await;
    assert_eq!(target.report("moved"), source.report("moved"));
    assert_eq!(
        target.succeed(&["export", "moved", "--format", "jsonl"]),
        source.succeed(&["export", "moved", "--format", "jsonl"])
    );
    let films = target.folder.path().join("artifacts/moved");
    let films: Vec<_> = std::fs::read_dir(films).expect("films").collect();
    assert_eq!(films.len(), 1);
    let imported_film = films[0].as_ref().expect("a film").path();
    assert_eq!(std::fs::read(imported_film).expect("a film"), film[0]);
    let status: Value =
        serde_json::from_str(&target.succeed(&["campaign", "status", "moved", "--json"]))
            .expect("JSON");
    let status = status.to_string();
    assert!(status.contains("\"priority\":7"), "{status}");
    // The workers that reported the results are not alive at this coordinator.
    let workers = target.succeed(&["workers", "--all", "--json"]);
    let workers: Value = serde_json::from_str(&workers).expect("JSON");
    let workers = workers["workers"].as_array().expect("workers");
    let alive = workers.iter().filter(|worker| worker["is_alive"] == true);
    let alive: Vec<&Value> = alive.map(|worker| &worker["worker_id"]).collect();
    assert_eq!((workers.len(), alive), (2, vec![&json!(target.worker.id)]));

    // Both campaigns continue and end with the same report.
    let success = succeeds(&rollout_id(&held));
    assert_eq!(source.worker.commit(&held, success).await, Verdict::Accepted);
    for bench in [&mut source, &mut target] {
        tokio::time::sleep(Duration::from_millis(1_200)).await;
        bench.run(13, "").await;
        bench.assert_invariants().await;
    }
    assert_eq!(target.report("moved"), source.report("moved"));
}

#[tokio::test(flavor = "multi_thread")]
async fn importing_an_existing_name_is_refused_and_another_name_makes_a_copy() {
    let mut source = Bench::with(&spec()).await;
    source.run(4, "").await;
    let filmed = source.worker.claim_one().await;
    assert_eq!(source.worker.commit(&filmed, true).await, Verdict::Accepted);
    put(&mut source.worker, &filmed, "video.mp4", &[vec![1; 10]]).await.expect("stored");
    let file = source.archive("moved");
    let before = source.rows().await;
    let path = file.display().to_string();
    let message = source.refused(&["campaign", "import", &path]);
    assert!(message.contains("`moved`") && message.contains("--as NAME"), "{message}");
    assert_eq!(source.rows().await, before);

    // A copy beside the original shares no attempt id with it.
    source.succeed(&["campaign", "import", &path, "--as", "copy"]);
    source.assert_invariants().await;
    let original = source.report("moved").replace("\"moved\"", "\"copy\"");
    assert_eq!(source.report("copy"), original);
    let films = source.folder.path().join("artifacts/copy");
    assert_eq!(std::fs::read_dir(films).expect("films").count(), 1);
    source.run(64, "").await;
    source.assert_invariants().await;
    source.succeed(&["campaign", "delete", "moved", "--confirm", "moved"]);
    source.assert_invariants().await;
    let films = source.folder.path().join("artifacts/copy");
    assert_eq!(std::fs::read_dir(films).expect("films").count(), 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn invalid_archives_are_refused_by_name_and_change_nothing() {
    let mut source = Bench::with(&spec()).await;
    source.run(6, "").await;
    let file = source.archive("moved");
    let whole = std::fs::read(&file).expect("an archive");
    let sound = members(&file);
    let target = Bench::with(&small_spec("resident")).await;
    let before = target.rows().await;
    let bad = target.folder.path().join("bad.tar.gz");
    let path = bad.display().to_string();
    let refused = |words: &[&str]| {
        let message = target.refused(&["campaign", "import", &path]);
        for word in words.iter().chain([&"bad.tar.gz"]) {
            assert!(message.contains(word), "{message} lacks {word}");
        }
    };

    for part in [3, 40, 75, 99] {
        std::fs::write(&bad, &whole[..whole.len() * part / 100]).expect("written");
        refused(&["cut off or damaged", "copy it again"]);
    }
    let mut flipped = whole.clone();
    let middle = flipped.len() / 2;
    flipped[middle] ^= 1;
    std::fs::write(&bad, flipped).expect("written");
    refused(&["copy it again"]);
    std::fs::write(&bad, [&whole[..], b"more"].concat()).expect("written");
    refused(&["data follows the last member"]);

    for foreign in [b"".as_slice(), b"SQLite format 3\0", &[0; 2_000]] {
        std::fs::write(&bad, foreign).expect("written");
        refused(&["read archive"]);
    }
    write(&bad, &[("notes.txt".to_owned(), vec![1; 10])], false);
    refused(&["not an archive of a campaign", "archive.json"]);

    // Every member in turn is altered, missing, or renamed.
    for number in 1..sound.len() {
        let name = sound[number].0.as_str();
        let mut altered = sound.clone();
        let middle = altered[number].1.len() / 2;
        altered[number].1[middle] ^= 1;
        write(&bad, &altered, false);
        refused(&[name, "SHA-256", "archive the campaign again"]);
        let mut altered = sound.clone();
        altered.remove(number);
        write(&bad, &altered, false);
        refused(&[name]);
        let mut altered = sound.clone();
        altered[number].0 = "../../outside".to_owned();
        write(&bad, &altered, false);
        refused(&[name, "another member is in its place"]);
        write(&bad, &altered, true);
        refused(&["archive.json"]);
    }
    let mut with_extra_member = sound.clone();
    with_extra_member.push(("artifacts/moved/../../outside".to_owned(), vec![1]));
    write(&bad, &with_extra_member, false);
    refused(&["does not list"]);
    write(&bad, &with_extra_member, true);
    refused(&["no film of this campaign"]);
    // A browser would run scripts in the first two of these files if the coordinator served them.
    for page in ["page.html", "film.mp4.svg", ".mp4", "film.mp4", &format!("a b.{:032x}.mp4", 1)] {
        with_extra_member.pop();
        with_extra_member.push((format!("artifacts/moved/{page}"), vec![1]));
        write(&bad, &with_extra_member, true);
        refused(&["archive.json", page, "no film of this campaign"]);
    }
    with_extra_member.pop();
    with_extra_member.push((film(), vec![1]));
    write(&bad, &with_extra_member, true);
    refused(&["rollouts.jsonl", "0 of 1 films have one"]);

    // In these archives, the table of contents matches the altered members. Member 1 is the
    // specification, member 3 the report, member 4 the rollouts.
    let mut report = sound.clone();
    let text = String::from_utf8(report[3].1.clone()).expect("JSON");
    report[3].1 = text.replacen("\"policy\": \"expert\"", "\"policy\": \"other\"", 1).into();
    assert_ne!(report[3].1, sound[3].1);
    write(&bad, &report, true);
    refused(&["report.json", "differs", ".policy"]);
    alter(&file, &bad, |lines| {
        let result = &mut lines[1]["result"]["measurement"]["result"];
        let success = result["success"] == false;
        result["success"] = json!(success);
        result["goal"]["at_end"] = json!(if success { 2 } else { 0 });
        result["goal"]["at_most"] = json!(2);
    });
    refused(&["report.json", "differs"]);
    let mut other = sound.clone();
    let text = String::from_utf8(other[1].1.clone()).expect("JSON");
    other[1].1 = text.replace("L1", "r1").into();
    write(&bad, &other, true);
    refused(&["rollouts.jsonl", "has no rollout"]);
    other[1].1 = b"{}".to_vec();
    write(&bad, &other, true);
    refused(&["specification.json"]);
    let mut empty = sound.clone();
    empty[4].1.clear();
    write(&bad, &empty, true);
    refused(&["rollouts.jsonl", "read line 1: it is missing"]);

    let mut other = sound.clone();
    let mut list: Value = serde_json::from_slice(&other[0].1).expect("a list");
    list["format"] = json!(1_000);
    list["members"] = json!("of another kind");
    other[0].1 = list.to_string().into_bytes();
    write(&bad, &other, false);
    refused(&["format 1000", "use the program that wrote it"]);

    assert_eq!(target.rows().await, before, "a refused archive changed rows");
    assert!(!target.folder.path().join("artifacts").exists());
    let missing = target.refused(&["campaign", "import", "nowhere.tar.gz"]);
    assert!(missing.contains("nowhere.tar.gz"), "{missing}");
    target.import(&file);
    target.assert_invariants().await;
}

/// A small archive that would unpack to a large one costs neither memory nor disk space.
#[tokio::test(flavor = "multi_thread")]
async fn a_decompression_bomb_is_refused_before_it_is_unpacked() {
    const UNPACKED_BYTES: u64 = 192 << 20;
    let mut source = Bench::with(&spec()).await;
    source.run(1, "").await;
    let sound = members(&source.archive("moved"));
    let bad = source.folder.path().join("bad.tar.gz");
    let path = bad.display().to_string();
    let refused = |words: &[&str]| {
        let message = source.refused(&["campaign", "import", &path, "--as", "another"]);
        for word in words {
            assert!(message.contains(word), "{message} lacks {word}");
        }
    };
    let before = source.serve.peak_memory_bytes();

    // A long name of `UNPACKED_BYTES` characters, before the table of contents and before a member.
    for place in [0, 1] {
        let out = GzEncoder::new(File::create(&bad).expect("a file"), Compression::fast());
        let mut tar = tar::Builder::new(out);
        for (name, bytes) in &sound[..place] {
            let mut header = tar::Header::new_gnu();
            header.set_size(bytes.len() as u64);
            tar.append_data(&mut header, name, bytes.as_slice()).expect("written");
        }
        let mut header = tar::Header::new_gnu();
        header.set_entry_type(tar::EntryType::GNULongName);
        header.set_size(UNPACKED_BYTES);
        header.set_cksum();
        tar.append(&header, std::io::repeat(b'n').take(UNPACKED_BYTES)).expect("written");
        tar.into_inner().expect("finished").finish().expect("finished");
        refused(&["bad.tar.gz"]);
    }
    // A film of zeros that the table of contents lists correctly.
    let mut large = sound.clone();
    large.push((film(), vec![0; UNPACKED_BYTES as usize]));
    write(&bad, &large, true);
    refused(&["archive.json", "it claims 192 MiB of members"]);
    // The same film, listed with a size of one byte.
    let mut list: Value = serde_json::from_slice(&sound[0].1).expect("a list");
    let listed = json!({"name": film(), "bytes": 1, "sha256": "00"});
    list["members"].as_array_mut().expect("members").push(listed);
    large[0].1 = list.to_string().into_bytes();
    write(&bad, &large, false);
    refused(&[&film(), "it has 201326592 bytes instead of 1"]);
    // Endless padding after the last member.
    let out = GzEncoder::new(File::create(&bad).expect("a file"), Compression::fast());
    let mut tar = tar::Builder::new(out);
    for (name, bytes) in &sound {
        let mut header = tar::Header::new_gnu();
        header.set_size(bytes.len() as u64);
        tar.append_data(&mut header, name, bytes.as_slice()).expect("written");
    }
    let mut out = tar.into_inner().expect("finished");
    std::io::copy(&mut std::io::repeat(0).take(UNPACKED_BYTES), &mut out).expect("written");
    out.finish().expect("finished");
    refused(&["its end"]);

    let grown = source.serve.peak_memory_bytes() - before;
    assert!(grown < UNPACKED_BYTES / 2, "{} MiB were taken", grown >> 20);
    // The unaltered archive is accepted.
    write(&bad, &sound, false);
    source.succeed(&["campaign", "import", &path, "--as", "another"]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_derived_campaign_is_imported_after_its_source() {
    let mut source = Bench::with(&with(spec(), json!({"levels": ["L2"]}))).await;
    source.run(64, "").await;
    let name = "moved-explained";
    let lease = source.begin(&["explain", "moved", "--create", "--budget", "20"]).await;
    assert_eq!(source.worker.commit(&lease, true).await, Verdict::Accepted);
    assert!(source.succeed(&["export", name, "--format", "jsonl"]).lines().count() > 0);
    let source_archive = source.archive("moved");
    let file = source.archive(name);

    let target = Bench::empty().await;
    let path = file.display().to_string();
    let message = target.refused(&["campaign", "import", &path]);
    assert!(message.contains("derived from `moved`") && message.contains("import that one first"));
    target.import(&source_archive);
    target.import(&file);
    target.assert_invariants().await;
    assert_eq!(target.report(name), source.report(name));
    let message = target.refused(&["campaign", "delete", "moved", "--confirm", "moved"]);
    assert!(message.contains(name), "{message}");

    // A campaign of that name with other outcomes is not accepted as the source.
    let mut other_target = Bench::with(&with(spec(), json!({"levels": ["L2"]}))).await;
    other_target.run(3, "").await;
    let message = other_target.refused(&["campaign", "import", &path]);
    assert!(message.contains("other outcomes here"), "{message}");
}
