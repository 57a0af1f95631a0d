//! Messages of vla-eval's protocol (module `protocol.messages`): msgpack maps of type, payload,
//! sequence number and time. Pure functions.

use proto::checks::ACTION_WIDTH;
use proto::policy::InferResponse;
use rmpv::{Value, ValueRef};
use thiserror::Error;

use super::address::MAX_EXECUTE;
use crate::numpy::{self, Array, ArrayError, as_text, lookup, map};

pub(super) const VERSION: u64 = 1;
/// Version of vla-eval whose client the gateway reproduces.
const HARNESS_VERSION: &str = "0.8.0";
/// Name of the LIBERO benchmark in vla-eval's configurations.
const BENCHMARK: &str = "vla_eval.benchmarks.libero.benchmark:LIBEROBenchmark";
/// Longest quoted part of a server's error, characters.
const QUOTED_CHARS: usize = 600;

#[derive(Clone, Copy, Debug)]
pub(super) enum Kind {
    Hello,
    EpisodeStart,
    Observation,
    EpisodeEnd,
}

/// Encodes a message to a server. `number` is its sequence number on the connection, from 1;
/// `time` is in seconds since 1970.
pub(super) fn message(kind: Kind, payload: Value, number: u64, time: f64) -> Vec<u8> {
    let kind = match kind {
        Kind::Hello => "hello",
        Kind::EpisodeStart => "episode_start",
        Kind::Observation => "observation",
        Kind::EpisodeEnd => "episode_end",
    };
    numpy::encode(&map([
        ("type", kind.into()),
        ("payload", payload),
        ("seq", number.into()),
        ("timestamp", time.into()),
    ]))
}

pub(super) fn hello() -> Value {
    map([
        ("harness_version", HARNESS_VERSION.into()),
        ("protocol_version", VERSION.into()),
        ("benchmark", BENCHMARK.into()),
    ])
}

/// Builds the task of an episode. The indices of task and initial state are left out, because no
/// policy should know them.
pub(super) fn task(suite: &str, instruction: &str) -> Value {
    let task = map([("name", instruction.into()), ("suite", suite.into())]);
    map([("task", task)])
}

#[derive(Debug)]
struct Reply<'a, 'b> {
    kind: &'b str,
    payload: &'b ValueRef<'a>,
    /// Sequence number of the client's message that the server answers.
    number: u64,
}

fn reply<'a, 'b>(message: &'b ValueRef<'a>) -> Option<Reply<'a, 'b>> {
    Some(Reply {
        kind: as_text(lookup(message, "type")?)?,
        payload: lookup(message, "payload")?,
        number: match lookup(message, "seq")? {
            ValueRef::Integer(number) => number.as_u64()?,
            _ => return None,
        },
    })
}

/// Returns the payload of a server's HELLO; `None` for any other message.
pub(super) fn hello_payload(bytes: &[u8]) -> Option<Value> {
    let message = numpy::read(bytes)?;
    let reply = reply(&message).filter(|reply| reply.kind == "hello")?;
    Some(reply.payload.to_owned())
}

/// Decodes the answer to the observation in the message with sequence number `asked`. Returns the
/// actions to execute: the only action, or the first `execute` actions of a chunk.
///
/// Gripper values from 0 up become 1 (closed) and negative values -1 (open), as in vla-eval's
/// LIBERO benchmark.
///
/// # Errors
/// If the answer does not hold the actions to execute, or is a chunk of several actions although
/// `execute` is 1.
pub fn answer(bytes: &[u8], asked: u64, execute: u32) -> Result<InferResponse, AnswerError> {
    let message = numpy::read(bytes);
    let reply = message.as_ref().and_then(reply);
    let Reply { kind, payload, number } = reply.ok_or(AnswerError::NoMessage)?;
    match kind {
        "action" if number == asked => actions(payload, execute),
        "action" => Err(AnswerError::OutOfStep { number, asked }),
        "error" if number == asked => Err(AnswerError::Policy(error_text(payload))),
        "error" => Err(AnswerError::Start(error_text(payload))),
        other => Err(AnswerError::Kind { kind: other.chars().take(16).collect() }),
    }
}

