//! Compares answers with PyTorch's for the shipped weights. Training exports weights and answers.

use std::fs;
use std::path::Path;

use builtin_policies::student::{Network, PICTURE_BYTES, PICTURE_SIDE, Query};
use safetensors::{Dtype, SafeTensors};

/// Largest absolute deviation of numbers of magnitude up to 1, and largest relative deviation of
/// larger numbers.
const TOLERANCE: f32 = 1e-4;

#[test]
fn answers_equal_those_of_pytorch() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"));
    let references = fs::read_dir(folder.join("tests/reference")).expect("references");
    let mut count = 0;
    for reference in references {
        check(folder, &reference.expect("a reference").path());
        count += 1;
    }
    assert!(count > 0, "no reference");
}

fn check(folder: &Path, path: &Path) {
    let bytes = fs::read(path).expect("queries");
    let (_, header) = SafeTensors::read_metadata(&bytes).expect("a header");
    let metadata = header.metadata().clone().expect("metadata");
    let instructions: Vec<String> =
        serde_json::from_str(&metadata["instructions"]).expect("a list of instructions");
    let weights = fs::read(folder.join("weights").join(&metadata["weights"])).expect("weights");
    let network = Network::from_safetensors(&weights).expect("a network");

    let file = SafeTensors::deserialize(&bytes).expect("tensors");
    let count = instructions.len();
    assert!(count > 0, "no queries");
    let agentview = pictures(&file, "agentview", count);
    let wrist = pictures(&file, "wrist", count);
    let positions = rows::<3>(&file, "eef_pos", count);
    let rotations = rows::<9>(&file, "eef_rotation", count);
    let grippers = rows::<2>(&file, "gripper_pos", count);
    let queries: Vec<Query<'_>> = (0..count)
        .map(|index| Query {
            agentview: &agentview[index],
            wrist: &wrist[index],
            eef_pos: positions[index].map(f64::from),
            eef_rotation: rotations[index].map(f64::from),
            gripper_pos: grippers[index].map(f64::from),
            instruction: &instructions[index],
        })
        .collect();

    let arms = rows::<48>(&file, "arm", count);
    let logits = rows::<8>(&file, "gripper_logits", count);
    for (index, output) in network.outputs(&queries).expect("answers").iter().enumerate() {
        // The exported arm components are clamped, as in actions.
        let arm = output.arm.as_flattened().iter();
        let arm = arm.map(|value| value.clamp(-1.0, 1.0));
        assert_close(arm, &arms[index], &format!("query {index}, arm"));
        let found = output.gripper_logits.into_iter();
        assert_close(found, &logits[index], &format!("query {index}, gripper"));
    }
}

fn assert_close(found: impl Iterator<Item = f32>, expected: &[f32], label: &str) {
    for (place, (found, expected)) in found.zip(expected).enumerate() {
        let deviation = (found - expected).abs() / expected.abs().max(1.0);
        assert!(deviation <= TOLERANCE, "{label} {place}: {found}, not {expected}");
    }
}

fn data<'a>(file: &SafeTensors<'a>, name: &str, dtype: Dtype, count: usize) -> &'a [u8] {
    let tensor = file.tensor(name).expect("a tensor");
    assert_eq!(tensor.dtype(), dtype, "{name}");
    assert_eq!(tensor.shape()[0], count, "{name}");
    tensor.data()
}

/// Returns pictures with row 0 at the bottom, as in the protocol.
fn pictures(file: &SafeTensors<'_>, name: &str, count: usize) -> Vec<Vec<u8>> {
    let pictures = data(file, name, Dtype::U8, count).chunks(PICTURE_BYTES);
    let flip = |picture: &[u8]| picture.rchunks(PICTURE_SIDE * 3).flatten().copied().collect();
    pictures.map(flip).collect()
}

fn rows<const WIDTH: usize>(file: &SafeTensors<'_>, name: &str, count: usize) -> Vec<[f32; WIDTH]> {
    let (values, _) = data(file, name, Dtype::F32, count).as_chunks();
    let values: Vec<f32> = values.iter().copied().map(f32::from_le_bytes).collect();
    let (rows, rest) = values.as_chunks();
    assert!(rest.is_empty() && rows.len() == count, "{name}");
    rows.to_vec()
}
