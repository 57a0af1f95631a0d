//! Cache of asset packs. Each pack is opened once per process, because comparing a folder with
//! LIBERO's pack reads all of its files.

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use scene::{AssetPack, SceneError, Sources, TaskFiles};

/// Packs by key: name or path, folder of the sources, and true if the pack also has files that
/// LIBERO lacks.
type Packs = HashMap<(String, PathBuf, bool), AssetPack>;

static PACKS: Mutex<Option<Packs>> = Mutex::new(None);

/// Returns the asset pack `libero`, `primitives`, or the pack in a folder.
pub(crate) fn opened(assets: &str, sources: &Sources) -> Result<AssetPack, SceneError> {
    let mut packs = PACKS.lock().unwrap_or_else(PoisonError::into_inner);
    let packs = packs.get_or_insert_default();
    let key = (assets.to_owned(), sources.dir().to_owned(), false);
    if let Some(pack) = packs.get(&key) {
        return Ok(pack.clone());
    }
    let pack = AssetPack::open(assets, sources)?;
    packs.insert(key, pack.clone());
    Ok(pack)
}

/// Returns the asset pack for the scene of a task, as [`opened`] does. If the scene needs models or
/// textures that LIBERO lacks and the pack is a folder with LIBERO's files, the pack has all files
/// of that folder.
pub(crate) fn opened_for(
    task: &TaskFiles,
    assets: &str,
    sources: &Sources,
) -> Result<AssetPack, SceneError> {
    let pack = opened(assets, sources)?;
    if !pack.is_too_narrow(std::iter::once(task.clone())) {
        return Ok(pack);
    }
    let mut packs = PACKS.lock().unwrap_or_else(PoisonError::into_inner);
    let packs = packs.get_or_insert_default();
    let key = (assets.to_owned(), sources.dir().to_owned(), true);
    if let Some(pack) = packs.get(&key) {
        return Ok(pack.clone());
    }
    let whole = AssetPack::open_whole(pack.dir())?;
    packs.insert(key, whole.clone());
    Ok(whole)
}
