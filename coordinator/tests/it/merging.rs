//! Archives of parts of one design become one campaign.

use std::path::Path;

use proto::coordinator::commit_response::Verdict;
use serde_json::json;

use crate::artifacts::put;
use crate::harness::{rollout_id, with};
use crate::moving::{Bench, spec, succeeds};
use crate::process::text;

/// Runs `coordinator merge` on archives; returns its output or its error message.
fn merge(archives: &[&Path], output: &Path) -> Result<String, String> {
    let archives: Vec<String> = archives.iter().map(|path| path.display().to_string()).collect();
    let output = output.display().to_string();
    let mut arguments = vec!["merge"];
    arguments.extend(archives.iter().map(String::as_str));
    arguments.extend(["--output", &output]);
    let result = crate::process::coordinator(&arguments);
    match result.status.success() {
        true => Ok(text(&result.stdout).to_owned()),
        false => Err(text(&result.stderr).to_owned()),
    }
}

/// Parses the numbers of rollouts with an outcome and of repeated outcomes from the output of
/// `merge`.
fn counts(message: &str) -> [u64; 2] {
    let number = |before: &str, after: &str| {
        let (_, rest) = message.split_once(before).expect("the words before");
        let (number, _) = rest.split_once(after).expect("the words after");
        number.parse().expect("a number")
    };
    [number("campaign moved: ", " rollout"), number("with an outcome, ", " outcomes repeated")]
}

#[tokio::test(flavor = "multi_thread")]
async fn consistent_halves_merge_into_the_campaign_of_one_coordinator() {
    let mut first = Bench::with(&spec()).await;
    first.run(4, "L3").await;
    let endpoint = json!({"policy": {"name": "expert", "endpoint": "http://10.0.0.2:50051"}});
    let mut second = Bench::with(&with(spec(), endpoint)).await;
    second.run(64, "L1").await;
    let filmed = second.worker.claim_one().await;
    let success = succeeds(&rollout_id(&filmed));
    assert_eq!(second.worker.commit(&filmed, success).await, Verdict::Accepted);
    put(&mut second.worker, &filmed, "video.mp4", &[vec![5; 99]]).await.expect("stored");
    let (a, b) = (first.archive("moved"), second.archive("moved"));
    let folder = tempfile::tempdir().expect("a folder");
    let merged = folder.path().join("whole.tar.gz");
    let message = merge(&[&a, &b], &merged).expect("merged");
    let [outcomes, repeated] = counts(&message);
    let reversed = folder.path().join("other.tar.gz");
    merge(&[&b, &a], &reversed).expect("merged");

    let mut target = Bench::empty().await;
    target.import(&merged);
    target.assert_invariants().await;
    let films = target.folder.path().join("artifacts/moved");
    assert_eq!(std::fs::read_dir(films).expect("films").count(), 1);
    // Rollouts that neither half has run are still waiting.
    target.run(64, "").await;
    target.assert_invariants().await;
    first.run(64, "").await;
    assert_eq!(target.report("moved"), first.report("moved"));
    // A campaign merged with itself stays the same.
    let finished = target.archive("moved");
    let merged_with_itself = folder.path().join("again.tar.gz");
    let message = merge(&[&finished, &finished], &merged_with_itself).expect("merged");
    assert_eq!(counts(&message), [13, 13], "{message}");
    assert!(message.contains("; 0 in quarantine, 0 still to run; "), "{message}");
    let three = folder.path().join("three.tar.gz");
    let message = merge(&[&a, &b, &finished], &three).expect("merged");
    assert_eq!(counts(&message), [13, repeated + outcomes], "{message}");
    let last = Bench::empty().await;
    last.import(&three);
    last.assert_invariants().await;
    assert_eq!(last.report("moved"), first.report("moved"));
}

#[tokio::test(flavor = "multi_thread")]
async fn contradictory_halves_are_refused_with_both_outcomes() {
    let mut first = Bench::with(&spec()).await;
    let mut second = Bench::with(&spec()).await;
    first.run(6, "").await;
    let lease = second.worker.claim_one().await;
    let (id, success) = (rollout_id(&lease), succeeds(&rollout_id(&lease)));
    assert_eq!(second.worker.commit(&lease, !success).await, Verdict::Accepted);
    let (a, b) = (first.archive("moved"), second.archive("moved"));
    let folder = tempfile::tempdir().expect("a folder");
    let merged = folder.path().join("whole.tar.gz");
    let message = merge(&[&a, &b], &merged).expect_err("a contradiction");
    for word in [
        id.as_str(),
        "success after 120 steps",
        "failure after 280 steps",
        "on bench",
        "1 of their rollouts",
    ] {
        assert!(message.contains(word), "{message} lacks {word}");
    }
    assert!(!merged.exists());

    // Halves with different scenes of one rollout are refused, even if their outcomes agree.
    let mut third = Bench::with(&spec()).await;
    let lease = third.worker.claim_one().await;
    let mut report = third.worker.report(&lease, succeeds(&rollout_id(&lease)));
    let scene = &mut report.provenance.as_mut().expect("provenance").scene_digest;
    *scene = "0".repeat(64);
    let (verdict, _) = third.worker.commit_request(report).await;
    assert_eq!(verdict, Verdict::Accepted);
    let c = third.archive("moved");
    let message = merge(&[&a, &c], &merged).expect_err("another scene");
    assert!(message.contains("scene digest"), "{message}");

    // An archive of a campaign with another design cannot be merged with this campaign's archives.
    let fourth = Bench::with(&with(spec(), json!({"levels": ["L1"]}))).await;
    let d = fourth.archive("moved");
    let message = merge(&[&a, &d], &merged).expect_err("another design");
    assert!(message.contains("`levels`"), "{message}");
    assert!(!merged.exists());
    let mut files = std::fs::read_dir(folder.path()).expect("a folder");
    assert!(files.next().is_none(), "a refused merge left files");
}
