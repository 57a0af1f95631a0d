//! Verdicts of the diagnosis, as pure functions of a server's answers. Each failure states what was
//! observed, its usual cause and the remedy.

use std::time::Duration;

use proto::checks::ActionFault;
use proto::policy::{DescribeResponse, Language};

use crate::doctor::{
    fit::GRIPPER,
    randomness::{REPEATABLE, SEEDS_PER_MEAN},
    server::Action,
    verdict::{Verdict, fail, pass, percentile, skip},
};

/// Largest difference between values that count as equal.
const SAME: f64 = 1e-6;
/// Factor by which a change exceeds the noise if it has an effect.
const BEYOND_NOISE: f64 = 1.5;
/// Growth of memory per episode that is ignored, bytes; logs and allocators cause that much.
const IGNORED_GROWTH_BYTES: u64 = 200 << 10;
/// Slowdown that indicates growing memory: the median episode of the second third takes longer than
/// that of the first by this factor, and that of the last third longer than that of the second.
const MIN_SLOWDOWN: f64 = 1.25;
/// Smallest slowdown from the first to the last third that indicates growing memory.
const MIN_TOTAL_SLOWDOWN: Duration = Duration::from_millis(50);

/// Variation of answers with a change of the input, and without. The answers of a server that
/// samples are means.
#[derive(Clone, Copy, Debug)]
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

pub(super) fn actions(faults: &[ActionFault], count: usize) -> Verdict {
    match faults.first() {
        None => pass(""),
        Some(fault) => fail(format!(
            "{} of {count} answers are not valid actions: {fault}. NaN usually comes from half \
             precision, or from statistics that lack a dimension: run the policy in float32 and \
             check the files that it loads.",
            faults.len()
        )),
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

/// Checks the latencies. The first query is separate, because it may include a compilation.
pub(super) fn latency(latencies: &[Duration], answer_within: Duration) -> Verdict {
    let Some((first, later)) = latencies.split_first() else {
        return skip("no query was sent");
    };
    let mut sorted = later.to_vec();
    sorted.sort_unstable();
    let (median, p99) = (percentile(&sorted, 50), percentile(&sorted, 99));
    let slowest = latencies.iter().max().copied().unwrap_or_default();
    let ms = |duration: Duration| duration.as_secs_f64() * 1e3;
    let figures = format!(
        "first {:.1} ms, then median {:.1} ms, 99th percentile {:.1} ms of {} queries",
        ms(*first),
        ms(median),
        ms(p99),
        sorted.len()
    );
    let limit = answer_within.as_secs_f64();
    if slowest > answer_within {
        let advice = match *first == slowest && p99 <= answer_within {
            true => "Compile and warm up before the server listens",
            false => "Serve it from a faster device",
        };
        fail(format!(
            "{figures}. A gateway treats a server that needs more than {limit} s as out of \
             service. {advice}, or raise answer_within_secs."
        ))
    } else if p99 > answer_within / 2 {
        pass(format!("{figures}; a gateway waits {limit} s"))
    } else {
        pass(figures)
    }
}

/// Checks that a process does not grow from episode to episode. `resident` holds its memory, in
/// bytes, after each episode.
pub(super) fn memory(process: &str, resident: &[u64]) -> Verdict {
    let count = resident.len();
    let third = count / 3;
    if third == 0 {
        return skip("too few episodes were played");
    }
    // Any program grows during the first third, as it warms up.
    let [begin, middle, end] = [count - 1 - 2 * third, count - 1 - third, count - 1];
    let grown = |from: usize, to: usize| resident[to].saturating_sub(resident[from]);
    let mib = |bytes: u64| bytes as f64 / f64::from(1 << 20);
    let allowed = IGNORED_GROWTH_BYTES * third as u64;
    if grown(begin, middle) > allowed && grown(middle, end) > allowed {
        return fail(format!(
            "{process} grew from {:.0} to {:.0} MiB over the last {} of {count} episodes, {:.2} \
             MiB each, though every episode was ended (End). Usually observations or caches are \
             kept by session: drop them at End, and bound how many episodes are kept.",
            mib(resident[begin]),
            mib(resident[end]),
            2 * third,
            mib(grown(begin, end)) / (2 * third) as f64,
        ));
    }
    pass(format!(
        "{process} holds {:.0} MiB after {count} episodes; a GPU's memory is not measured",
        mib(resident[end])
    ))
}

/// Checks that episodes do not become slower, for servers whose memory cannot be read, such as
/// those on other machines.
pub(super) fn slowing(durations: &[Duration]) -> Verdict {
    let third = durations.len() / 3;
    if third == 0 {
        return skip("too few episodes were played");
    }
    let median = |index: usize| {
        let mut sorted = durations[index * third..(index + 1) * third].to_vec();
        sorted.sort_unstable();
        sorted[third / 2]
    };
    let [first, second, last] = [0, 1, 2].map(median);
    let is_slower = |earlier: Duration, later: Duration| {
        later.as_secs_f64() > MIN_SLOWDOWN * earlier.as_secs_f64()
    };
    let count = durations.len();
    let ms = |duration: Duration| duration.as_secs_f64() * 1e3;
    if is_slower(first, second) && is_slower(second, last) && last - first > MIN_TOTAL_SLOWDOWN {
        return fail(format!(
            "episodes take longer and longer: medians of {:.0}, {:.0} and {:.0} ms by thirds of \
             {count}, though every episode was ended (End). Usually the server searches state that \
             it keeps per session.",
            ms(first),
            ms(second),
            ms(last),
        ));
    }
    pass(format!(
        "{count} episodes did not slow it down; its memory was not measured, because its process \
         is not on this machine or not accessible"
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
    fn steady_growth_is_a_leak_and_growth_at_the_start_is_not() {
        let mib = |number: f64| (number * f64::from(1 << 20)) as u64;
        let leaking: Vec<u64> = (0..30).map(|index| mib(100.0 + f64::from(index))).collect();
        assert!(fails(&memory("process 7", &leaking), "1.00 MiB each"));
        let starting: Vec<u64> =
            (0..30).map(|index| mib(100.0 + 40.0 * f64::from(index.min(12)))).collect();
        assert!(passes(&memory("process 7", &starting)));
        let one_jump: Vec<u64> =
            (0..30).map(|index| mib(if index < 25 { 100.0 } else { 180.0 })).collect();
        assert!(passes(&memory("process 7", &one_jump)));
    }

    #[test]
    fn steadily_slower_episodes_fail_and_one_slow_episode_does_not() {
        let durations = |millis: fn(u64) -> u64| {
            (0..30).map(|index| Duration::from_millis(millis(index))).collect()
        };
        let growing: Vec<Duration> = durations(|index| 20 + 10 * index);
        assert!(fails(&slowing(&growing), "longer and longer"));
        let jumping: Vec<Duration> = durations(|index| if index == 20 { 900 } else { 20 });
        assert!(passes(&slowing(&jumping)));
    }

    #[test]
    fn a_late_first_answer_gets_other_advice_than_a_slow_server() {
        let within = Duration::from_secs(50);
        let mut latencies = vec![Duration::from_millis(20); 40];
        assert!(passes(&latency(&latencies, within)));
        latencies[0] = Duration::from_secs(120);
        assert!(fails(&latency(&latencies, within), "warm up"));
        latencies = vec![Duration::from_secs(60); 40];
        assert!(fails(&latency(&latencies, within), "faster device"));
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
