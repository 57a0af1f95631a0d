use std::ffi::{CStr, CString, c_char};
use std::ops::Range;
use std::ptr::NonNull;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use bytes::Bytes;
use mujoco_rs::mujoco_c as c;

use super::arrays::{self, ModelArray, NamedArray};
use super::own::OwnArrays;
use super::values;
use crate::error::SimError;

/// Owns the arrays that a rollout changes (`_own`) and shares everything else with the other
/// models of its compilation.
pub struct Model {
    /// A copy of the compilation's, except for pointers to `_own` and for options of this model.
    raw: Box<c::mjModel>,
    _own: OwnArrays,
    compilation: Arc<Compilation>,
}

pub(super) struct Compilation {
    raw: NonNull<c::mjModel>,
    owner: MemoryOwner,
    /// Serial number, unique in the process. States and scenes have the sizes of the model that
    /// they were made for, and compare serial numbers before they are used with a model.
    serial: u64,
}

pub(super) enum MemoryOwner {
    Compiled,
    Shared(#[expect(dead_code, reason = "they are reached through the structure")] Bytes),
}

impl Compilation {
    pub(super) fn new(raw: NonNull<c::mjModel>, owner: MemoryOwner) -> Self {
        static COMPILED: AtomicU64 = AtomicU64::new(0);
        Self { raw, owner, serial: COMPILED.fetch_add(1, Ordering::Relaxed) }
    }

    pub(super) fn structure(&self) -> &c::mjModel {
        // SAFETY: the structure lives as long as `self`, and nobody writes to it.
        unsafe { self.raw.as_ref() }
    }
}

// SAFETY: plain memory that no thread owns, and that nobody writes to.
unsafe impl Send for Compilation {}
// SAFETY: as above.
unsafe impl Sync for Compilation {}
// SAFETY: plain memory that no thread owns; the arrays that are written to belong to
// this model alone, and are written through `&mut self`.
unsafe impl Send for Model {}
// SAFETY: as above; `&self` only reads.
unsafe impl Sync for Model {}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ObjectKind {
    Body,
    Joint,
    Geom,
    Site,
    Camera,
    Light,
    Actuator,
    Sensor,
}

impl ObjectKind {
    fn code(self) -> i32 {
        let kind = match self {
            Self::Body => c::mjtObj::mjOBJ_BODY,
            Self::Joint => c::mjtObj::mjOBJ_JOINT,
            Self::Geom => c::mjtObj::mjOBJ_GEOM,
            Self::Site => c::mjtObj::mjOBJ_SITE,
            Self::Camera => c::mjtObj::mjOBJ_CAMERA,
            Self::Light => c::mjtObj::mjOBJ_LIGHT,
            Self::Actuator => c::mjtObj::mjOBJ_ACTUATOR,
            Self::Sensor => c::mjtObj::mjOBJ_SENSOR,
        };
        kind as i32
    }
}

const ERROR_BYTES: usize = 1024;

macro_rules! slices {
    ($($name:ident: $kind:ty = $rows:ident * $columns:literal;)*) => {$(
        pub fn $name(&self) -> &[$kind] {
            let model = self.raw();
            // SAFETY: the field points at this many values while the model lives.
            unsafe { values(model.$name.cast_const(), model.$rows * $columns) }
        }
    )*};
}

impl Model {
    pub fn compile(mjcf: &str) -> Result<Self, SimError> {
        super::install_handlers();
        let text = CString::new(mjcf)
            .map_err(|_| SimError::Compile("the MJCF contains a NUL byte".to_owned()))?;
        let mut message = [0 as c_char; ERROR_BYTES];
        // SAFETY: the text is NUL-terminated, the buffer has the length given;
        // null for "no virtual file system". The specification is freed below.
        let (model, message) = unsafe {
            let spec = c::mj_parseXMLString(
                text.as_ptr(),
                std::ptr::null(),
                message.as_mut_ptr(),
                ERROR_BYTES as i32,
            );
            if spec.is_null() {
                let text = CStr::from_ptr(message.as_ptr()).to_string_lossy().into_owned();
                return Err(SimError::Compile(text));
            }
            let model = c::mj_compile(spec, std::ptr::null());
            let text = CStr::from_ptr(c::mjs_getError(spec)).to_string_lossy().into_owned();
            c::mj_deleteSpec(spec);
            (model, text)
        };
        super::return_freed_memory();
        let raw = NonNull::new(model).ok_or(SimError::Compile(message))?;
        Ok(Self::from_compilation(Arc::new(Compilation::new(raw, MemoryOwner::Compiled))))
    }

    /// Its own arrays are copies of this model's.
    #[must_use]
    pub fn share(&self) -> Self {
        let mut other = Self::from_compilation(Arc::clone(&self.compilation));
        other.copy_own(self);
        other
    }

