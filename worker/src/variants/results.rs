//! `results.jsonl`: a line for each rollout, pinned to one protocol, policy and simulator;
//! and what the lines say together.

use std::collections::BTreeMap;
use std::fmt;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use libero_ctrl::{JsonError, ManifestRow, TaskRef};
use libero_family::plus::Dimension;
use libero_family::protocol::Protocol;
use scene::AssetPack;
use serde::{Deserialize, Serialize};
use sim::Simulator;

use super::case::Case;
use super::error::VariantsError;
use crate::message::Finished;

/// The libraries whose arithmetic corrupted pictures have.
const CORRUPTION_RULES: &str =
    "numpy 1.26.4, scipy 1.13.1, scikit-image 0.24.0, ImageMagick 6.9.11-60 Q16";

/// Circumstances that results have in common.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Pin {
    /// The benchmark.
    pub benchmark: String,
    /// Name of the protocol.
    pub protocol: String,
    /// Source of the prompts.
    pub prompt_source: String,
    /// State in which the waits begin.
    pub beginning: String,
    /// Seed of the environment's generator.
    pub seed: u32,
    /// Control steps before the policy's first look.
    pub waits: u32,
    /// Libraries whose arithmetic corrupted pictures have.
    pub corruption_rules: String,
    /// Digest of the asset pack.
    pub asset_pack_digest: String,
    /// Version of MuJoCo.
    pub mujoco: String,
}

/// A rollout's result.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// The benchmark's name; of an unperturbed rollout the task's.
    pub variant: String,
    /// LIBERO's task.
    pub task: TaskRef,
    /// Dimension; none: unperturbed.
    pub dimension: Option<String>,
    /// 1 to 5; none: not given.
    pub difficulty: Option<u8>,
    /// The policy's instruction.
    pub prompt: String,
    /// Control steps that the policy had.
    pub budget: u32,
    /// True if the goal was reached.
    pub success: bool,
    /// Control steps of the policy.
    pub steps: u32,
    /// The policy's own name.
    pub policy: String,
    /// Digest of its weights.
    pub policy_checkpoint_digest: String,
    /// True if it gets the canonical instruction whatever the prompt.
    pub policy_canonical_only: bool,
    /// The renderer's own name; empty where none was opened.
    pub renderer: String,
    /// Digest of the composed scene.
    pub scene_digest: String,
    /// Digest of the initial state.
    pub init_state_digest: String,
    /// Digest of the policy's first frames.
    pub first_frame_digest: String,
    /// What it has in common with the others.
    #[serde(flatten)]
    pub pin: Pin,
}

impl Pin {
    /// The circumstances of a run.
    pub fn new(protocol: &Protocol, pack: &AssetPack) -> Self {
        Self {
            benchmark: "libero-plus".to_owned(),
            protocol: protocol.name.to_owned(),
            prompt_source: protocol.prompt.name().to_owned(),
            beginning: protocol.beginning.name().to_owned(),
            seed: protocol.seed,
            waits: protocol.waits,
            corruption_rules: CORRUPTION_RULES.to_owned(),
            asset_pack_digest: pack.digest().to_owned(),
            mujoco: Simulator::mujoco_version(),
        }
    }

    /// The first thing in which another differs: its name, and both values.
    fn difference(&self, other: &Self) -> Option<(&'static str, String, String)> {
        let values = |pin: &Self| {
            [
                pin.benchmark.clone(),
                pin.protocol.clone(),
                pin.prompt_source.clone(),
                pin.beginning.clone(),
                pin.seed.to_string(),
                pin.waits.to_string(),
                pin.corruption_rules.clone(),
                pin.asset_pack_digest.clone(),
                pin.mujoco.clone(),
            ]
        };
        const NAMES: [&str; 9] = [
            "benchmark",
            "protocol",
            "prompt source",
            "beginning",
            "seed",
            "waits",
            "corruption rules",
            "asset pack",
            "MuJoCo",
        ];
        let pairs = values(self).into_iter().zip(values(other));
        let mut named = NAMES.into_iter().zip(pairs);
        let (name, (own, others)) = named.find(|(_, (own, others))| own != others)?;
        Some((name, own, others))
    }
}

impl Row {
    pub(super) fn new(
        case: &Case,
        protocol: &Protocol,
        pack: &AssetPack,
        row: &ManifestRow,
        finished: &Finished,
    ) -> Self {
        let evidence = &finished.evidence;
        Self {
            variant: case.name(),
            task: case.task,
            dimension: case.entry.map(|it| it.dimension().name().to_owned()),
            difficulty: case.entry.and_then(|it| it.difficulty),
            prompt: match evidence.policy_canonical_only {
                true => case.task.instruction(),
                false => row.instruction.clone(),
            },
            budget: row.max_steps,
            success: finished.result.success,
            steps: finished.result.steps,
            policy: evidence.policy_name.clone(),
            policy_checkpoint_digest: evidence.policy_checkpoint_digest.clone(),
            policy_canonical_only: evidence.policy_canonical_only,
            renderer: evidence.renderer.clone(),
            scene_digest: evidence.scene_digest.clone(),
            init_state_digest: evidence.init_state_digest.clone(),
            first_frame_digest: evidence.first_frame_digest.clone(),
            pin: Pin::new(protocol, pack),
        }
    }
}

