//! One rollout of a benchmark: a variant of LIBERO-Plus, a task of LIBERO-PRO or of a suite file, a
//! sentence of LIBERO-Para, or an unmodified task of LIBERO for comparison, from one of its initial
//! states.

use crate::{Changes, ManifestRow, OwnTask, Perturbation, RolloutId, TaskRef, VariantName};

use crate::family::para::{Paraphrase, paraphrase};
use crate::family::plus::{Assets, Change, Entry, Prompt, Variant, View, entry, start_posture};
use crate::family::pro::{Kind, ProSuite};
use crate::family::protocol::{Benchmark, Protocol};
use crate::family::selection::SelectionError;

/// Folder of LIBERO's task files in that of the sources.
const LIBERO: &str = "libero";

/// Origin of a rollout's task.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Subject {
    Unperturbed,
    Plus(&'static Entry),
    Pro(ProSuite),
    Para(&'static Paraphrase),
    /// A task of a suite file, with the name of its suite. The field `own` of its manifest row
    /// names the task's files and the rules of its rollouts.
    Own(VariantName),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Case {
    pub subject: Subject,
    /// LIBERO's task, or the position of a suite file's task in the file.
    pub task: TaskRef,
    /// Number of the trial, from 0, which is also the index of the initial state.
    pub trial: u16,
}

impl Case {
    /// Returns the unperturbed rollouts of the cases' tasks and trials, for comparison.
    pub fn unperturbed(cases: &[Self]) -> Vec<Self> {
        let mut trials: Vec<_> = cases.iter().map(|case| (case.task, case.trial)).collect();
        trials.sort();
        trials.dedup();
        let unperturbed = trials.into_iter().map(|(task, trial)| Self {
            subject: Subject::Unperturbed,
            task,
            trial,
        });
        unperturbed.collect()
    }

    pub fn of_id(id: RolloutId) -> Result<Self, SelectionError> {
        let task = id.task();
        let subject = id.variant().and_then(|name| subject(task, name));
        Ok(Self { subject: subject.ok_or(SelectionError::Id { id })?, task, trial: id.number() })
    }

    pub fn of_row(row: &ManifestRow) -> Result<(Self, Protocol), SelectionError> {
        let case = Self::of_id(row.id)?;
        let protocol: Protocol = row.protocol.as_deref().unwrap_or_default().parse()?;
        match row.id.variant().and_then(|name| name.benchmark()) {
            Some(benchmark) => protocol.check(benchmark)?,
            None => return Err(SelectionError::Id { id: row.id }),
        }
        Ok((case, protocol))
    }

    /// `None` for an unperturbed rollout and one of a suite file.
    pub fn benchmark(&self) -> Option<Benchmark> {
        match self.subject {
            Subject::Unperturbed | Subject::Own(_) => None,
            Subject::Plus(_) => Some(Benchmark::Plus),
            Subject::Pro(_) => Some(Benchmark::Pro),
            Subject::Para(_) => Some(Benchmark::Para),
        }
    }

    /// Returns the name in results and of the output folder: the name that the benchmark uses and,
    /// except for LIBERO-Plus and LIBERO-Para, the number of the trial. A suite file's task is
    /// named by its suite and its position in the file.
    pub fn name(&self) -> String {
        let (task, trial) = (self.task.name(), self.trial);
        match self.subject {
            Subject::Plus(entry) => entry.variant.to_string(),
            Subject::Pro(suite) => format!("{suite}/{task}/e{trial:02}"),
            Subject::Para(paraphrase) => paraphrase.to_string(),
            Subject::Unperturbed => format!("{}/{task}/e{trial:02}", self.task.suite()),
            Subject::Own(suite) => {
                format!("{}/t{}/e{trial:02}", suite.change(), self.task.index())
            }
        }
    }

    /// Returns the rollout's id. `benchmark` is the benchmark that the id names; a rollout of a
    /// suite file ignores it.
    pub fn id(&self, benchmark: Benchmark) -> RolloutId {
        let change = match self.subject {
            Subject::Plus(entry) => entry.variant.change.label(),
            Subject::Pro(suite) => suite.kind.ending().to_owned(),
            Subject::Para(paraphrase) => paraphrase.label(),
            Subject::Unperturbed => VariantName::UNPERTURBED.to_owned(),
            Subject::Own(suite) => return RolloutId::of_variant(self.task, suite, self.trial),
        };
        let name = VariantName::new(benchmark, &change).expect("a test covers every change");
        RolloutId::of_variant(self.task, name, self.trial)
    }

    /// Returns the row of the result tables in which the case counts: a dimension of LIBERO-Plus,
    /// a suite of LIBERO-PRO or of a suite file, or the columns `high` and `mid` of a type of
    /// LIBERO-Para; `None` for an unperturbed rollout.
    pub fn group(&self) -> Option<String> {
        match self.subject {
            Subject::Unperturbed => None,
            Subject::Plus(entry) => Some(entry.dimension().name().to_owned()),
            Subject::Pro(suite) => Some(suite.to_string()),
            Subject::Para(Paraphrase { kind, .. }) => {
                Some(format!("{} {}", kind.high(), kind.mid()))
            }
            Subject::Own(suite) => Some(suite.change().to_owned()),
        }
    }

    pub fn difficulty(&self) -> Option<u8> {
        match self.subject {
            Subject::Plus(entry) => entry.difficulty,
            _ => None,
        }
    }

    /// Returns the policy's prompt; empty if only the BDDL file has it.
    fn prompt(&self, protocol: &Protocol) -> String {
        match self.subject {
            Subject::Para(_) => String::new(),
            Subject::Plus(entry) => protocol.prompt.of(&entry.variant, ""),
            _ if protocol.prompt == Prompt::Bddl => String::new(),
            _ => self.task.instruction(),
        }
    }

    /// Returns the manifest row of the rollout, with the trial's initial state and the protocol's
    /// settling steps and step budget. The instruction is empty if only the BDDL file has it.
    pub fn row(&self, protocol: &Protocol) -> ManifestRow {
        let id = self.id(protocol.benchmark);
        let row = ManifestRow::new(id, self.trial, self.trial, Perturbation::default());
        ManifestRow {
            instruction: self.prompt(protocol),
            settle_steps: protocol.waits,
            max_steps: protocol.budget(self.task.suite()),
            protocol: Some(protocol.name.to_owned()),
            own: Some(Box::new(self.own(protocol))),
            files: self.own_files(),
            ..row
        }
    }

    /// Returns the task's files, in LIBERO's folder or the benchmark's, and its conditions. The
    /// rollouts of LIBERO-Para are simulated from LIBERO's files, which differ in the sentence only,
    /// so that all sentences of a task share a compiled scene.
    fn own(&self, protocol: &Protocol) -> OwnTask {
        let (suite, name) = (self.task.suite(), self.task.name());
        let mut own = OwnTask {
            folder: LIBERO.to_owned(),
            bddl: format!("bddl_files/{suite}/{name}.bddl"),
            states: format!("init_files/{suite}/{name}.pruned_init"),
            states_folder: None,
            sentence: None,
            start: protocol.beginning,
            seed: protocol.seed,
            changes: Changes::default(),
            suite: String::new(),
            instruction: String::new(),
        };
        match self.subject {
            Subject::Unperturbed | Subject::Own(_) => {}
            Subject::Plus(Entry { variant, .. }) => {
                let stem = variant.bddl_stem();
                if stem != name {
                    Benchmark::Plus.name().clone_into(&mut own.folder);
                    own.bddl = format!("bddl_files/{suite}/{stem}.bddl");
                    match variant.has_one_state() {
                        true => own.states = format!("init_files/{}", variant.states_file()),
                        false => own.states_folder = Some(LIBERO.to_owned()),
                    }
                }
                let View { horizontal, vertical, scale, pan, tilt } = variant.view();
                own.changes = Changes {
                    view: Some([horizontal, vertical, scale, pan, tilt]),
                    posture: variant.robot().and_then(start_posture),
                    noise: variant.corruption(),
                    sha256: None,
                };
            }
            Subject::Pro(suite) => {
                Benchmark::Pro.name().clone_into(&mut own.folder);
                own.bddl = format!("bddl_files/{suite}/{name}.bddl");
                own.states = format!("init_files/{suite}/{name}.pruned_init.npz");
            }
            Subject::Para(paraphrase) => {
                own.sentence = Some(format!("{}/{}", Benchmark::Para, paraphrase.bddl_file()));
            }
        }
        own
    }

    /// Returns the benchmark whose task files the rollout needs; `None` if LIBERO's suffice.
    fn own_files(&self) -> Option<Benchmark> {
        let Subject::Plus(entry) = self.subject else { return self.benchmark() };
        let variant = &entry.variant;
        let has_own = variant.bddl_stem() != self.task.name() || variant.has_one_state();
        has_own.then_some(Benchmark::Plus)
    }

    /// Returns the files that the case needs in addition to LIBERO's and to the benchmark's task
    /// files; `None` if the case needs none.
    pub fn further_assets(&self) -> Option<Further> {
        match self.subject {
            Subject::Unperturbed | Subject::Para(_) | Subject::Own(_) => None,
            Subject::Pro(suite) => (suite.kind == Kind::Object).then_some(Further::Models),
            Subject::Plus(entry) => match entry.assets() {
                Assets::Libero => None,
                Assets::FloorTextures if entry.uses_liberos_styles() => None,
                assets => Some(Further::Assets(assets)),
            },
        }
    }
}

/// Files that no asset pack of this project has, so that a user must provide a folder with them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Further {
    Assets(Assets),
    Models,
}

/// Returns the origin of a task's variant from its name; `None` if the task has no such variant.
fn subject(task: TaskRef, name: VariantName) -> Option<Subject> {
    if name.is_unperturbed() {
        return Some(Subject::Unperturbed);
    }
    let Some(benchmark) = name.benchmark() else {
        return Some(Subject::Own(name));
    };
    match benchmark {
        Benchmark::Plus => {
            let change = Change::of_label(name.change())?;
            Some(Subject::Plus(entry(&Variant { task, change })?))
        }
        Benchmark::Pro => {
            let kind = Kind::ALL.into_iter().find(|kind| kind.ending() == name.change())?;
            let suite = task.suite();
            Some(Subject::Pro(ProSuite { suite, kind }))
        }
        Benchmark::Para => paraphrase(task, name.change()).map(Subject::Para),
    }
}

#[cfg(test)]
mod tests {
    use crate::TaskKey;

    use super::*;

    #[test]
    fn ids_that_name_no_variant_are_refused() {
        for text in [
            "goal/t8/plus:noise_51/i00",
            "goal/t8/plus:swap/i00",
            "goal/t8/pro:env/i00",
            "goal/t8/para:act_hint_11/i00",
            "object/t8/para:act_hint_1/i00",
            "goal/t8/nominal/i00",
        ] {
            let id = text.parse().expect("well-formed");
            assert!(Case::of_id(id).is_err(), "{text}");
        }
        let own = Case::of_id("own/t17/own:near/i03".parse().expect("an id")).expect("a case");
        assert_eq!(own.name(), "near/t17/e03");
        assert_eq!(own.group().as_deref(), Some("near"));
        assert_eq!(own.id(Benchmark::Plus).to_string(), "own/t17/own:near/i03");
        let case = Case::of_id("goal/t8/pro:swap/i07".parse().expect("an id")).expect("a case");
        let mut row = case.row(&Protocol::PRO_OFFICIAL);
        row.protocol = Some("plus-official".to_owned());
        let error = Case::of_row(&row).expect_err("another benchmark's protocol");
        assert!(matches!(error, SelectionError::Foreign { .. }), "{error}");
    }

    #[test]
    fn rows_lack_the_prompts_that_only_bddl_files_have() {
        let case = |text: &str| Case::of_id(text.parse().expect("an id")).expect("a case");
        let official = Protocol::PLUS_OFFICIAL;
        let noise = case("goal/t8/plus:noise_30/i00");
        let text = "put the bowl on the plate view 0 0 100 0 0 initstate 0 noise 30";
        assert_eq!(noise.row(&official).instruction, text);
        let language = case("goal/t8/plus:language_1/i00");
        assert_eq!(language.row(&official).instruction, "");
        let bddl: Protocol = "pro-bddl".parse().expect("a protocol");
        assert_eq!(case("goal/t8/pro:lan/i00").row(&bddl).instruction, "");
        let official = Protocol::PARA_OFFICIAL;
        let hint = case("goal/t8/para:act_hint_1/i00");
        assert_eq!(hint.row(&official).instruction, "");
        let pair = case("goal/t8/para:unperturbed/i00").row(&official);
        assert_eq!(pair.instruction, "put the bowl on the plate");
        assert_eq!((pair.settle_steps, pair.max_steps, pair.init_id), (10, 300, 0));
    }

    #[test]
    fn a_rows_key_names_the_benchmark_whose_files_the_rollout_needs() {
        for (id, expected) in [
            ("goal/t8/plus:unperturbed/i00", "libero_goal/8"),
            ("goal/t8/plus:noise_30/i00", "libero_goal/8"),
            ("goal/t8/plus:initstate_19/i00", "libero_goal/8"),
            ("goal/t8/plus:language_1/i00", "libero_goal/8+libero-plus"),
            ("goal/t8/plus:level1_sample1/i00", "libero_goal/8+libero-plus"),
            ("object/t0/plus:tb_18/i00", "libero_object/0+libero-plus"),
            ("goal/t8/pro:swap/i07", "libero_goal/8+libero-pro"),
            ("goal/t8/para:act_hint_1/i00", "libero_goal/8+libero-para"),
            ("goal/t8/para:unperturbed/i00", "libero_goal/8"),
        ] {
            let id: RolloutId = id.parse().expect("an id");
            let benchmark = id.variant().and_then(|name| name.benchmark()).expect("a benchmark");
            let row = Case::of_id(id).expect("a case").row(&Protocol::official(benchmark));
            assert_eq!(TaskKey::of_row(&row), expected, "{id}");
            assert_eq!(TaskKey::files_of(expected), row.files);
            let key = TaskKey { task: id.task(), files: row.files };
            assert!(TaskKey::of_task(key.task).any(|other| other == key));
            if let Some(benchmark) = key.files {
                assert!(TaskKey::needing(benchmark).any(|other| other == key));
            }
        }
    }
}
