//! Selection of variants, and the rows of a campaign that runs them.

use libero_ctrl::{
    CampaignSpec, ManifestRow, RolloutId, Rollouts, SpecError, Suite, TaskRef, UnknownName,
    Variants, select_tasks,
};

use crate::case::{Case, Subject};
use crate::lack::{Lack, Lacking};
use crate::para::{self, Paraphrase, TypeName};
use crate::plus::{Dimension, Entry, UnknownVariant, Variant, entry, inventory};
use crate::pro::{ProSuite, STATES};
use crate::protocol::{Benchmark, Protocol};

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
    pub fn of_spec(spec: &Variants) -> Result<Self, SelectionError> {
        let refuse = |filter, is_given: bool| match is_given {
            true => Err(SelectionError::Filter { benchmark: spec.benchmark.name(), filter }),
            false => Ok(()),
        };
        match spec.benchmark {
            Benchmark::Plus => {
                refuse("trials", spec.trials.is_some())?;
                refuse("paraphrases", !spec.paraphrases.is_empty())?;
                refuse("tasks", !spec.tasks.is_empty())?;
                if let Some(&given) = spec.difficulties.iter().find(|difficulty| **difficulty > 5) {
                    let (field, given) = ("difficulties", given.into());
                    let valid = [0, 5];
                    return Err(SelectionError::Range { field, given, valid });
                }
                let variants = spec.variants.iter().map(|name| name.parse());
                Ok(Self::Plus(PlusFilters {
                    variants: variants.collect::<Result<_, UnknownVariant>>()?,
                    suites: parse_all(&spec.suites)?,
                    dimensions: parse_all(&spec.dimensions)?,
                    difficulties: spec.difficulties.clone(),
                }))
            }
            Benchmark::Pro => {
                refuse("variants", !spec.variants.is_empty())?;
                refuse("dimensions", !spec.dimensions.is_empty())?;
                refuse("difficulties", !spec.difficulties.is_empty())?;
                refuse("paraphrases", !spec.paraphrases.is_empty())?;
                refuse("tasks", !spec.tasks.is_empty())?;
                let trials = spec.trials.unwrap_or(STATES);
                if !(1..=STATES).contains(&trials) {
                    let (field, given, valid) = ("trials", trials, [1, STATES]);
                    return Err(SelectionError::Range { field, given, valid });
                }
                let suites: Vec<ProSuite> = parse_all(&spec.suites)?;
                Ok(Self::Pro(ProFilters {
                    suites: match suites.is_empty() {
                        true => ProSuite::all().collect(),
                        false => suites,
                    },
                    trials,
                }))
            }
            Benchmark::Para => {
                refuse("trials", spec.trials.is_some())?;
                refuse("variants", !spec.variants.is_empty())?;
                refuse("suites", !spec.suites.is_empty())?;
                refuse("dimensions", !spec.dimensions.is_empty())?;
                refuse("difficulties", !spec.difficulties.is_empty())?;
                let tasks: Vec<Vec<TaskRef>> =
                    spec.tasks.iter().map(|text| select_tasks(text)).collect::<Result<_, _>>()?;
                Ok(Self::Para(ParaFilters {
                    types: parse_all(&spec.paraphrases)?,
                    tasks: tasks.concat(),
                }))
            }
        }
    }

    pub fn benchmark(&self) -> Benchmark {
        match self {
            Self::Plus(_) => Benchmark::Plus,
            Self::Pro(_) => Benchmark::Pro,
            Self::Para(_) => Benchmark::Para,
        }
    }

    /// Returns the selected rollouts, in the benchmark's order.
    pub fn cases(&self) -> Result<Vec<Case>, SelectionError> {
        let cases = match self {
            Self::Plus(filters) => filters.cases()?,
            Self::Pro(filters) => filters.cases(),
            Self::Para(filters) => filters.cases(),
        };
        match cases.is_empty() {
            true => Err(SelectionError::Nothing),
            false => Ok(cases),
        }
    }
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

/// Returns the rows of a campaign of any kind; see [`CampaignSpec::expand`]. The rows of a
/// campaign of LIBERO's family are the unperturbed rollouts, followed by the variants in the
/// benchmark's order.
pub fn expand(spec: &CampaignSpec) -> Result<Vec<ManifestRow>, SpecError> {
    let Rollouts::Variants(variants) = &spec.rollouts else {
        return spec.expand();
    };
    spec.check()?;
    rows(variants).map_err(|error| SpecError::Selection { problem: error.to_string() })
}

