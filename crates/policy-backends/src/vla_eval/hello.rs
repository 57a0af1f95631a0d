//! Interprets a vla-eval server's HELLO by the rules of vla-eval's orchestrator and LIBERO
//! benchmark: derives the observations that the server needs, and refuses a server that cannot be
//! run. Pure functions.

use benchmark::attempt::UNNAMED_CHECKPOINT;
use proto::policy::{DescribeResponse, Language, Setting, StateField};
use rmpv::{Value, ValueRef};
use sha2::{Digest, Sha256};

use super::address::VlaEvalAddress;
use super::message::VERSION;
use crate::numpy::{as_text, encode, lookup};
use crate::observations::camera;

/// Names of the cameras in the simulator and in vla-eval's observations.
pub(super) const CAMERAS: [(&str, &str); 2] =
    [("agentview", "agentview"), ("robot0_eye_in_hand", "wrist")];
const STATE: [StateField; 4] =
    [StateField::EefPos, StateField::EefQuatXyzw, StateField::EefRotation, StateField::GripperPos];
/// Parameters of vla-eval's LIBERO benchmark that a campaign sets, whatever the server requests.
/// Parameters that the benchmark does not know are ignored, as in the benchmark.
const CAMPAIGN_PARAMETERS: [&str; 4] = ["seed", "env_seed", "max_steps", "num_steps_wait"];
/// Length to which the recorded value of a setting is truncated, bytes; the digest covers the whole
/// HELLO.
const RECORDED_BYTES: usize = 512;

/// Negotiated settings of a server's episodes.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Terms {
    /// Suite of the server, if it names exactly one.
    pub(super) suite: Option<String>,
    pub(super) sends_wrist: bool,
    pub(super) sends_state: bool,
    /// True if a quaternion with negative w is replaced by its antipode.
    pub(super) flips_quaternion: bool,
    pub(super) described: DescribeResponse,
}

/// Derives the terms from a server's HELLO. The error includes the remedy, and follows the words
/// "the policy server cannot be run here:".
pub(super) fn terms(hello: &ValueRef<'_>, address: &VlaEvalAddress) -> Result<Terms, String> {
    let version = lookup(hello, "protocol_version");
    if version != Some(&VERSION.into()) {
        let version = version.map_or_else(
            || "an unnamed version".to_owned(),
            |version| format!("version {version}"),
        );
        return Err(format!(
            "it uses {version} of vla-eval's protocol, and this gateway uses version {VERSION}; \
             upgrade the older side"
        ));
    }
    check_actions(hello)?;
    let none = ValueRef::Map(vec![]);
    let requested = lookup(hello, "observation_params").unwrap_or(&none);
    let given = address.parameters;
    if flag(requested, "absolute_action", None)? {
        return Err(
            "it requests absolute_action, so its actions are poses, but LIBERO-CTRL's actions are \
             motions, which the actuation axis perturbs; serve a checkpoint of relative actions"
                .to_owned(),
        );
    }
    let wrist = flag(requested, "send_wrist_image", given.send_wrist_image)?;
    let state = flag(requested, "send_state", given.send_state)?;
    let flips = !flag(requested, "quat_no_antipodal", given.quat_no_antipodal)?;
    let suite = lookup(requested, "suite").and_then(as_text).map(str::to_owned);
    let text = |key| lookup(hello, key).and_then(as_text).unwrap_or_default();
    let cameras = &CAMERAS[..if wrist { 2 } else { 1 }];
    let slots: Vec<_> = cameras.iter().map(|(camera, slot)| format!("{slot}={camera}")).collect();
    let controller_states = match state {
        false => "none",
        true => "of the instant of observation, not of the end of the control step",
    };
    let state_format = match (state, flips) {
        (false, _) => "none",
        (true, true) => "eef_pos3_axisangle3_gripper2, nearer antipode",
        (true, false) => "eef_pos3_axisangle3_gripper2, quaternion as it is",
    };
    let campaign = CAMPAIGN_PARAMETERS.into_iter();
    let campaign: Vec<_> = campaign.filter(|name| lookup(requested, name).is_some()).collect();
    let recorded = |key| lookup(hello, key).map_or_else(|| "none".to_owned(), declaration);
    let settings = [
        ("server", format!("{} of vla-eval {}", text("model_server"), text("harness_version"))),
        ("observation parameters", recorded("observation_params")),
        ("left to the campaign", or_none(&campaign.join(", "))),
        ("observation spec", recorded("observation_spec")),
        ("action spec", recorded("action_spec")),
        ("image slots", slots.join(", ")),
        ("image format", address.image_format.to_string()),
        ("state", state_format.to_owned()),
        ("controller states", controller_states.to_owned()),
        ("gripper", "open below 0, else closed".to_owned()),
    ];
    let described = DescribeResponse {
        protocol_version: proto::PROTOCOL_VERSION,
        name: match text("model_server") {
            "" => "vla-eval".to_owned(),
            name => name.to_owned(),
        },
        checkpoint: format!("{UNNAMED_CHECKPOINT}, whose HELLO is sha256 {}…", digest(hello)),
        cameras: cameras.iter().map(|(name, _)| camera(name)).collect(),
        state: if state { STATE.map(i32::from).into() } else { vec![] },
        horizon: address.execute,
        execute: address.execute,
        // A connection is a session, with chunks, histories and ensembles.
        stateful: true,
        stochastic: true,
        unseeded: true,
        language: Language::FreeForm.into(),
        settings: settings
            .map(|(name, value)| Setting { name: name.to_owned(), value: truncated(value) })
            .into(),
        ..DescribeResponse::default()
    };
    Ok(Terms { suite, sends_wrist: wrist, sends_state: state, flips_quaternion: flips, described })
}

