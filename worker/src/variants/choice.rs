//! Command-line options that select variants.

use std::path::PathBuf;

use benchmark::family::para::TypeName;
use benchmark::family::plus::{Dimension, Variant};
use benchmark::family::pro::{ProSuite, STATES};
use benchmark::family::protocol::Protocol;
use benchmark::family::{Case, ParaFilters, PlusFilters, ProFilters, Selection};
use benchmark::{ManifestRow, Suite, TaskRef};
use clap::Args;
use terminal::number;

use super::case::rows_of_file;
use super::error::VariantsError;

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

impl Choice {
    /// Returns the chosen rollouts in the benchmark's order, with their rows under its official
    /// protocol or the suite file's rules.
    ///
    /// # Errors
    /// If nothing matches, or the suite file is invalid.
    pub fn rollouts(&self) -> Result<Vec<(Case, ManifestRow)>, VariantsError> {
        let Some(path) = &self.suite_file else {
            let selection = self.selection();
            let protocol = Protocol::official(selection.benchmark());
            let cases = selection.cases()?.into_iter();
            return Ok(cases.map(|case| (case, case.row(&protocol))).collect());
        };
        let rows = rows_of_file(path, self.trials)?.into_iter();
        rows.map(|row| Ok((Case::of_id(row.id)?, row))).collect()
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

#[cfg(test)]
mod tests {
    use benchmark::family::SelectionError;

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
        assert!(cases.iter().all(|case| case.further_assets().is_none()));
        let none = Choice { tasks: vec!["libero_object/8".parse().unwrap()], ..hints };
        assert!(none.selection().cases().is_err());
    }

    #[test]
    fn a_pro_suite_has_ten_tasks_of_fifty_trials() {
        let pro = Choice { pro: vec!["libero_goal_swap".parse().unwrap()], ..Choice::default() };
        let cases = pro.selection().cases().unwrap();
        assert_eq!((cases.len(), Case::unperturbed(&cases).len()), (500, 500));
        assert_eq!(cases[1].name(), "libero_goal_swap/open_the_middle_drawer_of_the_cabinet/e01");
    }
}
