//! The folder `generated` is what the `.proto` files generate. It is committed, so that no build
//! waits for the generator. `ROLLOUT_RENEW=1 cargo test -p proto` writes it again.

use std::path::Path;

#[test]
fn the_generated_code_is_that_of_the_proto_files() {
    let out = tempfile::tempdir().unwrap();
    let compiled =
        |file: &str| protox::compile([file], [env!("CARGO_MANIFEST_DIR")]).expect("a valid file");
    // Most bytes of messages are frames: as `Bytes`, they move from one message to another without
    // a copy.
    tonic_prost_build::configure()
        .bytes(".rollout.policy.v1.Image.rgb")
        // A server need not implement every call: missing ones return UNIMPLEMENTED.
        .generate_default_stubs(true)
        .out_dir(out.path())
        .compile_fds(compiled("rollout/policy/v1/policy.proto"))
        .unwrap();
    tonic_prost_build::configure()
        .out_dir(out.path())
        .compile_fds(compiled("rollout/coordinator/v1/coordinator.proto"))
        .unwrap();
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("generated");
    for name in ["rollout.policy.v1", "rollout.coordinator.v1"] {
        let generated = std::fs::read_to_string(out.path().join(format!("{name}.rs"))).unwrap();
        let committed = folder.join(format!("{name}.in"));
        if std::env::var_os("ROLLOUT_RENEW").is_some() {
            std::fs::write(&committed, &generated).unwrap();
        }
        let found = std::fs::read_to_string(&committed).unwrap();
        assert!(found == generated, "{name} is out of date: run this test with ROLLOUT_RENEW=1");
    }
}
