//! Import of result files; a file with a bad line is refused as a whole.

use std::fs;
use std::path::Path;

use paired::Outcome;
use report::{ImportError, Origin, import};

use crate::subjects::document;

const EXAMPLE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/openvla_oft");

/// A row as the reference writes it.
const ROW: &str = concat!(
    r#"{"rollout_id": "goal/t0/camera/L2/c01", "success": true, "steps": 113, "axis": "camera", "#,
    r#""level": "L2", "suite": "libero_goal", "task_id": 0, "init_id": 6, "config": 1, "#,
    r#""policy": "oft", "wall_s": 7.2, "ik_res_mm": 0.12}"#
);

fn file(rows: &[&str]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a temporary folder");
    fs::write(folder.path().join("rollouts.jsonl"), rows.join("\n")).expect("written");
    folder
}

/// Returns the error message about the bad lines of a file.
fn refused(rows: &[&str]) -> String {
    let folder = file(rows);
    let error = import(folder.path()).expect_err("bad lines");
    assert!(matches!(error, ImportError::Lines { .. }), "{error}");
    error.to_string()
}

#[test]
fn the_example_is_read_with_its_about_file() {
    let subject = import(Path::new(EXAMPLE)).expect("read");
    assert_eq!(subject.policy, "OpenVLA-OFT");
    assert_eq!(subject.records.len(), 8400);
    assert_eq!(subject.published_nominal, Some(0.971));
    assert_eq!(subject.reported_nominal.expect("counts").n, 2000);
    let Origin::File { name, digest, source } = &subject.origin else {
        panic!("results of a file");
    };
    assert_eq!((name.as_str(), digest.len()), ("openvla_oft", 64));
    assert!(source.contains("2609.15940"), "{source}");
}

#[test]
fn a_row_of_the_reference_is_read_with_or_without_the_fields_of_its_id() {
    let bare = r#"{"rollout_id": "goal/t0/combination/L2/c01", "success": false}"#;
    let nominal = r#"{"rollout_id": "goal/t0/clean/i06", "success": true, "replicate": 2}"#;
    let folder = file(&[ROW, "", bare, nominal, ""]);
    let subject = import(folder.path()).expect("read");
    assert_eq!(subject.policy, "oft");
    let [full, bare, nominal] = subject.records.as_slice() else {
        panic!("three rows");
    };
    assert_eq!((full.init_id, full.outcome), (6, Outcome::Success));
    assert_eq!((bare.init_id, bare.outcome), (6, Outcome::Failure));
    assert_eq!((nominal.init_id, nominal.replicate), (6, 2));
    let from_file = import(&folder.path().join("rollouts.jsonl")).expect("rows");
    assert_eq!(from_file.records, subject.records);
}

