//! MuJoCo's own renderer, through OpenGL. One context per process, owned by the
//! thread that opened it; the pictures of each scene have their own buffers.

use std::mem::MaybeUninit;

use mujoco_rs::mujoco_c as c;

use crate::error::SimError;
use crate::mujoco::{Data, Model};

use super::gl_context::GlContext;
use super::{COLLISION_GROUP, MAX_GEOMS};

/// What MuJoCo keeps to draw one scene. Dropping it needs the context that it
/// was made with to be current, which [`GlContext`] being alive ensures.
pub(crate) struct GlCanvas {
    options: c::mjvOption,
    scene: Box<c::mjvScene>,
    context: Box<c::mjrContext>,
}

impl GlCanvas {
    /// Uploads a model's meshes and textures; buffers for pictures up to this
    /// size, pixels.
    pub(crate) fn new(
        _current: &GlContext,
        model: &mut Model,
        width: u32,
        height: u32,
    ) -> Result<Self, SimError> {
        model.grow_offscreen_buffer(width, height);
        let mut options = MaybeUninit::uninit();
        let mut scene = Box::new(MaybeUninit::uninit());
        let mut context = Box::new(MaybeUninit::uninit());
        // SAFETY: each object is written whole by its default function before
        // it is assumed initialised; the boxes keep their addresses, which
        // MuJoCo may remember; a GL context is current on this thread.
        let mut canvas = unsafe {
            c::mjv_defaultOption(options.as_mut_ptr());
            c::mjv_defaultScene(scene.as_mut_ptr());
            c::mjr_defaultContext(context.as_mut_ptr());
            let mut canvas = Self {
                options: options.assume_init(),
                scene: scene.assume_init(),
                context: context.assume_init(),
            };
            c::mjv_makeScene(model.as_ptr(), &mut *canvas.scene, MAX_GEOMS);
            let scale = c::mjtFontScale::mjFONTSCALE_150 as i32;
            c::mjr_makeContext(model.as_ptr(), &mut *canvas.context, scale);
            c::mjr_setBuffer(
                c::mjtFramebuffer::mjFB_OFFSCREEN as i32,
                &mut *canvas.context,
            );
            canvas
        };
        canvas.options.geomgroup[COLLISION_GROUP] = 0;
        if canvas.context.currentBuffer != c::mjtFramebuffer::mjFB_OFFSCREEN as i32 {
            return Err(SimError::Graphics {
                problem: format!("no off-screen buffer of {width} × {height}"),
                remedy: "try a smaller picture or another device with --renderer gl:N",
            });
        }
        Ok(canvas)
    }

    /// Whether a picture of this size fits the buffers.
    pub(crate) fn holds(&self, width: u32, height: u32) -> bool {
        self.context.offWidth >= width as i32 && self.context.offHeight >= height as i32
    }

    /// Draws what a camera of the model sees; rows from bottom to top.
    pub(crate) fn draw(
        &mut self,
        model: &Model,
        data: &mut Data,
        camera: usize,
        width: u32,
        height: u32,
    ) -> Vec<u8> {
        let mut rgb = vec![0; width as usize * height as usize * 3];
        let viewport = c::mjrRect {
            left: 0,
            bottom: 0,
            width: width as i32,
            height: height as i32,
        };
        let mut view = MaybeUninit::uninit();
        // SAFETY: model and data belong together; the picture has room for
        // width × height pixels; the viewport lies inside the buffer, as the
        // caller has checked with `holds`.
        unsafe {
            c::mjv_defaultCamera(view.as_mut_ptr());
            let mut view: c::mjvCamera = view.assume_init();
            view.type_ = c::mjtCamera::mjCAMERA_FIXED as i32;
            view.fixedcamid = camera as i32;
            c::mjv_updateScene(
                model.as_ptr(),
                data.as_mut_ptr(),
                &self.options,
                std::ptr::null(),
                &mut view,
                c::mjtCatBit::mjCAT_ALL as i32,
                &mut *self.scene,
            );
            c::mjr_render(viewport, &mut *self.scene, &*self.context);
            c::mjr_readPixels(
                rgb.as_mut_ptr(),
                std::ptr::null_mut(),
                viewport,
                &*self.context,
            );
        }
        rgb
    }
}

impl Drop for GlCanvas {
    fn drop(&mut self) {
        // SAFETY: both were made in `new` and are freed once.
        unsafe {
            c::mjr_freeContext(&mut *self.context);
            c::mjv_freeScene(&mut *self.scene);
        }
    }
}
