//! Selection of variants, and the rows of their rollouts.

use crate::{Design, DesignVersion, ManifestRow, RolloutId, Suite, TaskRef, UnknownName};

use crate::family::case::{Case, Subject};
use crate::family::lack::{Lack, Lacking};
use crate::family::para::{self, Paraphrase, TypeName};
use crate::family::plus::{Dimension, Entry, UnknownVariant, Variant, entry, inventory};
use crate::family::pro::ProSuite;
use crate::family::protocol::{Benchmark, Protocol};

#[derive(Clone, Debug)]
pub enum Selection {
    Plus(PlusFilters),
    Pro(ProFilters),
    Para(ParaFilters),
}

/// Filters of LIBERO-Plus' variants. A variant must match all filters that are not empty.
#[derive(Clone, Debug, Default)]
pub struct PlusFilters {
    pub variants: Vec<Variant>,
    pub suites: Vec<Suite>,
    pub dimensions: Vec<Dimension>,
    /// Difficulties, 1 to 5; 0 for variants without one.
    pub difficulties: Vec<u8>,
}

#[derive(Clone, Debug)]
pub struct ProFilters {
    pub suites: Vec<ProSuite>,
    /// Number of trials of each task, from the first initial states.
    pub trials: u16,
}

/// Filters of LIBERO-Para's sentences. A sentence must match all filters that are not empty.
#[derive(Clone, Debug, Default)]
pub struct ParaFilters {
    /// Types, or sentences by name.
    pub types: Vec<TypeName>,
    pub tasks: Vec<TaskRef>,
}

impl Selection {
    pub fn benchmark(&self) -> Benchmark {
        match self {
            Self::Plus(_) => Benchmark::Plus,
            Self::Pro(_) => Benchmark::Pro,
            Self::Para(_) => Benchmark::Para,
        }
    }

    pub fn cases(&self) -> Result<Vec<Case>, SelectionError> {
        let cases = match self {
            Self::Plus(filters) => filters.cases()?,
            Self::Pro(filters) => filters.cases(),
            Self::Para(filters) => filters.cases(),
        };
        if cases.is_empty() { Err(SelectionError::Nothing) } else { Ok(cases) }
    }

    /// Returns the rows of a campaign: the unperturbed rollouts, followed by the variants in the
    /// benchmark's order; and the variants that no worker can run. Unless `runnable`, such a variant
    /// is an error.
    pub fn rows(
        &self,
        protocol: &Protocol,
        runnable: bool,
    ) -> Result<(Vec<ManifestRow>, Lacking), SelectionError> {
        protocol.check(self.benchmark())?;
        let (variants, lacking) = audit(self.cases()?);
        if lacking.count() > 0 && (!runnable || variants.is_empty()) {
            return Err(SelectionError::Lacking {
                lacking: lacking.count(),
                chosen: lacking.count() + variants.len(),
                report: lacking.to_string(),
            });
        }
        let cases = Case::unperturbed(&variants).into_iter().chain(variants);
        Ok((cases.map(|case| case.row(protocol)).collect(), lacking))
    }
}

impl Selection {
    /// Returns the rows of a design, whose tasks are the chosen variants in their order, numbered as
    /// a suite file's tasks are; and the variants that no worker can run.
    pub fn perturbed(
        &self,
        protocol: &Protocol,
        runnable: bool,
        design: Design,
    ) -> Result<(Vec<ManifestRow>, Lacking), SelectionError> {
        let (mut tasks, lacking) = self.rows(protocol, runnable)?;
        let is_variant = |id: RolloutId| id.variant().is_some_and(|name| !name.is_unperturbed());
        tasks.retain(|row| row.init_id == 0 && is_variant(row.id));
        let name = format!("{}@{}", self.benchmark(), DesignVersion::of_manifest(&tasks));
        let count = tasks.len();
        for (index, row) in (0..).zip(&mut tasks) {
            let index = u8::try_from(index).map_err(|_| SelectionError::TooMany { count })?;
            if let Some(own) = &mut row.own {
                row.id.suite_name().clone_into(&mut own.suite);
            }
            row.id = RolloutId::nominal(TaskRef::own(index), 0);
            row.protocol = Some(name.clone());
        }
        let states = if let Self::Pro(filters) = self { filters.trials } else { 1 };
        let rows = design.expand_over(&tasks, states);
        Ok((rows.map_err(|error| SelectionError::Design(error.to_string()))?, lacking))
    }
}

pub fn rows_of_all(benchmark: Benchmark) -> Vec<ManifestRow> {
    let cases = match benchmark {
        Benchmark::Plus => PlusFilters::default().cases().expect("no variant is named"),
        Benchmark::Pro => ProFilters { suites: ProSuite::all().collect(), trials: 1 }.cases(),
        Benchmark::Para => ParaFilters::default().cases(),
    };
    cases.iter().map(|case| case.row(&Protocol::official(benchmark))).collect()
}

