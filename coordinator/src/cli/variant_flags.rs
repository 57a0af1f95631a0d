//! The flags of `coordinator campaign create` for campaigns of LIBERO's family.

use std::path::PathBuf;

use anyhow::ensure;
use benchmark::family::para::TypeName;
use benchmark::family::plus::{Dimension, Variant};
use benchmark::family::pro::{ProSuite, STATES};
use benchmark::family::protocol::Protocol;
use benchmark::family::{Lacking, ParaFilters, PlusFilters, ProFilters, Selection};
use benchmark::{Benchmark, Design, ManifestRow, TaskRef};
use clap::Args;
use terminal::number;

use super::command::{CommandError, usage};
use super::create::parse_names;
use super::files::read_suite_file;

/// Flags of a design, which conflict with `--rows` and `--spec`.
#[rustfmt::skip]
pub(super) const DESIGN_FLAGS: [&str; 9] = [
    "axes", "subsets", "levels", "configs", "nominal", "design_seed", "directions",
    "placebo_radius", "placebo_configs",
];

/// The flags for LIBERO-Plus, LIBERO-PRO and LIBERO-Para, and the other sources of rollouts.
#[rustfmt::skip]
const NOT_WITH_SUITE_FILE: [&str; 10] = [
    "suite", "rows", "tasks", "protocol", "variants", "suites", "dimensions", "difficulties",
    "paraphrases", "runnable",
];

/// The flags that take the place of a design.
#[derive(Args, Debug)]
#[command(next_help_heading = "LIBERO-Plus, LIBERO-PRO, LIBERO-Para and further benchmarks")]
pub(super) struct VariantFlags {
    /// Variants of a benchmark: `libero-plus`, `libero-pro` or `libero-para`; with --axes, under a
    /// design, otherwise as released, with the unperturbed rollouts of their tasks.
    #[arg(long, value_name = "BENCHMARK", hide_short_help = true, conflicts_with = "rows")]
    suite: Option<Benchmark>,
    /// Tasks of a suite file, a further benchmark in JSON as docs/FAMILY.md describes it; with
    /// --axes, under a design, otherwise unperturbed. `-` reads standard input.
    #[arg(long, value_name = "FILE", hide_short_help = true,
        conflicts_with_all = NOT_WITH_SUITE_FILE)]
    suite_file: Option<PathBuf>,
    /// Evaluation protocol, see docs/FAMILY.md. If omitted, that of the benchmark's published
    /// table: `plus-official`, `pro-official` or `para-official`.
    #[arg(long, value_name = "NAME", requires = "suite", hide_short_help = true)]
    protocol: Option<Protocol>,
    /// Variants of LIBERO-Plus, by the benchmark's names.
    #[arg(long = "variant", value_name = "NAME,...", value_delimiter = ',', requires = "suite")]
    #[arg(hide_short_help = true)]
    variants: Vec<Variant>,
    /// Variants of these suites: `libero_goal` of LIBERO-Plus, `libero_goal_swap` of LIBERO-PRO.
    #[arg(long, value_name = "SUITE,...", value_delimiter = ',', requires = "suite")]
    #[arg(hide_short_help = true)]
    suites: Vec<String>,
    /// Variants of LIBERO-Plus in these dimensions: background, robot, camera, language, noise,
    /// layout, light.
    #[arg(long = "dimension", value_name = "NAME,...", value_delimiter = ',', requires = "suite")]
    #[arg(hide_short_help = true)]
    dimensions: Vec<Dimension>,
    /// Variants of LIBERO-Plus of these difficulties: 1 to 5, or 0 for variants without a
    /// difficulty.
    #[arg(long = "difficulty", value_name = "N,...", value_delimiter = ',', requires = "suite",
        hide_short_help = true, value_parser = number(0..=5_u8, ""))]
    difficulties: Vec<u8>,
    /// Sentences of LIBERO-Para of these types: entries of the columns `high`, `mid` and `low` of
    /// its metadata, such as obj, structural and hint, or all three joined, such as
    /// act_pragmatical_hint. `--tasks libero_goal/8` selects the sentences of a task.
    #[arg(long = "paraphrase", value_name = "TYPE,...", value_delimiter = ',', requires = "suite")]
    #[arg(hide_short_help = true)]
    paraphrases: Vec<TypeName>,
    /// Trials of each task of LIBERO-PRO or of a suite file. If omitted, 50 for LIBERO-PRO, or the
    /// number in the suite file.
    #[arg(long, value_name = "N", requires = "of_benchmark", hide_short_help = true,
        value_parser = number(1..=STATES, "trials"))]
    trials: Option<u16>,
    /// Leave out variants whose files are in no package index.
    #[arg(long, requires = "suite", hide_short_help = true)]
    runnable: bool,
}

