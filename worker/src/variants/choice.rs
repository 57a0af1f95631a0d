//! Command-line options that select variants and the way to run them.

use std::fs;
use std::path::PathBuf;

use clap::Args;
use libero_ctrl::{Suite, SuiteFile, TaskRef};
use libero_family::para::TypeName;
use libero_family::plus::{Dimension, Variant};
use libero_family::pro::{ProSuite, STATES};
use libero_family::protocol::{Benchmark, Protocol};
use libero_family::{Case, ParaFilters, PlusFilters, ProFilters, Selection, SelectionError};
use terminal::number;

use super::error::VariantsError;
use super::rules::Rules;

/// A choice of rollouts: variants of LIBERO-Plus that match every given filter, suites of
/// LIBERO-PRO, sentences of LIBERO-Para, or the tasks of a suite file.
#[derive(Clone, Debug, Default, Args)]
pub struct Choice {
    /// Variants of LIBERO-Plus by the benchmark's names, separated by commas
    /// [default: all 10,030]
    #[arg(long = "variant", value_name = "NAME,...", value_delimiter = ',')]
    pub variants: Vec<Variant>,
    /// Variants of suites: libero_spatial, libero_object, libero_goal, libero_10
    #[arg(long = "suite", value_name = "SUITE,...", value_delimiter = ',')]
    pub suites: Vec<Suite>,
    /// Variants of dimensions: background, robot, camera, language, noise, layout, light
    #[arg(long = "dimension", value_name = "NAME,...", value_delimiter = ',')]
    pub dimensions: Vec<Dimension>,
    /// Variants of difficulties, 1 to 5; 0: those without a difficulty
    #[arg(long = "difficulty", value_name = "N,...", value_delimiter = ',', value_parser = number(0..=5_u8, ""))]
    pub difficulties: Vec<u8>,
    /// Suites of LIBERO-PRO instead: each of LIBERO's four with _lan, _object, _swap or _task, such
    /// as libero_goal_swap
    #[arg(long = "pro", value_name = "SUITE,...", value_delimiter = ',', group = "of_suites", conflicts_with_all = ["variants", "suites", "dimensions", "difficulties"])]
    pub pro: Vec<ProSuite>,
    /// Tasks of a suite file instead: a further benchmark in JSON, as docs/FAMILY.md describes it
    #[arg(long, value_name = "FILE", group = "of_suites", conflicts_with_all = ["variants", "suites", "dimensions", "difficulties"])]
    pub suite_file: Option<PathBuf>,
    /// Sentences of LIBERO-Para instead: `all`, or types by their names in its metadata, such as
    /// obj, structural, hint or act_pragmatical_hint
    #[arg(long = "para", value_name = "TYPE,...", value_delimiter = ',', conflicts_with_all = ["variants", "suites", "dimensions", "difficulties", "of_suites"])]
    pub para: Vec<TypeName>,
    /// Sentences of these tasks only: libero_goal/8
    #[arg(long, value_name = "SUITE/N,...", value_delimiter = ',', requires = "para")]
    pub tasks: Vec<TaskRef>,
    /// Trials of each task of LIBERO-PRO or of a suite file, one from each initial state [default:
    /// 50, or as the suite file says]
    #[arg(long, value_name = "N", requires = "of_suites", value_parser = number(1..=STATES, "trials"))]
    pub trials: Option<u16>,
}

/// Protocol and options of a run of variants.
#[derive(Clone, Debug, Args)]
pub struct RunOptions {
    /// The protocol: plus-official, plus-openpi, plus-lerobot, plus-rlinf, plus-stripped,
    /// pro-official, pro-openpi, pro-bddl or para-official; docs/FAMILY.md describes each [default:
    /// plus-official, pro-official or para-official]
    #[arg(long, value_name = "NAME", conflicts_with = "suite_file")]
    pub protocol: Option<Protocol>,
    /// Leaves out rollouts whose files are missing, after naming them
    #[arg(long)]
    pub runnable: bool,
    /// Films each rollout
    #[arg(long)]
    pub video: bool,
    /// Prints a line for each rollout: the files that it needs, and whether they are present
    #[arg(long, conflicts_with = "endpoint")]
    pub list: bool,
    /// Prints how the start of a rollout differs between the protocols of the benchmark: the hand's
    /// pose, the picture, the prompt; for the variants of --variant, or one of each dimension or
    /// suite
    ///
    /// `hand moved` and `turned` are relative to the unperturbed task under the official protocol;
    /// `pixels` is the share that differs from the variant's picture under that protocol.
    #[arg(long, conflicts_with_all = ["endpoint", "list", "protocol", "suite_file"])]
    pub protocols: bool,
}

