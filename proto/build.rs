//! Generates the code of `rollout/*/v1/*.proto`, without needing `protoc`.

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let files = [
        "rollout/policy/v1/policy.proto",
        "rollout/coordinator/v1/coordinator.proto",
    ];
    for file in files {
        println!("cargo:rerun-if-changed={file}");
    }
    let descriptors = protox::compile(files, ["."])?;
    tonic_prost_build::configure().compile_fds(descriptors)?;
    Ok(())
}