impl VariantFlags {
    /// Returns the rows of the selected rollouts, and the variants that are left out; `None` if no
    /// benchmark and no suite file is named. `tasks` are those of `--tasks`, `design` is that of the
    /// suite file's tasks, if one is given.
    pub(super) fn rows(
        &self,
        tasks: &[TaskRef],
        design: impl FnOnce() -> anyhow::Result<Option<Design>>,
    ) -> Result<Option<(Vec<ManifestRow>, Lacking)>, CommandError> {
        if let Some(path) = &self.suite_file {
            let mut file = read_suite_file(path)?;
            file.trials = self.trials.unwrap_or(file.trials);
            let rows = match design().map_err(usage)? {
                Some(design) => file.perturbed(design).map_err(usage)?,
                None => file.rows(),
            };
            return Ok(Some((rows, Lacking::default())));
        }
        let Some(benchmark) = self.suite else { return Ok(None) };
        self.check_filters(benchmark, !tasks.is_empty()).map_err(usage)?;
        let selection = match benchmark {
            Benchmark::Plus => Selection::Plus(PlusFilters {
                variants: self.variants.clone(),
                suites: parse_names(&self.suites).map_err(usage)?,
                dimensions: self.dimensions.clone(),
                difficulties: self.difficulties.clone(),
            }),
            Benchmark::Pro => Selection::Pro(ProFilters {
                suites: match self.suites.is_empty() {
                    true => ProSuite::all().collect(),
                    false => parse_names(&self.suites).map_err(usage)?,
                },
                trials: self.trials.unwrap_or(STATES),
            }),
            Benchmark::Para => Selection::Para(ParaFilters {
                types: self.paraphrases.clone(),
                tasks: tasks.to_vec(),
            }),
        };
        let protocol = self.protocol.unwrap_or(Protocol::official(benchmark));
        let rows = match design().map_err(usage)? {
            Some(design) => selection.perturbed(&protocol, self.runnable, design),
            None => selection.rows(&protocol, self.runnable),
        };
        rows.map(Some).map_err(usage)
    }

    /// Refuses filters that only another benchmark has.
    fn check_filters(&self, benchmark: Benchmark, has_tasks: bool) -> anyhow::Result<()> {
        use Benchmark::{Para, Plus, Pro};
        let filters = [
            ("--variant", !self.variants.is_empty(), &[Plus][..]),
            ("--suites", !self.suites.is_empty(), &[Plus, Pro]),
            ("--dimension", !self.dimensions.is_empty(), &[Plus]),
            ("--difficulty", !self.difficulties.is_empty(), &[Plus]),
            ("--trials", self.trials.is_some(), &[Pro]),
            ("--paraphrase", !self.paraphrases.is_empty(), &[Para]),
            ("--tasks", has_tasks, &[Para]),
        ];
        for (flag, is_given, benchmarks) in filters {
            ensure!(
                !is_given || benchmarks.contains(&benchmark),
                "choose variants of {benchmark} by {flag}: only another benchmark has this filter; \
                 leave it out"
            );
        }
        Ok(())
    }
}
