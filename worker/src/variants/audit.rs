//! Checks before a run which of the chosen variants have all their files.

use std::collections::BTreeMap;
use std::fmt::{self, Write};

use assets::Table;
use libero_family::plus::{Assets, Entry};
use libero_family::protocol::Benchmark;
use scene::catalog::category;
use scene::{AssetPack, Sources};

use super::case::{Case, Subject};
use super::error::VariantsError;

/// Rollouts that a report names per reason; the others are counted.
const MAX_NAMED: usize = 3;

/// Reason why a variant cannot run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Lack {
    /// The BDDL file or the initial states are missing.
    TaskFiles(Benchmark),
    /// Files of LIBERO-Plus' archive are missing.
    Assets(Assets),
    /// Models of LIBERO-PRO are missing.
    Models,
}

impl fmt::Display for Lack {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TaskFiles(benchmark) => write!(
                f,
                "task files; run `worker assets fetch --suite {}`",
                benchmark.name()
            ),
            Self::Models => write!(
                f,
                "models of LIBERO-PRO; give --assets the folder of the unpacked wheels, which \
                 docs/FAMILY.md tells how to make"
            ),
            Self::Assets(assets @ Assets::Lights) => {
                write!(f, "{assets}, whose shadows are not drawn yet")
            }
            Self::Assets(assets @ Assets::NewObjects) => {
                write!(f, "{assets}, which the catalogue does not have yet")
            }
            Self::Assets(assets) => write!(f, "{assets}, which no package index has"),
        }
    }
}

/// Chosen rollouts, grouped by their missing files.
pub struct Audit {
    /// Rollouts with all their files.
    pub runnable: Vec<Case>,
    /// Rollouts with missing files, by reason.
    pub lacking: Vec<(Lack, Vec<Case>)>,
}

impl Audit {
    /// Checks which cases have all their files.
    ///
    /// # Errors
    /// If an existing BDDL file cannot be read.
    pub fn new(
        cases: Vec<Case>,
        pack: &AssetPack,
        sources: &Sources,
    ) -> Result<Self, VariantsError> {
        let mut audit = Self {
            runnable: Vec::new(),
            lacking: Vec::new(),
        };
        // All trials of a task need the same files.
        let mut last: Option<(Case, Option<Lack>)> = None;
        for case in cases {
            let lack = match &last {
                Some((known, lack)) if case.trial > 0 && known.files_are_of(&case) => *lack,
                _ => lack(&case, pack, sources)?,
            };
            last = Some((case, lack));
            let Some(lack) = lack else {
                audit.runnable.push(case);
                continue;
            };
            match audit.lacking.iter_mut().find(|(known, _)| *known == lack) {
                Some((_, cases)) => cases.push(case),
                None => audit.lacking.push((lack, vec![case])),
            }
        }
        Ok(audit)
    }

    /// Returns the number of rollouts.
    pub fn count(&self) -> usize {
        self.runnable.len() + self.lacking.iter().map(|(_, it)| it.len()).sum::<usize>()
    }

    /// Checks that no rollout lacks files.
    ///
    /// # Errors
    /// If any rollout lacks files.
    pub fn require_all(&self) -> Result<(), VariantsError> {
        match self.lacking.is_empty() {
            true => Ok(()),
            false => Err(VariantsError::Lacking {
                lacking: self.count() - self.runnable.len(),
                chosen: self.count(),
                report: self.reasons(),
            }),
        }
    }

    /// Lists the missing files, with the rollouts that need them.
    fn reasons(&self) -> String {
        let mut text = String::new();
        for (lack, cases) in &self.lacking {
            let named = cases.iter().take(MAX_NAMED).map(Case::name);
            let named: Vec<String> = named.collect();
            let more = match cases.len() - named.len() {
                0 => String::new(),
                more => format!(" and {more} more"),
            };
            let named = named.join(", ");
            let _ = writeln!(text, "{:>6}  {lack}: {named}{more}", cases.len());
        }
        text.trim_end().to_owned()
    }

