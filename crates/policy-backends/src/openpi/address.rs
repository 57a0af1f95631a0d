//! Address of an openpi server, as written in a route, with the settings of its inputs.

use std::fmt;
use std::str::FromStr;

use proto::policy::StateField;
use thiserror::Error;
use tonic::codegen::http::Uri;

use super::frame::SIDE;
use crate::websocket::{HostPort, Schemes};

const SCHEMES: Schemes = Schemes { clear: "ws", encrypted: "wss" };

/// Actions executed per chunk by default, as in openpi's LIBERO evaluation (`replan_steps`).
const DEFAULT_EXECUTE: u32 = 5;
const MAX_EXECUTE: u32 = 100;
const MAX_SIZE: u32 = 1024;
/// Value of an option that leaves an input out.
const NONE: &str = "none";

/// Options of an address, and the values that each takes.
pub const OPTIONS: [(&str, &str); 10] = [
    ("execute", "N, actions executed per query"),
    ("image_key", "KEY of the scene camera's frame"),
    ("wrist_key", "KEY of the wrist camera's frame, or none"),
    ("state_key", "KEY of the robot's state"),
    ("prompt_key", "KEY of the instruction"),
    ("rotate", "180 or 0 degrees, by which both frames are turned"),
    ("size", "N, side of both frames in pixels"),
    ("state", "eef, joints or none: position, axis times angle and fingers, or joints and fingers"),
    ("gripper", "OPEN..CLOSED, the server's integers for an open and a closed gripper"),
    ("checkpoint", "NAME of what it serves, recorded with every result"),
];

/// Robot readings that form the server's state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// Position, axis times angle and finger joints: eight numbers.
    Eef,
    /// Arm joints and finger joints: nine numbers.
    Joints,
    None,
}

impl State {
    const ALL: [(&str, Self); 3] =
        [("eef", Self::Eef), ("joints", Self::Joints), (NONE, Self::None)];

    /// In the order of their numbers.
    pub fn fields(self) -> &'static [StateField] {
        match self {
            Self::Eef => &[StateField::EefPos, StateField::EefAxisAngle, StateField::GripperPos],
            Self::Joints => &[StateField::JointPos, StateField::GripperPos],
            Self::None => &[],
        }
    }
}

/// Address of an openpi server: `ws://HOST:PORT` or `wss://HOST:PORT`, with `?NAME=VALUE&…` for
/// settings that differ from those of openpi's LIBERO client.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OpenpiAddress {
    pub host_port: HostPort,
    pub execute: u32,
    pub image_key: String,
    /// Key of the wrist camera's frame; [`NONE`] sends none.
    pub wrist_key: String,
    pub state_key: String,
    pub prompt_key: String,
    /// True if frames are turned by 180°.
    pub is_turned: bool,
    /// Side of the frames, pixels.
    pub size: u32,
    pub state: State,
    /// The server's integers for an open and a closed gripper.
    pub gripper: [i32; 2],
    /// Name of the checkpoint, which the server does not report; empty if unknown.
    pub checkpoint: String,
}

impl OpenpiAddress {
    fn new(host_port: HostPort) -> Self {
        Self {
            host_port,
            execute: DEFAULT_EXECUTE,
            image_key: "observation/image".to_owned(),
            wrist_key: "observation/wrist_image".to_owned(),
            state_key: "observation/state".to_owned(),
            prompt_key: "prompt".to_owned(),
            is_turned: true,
            size: SIDE as u32,
            state: State::Eef,
            gripper: [-1, 1],
            checkpoint: String::new(),
        }
    }

    /// `None` if none is sent.
    pub fn wrist_key(&self) -> Option<&str> {
        (self.wrist_key != NONE).then_some(self.wrist_key.as_str())
    }

    fn set(&mut self, name: &str, value: &str) -> Option<()> {
        let number = |most| value.parse().ok().filter(|number| (1..=most).contains(number));
        let text = || (!value.is_empty()).then(|| value.to_owned());
        match name {
            "execute" => self.execute = number(MAX_EXECUTE)?,
            "image_key" => self.image_key = text()?,
            "wrist_key" => self.wrist_key = text()?,
            "state_key" => self.state_key = text()?,
            "prompt_key" => self.prompt_key = text()?,
            "rotate" => {
                self.is_turned = ["0", "180"].iter().position(|angle| *angle == value)? == 1
            }
            "size" => self.size = number(MAX_SIZE)?,
            "state" => self.state = State::ALL.iter().find(|(name, _)| *name == value)?.1,
            "gripper" => {
                let (open, closed) = value.split_once("..")?;
                self.gripper = [open.parse().ok()?, closed.parse().ok()?];
                let [open, closed] = self.gripper;
                (open != closed).then_some(())?;
            }
            "checkpoint" => self.checkpoint = text()?,
            _ => return None,
        }
        Some(())
    }