fn error_text(payload: &ValueRef<'_>) -> String {
    let text = match lookup(payload, "error").and_then(as_text) {
        Some(text) => text.trim().to_owned(),
        None => payload.to_string(),
    };
    let skipped = text.chars().count().saturating_sub(QUOTED_CHARS);
    text.chars().skip(skipped).collect()
}

fn actions(payload: &ValueRef<'_>, execute: u32) -> Result<InferResponse, AnswerError> {
    let actions = lookup(payload, "actions").or_else(|| lookup(payload, "action"));
    let actions = actions.ok_or(AnswerError::NoActions)?;
    let Array { shape, numbers } = match actions {
        ValueRef::Array(items) => number_list(items).ok_or(ArrayError::NotAnArray)?,
        other => numpy::numbers(other)?,
    };
    let (count, width) = match *shape {
        [_] if execute > 1 => return Err(AnswerError::Single { execute }),
        [width] => (1, width),
        [0, _] => return Err(AnswerError::Empty { execute }),
        [count, _] if execute == 1 && count > 1 => return Err(AnswerError::Chunk { count }),
        [count, _] if count < execute as usize => {
            return Err(AnswerError::Short { count, execute });
        }
        [_, width] => (execute as usize, width),
        _ => return Err(AnswerError::Shape { shape }),
    };
    let mut actions = numbers[..count * width].to_vec();
    if width == ACTION_WIDTH {
        let grippers = actions.iter_mut().skip(width - 1).step_by(width);
        // Values that are not finite stay as they are: the gateway's checks report them.
        for gripper in grippers.filter(|gripper| gripper.is_finite()) {
            *gripper = if *gripper < 0.0 { -1.0 } else { 1.0 };
        }
    }
    Ok(InferResponse {
        actions,
        // The gateway's checks refuse an invalid width.
        action_width: u32::try_from(width).unwrap_or(u32::MAX),
    })
}

fn number_list(items: &[ValueRef<'_>]) -> Option<Array> {
    let number = |item: &ValueRef<'_>| match item {
        ValueRef::F32(number) => Some(*number),
        ValueRef::F64(number) => Some(*number as f32),
        ValueRef::Integer(number) => number.as_f64().map(|number| number as f32),
        _ => None,
    };
    Some(Array {
        shape: vec![items.len()],
        numbers: items.iter().map(number).collect::<Option<_>>()?,
    })
}

#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum AnswerError {
    #[error("its answer is not a message of vla-eval's protocol")]
    NoMessage,
    #[error("it answered an observation with a message of type {kind:?}")]
    Kind { kind: String },
    #[error(
        "it answered message {number} instead of message {asked}: serve it without \
         continuous_inference"
    )]
    OutOfStep { number: u64, asked: u64 },
    #[error("{0}")]
    Policy(String),
    /// The server reported an error at the start of the episode. A successful start has no answer,
    /// so the error arrives in place of the answer to the first query.
    #[error("{0}")]
    Start(String),
    #[error("its answer has no \"actions\"")]
    NoActions,
    #[error(transparent)]
    Array(#[from] ArrayError),
    #[error("its actions have shape {shape:?}, not [7] or [n, 7]")]
    Shape { shape: Vec<usize> },
    #[error(
        "it answered a chunk of {count} actions, and one is executed per query: write \
         ?execute={} (or less) after its address, or give the server a chunk_size, so that it \
         answers single actions of the chunk",
        (*count).min(MAX_EXECUTE as usize)
    )]
    Chunk { count: usize },
    #[error(
        "it answered one action, and {execute} are executed per query: leave out ?execute after \
         its address"
    )]
    Single { execute: u32 },
    #[error(
        "it answered an empty chunk: serve a checkpoint with chunks of {execute} or more actions"
    )]
    Empty { execute: u32 },
    #[error(
        "it answered {count} actions, and {execute} are executed per query: write \
         ?execute={count} after its address, or serve longer chunks"
    )]
    Short { count: usize, execute: u32 },
}

