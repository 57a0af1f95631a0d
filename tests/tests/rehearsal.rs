//! A week in compressed time, on a small scale; `rehearsal` without options is the full test
//! (docs/RELIABILITY.md).

use std::process::Command;

#[test]
fn a_disturbed_week_ends_as_an_undisturbed_one() {
    let output = Command::new(env!("CARGO_BIN_EXE_rehearsal"))
        .args(["--tasks", "libero_object/0", "--replicates", "1"])
        .args(["--workers", "2", "--slots", "2", "--outage-secs", "1"])
        .output()
        .unwrap();
    let printed = String::from_utf8_lossy(&output.stdout);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{printed}\n{errors}");
    // 50 nominal rollouts, and ten configurations under seven conditions at three levels.
    assert!(printed.contains("260 rollouts on 4 simulated slots"), "{printed}");
    for event in ["outage of the policy", "restart", "full disk", "restored"] {
        assert!(printed.contains(event), "no {event}: {printed}");
    }
    assert!(printed.contains("report and results: the same"), "{printed}");
}
