//! `worker assets`: describes, verifies and fetches asset packs; and the tasks whose files a
//! worker's pack has.

mod coverage;
mod error;

use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use benchmark::family::Lack;
use benchmark::family::protocol::Benchmark;
use benchmark::{ManifestRow, OwnTask, TaskRef};
use scene::assets::{Bar, Deadlines, FileFacts, Origin, Report, Table, size_in_words};
use scene::pack::{LIBERO, PRIMITIVES, digest_of_folder};
use scene::{AssetPack, FileStamps, Sources, TaskFiles};
use terminal::counted;

use crate::args::{AssetsArguments, AssetsCommand, FetchArguments, TaskChoice};
use crate::variants;

pub use coverage::Coverage;
pub use error::PackError;

/// Interval of progress messages in the log during a fetch, per cent.
const LOGGED_PERCENT: u64 = 25;
/// Number of files that a message names; further ones are only counted.
const MAX_NAMED: usize = 20;

pub fn run(arguments: &AssetsArguments) -> Result<(), PackError> {
    let dir = arguments.sources.clone();
    let dir = dir.unwrap_or_else(Sources::default_dir);
    if arguments.path {
        return print(&format!("{}\n", Sources::fetched_pack(&dir).display()));
    }
    let sources = Sources::open(&dir)?;
    if let Some(AssetsCommand::Fetch(arguments)) = &arguments.command {
        return fetch(arguments, &sources);
    }
    let default = [LIBERO, PRIMITIVES].map(str::to_owned);
    let packs = if arguments.packs.is_empty() { &default[..] } else { &arguments.packs };
    for pack in packs {
        let pack = AssetPack::open(pack, &sources)?;
        if arguments.verify {
            verify(&pack, &sources)?;
        } else {
            print(&describe(&pack, &sources)?)?;
        }
    }
    Ok(())
}

pub fn provide(
    pack: &AssetPack,
    sources: &Sources,
    tasks: impl IntoIterator<Item = TaskRef>,
) -> Result<(), PackError> {
    let tasks = tasks.into_iter();
    let tasks: Vec<TaskFiles> = tasks.map(|task| TaskFiles::of_task(sources, task)).collect();
    pack.provide_with_bar(&tasks)?;
    Ok(())
}

/// Reason why the files of a manifest row cannot be provided. The messages read after "failed to
/// …".
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ProvideError {
    /// Files could not be fetched or read; a later attempt may succeed.
    Fetch(String),
    /// Files that this program does not fetch are missing or wrong.
    Lack {
        /// Message with the remedy.
        error: String,
        /// Stamps of the task files when they were checked.
        files: FileStamps,
    },
}

/// Provides the files of a job before it starts, for a worker that serves a coordinator.
#[derive(Clone, Debug)]
pub struct Provider {
    pack: AssetPack,
    sources: Sources,
    is_cancelled: Arc<AtomicBool>,
}

impl Provider {
    pub fn new(pack: &AssetPack, sources: &Sources) -> Self {
        Self { pack: pack.clone(), sources: sources.clone(), is_cancelled: Arc::default() }
    }

    pub fn missing_benchmarks(&self) -> impl Iterator<Item = Benchmark> {
        let all = Benchmark::ALL.into_iter();
        all.filter(|benchmark| !scene::has_task_files(*benchmark, &self.sources))
    }

    /// Returns true if a row's files may have to be fetched, or may be missing.
    pub fn is_needed(&self, row: &ManifestRow) -> bool {
        self.pack.is_managed() || row.own.is_some()
    }

    /// Fetches a row's missing or altered assets, with progress in the log.
    pub fn provide(&self, row: &ManifestRow) -> Result<(), ProvideError> {
        let task = row.id.task();
        let files = match &row.own {
            None => TaskFiles::of_task(&self.sources, task),
            Some(own) => self.files_of_own(row, own)?,
        };
        let mut last_logged = None;
        let mut report = |report| {
            let (quarter, progress) = match report {
                Report::WaitingForAnotherFetch => (0, None),
                Report::Arriving(progress) => (progress.percent() / LOGGED_PERCENT, Some(progress)),
            };
            if last_logged != Some(quarter) {
                last_logged = Some(quarter);
                match progress {
                    None => tracing::info!("{task}: another process fetches LIBERO's assets"),
                    Some(progress) => {
                        tracing::info!("{task}: fetching LIBERO's assets: {progress}")
                    }
                }
            }
            match self.is_cancelled.load(Ordering::Relaxed) {
                true => ControlFlow::Break(()),
                false => ControlFlow::Continue(()),
            }
        };
        let provided = self.pack.provide(&[files], &mut report);
        let fetched = provided.map_err(|error| ProvideError::Fetch(transport::chain(&error)))?;
        if fetched.replaced > 0 {
            let replaced = counted(fetched.replaced as u64, "altered file");
            tracing::warn!("{task}: {replaced} of LIBERO's assets replaced");
        }
        Ok(())
    }

