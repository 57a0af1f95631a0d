use std::ffi::{CStr, c_char, c_void};
use std::rc::Rc;

use khronos_egl as egl;

use crate::error::SimError;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum GlDevice {
    /// The first device that works, in the driver's order.
    #[default]
    Auto,
    Index(usize),
}

type Egl = egl::DynamicInstance<egl::EGL1_5>;
type QueryDevices =
    unsafe extern "system" fn(egl::Int, *mut *mut c_void, *mut egl::Int) -> egl::Boolean;
type GetString = unsafe extern "system" fn(u32) -> *const c_char;

/// `EGL_PLATFORM_DEVICE_EXT` (EGL_EXT_platform_device).
const PLATFORM_DEVICE: egl::Enum = 0x313F;
/// `EGL_PLATFORM_SURFACELESS_MESA` (EGL_MESA_platform_surfaceless).
const PLATFORM_SURFACELESS: egl::Enum = 0x31DD;
const GL_RENDERER: u32 = 0x1F01;
/// Maximum number of listed devices, more than any machine has.
const MAX_DEVICES: usize = 32;

const REMEDY: &str = "install what `cargo xtask setup --gl` says that drawing through OpenGL needs \
     (Debian: `apt-get install libegl1 libegl-mesa0 libgl1-mesa-dri libgl1 libopengl0`) or with \
     the NVIDIA driver, or choose another device with --renderer gl:N";

/// An OpenGL context, bound to the thread that opened it. Canvases share ownership of it.
pub struct GlContext {
    egl: Egl,
    display: egl::Display,
    context: egl::Context,
    renderer: String,
}

impl GlContext {
    pub(super) fn open(device: GlDevice) -> Result<Rc<Self>, SimError> {
        // SAFETY: loads the system's EGL library, whose initialisers are as
        // trustworthy as those of any system library.
        let egl = unsafe { Egl::load_required() }
            .map_err(|error| graphics(format!("the EGL library cannot be loaded ({error})")))?;
        let candidates = candidates(&egl, device)?;
        let mut problem = "no device".to_owned();
        for display in candidates {
            match open_on(&egl, display) {
                Ok(context) => {
                    let renderer = renderer(&egl);
                    return Ok(Rc::new(Self { egl, display, context, renderer }));
                }
                Err(error) => problem = error.to_string(),
            }
        }
        Err(graphics(format!("no EGL device gives an OpenGL context ({problem})")))
    }

    pub(super) fn make_current(&self) -> Result<(), SimError> {
        let result = self.egl.make_current(self.display, None, None, Some(self.context));
        result.map_err(|error| graphics(format!("the OpenGL context is lost ({error})")))
    }

    /// Returns the driver's name of the renderer, for example `llvmpipe (…)`.
    pub fn renderer(&self) -> &str {
        &self.renderer
    }
}

impl Drop for GlContext {
    fn drop(&mut self) {
        // Errors are ignored, because a failing driver has no remedy here.
        if self.egl.get_current_context() == Some(self.context) {
            let _ = self.egl.make_current(self.display, None, None, None);
        }
        let _ = self.egl.destroy_context(self.display, self.context);
    }
}

fn graphics(problem: String) -> SimError {
    SimError::Graphics { problem, remedy: REMEDY }
}

fn candidates(egl: &Egl, device: GlDevice) -> Result<Vec<egl::Display>, SimError> {
    let devices = devices(egl);
    let display = |platform: egl::Enum, native: *mut c_void| {
        // SAFETY: the native handle is one that the driver just listed, or the
        // default handle of the surfaceless platform.
        unsafe { egl.get_platform_display(platform, native, &[egl::ATTRIB_NONE]) }.ok()
    };
    if let GlDevice::Index(index) = device {
        let native = *devices.get(index).ok_or_else(|| {
            graphics(format!(
                "there is no EGL device {index}; the driver lists {} devices",
                devices.len()
            ))
        })?;
        return Ok(display(PLATFORM_DEVICE, native).into_iter().collect());
    }
    let listed = devices.into_iter().filter_map(|native| display(PLATFORM_DEVICE, native));
    let surfaceless = display(PLATFORM_SURFACELESS, egl::DEFAULT_DISPLAY.cast());
    Ok(listed.chain(surfaceless).collect())
}

fn devices(egl: &Egl) -> Vec<*mut c_void> {
    let Some(query) = egl.get_proc_address("eglQueryDevicesEXT") else {
        return Vec::new();
    };
    let mut devices = [std::ptr::null_mut(); MAX_DEVICES];
    let mut count = 0;
    // SAFETY: the function has this signature (EGL_EXT_device_enumeration) and
    // writes at most MAX_DEVICES handles.
    let listed = unsafe {
        let query: QueryDevices = std::mem::transmute(query);
        query(MAX_DEVICES as egl::Int, devices.as_mut_ptr(), &mut count)
    };
    if listed == egl::FALSE {
        return Vec::new();
    }
    devices[..(count.max(0) as usize).min(MAX_DEVICES)].to_vec()
}

fn open_on(egl: &Egl, display: egl::Display) -> Result<egl::Context, egl::Error> {
    egl.initialize(display)?;
    // The API is chosen per thread, and is OpenGL ES by default.
    egl.bind_api(egl::OPENGL_API)?;
    let wanted = [
        egl::RED_SIZE,
        8,
        egl::GREEN_SIZE,
        8,
        egl::BLUE_SIZE,
        8,
        egl::ALPHA_SIZE,
        8,
        egl::DEPTH_SIZE,
        24,
        egl::STENCIL_SIZE,
        8,
        egl::COLOR_BUFFER_TYPE,
        egl::RGB_BUFFER,
        egl::SURFACE_TYPE,
        egl::PBUFFER_BIT,
        egl::RENDERABLE_TYPE,
        egl::OPENGL_BIT,
        egl::NONE,
    ];
    let config = egl.choose_first_config(display, &wanted)?.ok_or(egl::Error::BadConfig)?;
    let context = egl.create_context(display, config, None, &[egl::NONE])?;
    if let Err(error) = egl.make_current(display, None, None, Some(context)) {
        let _ = egl.destroy_context(display, context);
        return Err(error);
    }
    Ok(context)
}

fn renderer(egl: &Egl) -> String {
    let Some(get_string) = egl.get_proc_address("glGetString") else {
        return String::new();
    };
    // SAFETY: `glGetString` has this signature and returns a static string or
    // null; a context is current.
    unsafe {
        let get_string: GetString = std::mem::transmute(get_string);
        let text = get_string(GL_RENDERER);
        if text.is_null() { String::new() } else { CStr::from_ptr(text).to_string_lossy().into() }
    }
}
