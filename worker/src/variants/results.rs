//! `results.jsonl`: one line per rollout, pinned to one protocol, policy and simulator; and the
//! tally over the lines.

use std::collections::BTreeMap;
use std::fmt;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use libero_ctrl::{JsonError, Look, ManifestRow};
use libero_family::Case;
use libero_family::protocol::Protocol;
use scene::AssetPack;
use serde::{Deserialize, Serialize};
use sim::Simulator;

use super::error::VariantsError;
use crate::message::Finished;

/// Versions of the libraries whose arithmetic the image corruptions reproduce.
const CORRUPTION_RULES: &str =
    "numpy 1.26.4, scipy 1.13.1, scikit-image 0.24.0, ImageMagick 6.9.11-60 Q16";

/// Conditions that all results of a file share.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Pin {
    /// The benchmark, or the name of the suite file.
    pub benchmark: String,
    /// Name of the protocol, or of the suite file with the first digits of its digest.
    pub protocol: String,
    /// Source of the prompts.
    pub prompt_source: String,
    /// State in which the settling waits begin: an initial state or a reset.
    pub beginning: String,
    /// Seed of the environment's generator.
    pub seed: u32,
    /// Control steps before the policy's first query.
    pub waits: u32,
    /// Versions of the libraries whose arithmetic the image corruptions reproduce.
    pub corruption_rules: String,
    pub asset_pack_digest: String,
    /// Version of MuJoCo.
    pub mujoco: String,
    #[serde(default = "Look::of_unnamed_results")]
    pub look: Look,
}

/// A rollout's result.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Name of the case: the benchmark's name of the variant, or the name of the unperturbed task.
    pub variant: String,
    /// LIBERO's task, or `own/N` for the task at position N of a suite file.
    pub task: String,
    /// Number of the trial, which is also the index of its initial state.
    pub trial: u16,
    /// Dimension of LIBERO-Plus, suite of LIBERO-PRO or of a suite file, or type of LIBERO-Para;
    /// `None` for an unperturbed rollout.
    pub group: Option<String>,
    /// Difficulty, 1 to 5; `None` if not given.
    pub difficulty: Option<u8>,
    /// The policy's instruction.
    pub prompt: String,
    /// Step budget of the policy.
    pub budget: u32,
    /// True if the goal was reached.
    pub success: bool,
    /// Control steps of the policy.
    pub steps: u32,
    /// The policy's own name.
    pub policy: String,
    /// Digest of the policy's weights.
    pub policy_checkpoint_digest: String,
    /// True if the policy receives the canonical instruction in place of the prompt.
    pub policy_canonical_only: bool,
    /// The renderer's own name; empty if no renderer was opened.
    pub renderer: String,
    pub scene_digest: String,
    pub init_state_digest: String,
    /// Digest of the policy's first frames.
    pub first_frame_digest: String,
    /// Conditions that all results share.
    #[serde(flatten)]
    pub pin: Pin,
}

impl Pin {
    /// Returns the conditions of a run.
    pub fn new(protocol: &Protocol, pack: &AssetPack) -> Self {
        Self {
            benchmark: protocol.benchmark.name().to_owned(),
            protocol: protocol.name.to_owned(),
            prompt_source: protocol.prompt.name().to_owned(),
            beginning: protocol.beginning.name().to_owned(),
            seed: protocol.seed,
            waits: protocol.waits,
            corruption_rules: CORRUPTION_RULES.to_owned(),
            asset_pack_digest: pack.digest().to_owned(),
            mujoco: Simulator::mujoco_version(),
            look: pack.look(),
        }
    }

    /// Returns the first condition in which two pins differ: its name, and both values.
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
                pin.look.to_string(),
            ]
        };
        const NAMES: [&str; 10] = [
            "benchmark",
            "protocol",
            "prompt source",
            "beginning",
            "seed",
            "waits",
            "corruption rules",
            "asset pack",
            "MuJoCo",
            "look",
        ];
        let pairs = values(self).into_iter().zip(values(other));
        let mut named = NAMES.into_iter().zip(pairs);
        let (name, (value, other_value)) = named.find(|(_, (a, b))| a != b)?;
        Some((name, value, other_value))
    }
}