    /// Returns the files of a row's own task. Fails if files other than LIBERO's assets are missing.
    fn files_of_own(&self, row: &ManifestRow, own: &OwnTask) -> Result<TaskFiles, ProvideError> {
        // The stamps are taken before the check, so that a file that is corrected in between counts
        // as changed.
        let files = self.stamps(row);
        let lack = variants::lack(row, &self.pack, &self.sources);
        let lack = lack.map_err(|error| ProvideError::Fetch(transport::chain(&error)))?;
        match lack {
            // If the rollout's initial state does not exist, the rollout fails with an error that
            // names the state.
            None | Some(Lack::States { .. }) => Ok(TaskFiles::of_own(&self.sources, own)),
            Some(lack) => Err(ProvideError::Lack {
                error: format!("run {}: this worker lacks {lack}", row.id),
                files,
            }),
        }
    }

    /// Returns true if the files of a row have changed since the stamps `files` were taken, so that
    /// missing or wrong files may have been corrected.
    pub fn has_changed(&self, row: &ManifestRow, files: &FileStamps) -> bool {
        self.stamps(row) != *files
    }

    fn stamps(&self, row: &ManifestRow) -> FileStamps {
        let own = row.own.as_deref();
        let files = own.map(|own| TaskFiles::with_prompt(&self.sources, own));
        files.map_or_else(FileStamps::default, |files| files.stamps())
    }

    /// Cancels the fetches in progress, and every later fetch as soon as it reports progress.
    pub fn end(&self) {
        self.is_cancelled.store(true, Ordering::Relaxed);
    }
}

fn describe(pack: &AssetPack, sources: &Sources) -> Result<String, PackError> {
    let coverage = Coverage::check(pack, sources)?;
    let files = match pack.verified() {
        None => String::new(),
        Some(folder) => {
            let all = Table::libero().files();
            let present = all.iter().filter(|file| folder.seems_present(file));
            let present: Vec<&FileFacts> = present.collect();
            let bytes = present.iter().map(|file| file.bytes).sum();
            format!(
                "  files       {} of LIBERO's {}, {}\n",
                present.len(),
                all.len(),
                size_in_words(bytes)
            )
        }
    };
    Ok(format!(
        "{}\n  folder      {}\n  digest      {}\n{files}{coverage}",
        pack.name(),
        pack.dir().display(),
        pack.digest(),
    ))
}

fn verify(pack: &AssetPack, sources: &Sources) -> Result<(), PackError> {
    let folder = pack.dir().to_owned();
    if pack.name() == PRIMITIVES {
        if digest_of_folder(&folder)? != pack.digest() {
            return Err(PackError::Primitives { folder });
        }
        return print(&format!("{}: all files have the expected digest\n", folder.display()));
    }
    let (differences, present) = match pack.verified() {
        None => (pack.differences().to_vec(), 0),
        Some(verified) => {
            let (differences, present) = verified.differences();
            let named = differences.iter();
            let named = named.map(|(path, difference)| format!("{path} ({difference})"));
            (named.collect(), present)
        }
    };
    if !differences.is_empty() {
        return Err(PackError::Differs {
            folder,
            count: differences.len(),
            named: name_some(differences, "\n  "),
        });
    }
    let description = describe(pack, sources)?;
    if !pack.is_managed() && !Coverage::check(pack, sources)?.is_complete() {
        return Err(PackError::Incomplete { folder, description });
    }
    print(&format!(
        "{}: {} LIBERO's, and none differs\n{description}",
        folder.display(),
        match present {
            1 => "1 file is".to_owned(),
            more => format!("{more} files are"),
        }
    ))
}

/// Joins the first `MAX_NAMED` names, followed by the number of the remaining names.
pub fn name_some(mut names: Vec<String>, separator: &str) -> String {
    let count = names.len();
    if count > MAX_NAMED {
        names.truncate(MAX_NAMED);
        names.push(format!("and {} more", count - MAX_NAMED));
    }
    names.join(separator)
}

/// Fetches the task files of a benchmark of LIBERO's family, or copies them from a checkout.
fn fetch_suite(
    benchmark: Benchmark,
    arguments: &FetchArguments,
    sources: &Sources,
) -> Result<(), PackError> {
    if let Some(checkout) = &arguments.checkout {
        if benchmark != Benchmark::Para {
            return Err(PackError::Checkout { benchmark });
        }
        let folder = scene::copy_paraphrases(checkout, sources)?;
        let folder = folder.display();
        return print(&format!("{folder}: the task files are present\n"));
    }
    let origin = origin(arguments)?;
    let mut bar = Bar::default();
    let fetched = scene::fetch_task_files(benchmark, sources, &origin, &mut |report| {
        bar.show(report);
        ControlFlow::Continue(())
    });
    bar.finish();
    print(&format!(
        "{}: the task files are present; {} fetched\n",
        Sources::family(sources.dir(), benchmark).display(),
        size_in_words(fetched?.bytes),
    ))
}

