//! `--slots auto`: a short version of the measurement, and the choice that follows from it.

use std::collections::BTreeMap;
use std::num::NonZeroUsize;

use super::choice::{ENOUGH_SHARE, Throughput, choose, fitting_slots, numbers_to_measure};
use super::together::Slots;
use super::{MeasureError, cores, room};
use crate::child::SlotProgram;

/// Longest duration of all measurements of throughput together, seconds.
const ALL_SECS: f64 = 4.0;
/// Longest duration of one of these measurements, seconds.
const ONE_SECS: f64 = 1.0;
/// Measurements of each number of slots. The best measurement counts, since other load on the
/// machine only slows slots down.
const ROUNDS: usize = 2;

/// Chosen number of slots, with the reason.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Chosen {
    pub slots: NonZeroUsize,
    /// Measurements and applied limits, in one line.
    pub reason: String,
}

/// Measures how many slots are worth running on this machine: at most one per core, and no more
/// than fit into memory if each keeps `scenes` compiled scenes. `program` starts a measured slot.
pub fn choose_slots(program: SlotProgram, scenes: usize) -> Result<Chosen, MeasureError> {
    let cores = cores()?;
    let available = room::available()?;
    let measurements = ROUNDS * numbers_to_measure(cores).len();
    let secs = (ALL_SECS / measurements as f64).min(ONE_SECS);
    // The first slot on a machine compiles the scene, which takes memory that later slots, which
    // map the compiled files, do not take.
    Slots::new(program.clone()).start(1)?;
    let mut slots = Slots::new(program);
    // Only the memory of this measurement is used. If its throughput counted too, one slot would
    // have one more chance of a high value than larger numbers of slots.
    let per_slot = slots.measure(1, secs)?.per_slot(scenes);
    let fitting = fitting_slots(available, per_slot);
    let most = cores.min(fitting);
    // All slots are started at once, which takes about as long as starting one slot.
    slots.start(most)?;
    let mut best = BTreeMap::new();
    for _ in 0..ROUNDS {
        for number in numbers_to_measure(most) {
            let rate = slots.measure(number, secs)?.throughput.steps_per_sec;
            let best_rate: &mut f64 = best.entry(number).or_insert(rate);
            *best_rate = best_rate.max(rate);
        }
    }
    let throughput = |(&slots, &steps_per_sec)| Throughput { slots, steps_per_sec };
    let measured: Vec<Throughput> = best.iter().map(throughput).collect();
    // A number is always chosen: one slot was measured, and always fits.
    let slots = choose(&measured, most).map_or(1, |throughput| throughput.slots);
    let rates: Vec<String> = measured
        .iter()
        .map(|throughput| format!("{}: {:.1}", throughput.slots, throughput.steps_per_sec))
        .collect();
    const MIB: u64 = 1 << 20;
    Ok(Chosen {
        slots: NonZeroUsize::new(slots).unwrap_or(NonZeroUsize::MIN),
        reason: format!(
            "the fewest that reach {:.0} % of the most control steps per second \
             (by number of slots, {}); there are {cores} cores, and {} MiB of memory are \
             available, enough for {fitting} slots: a slot takes {} MiB, and a scene, which slots \
             share, {} MiB",
            ENOUGH_SHARE * 100.0,
            rates.join(", "),
            available / MIB,
            per_slot.own / MIB,
            per_slot.scene_files / MIB,
        ),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The first process of a slot compiles the scene and takes 853 MiB; later ones take 40 MiB.
    #[test]
    fn memory_is_that_of_a_slot_whose_scene_is_compiled() {
        let folder = tempfile::tempdir().expect("a folder");
        let script = r#"own=$((40 << 20)); mkdir "$0" 2>/dev/null && own=$((853 << 20))
            echo '{"ready":{"renderer":"none"}}' >&0
            while read -r secs; do
                echo '{"counted":{"secs":1.0,"steps":9,"frames":9,"memory":{"resident":0,' \
                    '"proportional":0,"files":0,"scene":0,"scene_files":0,"own":'"$own"'}}}' >&0
            done"#;
        let compiled = folder.path().join("compiled").into_os_string();
        let program = SlotProgram {
            program: "sh".into(),
            arguments: vec!["-c".into(), script.into(), compiled],
        };
        let chosen = choose_slots(program, 1).expect("slots");
        assert!(chosen.reason.contains("a slot takes 40 MiB"), "{}", chosen.reason);
    }
}
