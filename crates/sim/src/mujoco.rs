//! Safe interface to MuJoCo 3.3.7. All calls into C are in this module and in the renderer. Each C
//! object has one owner, and every array is exposed as a slice of its true length.

mod arrays;
mod changes;
mod data;
mod image;
mod model;
mod own;
mod visual_scene;

use std::cell::RefCell;
use std::ffi::{CStr, c_char};
use std::sync::Once;

use mujoco_rs::mujoco_c as c;

pub use arrays::{ModelArray, NamedArray, Values};
pub use changes::OwnArray;
pub use data::Data;
pub(crate) use image::{ALIGNMENT, STRUCTURE};
pub(crate) use model::{MeshData, TextureData};
pub use model::{Model, ObjectKind};
pub use visual_scene::Segment;
pub(crate) use visual_scene::VisualScene;

/// MuJoCo's error handler must not return, and C frames cannot be unwound.
pub const FATAL_EXIT_STATUS: i32 = 86;

/// A single warning already ends the rollout.
const MAX_WARNINGS: usize = 8;

thread_local! {
    /// Warnings of MuJoCo's calls on this thread.
    static WARNINGS: RefCell<Vec<String>> = const { RefCell::new(Vec::new()) };
}

pub fn version() -> String {
    // SAFETY: returns a static NUL-terminated string.
    let text = unsafe { CStr::from_ptr(c::mj_versionString()) };
    text.to_string_lossy().into_owned()
}

/// The default handlers write a log file into the current folder and exit unspecifically.
pub(crate) fn install_handlers() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        // SAFETY: plain assignments of function pointers before any other call
        // into the library; nothing reads them at the same time.
        unsafe {
            c::mju_user_error = Some(on_error);
            c::mju_user_warning = Some(on_warning);
        }
    });
}

/// Returns freed memory to the system. Compiling a scene decodes hundreds of megabytes of images
/// and meshes; glibc would retain most of it, a third of a slot's memory.
pub(crate) fn return_freed_memory() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    {
        // SAFETY: the declaration is glibc's, and the function may be called at any time, on any
        // thread.
        unsafe extern "C" {
            safe fn malloc_trim(pad: usize) -> std::ffi::c_int;
        }
        malloc_trim(0);
    }
}

/// Returns the first few warnings on this thread since the last call: at most [`MAX_WARNINGS`].
pub(crate) fn take_warnings() -> Vec<String> {
    WARNINGS.take()
}

unsafe extern "C" fn on_error(message: *const c_char) {
    // SAFETY: MuJoCo passes a NUL-terminated string that lives for this call.
    let message = unsafe { CStr::from_ptr(message) }.to_string_lossy();
    eprintln!("MuJoCo stopped: {message}");
    std::process::exit(FATAL_EXIT_STATUS);
}

unsafe extern "C" fn on_warning(message: *const c_char) {
    // SAFETY: as in `on_error`.
    let message = unsafe { CStr::from_ptr(message) }.to_string_lossy().into_owned();
    WARNINGS.with_borrow_mut(|warnings| {
        if warnings.len() < MAX_WARNINGS {
            warnings.push(message);
        }
    });
}

/// Returns a slice of `count` values; empty for a null pointer, which empty arrays may have.
///
/// # Safety
/// The pointer is null, or points at `count` values that outlive `'a`.
unsafe fn values<'a, T>(pointer: *const T, count: i32) -> &'a [T] {
    if pointer.is_null() || count <= 0 {
        return &[];
    }
    // SAFETY: the caller promises that the pointer points at `count` values.
    unsafe { std::slice::from_raw_parts(pointer, count as usize) }
}
