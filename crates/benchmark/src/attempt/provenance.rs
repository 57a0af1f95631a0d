//! Provenance of a result.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use crate::{Look, Realisation, RendererKind, Wanted};
use serde::{Deserialize, Serialize};

/// Name of this project's renderer, up to its version.
pub const SOFTWARE_RENDERER: &str = "rollout-raster ";

/// Name of the setting that holds the asset pack on which a policy was trained.
pub const TAUGHT_ON: &str = "taught on";

/// Name of the setting that holds the look on which a policy was trained.
pub const TAUGHT_ON_LOOK: &str = "taught on look";

/// Name of the setting that holds the execution model; absent if the model is `wait`.
pub const EXECUTION: &str = "execution model";

/// Name of the setting that holds the time since which no connection to a server was lost, for
/// servers that name no checkpoint and may have been replaced since.
pub const CONNECTED_SINCE: &str = "connected since";

/// Beginning of the checkpoint of a policy whose server names none.
pub const UNNAMED_CHECKPOINT: &str = "not named by its server";

/// Largest number of rollouts that one warning names; further ones are only counted.
const MAX_NAMED: usize = 5;
/// Longest text of a provenance, bytes.
pub const MAX_TEXT_BYTES: usize = 512;
/// Most settings of a provenance: those of a policy's description, and up to four that the worker
/// adds: `execute`, `horizon`, and two about the execution model.
pub const MAX_SETTINGS: usize = 68;

/// Most packages of another simulator.
pub const MAX_PACKAGES: usize = 512;

/// Execution model of results without the setting [`EXECUTION`].
const WAIT: &str = "wait";

/// Asset pack, simulator, renderer and look of a worker. A campaign is pinned to one combination:
/// results of different combinations belong to different benchmarks and are never pooled.
#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Pin {
    pub asset_pack: String,
    /// SHA-256 of the asset pack, hex.
    pub asset_pack_digest: String,
    pub mujoco_version: String,
    pub renderer: String,
    pub look: Look,
}

/// The part of a result's origin that many results share.
#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Provenance {
    pub host: String,
    /// The worker's asset pack, simulator, renderer and look.
    #[serde(flatten)]
    pub pin: Pin,
    /// SHA-256 of a fixed motion and its frames, hex. Slots with equal fingerprints simulate and
    /// render with equal bits.
    pub fingerprint: String,
    /// Realisation, as [`crate::Realisation`] names it.
    pub realisation: String,
    pub policy_name: String,
    pub policy_checkpoint: String,
    /// Digest of the weights, as the policy reports it.
    pub policy_checkpoint_digest: String,
    /// True if the policy received the simulator's state.
    pub policy_privileged: bool,
    /// True if the policy received the canonical instruction under every condition.
    pub policy_canonical_only: bool,
    /// Settings that the policy's server resolved and that affect its actions, by name: chunk
    /// length, executed actions, image slots, statistics, revision. Empty if it reports none.
    pub policy_settings: BTreeMap<String, String>,
    /// Batch mode in which a gateway queried the policy: "single", "deterministic" (single, with
    /// all queries of a seed at one replica) or "up to N" queries, with the suffix ", unseeded" if
    /// the server takes no seed. "single" without a gateway.
    pub batch_mode: String,
    pub program_version: String,
    /// Another simulator, and its graphics driver, as `simulator` and `driver`, and version and
    /// digest of each of its packages; empty for LIBERO.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub simulator: BTreeMap<String, String>,
}

/// Digests by which the rollouts of one initial state are compared, SHA-256, hex.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Digests {
    pub scene: String,
    /// Digest of the initial state's bytes, before any perturbation.
    pub init_state: String,
    /// Digest of the first frames that the policy received; empty if it uses none.
    pub first_frame: String,
}

/// Mix of fingerprints among the results of a campaign.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Fingerprints {
    /// Number of results by fingerprint.
    pub results: BTreeMap<String, u64>,
    /// Tasks and initial states whose results have several fingerprints.
    pub mixed: Vec<String>,
}

impl Pin {
    /// Returns true if a campaign pinned to `self` accepts results of a worker with the pin
    /// `worker`.
    pub fn accepts(&self, worker: &Pin) -> bool {
        self.asset_pack_digest == worker.asset_pack_digest
            && self.mujoco_version == worker.mujoco_version
            && self.renderer == worker.renderer
            && self.look == worker.look
    }

    /// Returns true if a worker with this pin meets a campaign's requirements.
    pub fn meets(&self, wanted: &Wanted) -> bool {
        let has_pack = |name: &String| {
            self.asset_pack == *name || self.asset_pack_digest.starts_with(name.as_str())
        };
        let is_software = self.renderer.starts_with(SOFTWARE_RENDERER);
        let draws = |kind| (kind == RendererKind::Software) == is_software;
        wanted.assets.as_ref().is_none_or(has_pack)
            && wanted.renderer.is_none_or(draws)
            && wanted.look.is_none_or(|look| look == self.look)
    }
}

