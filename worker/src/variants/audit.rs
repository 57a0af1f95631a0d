//! What the chosen variants need, and which of them have it here, before anything starts.

use std::collections::BTreeMap;
use std::fmt::{self, Write};

use libero_family::plus::{Assets, Dimension, Entry};
use scene::{AssetPack, Sources, TaskFiles};

use super::error::VariantsError;

/// Names that a report gives of each reason; the others are counted.
const MAX_NAMED: usize = 3;

/// Reason for which a variant cannot run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Lack {
    /// Its BDDL file or states.
    TaskFiles,
    /// Files beyond LIBERO's assets, which no package index has.
    Assets(Assets),
}

impl fmt::Display for Lack {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TaskFiles => write!(
                f,
                "task files of LIBERO-Plus; run `worker assets fetch --suite libero-plus`"
            ),
            Self::Assets(assets) => write!(f, "{assets}, which no package index has"),
        }
    }
}

/// The chosen variants, by what they lack.
pub struct Audit {
    /// Those that can run.
    pub runnable: Vec<&'static Entry>,
    /// The others.
    pub lacking: BTreeMap<Lack, Vec<&'static Entry>>,
}

impl Audit {
    /// Looks for the files of variants.
    pub fn new(entries: &[&'static Entry], pack: &AssetPack, sources: &Sources) -> Self {
        let mut audit = Self {
            runnable: Vec::new(),
            lacking: BTreeMap::new(),
        };
        for entry in entries {
            match lack(entry, pack, sources) {
                None => audit.runnable.push(entry),
                Some(lack) => audit.lacking.entry(lack).or_default().push(entry),
            }
        }
        audit
    }

    /// Number of variants.
    pub fn count(&self) -> usize {
        self.runnable.len() + self.lacking.values().map(Vec::len).sum::<usize>()
    }

    /// Refuses to go on without those whose files are missing.
    ///
    /// # Errors
    /// If there are any.
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

    /// What is missing, and for which variants.
    fn reasons(&self) -> String {
        let mut text = String::new();
        for (lack, entries) in &self.lacking {
            let named = entries.iter().take(MAX_NAMED);
            let named: Vec<String> = named.map(|entry| entry.variant.to_string()).collect();
            let more = match entries.len() - named.len() {
                0 => String::new(),
                more => format!(" and {more} more"),
            };
            let named = named.join(", ");
            let _ = writeln!(text, "{:>6}  {lack}: {named}{more}", entries.len());
        }
        text.trim_end().to_owned()
    }

    /// A table of dimensions, then what is missing.
    pub fn report(&self) -> String {
        let of = |dimension: Dimension, entries: &[&'static Entry]| {
            let of = entries.iter().filter(|it| it.dimension() == dimension);
            of.count()
        };
        let mut text = format!("{:<12}{:>9}{:>9}\n", "dimension", "variants", "can run");
        let mut line = |name: &str, all: usize, runnable: usize| {
            let _ = writeln!(text, "{name:<12}{all:>9}{runnable:>9}");
        };
        for dimension in Dimension::ALL {
            let runnable = of(dimension, &self.runnable);
            let lacking = self.lacking.values().map(|it| of(dimension, it));
            let all = runnable + lacking.sum::<usize>();
            if all > 0 {
                line(dimension.name(), all, runnable);
            }
        }
        line("all", self.count(), self.runnable.len());
        if !self.lacking.is_empty() {
            let _ = write!(text, "Missing:\n{}\n", self.reasons());
        }
        text
    }

    /// A line for each variant: name, dimension, difficulty, what it needs, whether it is
    /// here; separated by tabs.
    pub fn list(&self) -> String {
        let mut text = String::new();
        let all = [(None, &self.runnable)];
        let lacking = self.lacking.iter().map(|(lack, it)| (Some(lack), it));
        for (lack, entries) in all.into_iter().chain(lacking) {
            for entry in entries {
                let difficulty = match entry.difficulty {
                    Some(difficulty) => difficulty.to_string(),
                    None => "-".to_owned(),
                };
                let class = entry.class.as_ref();
                let scene = class.and_then(|class| class.scene.as_deref());
                let styles = class.map(|class| [&class.floor, &class.wall]);
                let styles = styles.into_iter().flatten().flatten();
                let textures = styles.map(|style| format!("textures/{}", style.file));
                let files = scene.map(str::to_owned).into_iter().chain(textures);
                let files: Vec<String> = files.collect();
                let state = match lack {
                    None => "runs".to_owned(),
                    Some(lack) => format!("lacks {lack}"),
                };
                let _ = writeln!(
                    text,
                    "{}\t{}\t{}\t{difficulty}\t{}\t{}\t{state}",
                    entry.variant.task.suite(),
                    entry.variant,
                    entry.dimension(),
                    entry.assets(),
                    files.join(" "),
                );
            }
        }
        text
    }
}

/// What a variant lacks.
fn lack(entry: &Entry, pack: &AssetPack, sources: &Sources) -> Option<Lack> {
    let assets = entry.assets();
    let is_in_pack = |file: &str| pack.dir().join(file).is_file();
    let has_assets = match (assets, &entry.class) {
        (Assets::Libero, _) => true,
        (Assets::FloorTextures, Some(class)) => {
            let mut styles = [&class.floor, &class.wall].into_iter().flatten();
            styles.all(|style| style.is_liberos || is_in_pack(&format!("textures/{}", style.file)))
        }
        (Assets::Scenes, Some(class)) => class.scene.as_deref().is_some_and(is_in_pack),
        // Lights cast shadows there, which the renderer does not draw, and the objects are
        // not in the catalogue.
        (Assets::Lights | Assets::NewObjects, _) | (_, None) => false,
    };
    if !has_assets {
        return Some(Lack::Assets(assets));
    }
    let files = TaskFiles::of_variant(sources, &entry.variant);
    let has_files = files.bddl.is_file() && files.init.is_file();
    (!has_files).then_some(Lack::TaskFiles)
}