impl PlusFilters {
    fn cases(&self) -> Result<Vec<Case>, SelectionError> {
        if let Some(unused) = self.variants.iter().find(|variant| entry(variant).is_none()) {
            return Err(SelectionError::Unused { name: unused.to_string() });
        }
        let chosen = inventory().iter().filter(|entry| {
            matches_filter(&self.variants, &entry.variant)
                && matches_filter(&self.suites, &entry.variant.task.suite())
                && matches_filter(&self.dimensions, &entry.dimension())
                && matches_filter(&self.difficulties, &entry.difficulty.unwrap_or(0))
        });
        let case = |entry: &'static Entry| Case {
            subject: Subject::Plus(entry),
            task: entry.variant.task,
            trial: 0,
        };
        Ok(chosen.map(case).collect())
    }
}

impl ProFilters {
    fn cases(&self) -> Vec<Case> {
        let suites = ProSuite::all().filter(|suite| self.suites.contains(suite));
        let cases = suites.flat_map(|suite| {
            let tasks = suite.suite.tasks();
            tasks.flat_map(move |task| {
                (0..self.trials).map(move |trial| Case {
                    subject: Subject::Pro(suite),
                    task,
                    trial,
                })
            })
        });
        cases.collect()
    }
}

impl ParaFilters {
    fn cases(&self) -> Vec<Case> {
        let is_chosen = |paraphrase: &&Paraphrase| {
            let mut types = self.types.iter();
            (self.types.is_empty() || types.any(|name| name.has(paraphrase)))
                && matches_filter(&self.tasks, &paraphrase.task)
        };
        let case = |paraphrase: &'static Paraphrase| Case {
            subject: Subject::Para(paraphrase),
            task: paraphrase.task,
            trial: 0,
        };
        let chosen = para::inventory().iter().filter(is_chosen);
        chosen.map(case).collect()
    }
}

/// Separates the rollouts whose files are LIBERO's or in a package index from all others, which a
/// campaign does not run, because its results are pinned to one asset pack.
fn audit(chosen: Vec<Case>) -> (Vec<Case>, Lacking) {
    let (mut runnable, mut lacking) = (Vec::new(), Lacking::default());
    for case in chosen {
        match case.further_assets() {
            Some(further) => lacking.add(Lack::Further(further), case),
            None => runnable.push(case),
        }
    }
    (runnable, lacking)
}

fn matches_filter<T: PartialEq>(filter: &[T], value: &T) -> bool {
    filter.is_empty() || filter.contains(value)
}

