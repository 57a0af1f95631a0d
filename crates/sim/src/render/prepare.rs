//! Prepares a compiled model's meshes and textures for the software renderer. Scenes share the
//! robot and much of the room, so a process prepares equal meshes and textures once for all scenes
//! in use. Scene files keep the result for other processes.

use std::collections::HashMap;
use std::sync::{Arc, LazyLock, Mutex, PoisonError, Weak};

use bytes::Bytes;
use mujoco_rs::mujoco_c as c;
use raster::{
    Mesh, MeshBuilder, ModelError, Quality, Texture, TextureKind, mesh_triangle, plane, plane_grid,
};
use twox_hash::XxHash3_128;

use crate::error::SimError;
use crate::mujoco::{MeshData, Model, TextureData};

const REMEDY: &str = "use --renderer gl";
/// Number of texture roles per material in `mat_texid`, and the role of the colour texture.
const TEXTURE_ROLES: usize = c::mjtTextureRole::mjNTEXROLE as usize;
const COLOUR_ROLE: usize = c::mjtTextureRole::mjTEXROLE_RGB as usize;

/// Items by a digest of the source, chosen for speed, since a forged collision gains nothing.
type Cache<T> = LazyLock<Mutex<HashMap<u128, Weak<T>>>>;

static MESHES: Cache<Mesh> = LazyLock::new(Mutex::default);
static TEXTURES: Cache<Texture> = LazyLock::new(Mutex::default);

#[derive(Clone, Copy)]
pub(super) struct Material {
    pub(super) texture: usize,
    pub(super) repeat: [f32; 2],
    /// True if `repeat` is per metre rather than per geom.
    pub(super) uniform: bool,
}

pub(crate) struct Prepared {
    pub(super) model: raster::Model,
    pub(super) materials: Vec<Option<Material>>,
    pub(super) sky: Option<usize>,
    pub(super) largest_levels: Vec<Bytes>,
}

impl Prepared {
    pub(crate) fn from_model(model: &Model) -> Result<Self, SimError> {
        let texels = model.texels();
        let largest_levels: Vec<Bytes> =
            model.textures().map(|texture| texels.slice(texture.texels())).collect();
        let meshes = model.meshes();
        let mesh = |index| {
            let mesh = meshes.get(index);
            shared(&MESHES, digest_of_mesh(&mesh), || Ok(build_mesh(&mesh)))
        };
        let texture = |(texture, texels): (TextureData, &Bytes)| {
            shared(&TEXTURES, digest_of_texture(&texture, texels), || {
                build_texture(&texture, texels)
            })
        };
        let textures = model.textures().zip(&largest_levels).map(texture);
        Self::assemble(
            model,
            (0..meshes.count()).map(mesh).collect::<Result<_, _>>()?,
            textures.collect::<Result<_, _>>()?,
            largest_levels,
        )
    }

    /// Restores data that was prepared earlier for the same model, without copying its bytes: each
    /// mesh, and for each texture the largest mipmap level and the smaller levels.
    pub(crate) fn from_bytes(
        model: &Model,
        meshes: &[Bytes],
        textures: &[[Bytes; 2]],
    ) -> Result<Self, SimError> {
        let meshes = meshes.iter().cloned().map(Mesh::from_bytes);
        let largest_levels = textures.iter().map(|[largest, _]| largest.clone());
        let textures = model.textures().zip(textures).map(|(texture, [_, smaller])| {
            let sizes = [texture.width, texture.height, texture.channels];
            Texture::with_smaller(texture_kind(&texture), sizes, smaller.clone())
        });
        Self::assemble(
            model,
            meshes.map(share_part).collect::<Result<_, _>>()?,
            textures.map(share_part).collect::<Result<_, _>>()?,
            largest_levels.collect(),
        )
    }

    pub(crate) fn meshes(&self) -> impl Iterator<Item = Vec<u8>> {
        self.model.meshes.iter().map(|mesh| mesh.to_bytes())
    }