impl Choice {
    /// Returns the rules of the run and the chosen rollouts, in the benchmark's order.
    pub fn rollouts(&self, options: &RunOptions) -> Result<(Rules, Vec<Case>), VariantsError> {
        let Some(path) = &self.suite_file else {
            let selection = self.selection();
            let protocol = options.protocol_of(selection.benchmark())?;
            return Ok((Rules::Protocol(protocol), selection.cases()?));
        };
        let path = path.clone();
        let text = match fs::read_to_string(&path) {
            Ok(text) => text,
            Err(source) => return Err(VariantsError::File { path, source }),
        };
        let mut file = match SuiteFile::from_json(&text) {
            Ok(file) => file,
            Err(source) => return Err(VariantsError::SuiteFile { path, source }),
        };
        file.trials = self.trials.unwrap_or(file.trials);
        Ok(Rules::of_file(file)?)
    }

    /// Returns true if a chosen rollout may need files that LIBERO's assets do not have.
    pub fn may_need_further_assets(&self, cases: &[Case]) -> bool {
        let needs = |case: &Case| case.further_assets().is_some();
        self.suite_file.is_some() || !self.pro.is_empty() || cases.iter().any(needs)
    }

    /// Returns the selection of the options of LIBERO-Plus, LIBERO-PRO and LIBERO-Para.
    fn selection(&self) -> Selection {
        if !self.para.is_empty() {
            return Selection::Para(ParaFilters {
                types: self.para.clone(),
                tasks: self.tasks.clone(),
            });
        }
        match self.pro.is_empty() {
            true => Selection::Plus(PlusFilters {
                variants: self.variants.clone(),
                suites: self.suites.clone(),
                dimensions: self.dimensions.clone(),
                difficulties: self.difficulties.clone(),
            }),
            false => Selection::Pro(ProFilters {
                suites: self.pro.clone(),
                trials: self.trials.unwrap_or(STATES),
            }),
        }
    }
}

impl RunOptions {
    /// Returns the protocol for a benchmark.
    pub fn protocol_of(&self, benchmark: Benchmark) -> Result<Protocol, SelectionError> {
        let protocol = self.protocol.unwrap_or(Protocol::official(benchmark));
        protocol.check(benchmark)?;
        Ok(protocol)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_filters_must_match() {
        let all = Choice::default();
        assert_eq!(all.selection().cases().unwrap().len(), 10_030);
        let some = Choice {
            suites: vec![Suite::Goal],
            dimensions: vec![Dimension::Light],
            difficulties: vec![0],
            ..Choice::default()
        };
        assert_eq!(some.selection().cases().unwrap().len(), 121);
        let none = Choice { suites: vec![Suite::Spatial], ..some };
        assert!(matches!(none.selection().cases(), Err(SelectionError::Nothing)));
        let unused = "turn_on_the_stove_table_19".parse().unwrap();
        let unused = Choice { variants: vec![unused], ..Choice::default() };
        assert!(matches!(unused.selection().cases(), Err(SelectionError::Unused { .. })));
    }

    #[test]
    fn sentences_are_chosen_by_type_and_task() {
        let hints = Choice {
            para: vec!["hint".parse().unwrap()],
            tasks: vec!["libero_goal/8".parse().unwrap()],
            ..Choice::default()
        };
        let cases = hints.selection().cases().unwrap();
        assert_eq!(Case::unperturbed(&cases).len(), 1);
        assert_eq!(cases[0].name(), "act_pragmatical_hint_eval3_ver1");
        assert!(!hints.may_need_further_assets(&cases));
        let none = Choice { tasks: vec!["libero_object/8".parse().unwrap()], ..hints };
        assert!(none.selection().cases().is_err());
    }

    #[test]
    fn a_pro_suite_has_ten_tasks_of_fifty_trials_and_its_own_protocol() {
        let pro = Choice { pro: vec!["libero_goal_swap".parse().unwrap()], ..Choice::default() };
        let cases = pro.selection().cases().unwrap();
        assert_eq!((cases.len(), Case::unperturbed(&cases).len()), (500, 500));
        assert_eq!(cases[1].name(), "libero_goal_swap/open_the_middle_drawer_of_the_cabinet/e01");
        let mut options = RunOptions {
            protocol: None,
            runnable: false,
            video: false,
            list: false,
            protocols: false,
        };
        let protocol = |options: &RunOptions, benchmark| options.protocol_of(benchmark);
        assert_eq!(protocol(&options, Benchmark::Pro).unwrap().name, "pro-official");
        assert_eq!(protocol(&options, Benchmark::Plus).unwrap().name, "plus-official");
        options.protocol = Some("plus-rlinf".parse().unwrap());
        assert!(matches!(protocol(&options, Benchmark::Pro), Err(SelectionError::Foreign { .. })));
    }
}
