//! Cache of asset packs. Each pack is opened once per process, because comparing a folder with
//! LIBERO's pack reads all of its files.

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use scene::{AssetPack, SceneError, Sources};

type Packs = HashMap<(String, PathBuf), AssetPack>;

static PACKS: Mutex<Option<Packs>> = Mutex::new(None);

/// Returns the asset pack `libero`, `primitives`, or the pack in a folder.
pub(crate) fn opened(assets: &str, sources: &Sources) -> Result<AssetPack, SceneError> {
    let mut packs = PACKS.lock().unwrap_or_else(PoisonError::into_inner);
    let packs = packs.get_or_insert_default();
    let key = (assets.to_owned(), sources.dir().to_owned());
    if let Some(pack) = packs.get(&key) {
        return Ok(pack.clone());
    }
    let pack = AssetPack::open(assets, sources)?;
    packs.insert(key, pack.clone());
    Ok(pack)
}
