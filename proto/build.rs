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
    // Frames are most of what travels: as `Bytes` they are taken out of a message,
    // and put into another one's query, without a copy.
    tonic_prost_build::configure()
        .bytes(".rollout.policy.v1.Image.rgb")
        .compile_fds(descriptors)?;
    Ok(())
}