fn fetch(arguments: &FetchArguments, sources: &Sources) -> Result<(), PackError> {
    if let Some(benchmark) = arguments.suite {
        return fetch_suite(benchmark, arguments, sources);
    }
    let pack = match &arguments.into {
        Some(dir) => AssetPack::to_fetch_into(dir),
        None => AssetPack::open(LIBERO, sources)?,
    };
    let files = match arguments.everything {
        true => Table::libero().files().iter().collect(),
        false => AssetPack::files_of_tasks(&tasks(arguments, sources))?,
    };
    let origin = origin(arguments)?;
    let mut bar = Bar::default();
    let fetched = pack.fetch(&files, &origin, &mut |report| {
        bar.show(report);
        ControlFlow::Continue(())
    });
    bar.finish();
    let fetched = fetched?;
    let replaced = match fetched.replaced {
        0 => String::new(),
        altered => format!(" ({altered} in place of altered ones)"),
    };
    let pack_or_path = match pack.is_managed() {
        true => format!("{LIBERO}, which is the default"),
        false => pack.dir().display().to_string(),
    };
    print(&format!(
        "{}: {} fetched{replaced}, {} compressed; {} already present. Give it as --assets \
         {pack_or_path}\n",
        pack.dir().display(),
        counted(fetched.fetched as u64, "file"),
        size_in_words(fetched.bytes),
        fetched.present,
    ))
}

fn tasks(arguments: &FetchArguments, sources: &Sources) -> Vec<TaskFiles> {
    let mut tasks = Vec::new();
    for choice in &arguments.tasks {
        let chosen: Vec<TaskRef> = match choice {
            TaskChoice::All => TaskRef::all().collect(),
            TaskChoice::One(task) => vec![*task],
        };
        let files = chosen.into_iter();
        tasks.extend(files.map(|task| TaskFiles::of_task(sources, task)));
    }
    let further = arguments.bddl.iter();
    tasks.extend(further.map(|bddl| TaskFiles { bddl: bddl.clone(), init: Default::default() }));
    tasks
}

fn origin(arguments: &FetchArguments) -> Result<Origin, PackError> {
    Ok(if let Some(folder) = &arguments.wheels {
        Origin::wheels(folder.clone())
    } else if let Some(url) = &arguments.index {
        Origin::index(url, Deadlines::default())?
    } else {
        Origin::of_environment()?
    })
}

/// Logs how many tasks a pack can show. Names and returns the tasks that it cannot show, which this
/// worker leaves to other workers.
pub fn check(pack: &AssetPack, sources: &Sources) -> Result<Vec<TaskRef>, PackError> {
    // Tests ensure that the built-in pack is complete.
    if pack.name() == PRIMITIVES {
        return Ok(Vec::new());
    }
    let coverage = Coverage::check(pack, sources)?;
    tracing::info!("assets {}: tasks: {}", pack.name(), coverage.summary());
    let mut lacking = Vec::new();
    for (reason, tasks) in coverage.not_shown() {
        let named = tasks.iter().map(ToString::to_string).collect();
        tracing::warn!(
            "left to other workers, because this pack cannot show them: {}: failed to {reason}",
            name_some(named, ", ")
        );
        lacking.extend_from_slice(tasks);
    }
    if lacking.len() == TaskRef::all().count() {
        return Err(PackError::Incomplete {
            folder: pack.dir().to_owned(),
            description: describe(pack, sources)?,
        });
    }
    Ok(lacking)
}

/// Describes how a custom pack differs from LIBERO's; `None` if the pack is LIBERO's or built in.
pub fn describe_differences(pack: &AssetPack, given: &Path) -> Option<String> {
    if pack.name() != scene::pack::CUSTOM {
        return None;
    }
    let differences = pack.differences().to_vec();
    let summary = match differences.len() {
        0 => "it has none of LIBERO's files".to_owned(),
        count => {
            format!("{} differ: {}", counted(count as u64, "file"), name_some(differences, ", "))
        }
    };
    Some(format!(
        "the asset pack {} is not LIBERO's, and its results go by the name `custom`: {summary}",
        given.display()
    ))
}

fn print(text: &str) -> Result<(), PackError> {
    terminal::print(text).map_err(PackError::Print)
}
