//! The messages of openpi's protocol: msgpack maps in which an array of NumPy is
//! a map of its own, with `__ndarray__`, `data`, `dtype` and `shape` as binary
//! keys (module `msgpack_numpy` of openpi-client). Pure.

use rmpv::{Value, ValueRef, decode::read_value_ref, encode::write_value};
use thiserror::Error;

/// An observation, as openpi's LIBERO client shows it.
#[derive(Clone, Copy, Debug)]
pub struct Shown<'a> {
    /// Height and width of both frames, pixels.
    pub side: usize,
    /// RGB, row after row, row 0 at the top.
    pub image: &'a [u8],
    /// The same, of the hand's camera.
    pub wrist_image: &'a [u8],
    /// Position (m), axis times angle (rad) and fingers (m): eight numbers.
    pub state: &'a [f64],
    /// The instruction.
    pub prompt: &'a str,
}

/// A chunk of actions.
#[derive(Clone, Debug, PartialEq)]
pub struct Chunk {
    /// Actions, and numbers of each.
    pub shape: [usize; 2],
    /// Row after row.
    pub numbers: Vec<f32>,
}

/// Writes an observation.
pub fn observation(shown: &Shown<'_>) -> Vec<u8> {
    let frame = |rgb: &[u8]| array("|u1", &[shown.side, shown.side, 3], rgb.to_vec());
    let state = shown.state.iter().flat_map(|it| it.to_le_bytes());
    let entries = [
        ("observation/image", frame(shown.image)),
        ("observation/wrist_image", frame(shown.wrist_image)),
        (
            "observation/state",
            array("<f8", &[shown.state.len()], state.collect()),
        ),
        ("prompt", Value::from(shown.prompt)),
    ];
    let entries = entries.map(|(key, value)| (Value::from(key), value));
    let mut bytes = vec![];
    write_value(&mut bytes, &Value::Map(entries.into())).expect("a vector takes every byte");
    bytes
}

/// Reads the actions out of an answer; whatever else is in it is left alone.
///
/// # Errors
/// When there are none.
pub fn answer(bytes: &[u8]) -> Result<Chunk, AnswerError> {
    let answer = read_value_ref(&mut &*bytes).map_err(|_| AnswerError::NoMessage)?;
    let actions = lookup(&answer, "actions").ok_or(AnswerError::NoActions)?;
    let shape = lookup(actions, "shape").and_then(as_shape);
    let shape = shape.ok_or(AnswerError::NoArray)?;
    let dtype = lookup(actions, "dtype").and_then(as_text);
    let data = lookup(actions, "data").and_then(as_bytes);
    let (Some(dtype), Some(data)) = (dtype, data) else {
        return Err(AnswerError::NoArray);
    };
    let numbers: Vec<f32> = match dtype {
        "<f4" => {
            let (numbers, []) = data.as_chunks() else {
                return Err(AnswerError::NoArray);
            };
            numbers.iter().map(|it| f32::from_le_bytes(*it)).collect()
        }
        "<f8" => {
            let (numbers, []) = data.as_chunks() else {
                return Err(AnswerError::NoArray);
            };
            let numbers = numbers.iter().map(|it| f64::from_le_bytes(*it));
            numbers.map(|it| it as f32).collect()
        }
        other => {
            return Err(AnswerError::Dtype {
                dtype: other.chars().take(16).collect(),
            });
        }
    };
    let &[count, width] = shape.as_slice() else {
        return Err(AnswerError::Shape { shape });
    };
    if count.checked_mul(width) != Some(numbers.len()) {
        return Err(AnswerError::NoArray);
    }
    Ok(Chunk {
        shape: [count, width],
        numbers,
    })
}

/// Why an answer holds no actions.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum AnswerError {
    /// Not even the form is right.
    #[error("its answer is no msgpack message")]
    NoMessage,
    /// A message about something else.
    #[error("its answer has no \"actions\": is it an openpi policy server?")]
    NoActions,
    /// Something else under that name.
    #[error("its \"actions\" are no array as openpi-client writes one")]
    NoArray,
    /// Numbers of a kind that no policy answers.
    #[error("its \"actions\" have dtype {dtype:?}, not <f4 or <f8")]
    Dtype {
        /// As NumPy writes it.
        dtype: String,
    },
    /// Not one chunk.
    #[error("its \"actions\" have shape {shape:?}, not [n, 7]")]
    Shape {
        /// As answered.
        shape: Vec<usize>,
    },
}

fn array(dtype: &str, shape: &[usize], data: Vec<u8>) -> Value {
    let shape = shape.iter().map(|&it| Value::from(it)).collect();
    let entries = [
        ("__ndarray__", Value::Boolean(true)),
        ("data", Value::Binary(data)),
        ("dtype", Value::from(dtype)),
        ("shape", Value::Array(shape)),
    ];
    let binary = |key: &str| Value::Binary(key.as_bytes().to_vec());
    Value::Map(entries.map(|(key, value)| (binary(key), value)).into())
}

/// The entry of a map under a key of text or, as in arrays, of bytes.
fn lookup<'a, 'b>(map: &'b ValueRef<'a>, key: &str) -> Option<&'b ValueRef<'a>> {
    let ValueRef::Map(entries) = map else {
        return None;
    };
    let is_key =
        |it: &ValueRef<'_>| as_text(it) == Some(key) || as_bytes(it) == Some(key.as_bytes());
    entries
        .iter()
        .find(|(it, _)| is_key(it))
        .map(|(_, value)| value)
}

