//! Rule for the number of slots. Pure functions.

use std::collections::BTreeSet;

use libero_ctrl::TaskRef;

/// Share of the best throughput that a number of slots must reach. Further slots would take memory
/// and cores from other processes for the remaining few per cent.
pub(super) const ENOUGH_SHARE: f64 = 0.95;
/// Share of the available memory that slots may take. The remaining memory is for videos and for
/// tasks whose scenes are larger than the measured scene.
const MEMORY_SHARE: f64 = 0.8;

/// Combined throughput of a number of slots.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Throughput {
    pub(super) slots: usize,
    /// Control steps per second of all these slots together.
    pub(super) steps_per_sec: f64,
}

/// Returns the smallest number of slots that reaches [`ENOUGH_SHARE`] of the best throughput.
/// Numbers above `most` are ignored, also for the best throughput. `None` if no number is left.
pub(super) fn choose(measured: &[Throughput], most: usize) -> Option<Throughput> {
    let fitting = || measured.iter().filter(|throughput| throughput.slots <= most).copied();
    let best = fitting().map(|throughput| throughput.steps_per_sec).fold(0.0, f64::max);
    fitting()
        .filter(|throughput| throughput.steps_per_sec >= ENOUGH_SHARE * best)
        .min_by_key(|throughput| throughput.slots)
}

/// Returns the number of slots that should keep `cores` cores busy, if one slot alone makes
/// `steps_per_sec` control steps per second, queries the policy every `execute` steps and waits
/// `policy_secs` for each answer. At most 100 slots per core.
pub(super) fn slots_to_fill_cores(
    cores: usize,
    steps_per_sec: f64,
    execute: u32,
    policy_secs: f64,
) -> usize {
    const LEAST_BUSY: f64 = 0.01;
    let waiting = policy_secs * steps_per_sec / f64::from(execute.max(1));
    let busy = (1.0 - waiting).clamp(LEAST_BUSY, 1.0);
    // A cast from float to integer saturates.
    (cores as f64 / busy).ceil() as usize
}

/// Returns the numbers of slots to measure: 1, 2, 4, … below `most`, and `most`.
pub(super) fn numbers_to_measure(most: usize) -> BTreeSet<usize> {
    let powers = (0..usize::BITS).map(|power| 1 << power);
    powers.take_while(|number| *number < most).chain([most]).collect()
}

/// Memory use of a slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct PerSlot {
    /// Bytes that no other process can share.
    pub(super) own: u64,
    /// Number of compiled scenes that the slot keeps.
    pub(super) scenes: usize,
    /// Bytes of a scene's files in use; all slots with that scene share them.
    pub(super) scene_files: u64,
}