impl AnswerError {
    /// Returns true if the server's next message will be the answer to the next query.
    pub(super) fn is_synchronised(&self) -> bool {
        !matches!(
            self,
            Self::NoMessage | Self::Kind { .. } | Self::OutOfStep { .. } | Self::Start(_)
        )
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::numpy::{Keys, array};
    use crate::vla_eval::image::{self, ImageFormat};

    // Output of `pack_message` of vla-eval 0.8.0, with raw images, for the messages in the tests
    // below.
    const HELLO: &str = "84a474797065a568656c6c6fa77061796c6f616483af6861726e6573735f76657273696f6ea5302e382e30b070726f746f636f6c5f76657273696f6e01a962656e63686d61726bd934766c615f6576616c2e62656e63686d61726b732e6c696265726f2e62656e63686d61726b3a4c494245524f42656e63686d61726ba373657101a974696d657374616d70cb3ff8000000000000";
    const START: &str = "84a474797065ad657069736f64655f7374617274a77061796c6f616481a47461736b82a46e616d65a77069636b207570a57375697465ab6c696265726f5f676f616ca373657102a974696d657374616d70cb3ff8000000000000";
    const OBSERVATION: &str = "84a474797065ab6f62736572766174696f6ea77061796c6f616484a6696d6167657381a96167656e747669657784ab5f5f6e6461727261795f5fc3a464617461c40c000102030405060708090a0ba56474797065a37c7531a5736861706593020203b07461736b5f6465736372697074696f6ea77069636b207570a673746174657384ab5f5f6e6461727261795f5fc3a464617461c440000000000000e03f000000000000f0bf00000000000000000000000000000000000000000000000000000000000000007b14ae47e17aa43f7b14ae47e17aa4bfa56474797065a33c6638a573686170659108b1636f6e74726f6c6c65725f73746174657384ab5f5f6e6461727261795f5fc3a464617461c4200000003f000080bf000000000000000000000000000000000ad7233d0ad723bda56474797065a33c6634a573686170659108a373657103a974696d657374616d70cb3ff8000000000000";
    const END: &str = "84a474797065ab657069736f64655f656e64a77061796c6f616480a373657104a974696d657374616d70cb3ff8000000000000";
    const ONE_ACTION: &str = "84a474797065a6616374696f6ea77061796c6f616481a7616374696f6e7384ab5f5f6e6461727261795f5fc3a464617461c41c000000000000003f000080bf0000803e00000000000000009a99993ea56474797065a33c6634a573686170659107a373657103a974696d657374616d70cb3ff8000000000000";
    /// Two actions, in f8.
    const CHUNK: &str = "84a474797065a6616374696f6ea77061796c6f616481a7616374696f6e7384ab5f5f6e6461727261795f5fc3a464617461c4700000000000000000000000000000e03f000000000000f0bf000000000000d03f00000000000000000000000000000000000000403333d33f0000000000000000000000000000e03f000000000000f0bf000000000000d03f00000000000000000000000000000000000000403333d33fa56474797065a33c6638a57368617065920207a373657103a974696d657374616d70cb3ff8000000000000";
    const ERROR: &str = "84a474797065a56572726f72a77061796c6f616481a56572726f72d9226f62736572766174696f6e5f6661696c65643a2056616c75654572726f723a206e6fa373657103a974696d657374616d70cb3ff8000000000000";

    fn bytes(hex: &str) -> Vec<u8> {
        let digits = |at: usize| u8::from_str_radix(&hex[at..at + 2], 16).expect("hex");
        (0..hex.len()).step_by(2).map(digits).collect()
    }

    fn answered(hex: &str, execute: u32) -> Result<InferResponse, AnswerError> {
        answer(&bytes(hex), 3, execute)
    }

    #[test]
    fn messages_are_encoded_byte_for_byte_as_by_vla_eval() {
        let frame: Vec<u8> = (0..12).collect();
        let frame = image::encode(ImageFormat::Raw, 2, &frame).expect("encoded");
        let numbers = [0.5, -1.0, 0.0, 0.0, 0.0, 0.0, 0.04, -0.04];
        let states = numbers.iter().flat_map(|number: &f64| number.to_le_bytes());
        let of_controller = numbers.iter().flat_map(|number| (*number as f32).to_le_bytes());
        let observation = map([
            ("images", map([("agentview", frame)])),
            ("task_description", "pick up".into()),
            ("states", array(Keys::Text, "<f8", &[8], states.collect())),
            ("controller_states", array(Keys::Text, "<f4", &[8], of_controller.collect())),
        ]);
        let cases = [
            (Kind::Hello, hello(), HELLO),
            (Kind::EpisodeStart, task("libero_goal", "pick up"), START),
            (Kind::Observation, observation, OBSERVATION),
            (Kind::EpisodeEnd, map([]), END),
        ];
        for (number, (kind, payload, expected)) in (1..).zip(cases) {
            assert_eq!(message(kind, payload, number, 1.5), bytes(expected), "{kind:?}");
        }
    }

    #[test]
    fn a_single_action_and_a_chunk_are_decoded_with_a_binary_gripper() {
        let action = [0.0, 0.5, -1.0, 0.25, 0.0, 0.0, 1.0];
        let one = answered(ONE_ACTION, 1).expect("an action");
        assert_eq!((one.actions.as_slice(), one.action_width), (&action[..], 7));
        let two = answered(CHUNK, 2).expect("actions");
        assert_eq!(two.actions, [action, action].concat());
        let chunk = Err(AnswerError::Chunk { count: 2 });
        assert_eq!(answered(CHUNK, 1), chunk);
        let short = AnswerError::Short { count: 2, execute: 3 };
        assert_eq!(answered(CHUNK, 3), Err(short));
        assert_eq!(answered(ONE_ACTION, 2), Err(AnswerError::Single { execute: 2 }));
    }

    #[test]
    fn advice_about_execute_is_within_the_limits_of_an_address() {
        let refusal = |count: usize, execute: u32| {
            let data = vec![0; 4 * ACTION_WIDTH * count];
            let actions = array(Keys::Text, "<f4", &[count, ACTION_WIDTH], data);
            let message = map([
                ("type", "action".into()),
                ("payload", map([("actions", actions)])),
                ("seq", 3.into()),
            ]);
            let refused = answer(&numpy::encode(&message), 3, execute);
            refused.expect_err("another number of actions").to_string()
        };
        for execute in [1, 5] {
            let empty = refusal(0, execute);
            assert!(empty.contains(&format!("chunks of {execute} or more")), "{empty}");
            assert!(!empty.contains("?execute"), "{empty}");
        }
        let long = refusal(200, 1);
        assert!(long.contains("?execute=100 "), "{long}");
    }

    #[test]
    fn errors_at_the_start_of_an_episode_differ_from_errors_of_a_query() {
        let text = || "observation_failed: ValueError: no".to_owned();
        assert_eq!(answered(ERROR, 1), Err(AnswerError::Policy(text())));
        let earlier = answer(&bytes(ERROR), 4, 1);
        assert_eq!(earlier, Err(AnswerError::Start(text())));
    }

    proptest! {
        #[test]
        fn decoding_never_panics(at in 0..CHUNK.len() / 2, byte: u8, length in 0..CHUNK.len()) {
            let mut changed = bytes(CHUNK);
            changed[at] = byte;
            changed.truncate(length);
            drop(hello_payload(&changed));
            let actions = answer(&changed, 3, 2).map(|answer| answer.actions).unwrap_or_default();
            let mut grippers = actions.iter().skip(6).step_by(7);
            prop_assert!(grippers.all(|gripper| !gripper.is_finite() || gripper.abs() == 1.0));
        }
    }
}