fn as_text<'a>(value: &ValueRef<'a>) -> Option<&'a str> {
    match value {
        ValueRef::String(text) => text.into_str(),
        _ => None,
    }
}

fn as_bytes<'a>(value: &ValueRef<'a>) -> Option<&'a [u8]> {
    match value {
        ValueRef::Binary(bytes) => Some(bytes),
        _ => None,
    }
}

fn as_shape(value: &ValueRef<'_>) -> Option<Vec<usize>> {
    let ValueRef::Array(sides) = value else {
        return None;
    };
    let side = |it: &ValueRef<'_>| match it {
        ValueRef::Integer(side) => side.as_u64().and_then(|side| usize::try_from(side).ok()),
        _ => None,
    };
    sides.iter().map(side).collect()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// `packb` of openpi-client 0.1.2 of the observation in the test below.
    const OBSERVATION: &str = "84b16f62736572766174696f6e2f696d61676584c40b5f5f6e6461727261795f5fc3c40464617461c40c000102030405060708090a0bc4056474797065a37c7531c405736861706593020203b76f62736572766174696f6e2f77726973745f696d61676584c40b5f5f6e6461727261795f5fc3c40464617461c40c090a0b060708030405000102c4056474797065a37c7531c405736861706593020203b16f62736572766174696f6e2f737461746584c40b5f5f6e6461727261795f5fc3c40464617461c440000000000000e03f000000000000f0bf00000000000000000000000000000000000000000000000000000000000000007b14ae47e17aa43f7b14ae47e17aa4bfc4056474797065a33c6638c40573686170659108a670726f6d7074a77069636b207570";
    /// Of an answer as openpi's server gives it, with two actions in f8.
    const ANSWER: &str = "84a5737461746584c40b5f5f6e6461727261795f5fc3c40464617461c40c000000000000000000000000c4056474797065a33c6634c40573686170659103a7616374696f6e7384c40b5f5f6e6461727261795f5fc3c40464617461c4700000000000000000000000000000e03f000000000000f0bf000000000000d03f00000000000000000000000000000000000000000000f03f0000000000000000000000000000e03f000000000000f0bf000000000000d03f00000000000000000000000000000000000000000000f03fc4056474797065a33c6638c4057368617065920207ad706f6c6963795f74696d696e6781a8696e6665725f6d73cb3ff8000000000000ad7365727665725f74696d696e6781a8696e6665725f6d73cb4004000000000000";
    /// Of an answer with one action of two numbers in f4.
    const NARROW: &str = "81a7616374696f6e7384c40b5f5f6e6461727261795f5fc3c40464617461c4080000003f000080bfc4056474797065a33c6634c4057368617065920102";

    fn bytes(hex: &str) -> Vec<u8> {
        let digits = |at: usize| u8::from_str_radix(&hex[at..at + 2], 16).expect("hex");
        (0..hex.len()).step_by(2).map(digits).collect()
    }

    #[test]
    fn an_observation_is_written_byte_by_byte_as_openpi_client_writes_it() {
        let image: Vec<u8> = (0..12).collect();
        let turned: Vec<u8> = image.rchunks(3).flatten().copied().collect();
        let written = observation(&Shown {
            side: 2,
            image: &image,
            wrist_image: &turned,
            state: &[0.5, -1.0, 0.0, 0.0, 0.0, 0.0, 0.04, -0.04],
            prompt: "pick up",
        });
        assert_eq!(written, bytes(OBSERVATION));
    }

    #[test]
    fn actions_are_read_in_either_precision_and_the_rest_is_left_alone() {
        let action = [0.0, 0.5, -1.0, 0.25, 0.0, 0.0, 1.0];
        let chunk = answer(&bytes(ANSWER)).expect("actions");
        assert_eq!(chunk.shape, [2, 7]);
        assert_eq!(chunk.numbers, [action, action].concat());
        let chunk = answer(&bytes(NARROW)).expect("actions");
        assert_eq!((chunk.shape, chunk.numbers), ([1, 2], vec![0.5, -1.0]));
    }

    #[test]
    fn what_holds_no_actions_is_named() {
        let written = |value: Value| {
            let mut bytes = vec![];
            write_value(&mut bytes, &value).expect("a vector");
            bytes
        };
        let actions = |array| written(Value::Map(vec![("actions".into(), array)]));
        let cases = [
            (vec![0xdf], AnswerError::NoMessage),
            (written(Value::Map(vec![])), AnswerError::NoActions),
            (actions(Value::from(3)), AnswerError::NoArray),
            // More numbers declared than sent.
            (
                actions(array("<f4", &[2, 7], vec![0; 28])),
                AnswerError::NoArray,
            ),
            (
                actions(array("<i8", &[1, 7], vec![0; 56])),
                AnswerError::Dtype {
                    dtype: "<i8".to_owned(),
                },
            ),
            (
                actions(array("<f4", &[7], vec![0; 28])),
                AnswerError::Shape { shape: vec![7] },
            ),
        ];
        for (bytes, error) in cases {
            assert_eq!(answer(&bytes), Err(error));
        }
    }

    proptest! {
        #[test]
        fn no_bytes_make_it_panic(at in 0..ANSWER.len() / 2, byte: u8, length in 0..ANSWER.len()) {
            let mut changed = bytes(ANSWER);
            changed[at] = byte;
            changed.truncate(length);
            drop(answer(&changed));
        }
    }
}
