//! Generates the code of `rollout/*/v1/*.proto`, without needing `protoc`.

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let [policy, coordinator] = [
        "rollout/policy/v1/policy.proto",
        "rollout/coordinator/v1/coordinator.proto",
    ];
    for file in [policy, coordinator] {
        println!("cargo:rerun-if-changed={file}");
    }
    // Frames are most of what travels: as `Bytes` they are taken out of a message,
    // and put into another one's query, without a copy.
    tonic_prost_build::configure()
        .bytes(".rollout.policy.v1.Image.rgb")
        // A server need not have every call: what it lacks is UNIMPLEMENTED.
        .generate_default_stubs(true)
        .compile_fds(protox::compile([policy], ["."])?)?;
    tonic_prost_build::configure()
        .btree_map(".rollout.coordinator.v1.Provenance")
        .compile_fds(protox::compile([coordinator], ["."])?)?;
    Ok(())
}
