//! `worker variants --protocols`: starts variants under every protocol of their benchmark, without
//! a policy, and compares the prompts, the hand's poses and the pictures at the first query.

use std::fmt::{self, Write};
use std::slice;

use benchmark::Realisation;
use benchmark::family::protocol::{PROTOCOLS, Protocol};
use benchmark::family::{Case, SelectionError, Subject};
use scene::AssetPack;
use sim::{CameraRequest, ObservationRequest, SimError, Simulator, SimulatorConfig};

use super::audit::Audit;
use super::case::Prepared;
use super::choice::Choice;
use super::error::VariantsError;

/// Side of the compared picture, pixels, as in the benchmarks' environments.
const SIDE: u32 = 256;

/// The policy's first observation.
struct FirstQuery {
    prompt: String,
    /// Position of the site between the fingertips, world frame, m.
    hand_pos: [f64; 3],
    /// Orientation of the hand, x y z w.
    hand_quat: [f64; 4],
    /// Pixels of `agentview`, three bytes each.
    picture: Vec<u8>,
}

/// Start of one variant under all protocols of its benchmark.
pub struct Starts {
    /// Name, dimension or suite, and initial state.
    title: String,
    lines: Vec<Start>,
}

/// Start of one variant under one protocol, compared with the start of the unperturbed task under
/// the benchmark's official protocol.
struct Start {
    protocol: Protocol,
    budget: u32,
    prompt: String,
    /// Distance between the hand's positions, mm.
    moved_mm: f64,
    /// Angle between the hand's orientations, degrees.
    turned_degrees: f64,
    /// Share of the pixels that differ from the variant's picture under the official protocol, per
    /// cent.
    changed_percent: f64,
}

/// Returns the first case of each dimension or suite.
fn one_of_each_group(cases: impl Iterator<Item = Case>) -> Vec<Case> {
    let mut chosen: Vec<Case> = Vec::new();
    for case in cases {
        if chosen.iter().all(|earlier| earlier.group() != case.group()) {
            chosen.push(case);
        }
    }
    chosen
}

/// Starts the chosen variants, or one of each dimension or suite if none is named, under every
/// protocol of their benchmark, and reports each variant's starts as soon as they are known.
///
/// # Errors
/// If a case belongs to no benchmark with protocols, the simulator fails, or `report` fails.
pub fn compare(
    audit: &Audit,
    choice: &Choice,
    simulator: SimulatorConfig,
    report: &mut dyn FnMut(&Starts) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    let cases = match choice.variants.is_empty() {
        true => one_of_each_group(audit.runnable()),
        false => audit.runnable().collect(),
    };
    let pack = simulator.pack.clone();
    let mut simulator = Simulator::new(simulator);
    for case in &cases {
        report(&starts(case, &pack, &mut simulator)?)?;
    }
    Ok(())
}

fn starts(
    case: &Case,
    pack: &AssetPack,
    simulator: &mut Simulator,
) -> Result<Starts, VariantsError> {
    let benchmark = case.benchmark().ok_or(SelectionError::Nothing)?;
    let unperturbed = Case { subject: Subject::Unperturbed, ..*case };
    let official = Protocol::official(benchmark);
    let reference = first_query(&unperturbed, &official, pack, simulator)?;
    let mut official_picture = None;
    let mut lines = Vec::new();
    for protocol in PROTOCOLS {
        if protocol.benchmark != benchmark {
            continue;
        }
        let query = first_query(case, &protocol, pack, simulator)?;
        let picture = official_picture.get_or_insert_with(|| query.picture.clone());
        lines.push(Start {
            budget: protocol.budget(case.task.suite()),
            moved_mm: 1e3 * distance(query.hand_pos, reference.hand_pos),
            turned_degrees: angle(query.hand_quat, reference.hand_quat).to_degrees(),
            changed_percent: 100.0 * changed_share(&query.picture, picture),
            prompt: query.prompt,
            protocol,
        });
    }
    let group = case.group();
    Ok(Starts {
        title: format!(
            "{} ({}), initial state {}",
            case.name(),
            group.as_deref().unwrap_or("unperturbed"),
            case.trial
        ),
        lines,
    })
}

