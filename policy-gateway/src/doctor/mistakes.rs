//! Verdicts on the usual mistakes, as pure functions of a server's answers. Each failure states what
//! was observed, its usual cause and the remedy.

use benchmark::Action;
use proto::policy::{DescribeResponse, Language};

use crate::doctor::fit::GRIPPER;
use crate::doctor::randomness::{REPEATABLE, SEEDS_PER_MEAN};
use crate::doctor::verdict::{Verdict, fail, pass, skip};

/// Largest difference between values that count as equal.
const SAME: f64 = 1e-6;
/// Factor by which a change exceeds the noise if it has an effect.
const BEYOND_NOISE: f64 = 1.5;

/// Variation of answers with a change of the input, and without. The answers of a server that
/// samples are means.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Change {
    /// Largest difference that the change causes.
    pub largest: f64,
    /// Largest difference between answers to a repeated query.
    pub noise: f64,
}

impl Change {
    /// Returns true if the change affects answers, by more than the noise of means explains:
    /// among as many changed as repeated answers, the largest difference varies by less than
    /// [`BEYOND_NOISE`].
    fn has_effect(self) -> bool {
        self.largest > SAME.max(BEYOND_NOISE * self.noise)
    }

    fn beside_noise(self) -> String {
        match self.noise > REPEATABLE {
            false => String::new(),
            true => format!(
                " (means of {SEEDS_PER_MEAN} answers, which differ by {:.2} with the change and by \
                 {:.2} without)",
                self.largest, self.noise
            ),
        }
    }
}

pub(super) fn is_constant(actions: &[Action]) -> bool {
    let Some(first) = actions.first() else {
        return true;
    };
    let difference = |action: &Action| {
        let pairs = action.iter().zip(first);
        pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    };
    actions.iter().all(|action| difference(action) <= SAME)
}

pub(super) fn motion(actions: &[Action]) -> Verdict {
    let is_still = |action: &Action| action[..GRIPPER].iter().all(|number| number.abs() <= SAME);
    let count = actions.len();
    let advice = "Usually weights are missing or random, or the variance in the statistics is 0: \
                  check the files that the server loads.";
    if actions.iter().all(is_still) {
        fail(format!("translation and rotation of all {count} actions are 0. {advice}"))
    } else if is_constant(actions) {
        let first: Vec<String> = actions[0].iter().map(|number| format!("{number:.3}")).collect();
        fail(format!("all {count} actions are [{}]. {advice}", first.join(", ")))
    } else {
        pass("")
    }
}

/// Checks that observations affect the answers at all.
pub(super) fn observations(
    change: Change,
    situations: usize,
    described: &DescribeResponse,
) -> Verdict {
    let has_inputs = !described.cameras.is_empty() || !described.state.is_empty();
    if !has_inputs && !described.privileged {
        return skip("it requests no observation");
    }
    match change.has_effect() {
        true => pass(""),
        false => fail(format!(
            "{situations} observations get the same answer, within {:.1e}{}. Usually the answer to \
             the first query is cached, or the inputs do not reach the network: log the network's \
             inputs.",
            change.largest,
            change.beside_noise()
        )),
    }
}

pub(super) fn frames(changes: &[(String, Change)]) -> Verdict {
    let unused = changes.iter().filter(|(_, change)| !change.has_effect());
    let names = unused.clone().map(|(camera, change)| format!("{camera}{}", change.beside_noise()));
    let names: Vec<String> = names.collect();
    if names.is_empty() {
        return pass("");
    }
    let other_cameras = match names.len() < changes.len() {
        true => "; frames of the other cameras do",
        false => "",
    };
    fail(format!(
        "frames of {} that are flipped vertically, or black, change no action{other_cameras}. \
         Usually an image slot of the network stays empty: compare the names of cameras and slots, \
         or do not request these frames.",
        names.join(" and ")
    ))
}

/// Checks that the policy declares that it reads instructions. The error says what the policy
/// declares instead.
pub(super) fn reads_language(described: &DescribeResponse) -> Result<(), &'static str> {
    match described.language() {
        Language::FreeForm | Language::CanonicalOnly => Ok(()),
        Language::Ignored => Err("it declares that it ignores instructions"),
        Language::Unspecified => Err("it does not declare whether it reads instructions"),
    }
}

pub(super) fn instructions(change: Change, count: usize) -> Verdict {
    match change.has_effect() {
        true => pass(""),
        // An instruction changes the first actions less than a frame does.
        false if change.noise > REPEATABLE => skip(format!(
            "no effect of {count} other instructions is seen beside the noise{}",
            change.beside_noise()
        )),
        false => fail(format!(
            "{count} other instructions change no action. Usually the text does not reach the \
             network, or it was tuned on one task: log the prompt. If it reads no instruction, \
             declare its language as ignored."
        )),
    }
}

pub(super) fn gripper(actions: &[Action]) -> Verdict {
    let numbers = || actions.iter().map(|action| action[GRIPPER]);
    let least = numbers().fold(f64::INFINITY, f64::min);
    let most = numbers().fold(f64::NEG_INFINITY, f64::max);
    if least < 0.0 {
        return pass("");
    }
    let convention = match most <= 1.0 {
        true => "Numbers of 0 to 1 are usually RLDS's, where 1 is open: answer 1 - 2 g.",
        false => "Usually the gripper's statistics are wrong.",
    };
    fail(format!(
        "its number lies within {least:.3}..{most:.3} in all {} actions, and only numbers below 0 \
         open it (-1 open, 1 closed). {convention}",
        actions.len()
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fails(verdict: &Verdict, expected: &str) -> bool {
        matches!(verdict, Verdict::Fail { reason } if reason.contains(expected))
    }

    fn passes(verdict: &Verdict) -> bool {
        verdict.parts().0 == "pass"
    }

    #[test]
    fn a_change_has_an_effect_if_it_exceeds_the_noise() {
        let change = |largest, noise| Change { largest, noise }.has_effect();
        for (largest, noise, has_effect) in
            [(0.1, 0.0, true), (0.0, 0.0, false), (1e-5, 1e-5, false), (0.06, 0.05, false)]
        {
            assert_eq!(change(largest, noise), has_effect, "{largest} {noise}");
        }
        assert!(change(0.5, 0.05));
        let hidden = instructions(Change { largest: 0.06, noise: 0.05 }, 8);
        assert!(
            matches!(&hidden, Verdict::Skip { reason } if reason.contains("0.06")),
            "{hidden:?}"
        );
    }

    #[test]
    fn frames_without_an_effect_beyond_the_noise_fail() {
        let verdict = |largest, noise| {
            let unused = Change { largest: 0.0, noise: 0.0 };
            let other = Change { largest, noise };
            frames(&[("a".to_owned(), unused), ("b".to_owned(), other)])
        };
        assert!(fails(&verdict(0.5, 0.0), "frames of the other cameras do"));
        assert!(fails(&verdict(0.06, 0.05), "frames of a and b (means of 8 answers"));
    }

    #[test]
    fn one_opening_action_passes_and_values_of_zero_to_one_fail_with_a_conversion() {
        let with_gripper = |number: f64| {
            let mut action = [0.1; 7];
            action[GRIPPER] = number;
            action
        };
        let opening = [with_gripper(0.5), with_gripper(-0.2)];
        assert!(passes(&gripper(&opening)));
        let zero_to_one = [with_gripper(0.0), with_gripper(1.0)];
        assert!(fails(&gripper(&zero_to_one), "1 - 2 g"));
    }
}
