//! `worker bench`: measures several numbers of slots one after the other and prints a table.

use std::collections::BTreeSet;
use std::fs;
use std::io::Write;

use super::choice::{ENOUGH_SHARE, choose, fitting_slots, numbers_to_measure, slots_to_fill_cores};
use super::together::{Measured, Slots};
use super::{MeasureError, cores, room};
use crate::child::SlotProgram;

/// Settings of `worker bench`.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Description of the simulated task.
    pub title: String,
    /// Numbers of slots to measure; if empty, the number that should keep all cores busy, its
    /// double, and all powers of 2 below the double.
    pub numbers: BTreeSet<usize>,
    /// Duration of the measurement of each number, seconds.
    pub secs: f64,
    /// Control steps between two queries of the policy.
    pub execute: u32,
    /// Time that the policy takes to answer, seconds.
    pub policy_secs: f64,
    /// Compiled scenes that a slot of a campaign keeps.
    pub scenes: usize,
    /// Command line of a measured slot's process.
    pub program: SlotProgram,
}

const MIB: f64 = (1 << 20) as f64;

/// Measures the slots and prints a table to `out`, with the recommended number of slots in the
/// last line.
pub fn bench(plan: Plan, out: &mut dyn Write) -> Result<(), MeasureError> {
    let (cores, available) = (cores()?, room::available()?);
    let mut slots = Slots::new(plan.program);
    let mut pending = plan.numbers;
    let is_default = pending.is_empty();
    slots.start(pending.first().copied().unwrap_or(1))?;
    writeln!(
        out,
        "{cores} cores of {}\n\
         {:.0} MiB of memory available; drawn by {}\n\
         {}, {} s for each number\n\
         {}\n",
        processor_model(),
        available as f64 / MIB,
        slots.renderer(),
        plan.title,
        plan.secs,
        policy(plan.policy_secs)
    )?;
    writeln!(out, "{HEADER}")?;
    let (mut measured, mut most) = (Vec::<Measured>::new(), usize::MAX);
    if is_default {
        pending.insert(1);
    }
    while let Some(number) = pending.pop_first() {
        if number > most {
            writeln!(out, "{number:>5}  left out: {most} slots fit into memory")?;
            continue;
        }
        let row = slots.measure(number, plan.secs)?;
        writeln!(out, "{}", line(&row))?;
        out.flush()?;
        if is_default && number == 1 {
            let alone = row.throughput.steps_per_sec;
            let filling = slots_to_fill_cores(cores, alone, plan.execute, plan.policy_secs);
            pending = &numbers_to_measure(filling) | &numbers_to_measure(2 * filling);
            pending.remove(&1);
        }
        measured.push(row);
        most = fitting_slots(available, row.per_slot(plan.scenes));
    }
    writeln!(
        out,
        "\nMiB a slot: memory of the largest slot, with one compiled scene; a slot of a\n\
         campaign keeps up to {}. PSS: the same, with shared memory divided among the\n\
         processes. One more adds: a slot's private memory. Scenes lie in files that all\n\
         slots map: {:.0} MiB of this scene's files are in use.",
        plan.scenes,
        measured.last().map_or(0, |row| row.memory.scene_files) as f64 / MIB
    )?;
    let throughputs: Vec<_> = measured.iter().map(|row| row.throughput).collect();
    match choose(&throughputs, most) {
        Some(chosen) => writeln!(
            out,
            "recommended: --slots {}, the fewest with {:.0} % of the best throughput",
            chosen.slots,
            ENOUGH_SHARE * 100.0,
        )?,
        None => writeln!(
            out,
            "recommended: --slots {most}, the most that fit into memory; more were measured"
        )?,
    }
    Ok(())
}

/// Describes the delay of the simulated policy, in lines of at most 80 columns.
fn policy(secs: f64) -> String {
    match secs {
        0.0 => "The policy takes no time here. Slots that wait for a real one leave cores idle,\n\
                so that more slots pay off: see --policy-secs.\n"
            .to_owned(),
        secs => format!(
            "The policy answers after {secs} s, regardless of the number of slots: its server is\n\
             assumed to run on another machine and to be fast enough for all slots.\n"
        ),
    }
}

const HEADER: &str =
    "slots    steps/s   frames/s  slowest–fastest  MiB a slot    PSS  one more adds";

fn line(row: &Measured) -> String {
    format!(
        "{:>5} {:>10.1} {:>10.1} {:>16} {:>11.0} {:>6.0} {:>14.0}",
        row.throughput.slots,
        row.throughput.steps_per_sec,
        row.frames_per_sec,
        format!("{:.1}–{:.1}", row.slowest, row.fastest),
        row.memory.resident as f64 / MIB,
        row.memory.proportional as f64 / MIB,
        row.memory.own as f64 / MIB,
    )
}

/// Returns the processor's model name for the table's heading.
fn processor_model() -> String {
    let about = fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = about.lines().find_map(|line| line.strip_prefix("model name"));
    let model = model.map(|rest| rest.trim_start_matches([' ', '\t', ':']));
    model.unwrap_or("an unnamed processor").to_owned()
}
