//! Address of a vla-eval model server, as written in a route.

use std::fmt;
use std::str::FromStr;

use thiserror::Error;
use tonic::codegen::http::Uri;

use super::image::ImageFormat;
use crate::websocket::{HostPort, Schemes};

const SCHEMES: Schemes = Schemes { clear: "vla-eval", encrypted: "vla-evals" };
/// Actions executed per answer by default, as in vla-eval's LIBERO benchmark.
pub const DEFAULT_EXECUTE: u32 = 1;
pub const MAX_EXECUTE: u32 = 100;

/// Address of a vla-eval model server: `vla-eval://HOST:PORT` or, over TLS,
/// `vla-evals://HOST:PORT`, with `?NAME=VALUE&…` for settings that differ from those that the
/// server and vla-eval's LIBERO benchmark negotiate.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct VlaEvalAddress {
    pub host_port: HostPort,
    pub execute: u32,
    pub image_format: ImageFormat,
    /// Parameters of vla-eval's LIBERO benchmark, under vla-eval's names.
    pub parameters: Parameters,
}

/// Parameters of vla-eval's LIBERO benchmark that an address sets. They override the server's
/// requests, as an evaluation's configuration does in vla-eval.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Parameters {
    pub send_wrist_image: Option<bool>,
    pub send_state: Option<bool>,
    /// Keeps the sign of the hand's quaternion, even if w is negative.
    pub quat_no_antipodal: Option<bool>,
}

impl VlaEvalAddress {
    fn set(&mut self, name: &str, value: &str) -> Option<()> {
        match name {
            "execute" => {
                self.execute = value.parse().ok()?;
                (1..=MAX_EXECUTE).contains(&self.execute).then_some(())?;
            }
            "image_format" => self.image_format = ImageFormat::named(value)?,
            "send_wrist_image" => self.parameters.send_wrist_image = Some(value.parse().ok()?),
            "send_state" => self.parameters.send_state = Some(value.parse().ok()?),
            "quat_no_antipodal" => self.parameters.quat_no_antipodal = Some(value.parse().ok()?),
            _ => return None,
        }
        Some(())
    }
}

impl FromStr for VlaEvalAddress {
    type Err = VlaEvalAddressError;

    fn from_str(text: &str) -> Result<Self, VlaEvalAddressError> {
        let parse = || {
            let uri: Uri = text.parse().ok()?;
            let mut address = Self {
                host_port: HostPort::read(&uri, SCHEMES)?,
                execute: DEFAULT_EXECUTE,
                image_format: ImageFormat::default(),
                parameters: Parameters::default(),
            };
            for option in uri.query().iter().flat_map(|query| query.split('&')) {
                let (name, value) = option.split_once('=')?;
                address.set(name, value)?;
            }
            Some(address)
        };
        parse().ok_or_else(|| VlaEvalAddressError { text: text.to_owned() })
    }
}

impl fmt::Display for VlaEvalAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.host_port.text(SCHEMES))?;
        let Parameters { send_wrist_image, send_state, quat_no_antipodal } = self.parameters;
        let text = |flag: bool| flag.to_string();
        let execute = (self.execute != DEFAULT_EXECUTE).then(|| self.execute.to_string());
        let format =
            (self.image_format != ImageFormat::default()).then(|| self.image_format.to_string());
        let options = [
            ("execute", execute),
            ("image_format", format),
            ("send_wrist_image", send_wrist_image.map(text)),
            ("send_state", send_state.map(text)),
            ("quat_no_antipodal", quat_no_antipodal.map(text)),
        ];
        let mut separator = '?';
        for (name, value) in options {
            if let Some(value) = value {
                write!(f, "{separator}{name}={value}")?;
                separator = '&';
            }
        }
        Ok(())
    }
}

#[derive(Debug, Error)]
#[error(
    "read {text:?} as a vla-eval model server's address: write vla-eval://HOST:PORT (vla-evals:// \
     over TLS), optionally followed by ?NAME=VALUE&NAME=VALUE with execute=1 to {MAX_EXECUTE}, \
     image_format=png, raw or jpeg, and send_wrist_image, send_state or quat_no_antipodal=true or \
     false"
)]
pub struct VlaEvalAddressError {
    pub text: String,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_is_parsed_and_displayed_unchanged() {
        let valid = [
            "vla-eval://gpu7:8000",
            "vla-evals://[::1]:8000?execute=10",
            "vla-eval://gpu7:8000?image_format=jpeg&send_wrist_image=true&send_state=false",
            "vla-eval://gpu7:8000?quat_no_antipodal=true",
        ];
        for text in valid {
            let address: VlaEvalAddress = text.parse().expect(text);
            assert_eq!(address.to_string(), text);
        }
        let invalid = [
            "vla-eval://gpu7",
            "vla-eval://:8000",
            "ws://gpu7:8000",
            "vla-eval://gpu7:8000/path",
            "vla-eval://gpu7:8000?execute=0",
            "vla-eval://gpu7:8000?image_format=gif",
            "vla-eval://gpu7:8000?send_state=1",
            "vla-eval://gpu7:8000?seed=7",
            "vla-eval://gpu7:8000?execute",
        ];
        for text in invalid {
            let error = text.parse::<VlaEvalAddress>().expect_err(text);
            assert!(error.to_string().contains("vla-eval://HOST:PORT"), "{error}");
        }
    }
}
