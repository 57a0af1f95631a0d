//! The wire protocols: [`policy`] between workers, gateways and policy servers,
//! [`coordinator`] between workers, operators and the coordinator. Generated
//! from the `.proto` files in this crate's folder `rollout`, whose comments are the reference; a
//! test compares them with the folder `generated`.

#![forbid(unsafe_code)]
#![allow(clippy::all, reason = "generated code")]

/// `rollout.policy.v1`.
pub mod checks;
pub mod resize;
pub mod policy {
    include!("../generated/rollout.policy.v1.in");
}

impl policy::DescribeResponse {
    /// Returns the reason why the settings cannot be recorded, as a predicate for the subject
    /// "it", such as "names setting `a` twice"; `None` if they can be recorded.
    pub fn settings_problem(&self) -> Option<String> {
        let count = self.settings.len();
        if count > MAX_SETTINGS {
            return Some(format!("names {count} settings: at most {MAX_SETTINGS} are recorded"));
        }
        self.settings.iter().enumerate().find_map(|(index, setting)| {
            let name = &setting.name;
            if !(1..=MAX_SETTING_NAME_BYTES).contains(&name.len()) {
                return Some(format!(
                    "gives setting {index} a name of {} bytes: 1 to {MAX_SETTING_NAME_BYTES} fit",
                    name.len()
                ));
            }
            if setting.value.len() > MAX_SETTING_VALUE_BYTES {
                return Some(format!(
                    "gives setting `{name}` {} bytes: at most {MAX_SETTING_VALUE_BYTES} fit",
                    setting.value.len()
                ));
            }
            let earlier = &self.settings[..index];
            let is_repeated = earlier.iter().any(|setting| setting.name == *name);
            is_repeated.then(|| format!("names setting `{name}` twice"))
        })
    }
}

/// `rollout.coordinator.v1`.
pub mod coordinator {
    include!("../generated/rollout.coordinator.v1.in");
}

/// Version of [`policy`], exchanged on `Describe`.
pub const PROTOCOL_VERSION: u32 = 1;
/// Version of [`coordinator`], exchanged on `Register`; a worker of another version is refused.
pub const COORDINATOR_PROTOCOL_VERSION: u32 = 8;
/// Largest number of control steps for which a motion is sent: ten times LIBERO's longest rollout.
/// The outcome of a longer rollout is sent without its motion.
pub const MAX_MOTION_STEPS: usize = 5_200;
/// Most settings of a policy's description.
pub const MAX_SETTINGS: usize = 64;
/// Longest text of a description, such as a name or a digest, bytes.
pub const MAX_TEXT_BYTES: usize = 512;
/// Longest name of a setting, bytes.
pub const MAX_SETTING_NAME_BYTES: usize = 64;
/// Longest value of a setting, bytes.
pub const MAX_SETTING_VALUE_BYTES: usize = 512;
/// Largest message accepted, bytes: a batch of 64 observations of two 256 × 256 frames each takes
/// 24 MiB. tonic's own default of 4 MiB does not hold such a batch.
pub const MAX_MESSAGE_BYTES: usize = 32 << 20;
