//! A fingerprint of a perturbation as it was realised.

use std::fmt::{self, Write};

use protocol::Axis;
use sha2::{Digest, Sha256};

/// SHA-256 per axis over its parameters and what was realised of them: drawn
/// elements, poses, light arrays, joints.
///
/// An axis alone and the same axis in a combination must agree, which a digest
/// over all axes at once could not show. Displays as `camera:HEX,sensor:HEX`,
/// and as nothing for a nominal rollout.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct PerturbationDigest {
    axes: Vec<(Axis, [u8; 32])>,
}

impl PerturbationDigest {
    /// Adds an axis: the values of its parameters, and what became of them.
    pub fn add(&mut self, axis: Axis, parameters: &[f64], realised: &[f64]) {
        let mut hash = Sha256::new();
        hash.update(axis.name());
        for part in [parameters, realised] {
            hash.update((part.len() as u64).to_le_bytes());
            for value in part {
                hash.update(value.to_le_bytes());
            }
        }
        self.axes.push((axis, hash.finalize().into()));
        self.axes.sort_unstable();
    }

    /// The digest of one axis, if it is perturbed.
    pub fn axis(&self, axis: Axis) -> Option<[u8; 32]> {
        let found = self.axes.iter().find(|(other, _)| *other == axis);
        found.map(|&(_, digest)| digest)
    }
}

impl fmt::Display for PerturbationDigest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, (axis, digest)) in self.axes.iter().enumerate() {
            if i > 0 {
                f.write_char(',')?;
            }
            write!(f, "{axis}:")?;
            for byte in digest {
                write!(f, "{byte:02x}")?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_axis_has_the_same_digest_alone_and_among_others() {
        let mut alone = PerturbationDigest::default();
        alone.add(Axis::Sensor, &[1.0], &[2.0, 3.0]);
        let mut combined = PerturbationDigest::default();
        combined.add(Axis::Sensor, &[1.0], &[2.0, 3.0]);
        combined.add(Axis::Camera, &[0.5], &[]);
        assert_eq!(alone.axis(Axis::Sensor), combined.axis(Axis::Sensor));
        assert!(combined.to_string().starts_with("camera:"));
        assert_eq!(PerturbationDigest::default().to_string(), "");
    }

    #[test]
    fn what_is_a_parameter_and_what_was_realised_are_told_apart() {
        let mut one = PerturbationDigest::default();
        one.add(Axis::Sensor, &[1.0, 2.0], &[3.0]);
        let mut other = PerturbationDigest::default();
        other.add(Axis::Sensor, &[1.0], &[2.0, 3.0]);
        assert_ne!(one, other);
    }
}