fn rows(variants: &Variants) -> Result<Vec<ManifestRow>, SelectionError> {
    let protocol: Protocol = variants.protocol.parse()?;
    protocol.check(variants.benchmark)?;
    let chosen = Selection::of_spec(variants)?.cases()?;
    let (runnable, lacking) = audit(chosen);
    let may_leave_out = variants.runnable && !runnable.is_empty();
    if lacking.count() > 0 && !may_leave_out {
        return Err(SelectionError::Lacking {
            lacking: lacking.count(),
            chosen: lacking.count() + runnable.len(),
            report: lacking.to_string(),
        });
    }
    let mut cases = Case::unperturbed(&runnable);
    cases.extend(runnable);
    Ok(cases.iter().map(|case| case.row(&protocol)).collect())
}

pub fn left_out(variants: &Variants) -> Result<Lacking, SelectionError> {
    let chosen = Selection::of_spec(variants)?.cases()?;
    Ok(audit(chosen).1)
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

fn parse_all<T: std::str::FromStr<Err = UnknownName>>(
    names: &[String],
) -> Result<Vec<T>, UnknownName> {
    names.iter().map(|name| name.parse()).collect()
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
        "choose variants of {benchmark} by `{filter}`: only another benchmark has this \
         filter; leave it out"
    )]
    Filter { benchmark: &'static str, filter: &'static str },
    #[error("choose variants: `{field}` has {given}, valid are {} to {}", valid[0], valid[1])]
    Range { field: &'static str, given: u16, valid: [u16; 2] },
    #[error(
        "read rollout {id}: neither LIBERO-Plus nor LIBERO-PRO nor LIBERO-Para has it; `coordinator \
         manifest expand` prints the ids of a specification"
    )]
    Id { id: RolloutId },
    #[error(
        "run {lacking} of the {chosen} chosen rollouts, whose files are missing:\n{report}\n{}",
        advice(chosen - lacking)
    )]
    Lacking { lacking: usize, chosen: usize, report: String },
    #[error(transparent)]
    Variant(#[from] UnknownVariant),
    #[error(transparent)]
    Name(#[from] UnknownName),
}

fn advice(runnable: usize) -> &'static str {
    match runnable {
        0 => "No chosen rollout can run: follow the advice above, or choose other rollouts",
        _ => {
            "Give --runnable (`\"runnable\": true` in a specification) to run the other rollouts \
             only"
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    fn spec(variants: &str) -> CampaignSpec {
        let text = format!(
            r#"{{"name":"family","policy":{{"name":"noop","endpoint":"http://localhost:1"}},
                "variants":{variants}}}"#
        );
        CampaignSpec::from_json(&text).expect("a specification")
    }

    fn count(variants: &str) -> usize {
        expand(&spec(variants)).expect("rows").len()
    }

    #[track_caller]
    fn check_refused(variants: &str, expected: &str) {
        let error = expand(&spec(variants)).expect_err(variants).to_string();
        assert!(error.contains(expected), "{error}");
    }

    #[test]
    fn every_rollout_of_each_benchmark_has_a_distinct_id_that_is_parsed() {
        let plus = Selection::Plus(PlusFilters::default());
        let pro = Selection::Pro(ProFilters { suites: ProSuite::all().collect(), trials: STATES });
        let para = Selection::Para(ParaFilters::default());
        for (selection, protocol, rollouts) in [
            (plus, Protocol::PLUS_OFFICIAL, 10_030 + 40),
            (pro, Protocol::PRO_OFFICIAL, 160 * 50 + 40 * 50),
            (para, Protocol::PARA_OFFICIAL, 4_092 + 10),
        ] {
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
    fn a_selection_expands_to_its_variants_and_their_unperturbed_rollouts() {
        let plus = r#""benchmark":"libero-plus","protocol":"plus-official""#;
        assert_eq!(count(&format!("{{{plus},\"runnable\":true}}")), 7_045 + 40);
        let noise = format!("{{{plus},\"dimensions\":[\"noise\"],\"suites\":[\"libero_goal\"]}}");
        let rows = expand(&spec(&noise)).expect("rows");
        assert_eq!(rows[0].id.to_string(), "goal/t0/plus:unperturbed/i00");
        assert!(rows[10..].iter().all(|row| row.id.to_string().contains("plus:noise_")));
        let text = libero_ctrl::manifest::to_text(&rows[..1]);
        assert!(text.contains("\"protocol\":\"plus-official\""), "{text}");
        let variant = "put_the_bowl_on_the_plate_view_0_0_100_0_0_initstate_0_noise_30";
        assert_eq!(count(&format!("{{{plus},\"variants\":[\"{variant}\"]}}")), 2);
        let pro = r#"{"benchmark":"libero-pro","protocol":"pro-bddl","suites":["libero_goal_swap",
                     "libero_goal_lan"],"trials":3}"#;
        assert_eq!(count(pro), 2 * 10 * 3 + 10 * 3);
        let para = r#""benchmark":"libero-para","protocol":"para-official""#;
        assert_eq!(count(&format!("{{{para}}}")), 4_092 + 10);
        let hints = format!("{{{para},\"paraphrases\":[\"hint\"],\"tasks\":[\"libero_goal/8\"]}}");
        let ids: Vec<String> =
            expand(&spec(&hints)).expect("rows").iter().map(|row| row.id.to_string()).collect();
        assert_eq!(ids[0], "goal/t8/para:unperturbed/i00");
        assert!(
            ids.len() > 5 && ids[1..].iter().all(|id| id.starts_with("goal/t8/para:act_hint_")),
            "{ids:?}"
        );
    }

    #[test]
    fn variants_that_no_worker_can_run_are_refused_or_left_out_with_runnable() {
        let lights = r#"{"benchmark":"libero-plus","protocol":"plus-official",
                        "dimensions":["light","camera"]}"#;
        check_refused(lights, "(scenes/lights/), which no package index has; give");
        check_refused(lights, "--runnable");
        check_refused(lights, r#"`"runnable": true` in a specification"#);
        let runnable = r#"{"benchmark":"libero-plus","protocol":"plus-official","runnable":true}"#;
        let Rollouts::Variants(variants) = spec(runnable).rollouts else {
            panic!("variants");
        };
        assert_eq!(left_out(&variants).expect("a selection").count(), 10_030 - 7_045);
        let none = r#"{"benchmark":"libero-plus","protocol":"plus-official",
                      "dimensions":["light"],"runnable":true}"#;
        check_refused(none, "run 1142 of the 1142 chosen rollouts");
        check_refused(none, "choose other rollouts");
        let objects = r#"{"benchmark":"libero-pro","protocol":"pro-official",
                         "suites":["libero_goal_object"],"trials":1}"#;
        check_refused(objects, "models of LIBERO-PRO");
    }

    #[test]
    fn malformed_selections_are_refused_with_the_remedy() {
        let plus = |rest: &str| {
            format!(r#"{{"benchmark":"libero-plus","protocol":"plus-official",{rest}}}"#)
        };
        let pro = |rest: &str| {
            format!(r#"{{"benchmark":"libero-pro","protocol":"pro-official",{rest}}}"#)
        };
        check_refused(
            r#"{"benchmark":"libero-plus","protocol":"plus"}"#,
            "read protocol `plus`: valid are plus-official",
        );
        check_refused(
            r#"{"benchmark":"libero-pro","protocol":"plus-official"}"#,
            "it is another benchmark's",
        );
        check_refused(&plus(r#""dimensions":["sound"]"#), "valid are background");
        check_refused(&plus(r#""difficulties":[6]"#), "valid are 0 to 5");
        check_refused(&plus(r#""trials":3"#), "leave it out");
        check_refused(&plus(r#""suites":["libero_goal_swap"]"#), "libero_goal");
        check_refused(&plus(r#""variants":["turn_on_the_stove"]"#), "without a change");
        check_refused(
            &plus(r#""variants":["turn_on_the_stove_table_19"]"#),
            "`worker variants --list`",
        );
        check_refused(&plus(r#""dimensions":["noise"],"difficulties":[0]"#), "leave a filter out");
        check_refused(&pro(r#""trials":51"#), "valid are 1 to 50");
        check_refused(&pro(r#""dimensions":["noise"]"#), "leave it out");
        check_refused(&pro(r#""suites":["libero_goal_env"]"#), "_swap");
        check_refused(&pro(r#""paraphrases":["obj"]"#), "leave it out");
        check_refused(&plus(r#""tasks":["libero_goal/3"]"#), "leave it out");
        let para = |rest: &str| {
            format!(r#"{{"benchmark":"libero-para","protocol":"para-official",{rest}}}"#)
        };
        check_refused(&para(r#""paraphrases":["noise"]"#), "valid are all, obj, act, comp");
        check_refused(&para(r#""tasks":["libero_object/3"]"#), "leave a filter out");
        check_refused(&para(r#""tasks":["libero_goal/10"]"#), "libero_goal/9");
        check_refused(&para(r#""dimensions":["noise"]"#), "leave it out");
        check_refused(&para(r#""trials":3"#), "leave it out");
    }
}
