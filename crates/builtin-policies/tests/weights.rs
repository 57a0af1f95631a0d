//! Acceptance of valid weights files, and refusal of invalid ones.

mod support;

use builtin_policies::student::{Network, WeightsError};
use safetensors::Dtype;
use support::{Random, Weights};

fn refusal(weights: &Weights) -> WeightsError {
    Network::from_safetensors(&weights.bytes()).expect_err("a refusal")
}

fn error_after(change: impl FnOnce(&mut Weights)) -> WeightsError {
    let mut weights = Weights::random(3);
    change(&mut weights);
    refusal(&weights)
}

#[test]
fn weights_have_a_name_and_a_digest() {
    let bytes = Weights::random(3).bytes();
    let network = Network::from_safetensors(&bytes).expect("weights");
    assert_eq!(network.name(), "student");
    assert_eq!(network.parameters(), 1_741_432);
    assert_eq!(network.digest().len(), 64);
    let mut changed = bytes.clone();
    *changed.last_mut().expect("a byte") ^= 1;
    let changed = Network::from_safetensors(&changed).expect("weights");
    assert_ne!(network.digest(), changed.digest());
}

#[test]
fn a_file_may_name_the_look_that_was_learned() {
    let mut weights = Weights::random(3);
    let look = |weights: &Weights| {
        let network = Network::from_safetensors(&weights.bytes()).expect("a network");
        network.look().map(str::to_owned)
    };
    assert_eq!(look(&weights), None);
    weights.metadata.insert("look".to_owned(), "mujoco-3.3.2".to_owned());
    assert_eq!(look(&weights).as_deref(), Some("mujoco-3.3.2"));
}

#[test]
fn a_missing_tensor_is_named() {
    for tensor in Weights::random(3).tensors.keys() {
        let refusal = error_after(|weights| {
            weights.tensors.remove(tensor);
        });
        let named = matches!(&refusal, WeightsError::Missing { tensor: missing, .. }
            if missing == tensor);
        assert!(named, "{tensor}: {refusal}");
    }
    let refusal = error_after(|weights| {
        weights.tensors.remove("wrist.block2.conv1.weight");
    });
    assert_eq!(
        refusal.to_string(),
        "the weights file has no tensor wrist.block2.conv1.weight, which must be [96, 48, 3, 3] \
         of F16: export the whole network"
    );
}

#[test]
fn a_tensor_of_another_shape_is_named() {
    let refusal = error_after(|weights| {
        let tensor = weights.tensors.get_mut("head1.weight").expect("a tensor");
        tensor.shape = vec![832, 384];
    });
    assert_eq!(
        refusal.to_string(),
        "tensor head1.weight of the weights file has the shape [832, 384]; expected is [384, 832]: \
         give weights of this network"
    );
}

#[test]
fn a_tensor_of_another_type_is_named() {
    for (tensor, dtype, expected) in [
        (
            "arm.bias",
            Dtype::BF16,
            "tensor arm.bias of the weights file is of type BF16; expected is F16",
        ),
        (
            "state_mean",
            Dtype::I32,
            "tensor state_mean of the weights file is of type I32; expected is F32",
        ),
    ] {
        let refusal = error_after(|weights| {
            weights.tensors.get_mut(tensor).expect("a tensor").dtype = dtype;
        });
        assert!(refusal.to_string().starts_with(expected), "{refusal}");
    }
}

#[test]
fn numbers_that_are_not_finite_or_not_positive_are_named() {
    let refusal = error_after(|weights| {
        let tensor = weights.tensors.get_mut("text2.bias").expect("a tensor");
        tensor.bytes[10..12].copy_from_slice(&half::f16::NAN.to_le_bytes());
    });
    let expected =
        "tensor text2.bias of the weights file holds NaN at place 5, where a finite number";
    assert!(refusal.to_string().starts_with(expected), "{refusal}");
    let refusal = error_after(|weights| {
        let tensor = weights.tensors.get_mut("state_mean").expect("a tensor");
        tensor.bytes[..4].copy_from_slice(&f32::NEG_INFINITY.to_le_bytes());
    });
    assert!(refusal.to_string().contains("holds -inf at place 0"), "{refusal}");
    let refusal = error_after(|weights| {
        let tensor = weights.tensors.get_mut("state_std").expect("a tensor");
        tensor.bytes[52..].copy_from_slice(&0.0_f32.to_le_bytes());
    });
    let expected =
        "tensor state_std of the weights file holds 0 at place 13, where a number above 0";
    assert!(refusal.to_string().starts_with(expected), "{refusal}");
}

#[test]
fn an_unknown_tensor_is_named() {
    let refusal = error_after(|weights| {
        let tensor = weights.tensors["gripper.bias"].clone();
        weights.tensors.insert("value.bias".to_owned(), tensor);
    });
    let expected = "the weights file has a tensor value.bias, which this network lacks: give \
                  weights of this network";
    assert_eq!(refusal.to_string(), expected);
}

#[test]
fn another_format_is_named() {
    let refusal = error_after(|weights| {
        let format = "rollout-student/3".to_owned();
        weights.metadata.insert("format".to_owned(), format);
    });
    assert_eq!(
        refusal.to_string(),
        "the weights file's metadata gives \"rollout-student/3\" as its format; this program reads \
         \"rollout-student/1\" or \"rollout-student/2\": give weights that were exported for it"
    );
    let refusal = error_after(|weights| weights.metadata.clear());
    assert!(refusal.to_string().contains("gives nothing as its format"), "{refusal}");
    let refusal = error_after(|weights| {
        weights.metadata.remove("name");
    });
    assert_eq!(refusal, WeightsError::Name);
}

#[test]
fn a_truncated_file_and_a_file_of_another_format_are_refused() {
    let bytes = Weights::random(3).bytes();
    for length in [0, 7, 8, 100, bytes.len() / 2, bytes.len() - 1] {
        let refusal = Network::from_safetensors(&bytes[..length]).expect_err("a refusal");
        assert_eq!(refusal, WeightsError::Unreadable { bytes: length });
    }
    let text = b"version https://example.org/pointer\n".repeat(4);
    let refusal = Network::from_safetensors(&text).expect_err("a refusal");
    assert_eq!(
        refusal.to_string(),
        "the weights file, 144 bytes, is not a complete safetensors file: export it or copy it \
         again"
    );
}

#[test]
fn a_damaged_header_never_panics() {
    let bytes = Weights::random(3).bytes();
    let header = 8 + u64::from_le_bytes(bytes[..8].try_into().expect("eight bytes")) as usize;
    let mut random = Random(4);
    for _ in 0..300 {
        let mut damaged = bytes.clone();
        for _ in 0..=random.next() % 3 {
            damaged[random.next() as usize % header] = random.next() as u8;
        }
        let _ = Network::from_safetensors(&damaged);
    }
}