/// Returns the number of slots that fit into [`MEMORY_SHARE`] of `available` bytes of memory, at
/// least one. Assumes that no two slots share a scene until the slots hold the scenes of all
/// tasks.
pub(super) fn fitting_slots(available: u64, per_slot: PerSlot) -> usize {
    let room = available as f64 * MEMORY_SHARE;
    let tasks = TaskRef::all().count() as f64;
    let (own, files) = (per_slot.own.max(1) as f64, per_slot.scene_files as f64);
    let scenes = per_slot.scenes as f64;
    let unshared = room / (own + scenes * files);
    let slots = match unshared * scenes <= tasks {
        true => unshared,
        false => (room - tasks * files) / own,
    };
    // A cast from float to integer saturates.
    (slots as usize).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    const GIB: u64 = 1 << 30;

    fn chosen(measured: &[(usize, f64)], most: usize) -> Option<usize> {
        let measured: Vec<Throughput> = measured
            .iter()
            .map(|&(slots, steps_per_sec)| Throughput { slots, steps_per_sec })
            .collect();
        choose(&measured, most).map(|throughput| throughput.slots)
    }

    #[test]
    fn slots_are_added_while_throughput_rises() {
        let measured = [(1, 30.0), (2, 59.0), (4, 110.0), (8, 112.0), (16, 113.0)];
        assert_eq!(chosen(&measured, usize::MAX), Some(4));
        let all = [(1, 30.0), (2, 59.0), (4, 117.0), (8, 230.0)];
        assert_eq!(chosen(&all, usize::MAX), Some(8));
        assert_eq!(chosen(&[], usize::MAX), None);
    }

    #[test]
    fn exactly_the_required_share_suffices() {
        assert_eq!(chosen(&[(1, 95.0), (2, 100.0)], 2), Some(1));
        assert_eq!(chosen(&[(1, 94.9), (2, 100.0)], 2), Some(2));
    }

    #[test]
    fn one_core_gets_one_slot() {
        assert_eq!(numbers_to_measure(1), BTreeSet::from([1]));
        assert_eq!(chosen(&[(1, 28.0)], 1), Some(1));
    }

    #[test]
    fn the_number_before_a_falling_throughput_is_chosen() {
        let measured = [(1, 30.0), (2, 58.0), (4, 51.0), (8, 40.0)];
        assert_eq!(chosen(&measured, usize::MAX), Some(2));
        assert_eq!(chosen(&[(1, 30.0), (2, 20.0)], usize::MAX), Some(1));
    }

    #[test]
    fn noise_on_a_plateau_takes_no_more_slots_than_the_plateau_needs() {
        // Four slots saturate the machine; every measurement is off by up to 2 %.
        for noise in [[0.98, 1.02, 0.98, 1.02], [1.02, 0.98, 1.02, 0.98], [1.0, 1.0, 0.98, 1.02]] {
            let measured: Vec<(usize, f64)> = [(1, 30.0), (2, 60.0), (4, 118.0), (8, 118.0)]
                .iter()
                .zip(noise)
                .map(|(&(slots, rate), noise)| (slots, rate * noise))
                .collect();
            assert_eq!(chosen(&measured, usize::MAX), Some(4), "{noise:?}");
        }
    }

    #[test]
    fn numbers_beyond_memory_are_ignored() {
        let measured = [(1, 30.0), (2, 58.0), (4, 80.0), (8, 160.0)];
        assert_eq!(chosen(&measured, 4), Some(4));
        assert_eq!(chosen(&measured, 3), Some(2));
        let flat = [(1, 30.0), (2, 30.5), (4, 200.0)];
        assert_eq!(chosen(&flat, 2), Some(1));
        assert_eq!(chosen(&measured, 0), None);
    }

    #[test]
    fn slots_leave_spare_memory_and_one_always_fits() {
        let per_slot = |own| PerSlot { own, scenes: 2, scene_files: 0 };
        assert_eq!(fitting_slots(10 * GIB, per_slot(GIB)), 8);
        assert_eq!(fitting_slots(10 * GIB, per_slot(3 * GIB)), 2);
        assert_eq!(fitting_slots(GIB, per_slot(3 * GIB)), 1);
        assert_eq!(fitting_slots(0, per_slot(GIB)), 1);
        assert!(fitting_slots(GIB, per_slot(0)) > 1000);
    }

    #[test]
    fn scenes_of_files_count_once_for_all_slots() {
        let per_slot = PerSlot { own: GIB, scenes: 2, scene_files: GIB };
        // Slots of 3 GiB each, until all 40 tasks' scenes are in memory.
        assert_eq!(fitting_slots(10 * GIB, per_slot), 2);
        assert_eq!(fitting_slots(75 * GIB, per_slot), 20);
        assert_eq!(fitting_slots(100 * GIB, per_slot), 40);
    }

    #[test]
    fn more_slots_keep_the_cores_busy_if_the_policy_is_slower() {
        // Ten steps take 0.4 s; the policy takes no time, half and all of that.
        assert_eq!(slots_to_fill_cores(8, 25.0, 10, 0.0), 8);
        assert_eq!(slots_to_fill_cores(8, 25.0, 10, 0.2), 16);
        assert_eq!(slots_to_fill_cores(8, 25.0, 10, 0.4), 800);
        assert_eq!(slots_to_fill_cores(1, 25.0, 10, 0.1), 2);
    }

    #[test]
    fn measured_numbers_double_up_to_the_most() {
        assert_eq!(numbers_to_measure(2), BTreeSet::from([1, 2]));
        assert_eq!(numbers_to_measure(6), BTreeSet::from([1, 2, 4, 6]));
        assert_eq!(numbers_to_measure(64).len(), 7);
    }
}
