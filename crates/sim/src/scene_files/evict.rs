//! Eviction: removes the least recently used scenes that are not mapped.

use std::collections::HashSet;
use std::fs::{self, File};
use std::io;
use std::time::SystemTime;

use super::container;
use super::folder::{SceneFolder, TEMPORARY_PREFIX, names_of_textures};
use super::name_text;

struct Scene {
    name: String,
    bytes: u64,
    last_used: SystemTime,
}

impl SceneFolder {
    /// Removes temporary files of crashed writers. Then removes the least recently used scenes
    /// until all remaining files are within the size limit, but never the scene `keep` or a mapped
    /// scene. The caller holds the folder's lock.
    pub(super) fn make_room(&self, keep: &str) -> io::Result<()> {
        let (mut total, mut scenes, mut textures) = (0, Vec::<Scene>::new(), Vec::new());
        let mut records = Vec::new();
        for entry in fs::read_dir(&self.dir)? {
            let entry = entry?;
            // Gone: another process has replaced a check record, or removed a temporary file.
            let Ok(metadata) = entry.metadata() else {
                continue;
            };
            let file = entry.file_name().to_string_lossy().into_owned();
            if file.starts_with(TEMPORARY_PREFIX) {
                if File::open(entry.path()).is_ok_and(|file| file.try_lock().is_ok()) {
                    let _ = fs::remove_file(entry.path());
                }
                continue;
            }
            let Some((name, kind)) = file.split_once('.') else {
                continue;
            };
            total += metadata.len();
            let last_used = metadata.modified()?;
            match kind {
                "scene" => {
                    scenes.push(Scene { name: name.to_owned(), bytes: metadata.len(), last_used })
                }
                "texture" => textures.push((name.to_owned(), metadata.len())),
                _ if kind.ends_with(".checked") => records.push((name.to_owned(), last_used, file)),
                _ => {}
            }
        }
        if total <= self.limit {
            return Ok(());
        }
        for scene in &mut scenes {
            let own_records = records.iter().filter(|(name, ..)| *name == scene.name);
            scene.last_used = own_records
                .map(|(_, last_used, _)| *last_used)
                .fold(scene.last_used, SystemTime::max);
        }
        scenes.sort_by_key(|scene| scene.last_used);
        let mut remaining: Vec<&str> = scenes.iter().map(|scene| &*scene.name).collect();
        let mut candidates = scenes.iter().filter(|scene| scene.name != keep);
        loop {
            let needed = self.textures_of(&remaining);
            textures.retain(|(name, bytes)| {
                let is_used = needed.contains(name);
                if !is_used && fs::remove_file(self.texture(name)).is_ok() {
                    total -= bytes;
                }
                is_used
            });
            let Some(scene) = candidates.next().filter(|_| total > self.limit) else {
                return Ok(());
            };
            let path = self.scene(&scene.name);
            if !File::open(&path).is_ok_and(|file| file.try_lock().is_ok()) {
                continue;
            }
            fs::remove_file(&path)?;
            total -= scene.bytes;
            remaining.retain(|name| *name != scene.name);
            let _ = fs::remove_file(self.dir.join(format!("{}.lock", scene.name)));
            for (.., record) in records.iter().filter(|(name, ..)| *name == scene.name) {
                let _ = fs::remove_file(self.dir.join(record));
            }
        }
    }

    /// A scene that cannot be read has none, and is compiled again when needed.
    fn textures_of(&self, scenes: &[&str]) -> HashSet<String> {
        let sections = |name: &&str| {
            let file = File::open(self.scene(name)).ok()?;
            container::map(&file, None).ok()?
        };
        let all = scenes.iter().filter_map(sections);
        all.flat_map(|sections| {
            let names = names_of_textures(&sections).unwrap_or_default().iter();
            names.map(|name| name_text(name).to_owned()).collect::<Vec<_>>()
        })
        .collect()
    }
}