    /// Formats a table of dimensions or suites, followed by the missing files.
    pub fn report(&self) -> String {
        let mut counts: BTreeMap<String, [usize; 2]> = BTreeMap::new();
        let mut count = |cases: &[Case], runnable: usize| {
            for group in cases.iter().filter_map(Case::group) {
                let counts = counts.entry(group).or_default();
                counts[0] += 1;
                counts[1] += runnable;
            }
        };
        count(&self.runnable, 1);
        for (_, cases) in &self.lacking {
            count(cases, 0);
        }
        let mut text = format!("{:<22}{:>9}{:>9}\n", "", "rollouts", "can run");
        let mut line = |name: &str, [all, runnable]: [usize; 2]| {
            let _ = writeln!(text, "{name:<22}{all:>9}{runnable:>9}");
        };
        for (group, counts) in counts {
            line(&group, counts);
        }
        line("all", [self.count(), self.runnable.len()]);
        if !self.lacking.is_empty() {
            let _ = write!(text, "Missing:\n{}\n", self.reasons());
        }
        text
    }

    /// Formats a line per rollout, separated by tabs: suite, name, group, difficulty, files needed
    /// beyond LIBERO's assets, and whether the rollout can run.
    pub fn list(&self) -> String {
        let mut text = String::new();
        let all = [(None, &self.runnable)];
        let lacking = self.lacking.iter().map(|(lack, it)| (Some(lack), it));
        for (lack, cases) in all.into_iter().chain(lacking) {
            for case in cases {
                let difficulty = case.difficulty().map(|it| it.to_string());
                let state = match lack {
                    None => "runs".to_owned(),
                    Some(lack) => format!("lacks {lack}"),
                };
                let _ = writeln!(
                    text,
                    "{}\t{}\t{}\t{}\t{}\t{state}",
                    case.task.suite(),
                    case.name(),
                    case.group().unwrap_or_default(),
                    difficulty.as_deref().unwrap_or("-"),
                    needs(case),
                );
            }
        }
        text
    }
}

/// Lists the files of LIBERO-Plus' archive that a variant needs.
fn needs(case: &Case) -> String {
    let Subject::Plus(Entry {
        class: Some(class), ..
    }) = case.subject
    else {
        return "-".to_owned();
    };
    let styles = [&class.floor, &class.wall].into_iter().flatten();
    let textures = styles.map(|style| format!("textures/{}", style.file));
    let files = class.scene.iter().cloned().chain(textures);
    files.collect::<Vec<_>>().join(" ")
}

/// Returns the reason why a rollout cannot run; `None` if all its files exist.
fn lack(case: &Case, pack: &AssetPack, sources: &Sources) -> Result<Option<Lack>, VariantsError> {
    let lack = match case.subject {
        Subject::Plus(entry) => assets_lack(entry, pack),
        Subject::Pro(_) | Subject::Unperturbed => None,
    };
    if lack.is_some() {
        return Ok(lack);
    }
    let files = case.files(sources);
    match case.benchmark() {
        Some(benchmark) if !(files.bddl.is_file() && files.init.is_file()) => {
            Ok(Some(Lack::TaskFiles(benchmark)))
        }
        Some(Benchmark::Pro) => {
            let problem = files.problem()?;
            let declared = problem.objects.iter().chain(&problem.fixtures);
            let mut models = declared.filter_map(|it| category(&it.category));
            let is_there = |file: &str| {
                (pack.is_managed() && Table::libero().get(file).is_some())
                    || pack.dir().join(file).is_file()
            };
            Ok((!models.all(|model| is_there(model.file))).then_some(Lack::Models))
        }
        _ => Ok(None),
    }
}

/// Returns the files that a LIBERO-Plus variant lacks, apart from its task files.
fn assets_lack(entry: &Entry, pack: &AssetPack) -> Option<Lack> {
    let assets = entry.assets();
    let is_in_pack = |file: &str| pack.dir().join(file).is_file();
    let is_there = match (assets, &entry.class) {
        (Assets::Libero, _) => true,
        (Assets::FloorTextures, Some(class)) => {
            let mut styles = [&class.floor, &class.wall].into_iter().flatten();
            styles.all(|style| style.is_liberos || is_in_pack(&format!("textures/{}", style.file)))
        }
        (Assets::Scenes, Some(class)) => class.scene.as_deref().is_some_and(is_in_pack),
        (Assets::Lights | Assets::NewObjects, _) | (_, None) => false,
    };
    (!is_there).then_some(Lack::Assets(assets))
}