    /// Returns the largest mipmap level and the smaller levels of each texture.
    pub(crate) fn textures(&self) -> impl Iterator<Item = [&[u8]; 2]> {
        let textures = self.largest_levels.iter().zip(&self.model.textures);
        textures.map(|(largest, texture)| [largest, texture.smaller()])
    }

    /// Returns the texels of all textures in MuJoCo's format.
    pub(super) fn texels(&self, model: &Model) -> Vec<u8> {
        let mut all = vec![0; model.raw().ntexdata as usize];
        for (texture, level) in model.textures().zip(&self.largest_levels) {
            all[texture.texels()].copy_from_slice(level);
        }
        all
    }

    fn assemble(
        model: &Model,
        meshes: Vec<Arc<Mesh>>,
        textures: Vec<Arc<Texture>>,
        largest_levels: Vec<Bytes>,
    ) -> Result<Self, SimError> {
        let sky = c::mjtTexture::mjTEXTURE_SKYBOX as i32;
        let mut prepared = with_planes(model)?;
        prepared.meshes = meshes;
        prepared.textures = textures;
        Ok(Self {
            model: prepared,
            materials: materials(model),
            sky: model.textures().position(|texture| texture.kind == sky),
            largest_levels,
        })
    }
}

fn share_part<T>(part: Result<T, ModelError>) -> Result<Arc<T>, SimError> {
    part.map(Arc::new).map_err(|error| graphics(error.to_string()))
}

/// Built-in shapes and planes are computed faster than they could be loaded.
fn with_planes(model: &Model) -> Result<raster::Model, SimError> {
    let raw = model.raw();
    let quality = &raw.vis.quality;
    let quality = Quality {
        slices: quality.numslices as usize,
        stacks: quality.numstacks as usize,
        quads: quality.numquads as usize,
    };
    let mut prepared = raster::Model::new(quality).map_err(|error| graphics(error.to_string()))?;
    let far = f64::from(raw.vis.map.zfar) * raw.stat.extent;
    let repeat = model.mat_texrepeat();
    for (geom, kind) in model.geom_type().iter().enumerate() {
        if *kind != c::mjtGeom::mjGEOM_PLANE as i32 {
            continue;
        }
        let size = &model.geom_size()[geom * 3..][..3];
        let material = usize::try_from(model.geom_matid()[geom]).ok();
        let lines = |axis: usize| {
            let repeat = material.map(|material| f64::from(repeat[material * 2 + axis]));
            let period = repeat.filter(|repeat| *repeat > 0.0).map(|repeat| 2.0 / repeat);
            plane_grid(size[axis], size[2], period, far)
        };
        prepared.planes.push(plane(&lines(0), &lines(1)));
    }
    Ok(prepared)
}

/// Returns the cached item with this digest if the item is still in use, or creates one.
fn shared<T>(
    cache: &Cache<T>,
    digest: u128,
    make: impl FnOnce() -> Result<T, SimError>,
) -> Result<Arc<T>, SimError> {
    let lock = || cache.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(found) = lock().get(&digest).and_then(Weak::upgrade) {
        return Ok(found);
    }
    let item = Arc::new(make()?);
    let mut cache = lock();
    cache.retain(|_, item| item.strong_count() > 0);
    cache.insert(digest, Arc::downgrade(&item));
    Ok(item)
}

fn digest_of_mesh(mesh: &MeshData<'_>) -> u128 {
    let integers = [mesh.faces, mesh.face_normals, mesh.face_texture_coordinates];
    let numbers = [mesh.vertices, mesh.normals, mesh.texture_coordinates.unwrap_or_default()];
    digest(integers.map(bytemuck::cast_slice).into_iter().chain(numbers.map(bytemuck::cast_slice)))
}

pub(crate) fn digest_of_texture(texture: &TextureData, texels: &[u8]) -> u128 {
    let sizes = [texture.width, texture.height, texture.channels].map(usize::to_le_bytes);
    let kinds = [texture.kind, texture.colorspace].map(i32::to_le_bytes);
    let head = [kinds.as_flattened(), sizes.as_flattened()];
    digest(head.into_iter().chain([texels]))
}

