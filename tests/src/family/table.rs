//! Table of the comparison, which docs/dev/FIDELITY.md summarises.

use std::collections::BTreeMap;
use std::fmt;

use benchmark::Benchmark;

use super::comparison::Findings;
use crate::fidelity::FrameFindings;

#[derive(Default)]
pub struct Table {
    lines: BTreeMap<(Benchmark, String), Line>,
}

#[derive(Default)]
struct Line {
    cases: usize,
    held_out: usize,
    states: f64,
    camera: Option<f64>,
    prompts: [usize; 2],
    draws: [usize; 2],
    pictured: usize,
    frames: FrameFindings,
}

impl Table {
    pub fn add(&mut self, benchmark: Benchmark, is_held_out: bool, findings: &Findings) {
        let line = self.lines.entry((benchmark, findings.group.clone()));
        let line = line.or_default();
        line.cases += 1;
        line.held_out += usize::from(is_held_out);
        line.states = line.states.max(findings.states);
        if let Some(camera) = findings.camera {
            line.camera = Some(line.camera.unwrap_or_default().max(camera));
        }
        count(&mut line.prompts, findings.prompt);
        count(&mut line.draws, findings.draw);
        if let Some(frames) = &findings.frames {
            line.pictured += 1;
            line.frames.merge(frames);
        }
    }
}

fn short(difference: f64) -> String {
    match difference {
        0.0 => "0".to_owned(),
        _ => format!("{difference:.0e}"),
    }
}

fn count([equal, compared]: &mut [usize; 2], is_equal: Option<bool>) {
    *equal += usize::from(is_equal == Some(true));
    *compared += usize::from(is_equal.is_some());
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "| benchmark | | cases | of these held out | states | camera | prompts equal | \
             generator equal | with pictures | pixels equal, % | within two levels, % | largest |"
        )?;
        writeln!(f, "|{}", " --- |".repeat(12))?;
        for ((benchmark, group), line) in &self.lines {
            let camera = line.camera.map(short);
            let camera = camera.as_deref().unwrap_or("");
            let of = |[equal, compared]: [usize; 2]| format!("{equal} of {compared}");
            let frames = match line.pictured {
                0 => "| 0 | | | |".to_owned(),
                pictured => format!(
                    "| {pictured} | {:.2} | {:.3} | {} |",
                    line.frames.equal.share * 100.0,
                    line.frames.close.share * 100.0,
                    line.frames.largest
                ),
            };
            writeln!(
                f,
                "| {benchmark} | {group} | {} | {} | {} | {camera} | {} | {} {frames}",
                line.cases,
                line.held_out,
                short(line.states),
                of(line.prompts),
                of(line.draws),
            )?;
        }
        Ok(())
    }
}