impl Digests {
    /// Names the first field that holds no digest; `None` if there is none.
    pub(crate) fn problem(&self) -> Option<String> {
        let first_frame = Some(&self.first_frame).filter(|digest| !digest.is_empty());
        let digests = [
            ("digests.scene", Some(&self.scene)),
            ("digests.init_state", Some(&self.init_state)),
            ("digests.first_frame", first_frame),
        ];
        digests.into_iter().find_map(|(field, digest)| not_a_digest(field, digest?))
    }
}

fn not_a_digest(field: &str, value: &str) -> Option<String> {
    let is_hex = |byte: u8| byte.is_ascii_digit() || (b'a'..=b'f').contains(&byte);
    let is_digest = value.len() == 64 && value.bytes().all(is_hex);
    (!is_digest).then(|| format!("`{field}` is not a SHA-256 in lower-case hex"))
}

impl Provenance {
    /// Describes the first field with a value that no worker sends; `None` if there is none.
    pub fn problem(&self) -> Option<String> {
        let pin = &self.pin;
        let required = [
            ("asset_pack", &pin.asset_pack),
            ("asset_pack_digest", &pin.asset_pack_digest),
            ("mujoco_version", &pin.mujoco_version),
            ("renderer", &pin.renderer),
            ("policy_name", &self.policy_name),
        ];
        let settings = self.policy_settings.iter().flat_map(|(name, value)| [name, value]);
        let simulator = self.simulator.iter().flat_map(|(name, value)| [name, value]);
        let mut texts = required
            .into_iter()
            .chain([
                ("host", &self.host),
                ("policy_checkpoint", &self.policy_checkpoint),
                ("policy_checkpoint_digest", &self.policy_checkpoint_digest),
                ("batch_mode", &self.batch_mode),
                ("program_version", &self.program_version),
            ])
            .chain(settings.map(|text| ("policy_settings", text)))
            .chain(simulator.map(|text| ("simulator", text)));
        if let Some((field, _)) = texts.find(|(_, text)| text.len() > MAX_TEXT_BYTES) {
            return Some(format!("`{field}` is longer than {MAX_TEXT_BYTES} bytes"));
        }
        if let Some((field, _)) = required.into_iter().find(|(_, text)| text.is_empty()) {
            return Some(format!("`{field}` is empty"));
        }
        let settings = self.policy_settings.len();
        if settings > MAX_SETTINGS {
            return Some(format!(
                "`policy_settings` has {settings} entries; it may have at most {MAX_SETTINGS}"
            ));
        }
        // The simulator's name and its driver are beside the packages.
        let (entries, most) = (self.simulator.len(), MAX_PACKAGES + 2);
        if entries > most {
            return Some(format!("`simulator` has {entries} entries; it may have at most {most}"));
        }
        if let Err(error) = self.realisation.parse::<Realisation>() {
            return Some(format!("`realisation`: {error}"));
        }
        not_a_digest("fingerprint", &self.fingerprint)
    }

    /// Formats the policy's settings, such as `execute 8, horizon 50`; empty if there are none.
    pub fn policy_settings_in_words(&self) -> String {
        let settings = self.policy_settings.iter();
        let settings: Vec<String> =
            settings.map(|(name, value)| format!("{name} {value}")).collect();
        settings.join(", ")
    }

    /// Returns the text of the execution model: what the robot does while a response is pending.
    pub fn execution(&self) -> &str {
        self.policy_settings.get(EXECUTION).map_or(WAIT, String::as_str)
    }

    /// Returns true if neither a digest nor a name identifies the weights that were measured.
    pub fn is_unidentified(&self) -> bool {
        let name = &self.policy_checkpoint;
        let is_unnamed = name.is_empty() || name.starts_with(UNNAMED_CHECKPOINT);
        is_unnamed && self.policy_checkpoint_digest.is_empty()
    }

    /// Returns the asset pack that the policy reports to have been trained on, if it differs from
    /// the one that the policy was measured on.
    pub fn other_training_pack(&self) -> Option<&str> {
        let taught_on = self.policy_settings.get(TAUGHT_ON)?.as_str();
        let Pin { asset_pack, asset_pack_digest, .. } = &self.pin;
        (taught_on != asset_pack && taught_on != asset_pack_digest).then_some(taught_on)
    }

    /// Returns the look that the policy reports to have been trained on, if it differs from the one
    /// that the policy was measured on.
    pub fn other_training_look(&self) -> Option<&str> {
        let taught_on = self.policy_settings.get(TAUGHT_ON_LOOK)?.as_str();
        (taught_on != self.pin.look.name()).then_some(taught_on)
    }

