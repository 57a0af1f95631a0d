//! Memory over a few rollouts; the full measurement is `endurance --rollouts 500 --assets PATH`.

use std::process::Command;

#[test]
fn memory_stays_level_over_sixty_rollouts_of_four_tasks() {
    let output = Command::new(env!("CARGO_BIN_EXE_endurance"))
        .args(["--rollouts", "60", "--tasks", "4", "--assets", "primitives"])
        .output()
        .unwrap();
    let printed = String::from_utf8_lossy(&output.stdout);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{printed}\n{errors}");
    assert!(printed.contains("   60 rollouts"), "{printed}");
}

#[test]
fn too_few_rollouts_to_measure_growth_are_refused() {
    let output = Command::new(env!("CARGO_BIN_EXE_endurance"))
        .args(["--rollouts", "4", "--tasks", "4"])
        .output()
        .unwrap();
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{errors}");
    assert!(errors.contains("make 1 rounds"), "{errors}");
}