/// Hashes parts, each preceded by its length.
fn digest<'a>(parts: impl Iterator<Item = &'a [u8]>) -> u128 {
    let mut hash = XxHash3_128::new();
    for part in parts {
        hash.write(&part.len().to_le_bytes());
        hash.write(part);
    }
    hash.finish_128()
}

fn texture_kind(texture: &TextureData) -> TextureKind {
    match texture.kind {
        kind if kind == c::mjtTexture::mjTEXTURE_2D as i32 => TextureKind::Flat {
            srgb: texture.colorspace == c::mjtColorSpace::mjCOLORSPACE_SRGB as i32,
        },
        _ => TextureKind::Cube,
    }
}

fn build_texture(texture: &TextureData, texels: &[u8]) -> Result<Texture, SimError> {
    let TextureData { width, height, channels, .. } = *texture;
    Texture::new(texture_kind(texture), width, height, channels, texels)
        .map_err(|error| graphics(error.to_string()))
}

fn build_mesh(mesh: &MeshData<'_>) -> Mesh {
    let mut builder = MeshBuilder::default();
    for face in 0..mesh.faces.len() / 3 {
        let three = |ids: &[i32], values: &[f32]| {
            [0, 1, 2].map(|corner| {
                let at = ids[face * 3 + corner] as usize * 3;
                [values[at], values[at + 1], values[at + 2]]
            })
        };
        let st = mesh.texture_coordinates.map(|values| {
            [0, 1, 2].map(|corner| {
                let at = mesh.face_texture_coordinates[face * 3 + corner] as usize * 2;
                [values[at], values[at + 1]]
            })
        });
        let pos = three(mesh.faces, mesh.vertices);
        let normals = three(mesh.face_normals, mesh.normals);
        builder.triangle(mesh_triangle(pos, normals, st));
    }
    builder.build()
}

fn materials(model: &Model) -> Vec<Option<Material>> {
    let textures = model.mat_texid().chunks_exact(TEXTURE_ROLES);
    let repeats = model.mat_texrepeat().chunks_exact(2);
    let all = textures.zip(repeats).zip(model.mat_texuniform());
    all.map(|((textures, repeat), uniform)| {
        let texture = usize::try_from(textures[COLOUR_ROLE]).ok()?;
        Some(Material { texture, repeat: [repeat[0], repeat[1]], uniform: *uniform != 0 })
    })
    .collect()
}

pub(super) fn graphics(problem: String) -> SimError {
    SimError::Graphics { problem, remedy: REMEDY }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn models_share_equal_meshes_and_textures_until_the_last_model_is_dropped() {
        let scene = |height: f32| {
            Model::compile(&format!(
                r#"<mujoco><asset>
                  <mesh name="wedge" vertex="0 0 0  1 0 0  0 1 0  0 0 1"/>
                  <mesh name="own" vertex="0 0 0  1 0 0  0 1 0  0 0 {height}"/>
                  <texture name="tiles" type="2d" builtin="checker" width="8" height="8"/>
                </asset><worldbody>
                  <geom type="mesh" mesh="wedge"/><geom type="mesh" mesh="own"/>
                </worldbody></mujoco>"#
            ))
            .expect("a model")
        };
        let [first, second] =
            [2.5, 3.5].map(|height| Prepared::from_model(&scene(height)).expect("prepared").model);
        assert!(Arc::ptr_eq(&first.meshes[0], &second.meshes[0]));
        assert!(!Arc::ptr_eq(&first.meshes[1], &second.meshes[1]));
        assert!(Arc::ptr_eq(&first.textures[0], &second.textures[0]));
        let wedge = Arc::downgrade(&first.meshes[0]);
        drop(first);
        assert_eq!(wedge.strong_count(), 1);
        drop(second);
        assert_eq!(wedge.strong_count(), 0);
    }
}