    /// Describes the first difference of this result's policy from the policy of an earlier result,
    /// `pinned`, of the same campaign and suite; `None` if the policies are the same. Ignores the
    /// execution model, the time of connection and the reported training assets: none affects the policy's actions, and
    /// a server may begin to report them later.
    pub fn policy_difference(&self, pinned: &Provenance) -> Option<String> {
        let differs = |property: &str, now: &str, before: &str| {
            (now != before).then(|| format!("{property} is `{now}` now and was `{before}`"))
        };
        let digests = [self, pinned].map(|provenance| provenance.policy_checkpoint_digest.as_str());
        let settings = &pinned.policy_settings;
        differs("name", &self.policy_name, &pinned.policy_name)
            .or_else(|| {
                let names = (&self.policy_checkpoint, &pinned.policy_checkpoint);
                differs("checkpoint", names.0, names.1)
            })
            .or_else(|| differs("digest of the weights", digests[0], digests[1]))
            .or_else(|| {
                // Fast path: this runs for every commit, and nearly all settings are equal.
                if &self.policy_settings == settings {
                    return None;
                }
                let mut names: BTreeSet<&String> =
                    settings.keys().chain(self.policy_settings.keys()).collect();
                names.retain(|name| {
                    ![TAUGHT_ON, TAUGHT_ON_LOOK, EXECUTION, CONNECTED_SINCE]
                        .contains(&name.as_str())
                });
                names.into_iter().find_map(|name| {
                    let [now, before] = [&self.policy_settings, settings]
                        .map(|settings| settings.get(name).map_or("not given", String::as_str));
                    differs(name, now, before)
                })
            })
    }
}

/// Numbers of results with each fingerprint, and configurations whose results have several.
impl fmt::Display for Fingerprints {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let results = self.results.iter();
        let results: Vec<String> = results
            .map(|(fingerprint, count)| {
                format!("{count} of {}", fingerprint.get(..12).unwrap_or(fingerprint))
            })
            .collect();
        let mixture = match self.mixed.len() {
            0 => "no configuration mixes them".to_owned(),
            1 => format!("1 configuration mixes them: {}", first_names(&self.mixed)),
            many => format!("{many} configurations mix them: {}", first_names(&self.mixed)),
        };
        write!(
            f,
            "results have {} fingerprints, so that the machines' arithmetic or frames differ: {}; \
             {mixture}",
            self.results.len(),
            results.join(", ")
        )
    }
}

/// Lists the first [`MAX_NAMED`] names and the number of further ones.
pub fn first_names(names: &[String]) -> String {
    let mut text = names[..names.len().min(MAX_NAMED)].join("; ");
    if names.len() > MAX_NAMED {
        text.push_str(&format!("; and {} more", names.len() - MAX_NAMED));
    }
    text
}

impl fmt::Display for Pin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let digest = self.asset_pack_digest.get(..12);
        let digest = digest.unwrap_or(&self.asset_pack_digest);
        let Pin { asset_pack, mujoco_version, renderer, look, .. } = self;
        write!(
            f,
            "asset pack `{asset_pack}` ({digest}) with MuJoCo {mujoco_version}, renderer \
             `{renderer}` and look `{look}`"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn measured_on(pack: &str, taught_on: Option<&str>) -> Provenance {
        let taught_on = taught_on.map(|assets| (TAUGHT_ON.to_owned(), assets.to_owned()));
        Provenance {
            pin: Pin {
                asset_pack: pack.to_owned(),
                asset_pack_digest: "d1".to_owned(),
                ..Pin::default()
            },
            policy_settings: taught_on.into_iter().collect(),
            ..Provenance::default()
        }
    }

    #[test]
    fn training_on_other_assets_is_detected_if_declared() {
        let training_pack = |pack, taught_on| {
            let provenance = measured_on(pack, taught_on);
            provenance.other_training_pack().map(str::to_owned)
        };
        assert_eq!(training_pack("libero", None), None);
        assert_eq!(training_pack("libero", Some("libero")), None);
        assert_eq!(training_pack("libero", Some("d1")), None);
        let primitives = Some("primitives");
        assert_eq!(training_pack("libero", primitives).as_deref(), primitives);
    }

    #[test]
    fn newly_declared_training_assets_and_another_connection_do_not_change_the_policy() {
        let undeclared = measured_on("libero", None);
        let mut connected = undeclared.clone();
        connected.policy_settings.insert(CONNECTED_SINCE.to_owned(), "1".to_owned());
        for declared in [measured_on("libero", Some("libero")), connected] {
            assert_eq!(declared.policy_difference(&undeclared), None);
            assert_eq!(undeclared.policy_difference(&declared), None);
        }
    }
}
