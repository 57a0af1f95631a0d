//! Messages of openpi's protocol: msgpack maps with NumPy arrays (module `msgpack_numpy` of
//! openpi-client). Pure functions.

use rmpv::Value;
use thiserror::Error;

use crate::numpy::{self, Array, ArrayError, Keys, array, lookup};

/// Observation as openpi's LIBERO client sends it.
#[derive(Clone, Copy, Debug)]
pub struct ClientObservation<'a> {
    /// Height and width of both frames, pixels.
    pub side: usize,
    /// Frames with their keys, RGB, row by row, row 0 at the top.
    pub images: &'a [(&'a str, Vec<u8>)],
    /// Robot readings with their key, for example position (m), axis-angle (rad) and finger
    /// joints (m).
    pub state: Option<(&'a str, &'a [f64])>,
    /// Instruction of the episode with its key.
    pub prompt: (&'a str, &'a str),
}

#[derive(Clone, Debug, PartialEq)]
pub struct Chunk {
    /// Number of actions, and of values per action.
    pub shape: [usize; 2],
    /// Values in row-major order.
    pub numbers: Vec<f32>,
}

pub fn observation(input: &ClientObservation<'_>) -> Vec<u8> {
    let frame = |rgb: &[u8]| array(Keys::Bytes, "|u1", &[input.side, input.side, 3], rgb.to_vec());
    let mut entries: Vec<(Value, Value)> =
        input.images.iter().map(|(key, rgb)| (Value::from(*key), frame(rgb))).collect();
    entries.extend(input.state.map(|(key, numbers)| {
        let bytes = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
        (key.into(), array(Keys::Bytes, "<f8", &[numbers.len()], bytes))
    }));
    let (key, prompt) = input.prompt;
    entries.push((key.into(), prompt.into()));
    numpy::encode(&Value::Map(entries))
}

/// Decodes the actions of an answer; its other entries are ignored.
pub fn answer(bytes: &[u8]) -> Result<Chunk, AnswerError> {
    let answer = numpy::read(bytes).ok_or(AnswerError::NoMessage)?;
    let actions = lookup(&answer, "actions").ok_or(AnswerError::NoActions)?;
    let Array { shape, numbers } = numpy::numbers(actions)?;
    match *shape {
        [count, width] => Ok(Chunk { shape: [count, width], numbers }),
        _ => Err(AnswerError::Shape { shape }),
    }
}

#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum AnswerError {
    #[error("its answer is not a msgpack message")]
    NoMessage,
    #[error("its answer has no \"actions\": is it an openpi policy server?")]
    NoActions,
    #[error(transparent)]
    Array(#[from] ArrayError),
    #[error("its actions have shape {shape:?}, not [n, 7]")]
    Shape { shape: Vec<usize> },
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numpy::map;
    use crate::observations::rotated;
    use proptest::prelude::*;

    /// Output of `packb` of openpi-client 0.1.2 for the observation in the test below.
    const OBSERVATION: &str = "84b16f62736572766174696f6e2f696d61676584c40b5f5f6e6461727261795f5fc3c40464617461c40c000102030405060708090a0bc4056474797065a37c7531c405736861706593020203b76f62736572766174696f6e2f77726973745f696d61676584c40b5f5f6e6461727261795f5fc3c40464617461c40c090a0b060708030405000102c4056474797065a37c7531c405736861706593020203b16f62736572766174696f6e2f737461746584c40b5f5f6e6461727261795f5fc3c40464617461c440000000000000e03f000000000000f0bf00000000000000000000000000000000000000000000000000000000000000007b14ae47e17aa43f7b14ae47e17aa4bfc4056474797065a33c6638c40573686170659108a670726f6d7074a77069636b207570";
    /// Answer in the form of openpi's server, with two actions in f8.
    const ANSWER: &str = "84a5737461746584c40b5f5f6e6461727261795f5fc3c40464617461c40c000000000000000000000000c4056474797065a33c6634c40573686170659103a7616374696f6e7384c40b5f5f6e6461727261795f5fc3c40464617461c4700000000000000000000000000000e03f000000000000f0bf000000000000d03f00000000000000000000000000000000000000000000f03f0000000000000000000000000000e03f000000000000f0bf000000000000d03f00000000000000000000000000000000000000000000f03fc4056474797065a33c6638c4057368617065920207ad706f6c6963795f74696d696e6781a8696e6665725f6d73cb3ff8000000000000ad7365727665725f74696d696e6781a8696e6665725f6d73cb4004000000000000";
    /// Answer with one action of two numbers in f4.
    const NARROW: &str = "81a7616374696f6e7384c40b5f5f6e6461727261795f5fc3c40464617461c4080000003f000080bfc4056474797065a33c6634c4057368617065920102";

    fn bytes(hex: &str) -> Vec<u8> {
        let digits = |at: usize| u8::from_str_radix(&hex[at..at + 2], 16).expect("hex");
        (0..hex.len()).step_by(2).map(digits).collect()
    }

    #[test]
    fn an_observation_is_encoded_byte_for_byte_as_by_openpi_client() {
        let image: Vec<u8> = (0..12).collect();
        let encoded = observation(&ClientObservation {
            side: 2,
            images: &[
                ("observation/image", image.clone()),
                ("observation/wrist_image", rotated(&image)),
            ],
            state: Some(("observation/state", &[0.5, -1.0, 0.0, 0.0, 0.0, 0.0, 0.04, -0.04])),
            prompt: ("prompt", "pick up"),
        });
        assert_eq!(encoded, bytes(OBSERVATION));
    }

    #[test]
    fn actions_are_decoded_in_either_precision_and_other_entries_are_ignored() {
        let action = [0.0, 0.5, -1.0, 0.25, 0.0, 0.0, 1.0];
        let chunk = answer(&bytes(ANSWER)).expect("actions");
        assert_eq!(chunk.shape, [2, 7]);
        assert_eq!(chunk.numbers, [action, action].concat());
        let chunk = answer(&bytes(NARROW)).expect("actions");
        assert_eq!((chunk.shape, chunk.numbers), ([1, 2], vec![0.5, -1.0]));
    }

    #[test]
    fn an_answer_without_valid_actions_is_an_error_that_names_the_fault() {
        let actions = |array: Value| numpy::encode(&map([("actions", array)]));
        let array = |dtype, shape: &[usize], data| array(Keys::Bytes, dtype, shape, data);
        let cases = [
            (vec![0xdf], AnswerError::NoMessage),
            (numpy::encode(&map([])), AnswerError::NoActions),
            (actions(Value::from(3)), ArrayError::NotAnArray.into()),
            (actions(array("<f4", &[2, 7], vec![0; 28])), ArrayError::NotAnArray.into()),
            (
                actions(array("<i8", &[1, 7], vec![0; 56])),
                ArrayError::Dtype { dtype: "<i8".to_owned() }.into(),
            ),
            (actions(array("<f4", &[7], vec![0; 28])), AnswerError::Shape { shape: vec![7] }),
        ];
        for (bytes, error) in cases {
            assert_eq!(answer(&bytes), Err(error));
        }
    }

    proptest! {
        #[test]
        fn decoding_never_panics(at in 0..ANSWER.len() / 2, byte: u8, length in 0..ANSWER.len()) {
            let mut changed = bytes(ANSWER);
            changed[at] = byte;
            changed.truncate(length);
            drop(answer(&changed));
        }
    }
}
