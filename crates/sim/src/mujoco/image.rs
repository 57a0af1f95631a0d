//! Serialised compiled models that processes can share. A serialised model consists of MuJoCo's
//! structure and of the one buffer that all pointers of the structure point into.

use std::mem::offset_of;
use std::ptr::NonNull;
use std::sync::Arc;

use bytes::Bytes;
use mujoco_rs::mujoco_c::mjModel;

use super::model::{Compilation, MemoryOwner, Model};
use super::values;

/// Alignment of MuJoCo's arrays, bytes; required of the bytes that an image is restored from.
pub(crate) const ALIGNMENT: usize = 64;
pub(crate) const STRUCTURE: usize = size_of::<mjModel>();
/// Byte range in the structure. They point into MuJoCo's buffer, the first one to its start.
const POINTERS: std::ops::Range<usize> =
    offset_of!(mjModel, buffer)..offset_of!(mjModel, signature);
const NULL: usize = usize::MAX;

const _: () = assert!(
    POINTERS.start.is_multiple_of(size_of::<usize>())
        && POINTERS.end.is_multiple_of(size_of::<usize>())
        && offset_of!(mjModel, qpos0) == POINTERS.start + size_of::<usize>()
        && offset_of!(mjModel, mapD2M) + size_of::<usize>() == POINTERS.end
);

pub(crate) struct ModelImage<'a> {
    /// MuJoCo's structure, with offsets in place of pointers.
    pub(crate) structure: Vec<u8>,
    /// The arrays, split where the textures' texels were removed.
    pub(crate) arrays: [&'a [u8]; 2],
}

impl Model {
    /// Leaves out the texels, most of the model, which texture files hold. `None` if the arrays do
    /// not have the expected layout, or the texels are already missing.
    pub(crate) fn image(&self) -> Option<ModelImage<'_>> {
        let compiled = self.compilation().structure();
        let (start, length) = (compiled.buffer as usize, compiled.nbuffer as usize);
        let texels = compiled.ntexdata as usize;
        let has_expected_layout =
            start.is_multiple_of(ALIGNMENT) && (texels == 0 || !self.lacks_texels());
        if !has_expected_layout {
            return None;
        }
        let cut = match texels {
            0 => length,
            _ => (compiled.tex_data as usize).checked_sub(start)?,
        };
        // A multiple of the alignment, so that the arrays behind it stay aligned.
        let removed = texels / ALIGNMENT * ALIGNMENT;
        if cut + removed > length {
            return None;
        }
        // SAFETY: MuJoCo's buffer has this length, and nobody writes to it.
        let buffer = unsafe {
            std::slice::from_raw_parts(compiled.buffer.cast::<u8>().cast_const(), length)
        };
        // SAFETY: views the structure as bytes. MuJoCo clears it whole, its padding included,
        // before it fills it in.
        let mut structure =
            unsafe { std::slice::from_raw_parts((&raw const *compiled).cast::<u8>(), STRUCTURE) }
                .to_vec();
        for word in structure[POINTERS].chunks_exact_mut(size_of::<usize>()) {
            let pointer = usize::from_ne_bytes(word.try_into().expect("a word"));
            let offset = match pointer {
                0 => NULL,
                _ => {
                    let offset = pointer.checked_sub(start).filter(|offset| *offset <= length)?;
                    offset - if offset > cut { removed } else { 0 }
                }
            };
            word.copy_from_slice(&offset.to_ne_bytes());
        }
        if texels > 0 {
            let field = offset_of!(mjModel, tex_data);
            structure[field..][..size_of::<usize>()].copy_from_slice(&NULL.to_ne_bytes());
        }
        Some(ModelImage { structure, arrays: [&buffer[..cut], &buffer[cut + removed..]] })
    }

    /// `arrays`, which stays in use, holds both parts of the image's arrays. `None` if it is
    /// misaligned, the structure has another size, or an offset in it exceeds `arrays`.
    ///
    /// # Safety
    /// The bytes must come from [`Model::image`] of the same version of MuJoCo on the same kind of
    /// machine.
    pub(crate) unsafe fn from_image(structure: &[u8], arrays: Bytes) -> Option<Self> {
        super::install_handlers();
        let start = arrays.as_ptr();
        if structure.len() != STRUCTURE || !start.addr().is_multiple_of(ALIGNMENT) {
            return None;
        }
        let mut raw = Box::<mjModel>::new_uninit();
        let target = raw.as_mut_ptr().cast::<u8>();
        // SAFETY: the structure has as many bytes as the box has room for.
        unsafe { target.copy_from_nonoverlapping(structure.as_ptr(), STRUCTURE) };
        for at in POINTERS.step_by(size_of::<usize>()) {
            let word = &structure[at..][..size_of::<usize>()];
            let offset = usize::from_ne_bytes(word.try_into().expect("a word"));
            let pointer = match offset {
                NULL => std::ptr::null_mut(),
                offset if offset <= arrays.len() => start.cast_mut().wrapping_add(offset),
                _ => return None,
            };
            // SAFETY: `at` is a pointer's position in the structure, aligned as asserted above.
            unsafe { target.add(at).cast::<*mut u8>().write(pointer) };
        }
        // SAFETY: the structure was written whole, from a model of the same version as the caller
        // promises; its pointers point into `arrays`, which the compilation keeps alive. Nobody
        // writes through them: arrays that a model changes are copied first.
        let raw = NonNull::from(Box::leak(unsafe { raw.assume_init() }));
        Some(Self::from_compilation(Arc::new(Compilation::new(raw, MemoryOwner::Shared(arrays)))))
    }

    pub(crate) fn lacks_texels(&self) -> bool {
        let compiled = self.compilation().structure();
        compiled.ntexdata > 0 && compiled.tex_data.is_null()
    }

    /// Returns the texels of all textures in order; empty if they are missing.
    pub(crate) fn texels(&self) -> Bytes {
        Bytes::from_owner(Texels(Arc::clone(self.compilation())))
    }

    pub(crate) fn with_texels<T>(
        &mut self,
        texels: &[u8],
        use_model: impl FnOnce(&Self) -> T,
    ) -> T {
        assert!(self.lacks_texels() && texels.len() == self.raw().ntexdata as usize);
        self.raw_mut().tex_data = texels.as_ptr().cast_mut();
        let result = use_model(self);
        self.raw_mut().tex_data = std::ptr::null_mut();
        result
    }
}

struct Texels(Arc<Compilation>);

impl AsRef<[u8]> for Texels {
    fn as_ref(&self) -> &[u8] {
        let compiled = self.0.structure();
        // SAFETY: the field is null, or points at this many values while the compilation lives.
        unsafe { values(compiled.tex_data.cast_const(), compiled.ntexdata) }
    }
}