/// A row without an execution model, such as the reference's rows, counts as `wait`.
#[test]
fn a_file_has_one_execution_model() {
    let overlapped = ROW.replace("\"success\"", r#""execution": "overlap:4", "success""#);
    let subject = import(file(&[&overlapped]).path()).expect("read");
    assert_eq!(subject.execution.to_string(), "overlap:4");
    let waited = import(file(&[ROW]).path()).expect("read");
    assert!(waited.execution.is_wait());
    let second = overlapped.replace("c01", "c02").replace("\"config\": 1", "\"config\": 2");
    let message = refused(&[ROW, &second]);
    assert!(
        message.contains(
            "line 2: it ran under execution model `overlap:4`, earlier lines under `wait`"
        ),
        "{message}"
    );
    let text = document(vec![subject, waited]).text();
    let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(text.contains("more than one execution model"), "{text}");
    assert!(text.contains("overlap:4; wait"), "{text}");
}

/// Rows of LIBERO's family, as `coordinator export` writes them, give the report of their campaign.
#[test]
fn a_file_of_variants_has_one_protocol_and_the_report_of_its_benchmark() {
    let row = |id: &str, success: bool| {
        format!(
            r#"{{"rollout_id": "{id}", "success": {success}, "axis": "variant", "protocol": "pro-official"}}"#
        )
    };
    let swapped = row("goal/t0/pro:swap/i03", false);
    let unperturbed = row("goal/t0/pro:unperturbed/i03", true);
    let subject = import(file(&[&swapped, &unperturbed]).path()).expect("read");
    let family = document(vec![subject]).family.expect("of LIBERO's family");
    assert_eq!(family.protocol, "pro-official");
    assert_eq!((family.all.rollouts, family.all.broken), (1, 1));

    let suite_file_row = concat!(
        r#"{"rollout_id": "own/t0/own:near/i00", "success": true, "suite": "own", "#,
        r#""protocol": "kitchen@0123456789abcdef"}"#
    );
    let subject = import(file(&[suite_file_row]).path()).expect("read");
    let family = document(vec![subject]).family.expect("of a suite file");
    assert_eq!((family.all.rollouts, family.all.successes), (1, 1));

    let other = unperturbed.replace("pro-official", "pro-bddl");
    for (second, expected) in [
        (
            other,
            "line 2: it is under protocol `pro-bddl`, earlier lines are under protocol `pro-official`",
        ),
        (ROW.to_owned(), "line 2: it is without `protocol`"),
        (
            unperturbed.replace("pro-official", "kitchen@0123456789abcdef"),
            "line 2: rollout goal/t0/pro:unperturbed/i03 does not belong to the benchmark of \
             protocol `kitchen@0123456789abcdef`",
        ),
    ] {
        let message = refused(&[&swapped, &second]);
        assert!(message.contains(expected), "{message}");
    }
}

#[test]
fn bad_lines_are_named_by_their_numbers_and_nothing_is_imported() {
    let message = refused(&[
        ROW,
        "{",
        r#"{"rollout_id": "goal/t0/camera/L9/c01", "success": true}"#,
        r#"{"rollout_id": "goal/t0/camera/L1/c01", "success": "yes"}"#,
    ]);
    for expected in [
        "3 lines are bad",
        "line 2: ",
        "line 3: read level `L9`",
        "line 4: \"yes\" is given where true or false is expected",
    ] {
        assert!(message.contains(expected), "{expected}: {message}");
    }
    assert!(!message.contains("line 1"), "{message}");
}

#[test]
fn many_bad_lines_are_counted() {
    let message = refused(&["[]"; 25]);
    assert!(message.contains("25 lines are bad") && message.ends_with("and 15 more"), "{message}");
}

#[test]
fn a_row_that_contradicts_itself_or_another_is_bad() {
    let wrong = |from: &str, to: &str| ROW.replace(from, to);
    for (from, to, expected) in [
        ("\"L2\",", "\"L3\",", "`level` contradicts the rollout id"),
        ("\"camera\",", "\"robot\",", "`axis` contradicts the rollout id"),
        ("libero_goal", "libero_object", "`suite` contradicts the rollout id"),
        ("\"task_id\": 0", "\"task_id\": 7", "`task_id` contradicts the rollout id"),
        ("\"config\": 1", "\"config\": 2", "`config` contradicts the rollout id"),
    ] {
        let message = refused(&[&wrong(from, to)]);
        assert!(message.contains(expected), "{expected}: {message}");
    }
    let message = refused(&[ROW, ROW]);
    assert!(message.contains("line 2: goal/t0/camera/L2/c01 is on line 1 too"), "{message}");
    let other = wrong("c01", "c02").replace("\"config\": 1", "\"config\": 2");
    let message = refused(&[ROW, &other.replace("oft", "pi05")]);
    assert!(message.contains("line 2: it is of policy `pi05`"), "{message}");
    let message = refused(&[r#"{"rollout_id": "goal/t0/camera/L2/c12", "success": true}"#]);
    assert!(message.contains("has no `init_id`"), "{message}");
}

#[test]
fn a_line_longer_than_the_limit_is_refused() {
    let long = format!("{{\"rollout_id\": \"{}", "x".repeat(200_000));
    let message = refused(&[&long, "{"]);
    for expected in ["2 lines are bad", "line 1: it is longer than 65536 bytes", "line 2: "] {
        assert!(message.contains(expected), "{expected}: {message}");
    }
    // With its newline, the line is as long as the limit.
    let longest = format!("{ROW:<65535}");
    let folder = file(&[&longest, ""]);
    assert_eq!(import(folder.path()).expect("read").records.len(), 1);
    let blank = " ".repeat(65_536);
    assert!(refused(&[&blank, ROW]).contains("line 1: it is longer than 65536 bytes"));
}

#[test]
fn an_empty_or_absent_file_is_refused_by_its_name() {
    let folder = file(&[""]);
    let error = import(folder.path()).expect_err("no row");
    assert!(error.to_string().ends_with("rollouts.jsonl: it has no row"), "{error}");
    let error = import(&folder.path().join("nowhere")).expect_err("no such folder");
    assert!(error.to_string().contains("nowhere: name a folder that holds"), "{error}");
}

#[test]
fn an_about_file_with_an_unknown_field_is_refused() {
    let folder = file(&[ROW]);
    fs::write(folder.path().join("about.json"), r#"{"polcy": "oft"}"#).expect("written");
    let error = import(folder.path()).expect_err("misspelt");
    assert!(matches!(error, ImportError::About { .. }), "{error}");
}

/// A sparse file needs no disk space, but reading it would take an hour.
#[test]
fn a_file_above_the_size_limit_is_refused_before_it_is_read() {
    let folder = tempfile::tempdir().expect("a folder");
    let rows = std::fs::File::create(folder.path().join("rollouts.jsonl")).expect("a file");
    rows.set_len(1 << 40).expect("a sparse file");
    let error = import(folder.path()).expect_err("a terabyte");
    assert!(error.to_string().contains("4 GiB"), "{error}");
}