    pub(super) fn from_compilation(compilation: Arc<Compilation>) -> Self {
        // SAFETY: the structure is initialised, and lives as long as the shared compilation.
        // Dropping the copy frees nothing.
        let mut raw = Box::new(unsafe { compilation.raw.read() });
        Self { _own: OwnArrays::copy_of(&mut raw), raw, compilation }
    }

    /// Copies the own arrays of another model of the same compilation.
    ///
    /// # Panics
    /// If the other model is of another compilation.
    pub fn copy_own(&mut self, other: &Self) {
        assert!(self.serial() == other.serial(), "this is a model of another compilation");
        self.copy_arrays(other);
        self.raw.vis.clone_from(&other.raw.vis);
        self.raw.opt.clone_from(&other.raw.opt);
    }

    pub(crate) fn raw(&self) -> &c::mjModel {
        &self.raw
    }

    pub(super) fn raw_mut(&mut self) -> &mut c::mjModel {
        &mut self.raw
    }

    pub(crate) fn as_ptr(&self) -> *const c::mjModel {
        &raw const *self.raw
    }

    pub(super) fn compilation(&self) -> &Arc<Compilation> {
        &self.compilation
    }

    pub(super) fn serial(&self) -> u64 {
        self.compilation.serial
    }

    /// Sets bits of `option.disableflags`.
    pub fn disable(&mut self, flags: i32) {
        self.raw.opt.disableflags |= flags;
    }

    pub fn nq(&self) -> usize {
        self.raw().nq as usize
    }

    pub fn nv(&self) -> usize {
        self.raw().nv as usize
    }

    pub fn nu(&self) -> usize {
        self.raw().nu as usize
    }

    pub fn count(&self, kind: ObjectKind) -> usize {
        let model = self.raw();
        let count = match kind {
            ObjectKind::Body => model.nbody,
            ObjectKind::Joint => model.njnt,
            ObjectKind::Geom => model.ngeom,
            ObjectKind::Site => model.nsite,
            ObjectKind::Camera => model.ncam,
            ObjectKind::Light => model.nlight,
            ObjectKind::Actuator => model.nu,
            ObjectKind::Sensor => model.nsensor,
        };
        count as usize
    }

    /// Returns the name of an element; `None` if it is unnamed.
    pub fn name(&self, kind: ObjectKind, id: usize) -> Option<String> {
        // SAFETY: an id out of range gives null, checked below; the string
        // lives as long as the model.
        let name = unsafe { c::mj_id2name(self.as_ptr(), kind.code(), id as i32) };
        if name.is_null() {
            return None;
        }
        // SAFETY: not null and NUL-terminated.
        let name = unsafe { CStr::from_ptr(name) }.to_string_lossy().into_owned();
        Some(name)
    }

    pub fn id(&self, kind: ObjectKind, name: &str) -> Result<usize, SimError> {
        let missing = || SimError::Missing { kind, name: name.to_owned() };
        let text = CString::new(name).map_err(|_| missing())?;
        // SAFETY: a NUL-terminated name and a live model.
        let id = unsafe { c::mj_name2id(self.as_ptr(), kind.code(), text.as_ptr()) };
        usize::try_from(id).map_err(|_| missing())
    }

    pub fn arrays(&self) -> Vec<NamedArray> {
        arrays::all_arrays(self.raw())
    }

    /// Returns one of these arrays ([`arrays`](Self::arrays)); `None` if none has this name.
    pub fn array(&self, name: &str) -> Option<ModelArray> {
        arrays::array(self.raw(), name)
    }

    pub fn headlight_ambient(&self) -> [f32; 3] {
        self.raw().vis.headlight.ambient
    }

    pub fn set_headlight_ambient(&mut self, rgb: [f32; 3]) {
        self.raw.vis.headlight.ambient = rgb;
    }

    /// Extent, m, and near and far planes as multiples of it.
    pub fn planes(&self) -> [f64; 3] {
        let raw = self.raw();
        let map = &raw.vis.map;
        [raw.stat.extent, map.znear.into(), map.zfar.into()]
    }

    /// Enlarges the offscreen buffer of contexts created later to at least this size, pixels.
    pub(crate) fn grow_offscreen_buffer(&mut self, width: u32, height: u32) {
        let global = &mut self.raw.vis.global;
        global.offwidth = global.offwidth.max(width as i32);
        global.offheight = global.offheight.max(height as i32);
    }

    pub(crate) fn textures(&self) -> impl Iterator<Item = TextureData> {
        let raw = self.raw();
        // SAFETY: the fields point at this many values while the model lives; a
        // model without textures may have null pointers.
        let field = |pointer: *const i32| unsafe { values(pointer, raw.ntex) };
        let (kinds, spaces) = (field(raw.tex_type), field(raw.tex_colorspace));
        let (widths, heights) = (field(raw.tex_width), field(raw.tex_height));
        let (channels, starts) = (field(raw.tex_nchannel), field(raw.tex_adr));
        (0..kinds.len()).map(move |index| {
            let (width, height) = (widths[index] as usize, heights[index] as usize);
            let channels = channels[index] as usize;
            TextureData {
                kind: kinds[index],
                colorspace: spaces[index],
                width,
                height,
                channels,
                start: starts[index] as usize,
            }
        })
    }