    /// Returns the address with the key that a server's `KeyError` asks for; `None` if the error
    /// names no key, or one whose input is not known or is sent already.
    pub fn with_key_of(&self, error: &str) -> Option<Self> {
        let quoted = error.rsplit_once("KeyError: ")?.1.trim();
        let quote = quoted.chars().next().filter(|c| ['\'', '"'].contains(c))?;
        let key = quoted[1..].split(quote).next()?;
        let words = [
            ("wrist_key", ["wrist", "hand"]),
            ("image_key", ["image", "rgb"]),
            ("state_key", ["state", "proprio"]),
            ("prompt_key", ["prompt", "instruction"]),
        ];
        let input = words.iter().find(|(_, words)| words.iter().any(|word| key.contains(word)))?;
        let mut changed = self.clone();
        changed.set(input.0, key)?;
        (changed != *self).then_some(changed)
    }

    /// Returns the options that differ from those of openpi's LIBERO client.
    pub fn options(&self) -> Vec<(&'static str, String)> {
        let default = Self::new(self.host_port.clone());
        let values = |address: &Self| {
            let state = State::ALL.iter().find(|(_, state)| *state == address.state);
            let [open, closed] = address.gripper;
            [
                address.execute.to_string(),
                address.image_key.clone(),
                address.wrist_key.clone(),
                address.state_key.clone(),
                address.prompt_key.clone(),
                if address.is_turned { "180" } else { "0" }.to_owned(),
                address.size.to_string(),
                state.map_or(NONE, |(name, _)| name).to_owned(),
                format!("{open}..{closed}"),
                address.checkpoint.clone(),
            ]
        };
        let names = OPTIONS.iter().map(|(name, _)| *name);
        let pairs = names.zip(values(self)).zip(values(&default));
        pairs.filter(|((_, value), default)| value != default).map(|(pair, _)| pair).collect()
    }
}

impl FromStr for OpenpiAddress {
    type Err = OpenpiAddressError;

    fn from_str(text: &str) -> Result<Self, OpenpiAddressError> {
        let parse = || {
            let uri: Uri = text.parse().ok()?;
            let mut address = Self::new(HostPort::read(&uri, SCHEMES)?);
            for option in uri.query().iter().flat_map(|query| query.split('&')) {
                let (name, value) = option.split_once('=')?;
                address.set(name, value)?;
            }
            Some(address)
        };
        parse().ok_or_else(|| OpenpiAddressError { text: text.to_owned() })
    }
}

impl fmt::Display for OpenpiAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.host_port.text(SCHEMES))?;
        let options = self.options();
        options.iter().enumerate().try_for_each(|(index, (name, value))| {
            let separator = if index == 0 { '?' } else { '&' };
            write!(f, "{separator}{name}={value}")
        })
    }
}

#[derive(Debug, Error)]
#[error(
    "read {text:?} as an openpi server's address: write ws://HOST:PORT, or \
     ws://HOST:PORT?NAME=VALUE&… with {}",
    options_in_words()
)]
pub struct OpenpiAddressError {
    pub text: String,
}

fn options_in_words() -> String {
    OPTIONS.map(|(name, values)| format!("{name}={values}")).join("; ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_is_parsed_and_displayed_unchanged() {
        let valid = [
            "ws://gpu7:8000",
            "wss://[::1]:8000?execute=10",
            "ws://gpu7:8000?image_key=image&wrist_key=none&rotate=0&size=256&state=joints",
            "ws://gpu7:8000?gripper=1..0&checkpoint=s3://openpi-assets/checkpoints/pi05_libero",
        ];
        for text in valid {
            let address: OpenpiAddress = text.parse().expect(text);
            assert_eq!(address.to_string(), text);
        }
        let invalid = [
            "ws://gpu7",
            "ws://:8000",
            "http://gpu7:8000",
            "ws://gpu7:8000/path",
            "ws://gpu7:8000?execute=0",
            "ws://gpu7:8000?run=5",
            "ws://gpu7:8000?rotate=90",
            "ws://gpu7:8000?gripper=1..1",
            "ws://gpu7:8000?state=pose",
        ];
        for text in invalid {
            let error = text.parse::<OpenpiAddress>().expect_err(text).to_string();
            assert!(error.contains("ws://HOST:PORT") && error.contains("rotate=180"), "{error}");
        }
    }

    #[test]
    fn a_key_error_names_the_option_that_it_asks_for() {
        let address: OpenpiAddress = "ws://gpu7:8000".parse().expect("an address");
        let found = |error: &str| Some(address.with_key_of(error)?.to_string());
        for (key, option) in [
            ("image", "image_key=image"),
            ("observation/wrist_image_left", "wrist_key=observation/wrist_image_left"),
            ("proprio", "state_key=proprio"),
            ("task_instruction", "prompt_key=task_instruction"),
        ] {
            let error = format!("Traceback …\n  image = data['{key}']\nKeyError: '{key}'\n");
            assert_eq!(found(&error), Some(format!("ws://gpu7:8000?{option}")));
        }
        for error in ["KeyError: 'prompt'", "KeyError: 'seed'", "KeyError: 3", "ValueError: image"]
        {
            assert_eq!(found(error), None, "{error}");
        }
    }

    #[test]
    fn the_documentation_lists_every_option() {
        let page = include_str!("../../../../docs/POLICIES.md");
        for (name, _) in OPTIONS {
            assert!(page.contains(&format!("| `{name}` |")), "{name}");
        }
    }
}