impl Row {
    pub(super) fn new(case: &Case, pin: Pin, row: &ManifestRow, finished: &Finished) -> Self {
        let evidence = &finished.evidence;
        Self {
            variant: case.name(),
            task: case.task.to_string(),
            trial: case.trial,
            group: case.group(),
            difficulty: case.difficulty(),
            prompt: match evidence.policy_canonical_only && row.own.is_none() {
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
            pin,
        }
    }
}

/// Results of a folder, open for appending.
pub(super) struct Results {
    path: PathBuf,
    file: File,
    pin: Pin,
    rows: Vec<Row>,
}

impl Results {
    /// Reads existing results, and opens the file for appending.
    pub(super) fn open(folder: &Path, pin: Pin) -> Result<Self, VariantsError> {
        let path = folder.join("results.jsonl");
        let file_error = |source: io::Error| VariantsError::File { path: path.clone(), source };
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
        let results = Self { path, file, pin, rows };
        for row in &results.rows {
            results.check(row)?;
        }
        Ok(results)
    }

    pub(super) fn has(&self, variant: &str) -> bool {
        self.rows.iter().any(|row| row.variant == variant)
    }

    /// Appends a result; fails if its pin, policy or renderer differs from the earlier results'.
    pub(super) fn add(&mut self, row: Row) -> Result<(), VariantsError> {
        self.check(&row)?;
        let mut line = serde_json::to_string(&row).expect("texts and numbers");
        line.push('\n');
        let written = self.file.write_all(line.as_bytes());
        let written = written.and_then(|()| self.file.sync_data());
        written.map_err(|source| VariantsError::File { path: self.path.clone(), source })?;
        self.rows.push(row);
        Ok(())
    }

    /// Checks that a result agrees with the run's pin and with the first result.
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
            ("policy weights", &first.policy_checkpoint_digest, &row.policy_checkpoint_digest),
            ("renderer", &first.renderer, &row.renderer),
        ] {
            if found != expected {
                return Err(pinned(what, found, expected));
            }
        }
        Ok(())
    }

    pub(super) fn tally(&self) -> Tally {
        Tally::from_rows(&self.rows)
    }
}

/// Successes by group (see [`Row::group`]), paired with the unperturbed rollouts of the same tasks.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Counts of each group with results, followed by the counts of all groups together.
    pub lines: Vec<(String, Count)>,
}

/// Outcomes of variants, paired with their unperturbed tasks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Count {
    pub rollouts: usize,
    /// Successful rollouts of variants.
    pub successes: usize,
    /// Failed variants whose unperturbed task succeeds.
    pub broken: usize,
    /// Successful variants whose unperturbed task fails.
    pub gained: usize,
}

impl Count {
    fn add(&mut self, success: bool, unperturbed: Option<bool>) {
        self.rollouts += 1;
        self.successes += usize::from(success);
        self.broken += usize::from(!success && unperturbed == Some(true));
        self.gained += usize::from(success && unperturbed == Some(false));
    }
}

impl Tally {
    /// Counts the rows.
    pub fn from_rows(rows: &[Row]) -> Self {
        let unperturbed = rows.iter().filter(|row| row.group.is_none());
        let unperturbed: BTreeMap<(&str, u16), bool> =
            unperturbed.map(|row| ((row.task.as_str(), row.trial), row.success)).collect();
        let mut groups: BTreeMap<&str, Count> = BTreeMap::new();
        let mut all = Count::default();
        for row in rows {
            let Some(group) = &row.group else { continue };
            let unperturbed_success = unperturbed.get(&(row.task.as_str(), row.trial)).copied();
            groups.entry(group).or_default().add(row.success, unperturbed_success);
            all.add(row.success, unperturbed_success);
        }
        let groups = groups.into_iter();
        let groups = groups.map(|(name, count)| (name.to_owned(), count));
        Self { lines: groups.chain([("all".to_owned(), all)]).collect() }
    }
}