/// The results of a folder.
pub(super) struct Results {
    path: PathBuf,
    file: File,
    pin: Pin,
    rows: Vec<Row>,
}

impl Results {
    /// Reads what is there, and goes on behind it.
    pub(super) fn open(folder: &Path, pin: Pin) -> Result<Self, VariantsError> {
        let path = folder.join("results.jsonl");
        let file_error = |source: io::Error| VariantsError::File {
            path: path.clone(),
            source,
        };
        fs::create_dir_all(folder).map_err(file_error)?;
        let text = match fs::read_to_string(&path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => String::new(),
            read => read.map_err(file_error)?,
        };
        let mut rows: Vec<Row> = Vec::new();
        for (index, line) in text.lines().enumerate() {
            let row = serde_json::from_str(line).map_err(|error| VariantsError::Malformed {
                path: path.clone(),
                line: index + 1,
                problem: JsonError::from(error).to_string(),
            })?;
            rows.push(row);
        }
        let file = OpenOptions::new().create(true).append(true).open(&path);
        let file = file.map_err(file_error)?;
        let results = Self {
            path,
            file,
            pin,
            rows,
        };
        for row in &results.rows {
            results.check(row)?;
        }
        Ok(results)
    }

    pub(super) fn has(&self, variant: &str) -> bool {
        self.rows.iter().any(|row| row.variant == variant)
    }

    /// Adds a rollout of the same policy and simulator as the others.
    pub(super) fn add(&mut self, row: Row) -> Result<(), VariantsError> {
        self.check(&row)?;
        let mut line = serde_json::to_string(&row).expect("texts and numbers");
        line.push('\n');
        let written = self.file.write_all(line.as_bytes());
        let written = written.and_then(|()| self.file.sync_data());
        written.map_err(|source| VariantsError::File {
            path: self.path.clone(),
            source,
        })?;
        self.rows.push(row);
        Ok(())
    }

    /// Holds a row against the run and the first row.
    fn check(&self, row: &Row) -> Result<(), VariantsError> {
        let pinned = |what, found: &str, expected: &str| VariantsError::Pinned {
            path: self.path.clone(),
            what,
            found: found.to_owned(),
            expected: expected.to_owned(),
        };
        if let Some((what, found, expected)) = row.pin.difference(&self.pin) {
            return Err(pinned(what, &found, &expected));
        }
        let Some(first) = self.rows.first() else {
            return Ok(());
        };
        for (what, found, expected) in [
            ("policy", &first.policy, &row.policy),
            (
                "policy weights",
                &first.policy_checkpoint_digest,
                &row.policy_checkpoint_digest,
            ),
            ("renderer", &first.renderer, &row.renderer),
        ] {
            if found != expected {
                return Err(pinned(what, found, expected));
            }
        }
        Ok(())
    }

    pub(super) fn tally(&self) -> Tally {
        Tally::of(&self.rows)
    }
}

/// Successes by dimension, beside those of the same tasks unperturbed.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Of each dimension that has results, and of all.
    pub lines: Vec<(String, Count)>,
}

/// Outcomes of variants, paired with their unperturbed tasks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Count {
    /// Variants.
    pub variants: usize,
    /// Those that succeeded.
    pub successes: usize,
    /// Those that failed, and whose task succeeds unperturbed.
    pub broken: usize,
    /// Those that succeeded, and whose task fails unperturbed.
    pub gained: usize,
}

impl Tally {
    /// Counts rows.
    pub fn of(rows: &[Row]) -> Self {
        let nominal = rows.iter().filter(|row| row.dimension.is_none());
        let nominal: BTreeMap<TaskRef, bool> = nominal.map(|row| (row.task, row.success)).collect();
        let count = |dimension: Option<Dimension>| {
            let mut count = Count::default();
            for row in rows {
                let Some(of) = &row.dimension else { continue };
                if dimension.is_some_and(|it| it.name() != of) {
                    continue;
                }
                count.variants += 1;
                count.successes += usize::from(row.success);
                match (nominal.get(&row.task), row.success) {
                    (Some(true), false) => count.broken += 1,
                    (Some(false), true) => count.gained += 1,
                    _ => {}
                }
            }
            count
        };
        let dimensions = Dimension::ALL.map(|it| (it.name().to_owned(), count(Some(it))));
        let lines = dimensions
            .into_iter()
            .filter(|(_, count)| count.variants > 0);
        let total = [("all".to_owned(), count(None))];
        Self {
            lines: lines.chain(total).collect(),
        }
    }
}

impl fmt::Display for Tally {
    /// Success is that of the published table: successes over variants; all of them together
    /// in the last line, dimensions weighing by their variants.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{:<12}{:>9}{:>10}{:>9}{:>8}{:>8}",
            "dimension", "variants", "successes", "percent", "broken", "gained"
        )?;
        for (name, count) in &self.lines {
            let Count {
                variants,
                successes,
                broken,
                gained,
            } = count;
            let percent = match variants {
                0 => "-".to_owned(),
                _ => format!("{:.1}", 100.0 * *successes as f64 / *variants as f64),
            };
            writeln!(
                f,
                "{name:<12}{variants:>9}{successes:>10}{percent:>9}{broken:>8}{gained:>8}"
            )?;
        }
        Ok(())
    }
}
