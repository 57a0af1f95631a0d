//! `worker assets`: looks after asset packs. Responsible for what the command
//! prints; what packs are for is crate `scene`'s business.

mod coverage;
mod error;

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::thread;

use assets::{Bar, Fetch, Hub, Manifest, Program, fetched_pack, size_in_words};
use scene::pack::PRIMITIVES;
use scene::{AssetPack, Sources};

use crate::args::{AssetsArguments, AssetsCommand};

use coverage::Coverage;
pub use error::PackError;

/// Names of files that a message spells out; the rest are counted.
const MAX_NAMED: usize = 20;
/// What messages of a fetch say of this program.
const PROGRAM: Program = Program {
    occupied: "see `worker assets verify` whether it is whole, or move it away and fetch again",
    assets: "--assets",
};

/// Does what the command line says.
///
/// # Errors
/// If a pack cannot be read or fetched, or is not what it should be.
pub fn run(arguments: &AssetsArguments) -> Result<(), PackError> {
    let dir = arguments.sources.clone();
    let dir = dir.unwrap_or_else(Sources::default_dir);
    match &arguments.command {
        AssetsCommand::List { packs, files } => {
            let sources = Sources::open(&dir)?;
            let packs = match packs.as_slice() {
                [] => known_packs(&dir),
                given => given.to_vec(),
            };
            for pack in &packs {
                let pack = AssetPack::open(pack, &sources)?;
                let report = if *files {
                    Manifest::of_folder(pack.dir())?.to_string()
                } else {
                    describe(&pack, &sources)?
                };
                print(&report)?;
            }
            Ok(())
        }
        AssetsCommand::Verify { pack, manifest } => {
            let packs = match pack {
                Some(pack) => vec![pack.clone()],
                None => known_packs(&dir),
            };
            for pack in &packs {
                verify(pack, manifest.as_deref(), &dir)?;
            }
            Ok(())
        }
        AssetsCommand::Fetch { into, hub } => {
            let into = into.clone().unwrap_or_else(|| fetched_pack(&dir));
            fetch(hub, &into)
        }
    }
}

/// The built-in pack, and the fetched one if there is one.
fn known_packs(sources: &Path) -> Vec<String> {
    let fetched = fetched_pack(sources);
    let fetched = fetched.is_dir().then(|| fetched.display().to_string());
    [PRIMITIVES.to_owned()].into_iter().chain(fetched).collect()
}

fn describe(pack: &AssetPack, sources: &Sources) -> Result<String, PackError> {
    let coverage = Coverage::of(pack, sources)?;
    describe_with(pack, &coverage)
}

fn describe_with(pack: &AssetPack, coverage: &Coverage) -> Result<String, PackError> {
    let files = Manifest::of_folder(pack.dir())?;
    Ok(format!(
        "{}\n  folder      {}\n  digest      {}\n  files       {}, {}\n{coverage}",
        pack.name(),
        pack.dir().display(),
        pack.digest(),
        files.count(),
        size_in_words(files.total_bytes()),
    ))
}

fn verify(pack: &str, manifest: Option<&Path>, sources: &Path) -> Result<(), PackError> {
    let folder = if pack == PRIMITIVES {
        let pack = AssetPack::open(PRIMITIVES, &Sources::open(sources)?)?;
        pack.dir().to_owned()
    } else {
        PathBuf::from(pack)
    };
    if pack == PRIMITIVES && manifest.is_none() {
        return verify_primitives(&folder, sources);
    }
    let file = match manifest {
        Some(file) => file.to_owned(),
        None => {
            let fetched = Manifest::beside(&folder);
            if !fetched.exists() {
                return verify_without_manifest(&folder, sources);
            }
            fetched
        }
    };
    let expected = Manifest::read(&file)?;
    let mut differences = expected.compare(&Manifest::of_folder(&folder)?);
    if !differences.is_empty() {
        let count = differences.len();
        if count > MAX_NAMED {
            differences.truncate(MAX_NAMED);
            differences.push(format!("and {} more", count - MAX_NAMED));
        }
        return Err(PackError::Differs {
            folder,
            manifest: file,
            count,
            named: differences.join("\n  "),
        });
    }
    print(&format!(
        "{}: all {} files are as they should be\n",
        folder.display(),
        expected.count()
    ))
}

/// Of a pack that was not fetched, what can be said is whether all tasks can be
/// shown with it.
fn verify_without_manifest(folder: &Path, sources: &Path) -> Result<(), PackError> {
    let sources = Sources::open(sources)?;
    let pack = AssetPack::open(&folder.to_string_lossy(), &sources)?;
    let coverage = Coverage::of(&pack, &sources)?;
    let description = describe_with(&pack, &coverage)?;
    if !coverage.is_whole() {
        let folder = folder.to_owned();
        return Err(PackError::Incomplete {
            folder,
            description,
        });
    }
    print(&format!(
        "{description}\
         Every task can be shown. The contents of the files were not compared: only\n\
         fetched packs have a manifest. To compare with a pack that is known to be whole:\n  \
         worker assets list --files KNOWN_PACK > files.txt\n  \
         worker assets verify {} --manifest files.txt\n",
        folder.display()
    ))
}

/// The built-in pack knows its own digest; the folder must have the same.
fn verify_primitives(folder: &Path, sources: &Path) -> Result<(), PackError> {
    let sources = Sources::open(sources)?;
    let built_in = AssetPack::open(PRIMITIVES, &sources)?;
    let unpacked = AssetPack::open(&folder.to_string_lossy(), &sources)?;
    if built_in.digest() != unpacked.digest() {
        let folder = folder.to_owned();
        return Err(PackError::Primitives { folder });
    }
    print(&format!(
        "{}: all files are as they should be\n",
        folder.display()
    ))
}

fn fetch(hub: &str, into: &Path) -> Result<(), PackError> {
    let hub = Hub::new(hub, PROGRAM);
    let mut bar = Bar::default();
    let mut fetch = Fetch {
        hub: &hub,
        into,
        pause: &mut thread::sleep,
        progress: &mut |progress| {
            bar.show(progress);
            ControlFlow::Continue(())
        },
    };
    let fetched = fetch.run();
    bar.finish();
    let manifest = fetched?;
    print(&format!(
        "{}: {} files, {}; give it as --assets {}\n",
        into.display(),
        manifest.count(),
        size_in_words(manifest.total_bytes()),
        into.display()
    ))
}

fn print(text: &str) -> Result<(), PackError> {
    terminal::print(text).map_err(PackError::Print)
}