impl fmt::Display for Tally {
    /// Prints a table whose percentages are successes over rollouts, as in the published tables;
    /// the last line counts all groups together.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{:<32}{:>9}{:>10}{:>9}{:>8}{:>8}",
            "", "rollouts", "successes", "percent", "broken", "gained"
        )?;
        for (name, count) in &self.lines {
            let Count { rollouts, successes, broken, gained } = count;
            let percent = match rollouts {
                0 => "-".to_owned(),
                _ => format!("{:.1}", 100.0 * *successes as f64 / *rollouts as f64),
            };
            writeln!(
                f,
                "{name:<32}{rollouts:>9}{successes:>10}{percent:>9}{broken:>8}{gained:>8}"
            )?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pin(protocol: &str) -> Pin {
        Pin {
            benchmark: "libero-plus".to_owned(),
            protocol: protocol.to_owned(),
            prompt_source: "released".to_owned(),
            beginning: "initial-state".to_owned(),
            seed: 0,
            waits: 10,
            corruption_rules: CORRUPTION_RULES.to_owned(),
            asset_pack_digest: "ab".to_owned(),
            mujoco: "3.3.7".to_owned(),
            look: Look::default(),
        }
    }

    fn row(variant: &str, group: Option<&str>, success: bool) -> Row {
        Row {
            variant: variant.to_owned(),
            task: "libero_goal/8".to_owned(),
            trial: 0,
            group: group.map(str::to_owned),
            difficulty: None,
            prompt: "put the bowl on the plate".to_owned(),
            budget: 300,
            success,
            steps: 80,
            policy: "a".to_owned(),
            policy_checkpoint_digest: String::new(),
            policy_canonical_only: false,
            renderer: String::new(),
            scene_digest: String::new(),
            init_state_digest: String::new(),
            first_frame_digest: String::new(),
            pin: pin("plus-official"),
        }
    }

    #[test]
    fn a_run_resumes_from_its_own_results_only() {
        let folder = tempfile::tempdir().unwrap();
        let open = |protocol| Results::open(folder.path(), pin(protocol));
        let mut results = open("plus-official").unwrap();
        results.add(row("one", None, true)).unwrap();
        let mut results = open("plus-official").unwrap();
        assert!(results.has("one") && !results.has("two"));
        let another = Row { policy_checkpoint_digest: "cd".to_owned(), ..row("two", None, true) };
        let error = results.add(another).unwrap_err();
        let what = |error: &VariantsError| match error {
            VariantsError::Pinned { what, .. } => *what,
            unexpected => panic!("{unexpected}"),
        };
        assert_eq!(what(&error), "policy weights");
        assert!(!results.has("two"));
        let error = open("plus-rlinf").err().unwrap();
        assert_eq!(what(&error), "protocol");
        fs::write(folder.path().join("results.jsonl"), "{}\n").unwrap();
        let error = open("plus-official").err().unwrap().to_string();
        assert!(error.contains("read line 1"), "{error}");
    }

    #[test]
    fn variants_are_counted_by_group_and_paired_with_the_unperturbed_task() {
        let noise = Some("noise");
        let rows = [
            row("task", None, true),
            row("task_noise_1", noise, false),
            row("task_noise_2", noise, true),
            row("task_light_1", Some("light"), true),
        ];
        let count = |rollouts, successes, broken| Count { rollouts, successes, broken, gained: 0 };
        let expected =
            [("light", count(1, 1, 0)), ("noise", count(2, 1, 1)), ("all", count(3, 2, 1))];
        let expected = expected.map(|(name, count)| (name.to_owned(), count));
        assert_eq!(Tally::from_rows(&rows).lines, expected);
        let rows = [row("task", None, false), row("task_noise_2", noise, true)];
        assert_eq!(Tally::from_rows(&rows).lines[0].1.gained, 1);
        assert!(Tally::from_rows(&rows).to_string().contains("100.0"));
    }
}