    pub(crate) fn meshes(&self) -> Meshes<'_> {
        Meshes(self.raw())
    }

    // MuJoCo's arrays of these names: positions and sizes in m, in the frame of the parent or body;
    // quaternions w x y z; -1 for no material or texture.
    slices! {
        geom_type: i32 = ngeom * 1;
        geom_size: f64 = ngeom * 3;
        geom_matid: i32 = ngeom * 1;
        mat_texid: i32 = nmat * 10;
        mat_texrepeat: f32 = nmat * 2;
        mat_texuniform: u8 = nmat * 1;
        jnt_type: i32 = njnt * 1;
        jnt_qposadr: i32 = njnt * 1;
        jnt_bodyid: i32 = njnt * 1;
        jnt_range: f64 = njnt * 2;
        body_pos: f64 = nbody * 3;
        body_quat: f64 = nbody * 4;
        geom_bodyid: i32 = ngeom * 1;
        geom_aabb: f64 = ngeom * 6;
        cam_pos: f64 = ncam * 3;
        cam_quat: f64 = ncam * 4;
        light_pos: f64 = nlight * 3;
        light_dir: f64 = nlight * 3;
        light_diffuse: f32 = nlight * 3;
        light_specular: f32 = nlight * 3;
        site_rgba: f32 = nsite * 4;
        site_size: f64 = nsite * 3;
        actuator_ctrlrange: f64 = nu * 2;
    }
}

pub(crate) struct TextureData {
    /// `mjtTexture`.
    pub(crate) kind: i32,
    /// `mjtColorSpace`.
    pub(crate) colorspace: i32,
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) channels: usize,
    start: usize,
}

impl TextureData {
    /// Returns the range of the texture's texels among the texels of all textures.
    pub(crate) fn texels(&self) -> Range<usize> {
        self.start..self.start + self.width * self.height * self.channels
    }
}

pub(crate) struct Meshes<'a>(&'a c::mjModel);

/// Faces hold the indices of their corners' vertices, normals and texture coordinates.
pub(crate) struct MeshData<'a> {
    pub(crate) vertices: &'a [f32],
    pub(crate) normals: &'a [f32],
    pub(crate) texture_coordinates: Option<&'a [f32]>,
    pub(crate) faces: &'a [i32],
    pub(crate) face_normals: &'a [i32],
    pub(crate) face_texture_coordinates: &'a [i32],
}

impl<'a> Meshes<'a> {
    pub(crate) fn count(&self) -> usize {
        self.0.nmesh as usize
    }

    pub(crate) fn get(&self, index: usize) -> MeshData<'a> {
        let raw = self.0;
        // SAFETY: the fields point at this many values while the model lives; a
        // model without meshes may have null pointers.
        unsafe {
            let field = |pointer: *const i32| values(pointer, raw.nmesh)[index];
            let part = |pointer: *const f32, count: i32, start: i32, length: i32, width: usize| {
                &values(pointer, count * width as i32)[start as usize * width..]
                    [..length as usize * width]
            };
            let (first, length) = (field(raw.mesh_faceadr), field(raw.mesh_facenum));
            let faces = |pointer: *const i32| {
                &values(pointer, raw.nmeshface * 3)[first as usize * 3..][..length as usize * 3]
            };
            let (start, count) = (field(raw.mesh_texcoordadr), field(raw.mesh_texcoordnum));
            MeshData {
                vertices: part(
                    raw.mesh_vert,
                    raw.nmeshvert,
                    field(raw.mesh_vertadr),
                    field(raw.mesh_vertnum),
                    3,
                ),
                normals: part(
                    raw.mesh_normal,
                    raw.nmeshnormal,
                    field(raw.mesh_normaladr),
                    field(raw.mesh_normalnum),
                    3,
                ),
                texture_coordinates: (start >= 0)
                    .then(|| part(raw.mesh_texcoord, raw.nmeshtexcoord, start, count, 2)),
                faces: faces(raw.mesh_face),
                face_normals: faces(raw.mesh_facenormal),
                face_texture_coordinates: faces(raw.mesh_facetexcoord),
            }
        }
    }
}

impl Drop for Compilation {
    fn drop(&mut self) {
        match self.owner {
            // SAFETY: owned, freed once, with the last model of this compilation.
            MemoryOwner::Compiled => unsafe { c::mj_deleteModel(self.raw.as_ptr()) },
            // SAFETY: leaked from a box, freed once, with the last model of this compilation.
            MemoryOwner::Shared(_) => drop(unsafe { Box::from_raw(self.raw.as_ptr()) }),
        }
    }
}