#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SelectionError {
    #[error("choose variants: none matches all filters; leave a filter out")]
    Nothing,
    #[error(
        "run {benchmark} under protocol `{protocol}`: it is another benchmark's protocol; \
         docs/FAMILY.md lists the protocols of each benchmark"
    )]
    Foreign { protocol: &'static str, benchmark: &'static str },
    #[error(
        "choose variant `{name}`: its name is well-formed, but LIBERO-Plus' task map does not \
         have it; `worker variants --list` lists the variants"
    )]
    Unused { name: String },
    #[error(
        "read rollout {id}: neither LIBERO-Plus nor LIBERO-PRO nor LIBERO-Para has it; `coordinator \
         manifest --spec FILE` prints the ids of a specification"
    )]
    Id { id: RolloutId },
    #[error(
        "run {lacking} of the {chosen} chosen rollouts, whose files are missing:\n{report}\n{}",
        advice(chosen - lacking)
    )]
    Lacking { lacking: usize, chosen: usize, report: String },
    #[error("perturb {count} variants: at most 256 are possible, choose fewer")]
    TooMany { count: usize },
    #[error("{0}")]
    Design(String),
    #[error(transparent)]
    Variant(#[from] UnknownVariant),
    #[error(transparent)]
    Name(#[from] UnknownName),
}

fn advice(runnable: usize) -> &'static str {
    match runnable {
        0 => "No chosen rollout can run: follow the advice above, or choose other rollouts",
        _ => "Give --runnable to run the other rollouts only",
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use crate::{Level, OwnTask, manifest};

    use super::*;
    use crate::family::pro::STATES;

    fn of_dimensions(dimensions: &[Dimension]) -> Selection {
        Selection::Plus(PlusFilters { dimensions: dimensions.to_vec(), ..PlusFilters::default() })
    }

    fn of_pro(suite: &str, trials: u16) -> Selection {
        let suites = vec![suite.parse().expect("a suite")];
        Selection::Pro(ProFilters { suites, trials })
    }

    #[test]
    fn every_rollout_of_each_benchmark_has_a_distinct_id_that_is_parsed() {
        let plus = of_dimensions(&[]);
        let pro = Selection::Pro(ProFilters { suites: ProSuite::all().collect(), trials: STATES });
        let para = Selection::Para(ParaFilters::default());
        for (selection, rollouts) in
            [(plus, 10_030 + 40), (pro, 160 * 50 + 40 * 50), (para, 4_092 + 10)]
        {
            let protocol = Protocol::official(selection.benchmark());
            let mut cases = selection.cases().expect("cases");
            cases.extend(Case::unperturbed(&cases));
            let mut ids = BTreeSet::new();
            for case in &cases {
                let row = case.row(&protocol);
                let text = row.id.to_string();
                assert_eq!(text.parse(), Ok(row.id));
                let read = Case::of_row(&row).expect("a case");
                assert_eq!(read, (*case, protocol), "{text}");
                ids.insert(row.id);
            }
            assert_eq!((cases.len(), ids.len()), (rollouts, rollouts));
        }
    }

    #[test]
    fn a_selection_has_the_rows_of_its_variants_after_those_of_their_unperturbed_rollouts() {
        let hints = Selection::Para(ParaFilters {
            types: vec!["hint".parse().expect("a type")],
            tasks: vec!["libero_goal/8".parse().expect("a task")],
        });
        for (selection, runnable, count, variants) in [
            (of_dimensions(&[]), true, 7_045 + 40, "plus:"),
            (of_dimensions(&[Dimension::Noise]), false, 1_601 + 40, "plus:noise_"),
            (of_pro("libero_goal_swap", 3), false, 10 * 3 + 10 * 3, "pro:swap"),
            (hints, false, 9 + 1, "goal/t8/para:act_hint_"),
        ] {
            let protocol = Protocol::official(selection.benchmark());
            let (rows, left_out) = selection.rows(&protocol, runnable).expect("rows");
            assert_eq!((rows.len(), left_out.count() > 0), (count, runnable), "{variants}");
            assert!(rows.iter().all(|row| row.protocol.as_deref() == Some(protocol.name)));
            let ids: Vec<String> = rows.iter().map(|row| row.id.to_string()).collect();
            let first = ids.iter().position(|id| !id.contains(":unperturbed/")).expect("variants");
            assert!(first > 0 && ids[first..].iter().all(|id| id.contains(variants)), "{variants}");
        }
    }

    #[test]
    fn variants_take_every_axis_as_liberos_tasks_do() {
        let protocol = Protocol::PRO_OFFICIAL;
        let design = Design { levels: vec![Level::L2], configs: vec![0, 1, 2], ..Design::v0_1() };
        let swapped = of_pro("libero_goal_swap", 3);
        let (rows, _) = swapped.perturbed(&protocol, false, design.clone()).expect("rows");
        assert_eq!(rows.len(), 10 * 3 + 10 * 3 * 7);
        assert!(rows.iter().all(|row| row.init_id < 3 && row.suite_name() == "libero_goal"));
        let camera = rows.iter().find(|row| row.id.to_string() == "own/t8/camera/L2/c00");
        let camera = camera.expect("a row");
        let plain = swapped.rows(&protocol, false).expect("rows").0;
        let plain = plain.iter().find(|row| row.id.to_string() == "goal/t8/pro:swap/i00");
        let (plain, own) = (plain.expect("a row"), camera.own.as_deref().expect("a task"));
        let suite = String::new();
        assert_eq!(Some(OwnTask { suite, ..own.clone() }), plain.own.as_deref().cloned());
        assert_eq!(own.bddl, "bddl_files/libero_goal_swap/put_the_bowl_on_the_plate.bddl");
        assert_eq!((&camera.instruction, camera.files), (&plain.instruction, plain.files));
        assert!(!camera.perturbation.axes().is_empty());
        assert_eq!(manifest::parse(&manifest::to_text(&rows)), Ok(rows));
        let noise = of_dimensions(&[Dimension::Noise]);
        let error = noise.perturbed(&Protocol::PLUS_OFFICIAL, false, design);
        assert_eq!(error.expect_err("too many"), SelectionError::TooMany { count: 1601 });
    }

    #[test]
    fn selections_that_cannot_run_are_refused_with_the_remedy() {
        use Dimension::{Camera, Light, Noise};
        let unrated = PlusFilters {
            dimensions: vec![Noise],
            difficulties: vec![0],
            ..PlusFilters::default()
        };
        for (selection, runnable, expected) in [
            (
                of_dimensions(&[Light, Camera]),
                false,
                "(scenes/lights/), which no package index has",
            ),
            (of_dimensions(&[Light, Camera]), false, "Give --runnable to run the other rollouts"),
            (of_dimensions(&[Light]), true, "run 1142 of the 1142 chosen rollouts"),
            (of_dimensions(&[Light]), true, "choose other rollouts"),
            (of_pro("libero_goal_object", 1), true, "models of LIBERO-PRO"),
            (Selection::Plus(unrated), false, "leave a filter out"),
        ] {
            let protocol = Protocol::official(selection.benchmark());
            let error = selection.rows(&protocol, runnable).expect_err(expected).to_string();
            assert!(error.contains(expected), "{error}");
        }
        let foreign = of_pro("libero_goal_swap", 1).rows(&Protocol::PLUS_OFFICIAL, false);
        assert!(matches!(foreign, Err(SelectionError::Foreign { .. })));
    }
}
