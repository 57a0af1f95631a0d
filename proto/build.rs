//! Generates the code of `rollout/*/v1/*.proto`, without needing `protoc`.

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let [policy, coordinator] =
        ["rollout/policy/v1/policy.proto", "rollout/coordinator/v1/coordinator.proto"];
    for file in [policy, coordinator] {
        println!("cargo:rerun-if-changed={file}");
    }
    // Most bytes of messages are frames: as `Bytes`, they move from one message to another without
    // a copy.
    tonic_prost_build::configure()
        .bytes(".rollout.policy.v1.Image.rgb")
        // A server need not implement every call: missing ones return UNIMPLEMENTED.
        .generate_default_stubs(true)
        .compile_fds(protox::compile([policy], ["."])?)?;
    tonic_prost_build::configure()
        .btree_map(".rollout.coordinator.v1.Provenance")
        .compile_fds(protox::compile([coordinator], ["."])?)?;
    Ok(())
}