fn first_query(
    case: &Case,
    protocol: &Protocol,
    pack: &AssetPack,
    simulator: &mut Simulator,
) -> Result<FirstQuery, VariantsError> {
    let prepared = Prepared::new(&case.row(protocol), simulator.sources())?;
    pack.provide_with_bar(slice::from_ref(&prepared.files))?;
    let row = &prepared.row;
    let failed = |source: SimError| VariantsError::Start { id: row.id, source: Box::new(source) };
    let begun = simulator.begin_variant(prepared.files, row, Realisation::Matched, &prepared.start);
    let mut episode = begun.map_err(failed)?;
    episode.settle().map_err(failed)?;
    let agentview = CameraRequest { name: "agentview".to_owned(), width: SIDE, height: SIDE };
    let request = ObservationRequest { cameras: vec![agentview], privileged: false };
    let mut observation = episode.observe(&request).map_err(failed)?;
    Ok(FirstQuery {
        prompt: row.instruction.clone(),
        hand_pos: observation.robot.eef_pos,
        hand_quat: observation.robot.eef_quat_xyzw,
        picture: observation.frames.swap_remove(0).rgb,
    })
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

/// Returns the angle between two orientations, rad.
fn angle(a: [f64; 4], b: [f64; 4]) -> f64 {
    let cosine: f64 = a.iter().zip(b).map(|(a, b)| a * b).sum();
    2.0 * cosine.abs().min(1.0).acos()
}

/// Returns the share of the pixels that differ between two pictures of the same size.
fn changed_share(a: &[u8], b: &[u8]) -> f64 {
    let pixels = a.chunks_exact(3).zip(b.chunks_exact(3));
    let changed = pixels.filter(|(a, b)| a != b).count();
    3.0 * changed as f64 / a.len() as f64
}

impl fmt::Display for Starts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}", self.title)?;
        let head = ["hand moved", "turned", "pixels", "waits", "budget"];
        writeln!(
            f,
            "  {:<15}{:>11}{:>9}{:>9}{:>7}{:>8}",
            "", head[0], head[1], head[2], head[3], head[4]
        )?;
        for start in &self.lines {
            writeln!(
                f,
                "  {:<15}{:>8.1} mm{:>7.1} °{:>7.1} %{:>7}{:>8}",
                start.protocol.name,
                start.moved_mm,
                start.turned_degrees,
                start.changed_percent,
                start.protocol.waits,
                start.budget
            )?;
        }
        for (prompt, names) in self.prompts() {
            writeln!(f, "  \"{prompt}\": {names}")?;
        }
        Ok(())
    }
}

impl Starts {
    /// Returns the prompts, each with the names of its protocols.
    fn prompts(&self) -> Vec<(&str, String)> {
        let mut prompts: Vec<(&str, String)> = Vec::new();
        for start in &self.lines {
            let name = start.protocol.name;
            match prompts.iter_mut().find(|(prompt, _)| *prompt == start.prompt) {
                Some((_, names)) => drop(write!(names, ", {name}")),
                None => prompts.push((&start.prompt, name.to_owned())),
            }
        }
        prompts
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_angles_and_shares_are_those_of_known_poses_and_pictures() {
        assert!((distance([0.0, 3.0, 0.0], [4.0, 0.0, 0.0]) - 5.0).abs() < 1e-12);
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let quarter_turn = angle([0.0, 0.0, 0.0, 1.0], [0.0, 0.0, half, half]);
        assert!((quarter_turn.to_degrees() - 90.0).abs() < 1e-9);
        assert!(angle([0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0, -1.0]) < 1e-9);
        assert!((changed_share(&[1, 2, 3, 4, 5, 6], &[1, 2, 3, 4, 5, 7]) - 0.5).abs() < 1e-12);
    }
}