/// Refuses actions that LIBERO's robot would misinterpret. Other declarations that differ from
/// LIBERO's (such as Euler angles) are accepted, as in vla-eval's LIBERO benchmark.
fn check_actions(hello: &ValueRef<'_>) -> Result<(), String> {
    let format = |part| {
        let spec = lookup(lookup(hello, "action_spec")?, part)?;
        lookup(spec, "format").and_then(as_text)
    };
    let effect = match format("gripper") {
        Some("continuous_01" | "binary_close_01") => "never open",
        Some("binary_close_negative") => "open where it should close",
        _ => "",
    };
    if !effect.is_empty() {
        let format = format("gripper").unwrap_or_default();
        return Err(format!(
            "it declares its gripper as {format}, and LIBERO closes the gripper at values from 0 \
             up: it would {effect}; have the server answer -1 for open and 1 for closed \
             (binary_close_positive; GR00T: invert_gripper)"
        ));
    }
    if format("position") == Some("absolute_xyz") {
        return Err(
            "it declares absolute positions, and LIBERO-CTRL's actions are motions; serve a \
             checkpoint of relative actions"
                .to_owned(),
        );
    }
    Ok(())
}

/// Returns a flag: the address's value, else the server's request, else false.
fn flag(requested: &ValueRef<'_>, name: &str, given: Option<bool>) -> Result<bool, String> {
    match (given, lookup(requested, name)) {
        (Some(given), _) => Ok(given),
        (None, None | Some(ValueRef::Nil)) => Ok(false),
        (None, Some(ValueRef::Boolean(requested))) => Ok(*requested),
        (None, Some(other)) => Err(format!(
            "it requests {name} = {other}, which is neither true nor false; correct the server's \
             observation parameters"
        )),
    }
}

/// Summarises a map of a HELLO. A component's specification is reduced to its format.
fn declaration(value: &ValueRef<'_>) -> String {
    let ValueRef::Map(entries) = value else {
        return or_none(&value.to_string());
    };
    let entries = entries.iter().map(|(name, value)| {
        let name = as_text(name).map_or_else(|| name.to_string(), str::to_owned);
        match lookup(value, "format").and_then(as_text) {
            Some(format) => format!("{name}={format}"),
            None => format!("{name}={value}"),
        }
    });
    or_none(&entries.collect::<Vec<_>>().join(", "))
}

fn truncated(mut text: String) -> String {
    let fits = |at: &usize| *at <= RECORDED_BYTES;
    let ends = text.char_indices().map(|(at, c)| at + c.len_utf8());
    text.truncate(ends.take_while(fits).last().unwrap_or_default());
    text
}

fn or_none(text: &str) -> String {
    match text {
        "" => "none".to_owned(),
        text => text.to_owned(),
    }
}

fn digest(hello: &ValueRef<'_>) -> String {
    let hello: Value = hello.to_owned();
    hex::encode(&Sha256::digest(encode(&hello))[..8])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn terms_for(parameters: Value) -> Result<Terms, String> {
        let hello = crate::numpy::map([
            ("protocol_version", VERSION.into()),
            ("observation_params", parameters),
        ]);
        let address = "vla-eval://h:1".parse().expect("an address");
        terms(&hello.as_ref(), &address)
    }

    #[test]
    fn a_long_declaration_is_truncated_to_the_recorded_length() {
        let long = "é".repeat(10 * RECORDED_BYTES);
        let parameters = Value::Map(vec![(long.as_str().into(), true.into())]);
        let described = terms_for(parameters).expect("valid terms").described;
        let lengths = described.settings.iter().map(|setting| setting.value.len());
        assert_eq!(lengths.max(), Some(RECORDED_BYTES));
    }

    #[test]
    fn null_or_empty_parameters_count_as_absent() {
        for absent in [Value::Nil, Value::Map(vec![]), "".into()] {
            let terms = terms_for(absent).expect("valid terms");
            assert!(!terms.sends_wrist && !terms.sends_state && terms.flips_quaternion);
        }
    }
}
