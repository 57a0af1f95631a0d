//! MuJoCo's own renderer, through OpenGL. One context per process, owned by the
//! thread that opened it; the pictures of each scene have their own buffers.

use std::mem::MaybeUninit;

use mujoco_rs::mujoco_c as c;

use crate::error::SimError;
use crate::mujoco::Model;

use super::abstraction::Abstraction;
use super::gl_context::GlContext;
use super::{Segment, View};

/// What MuJoCo keeps to draw one scene. Dropping it needs the context that it
/// was made with to be current, which [`GlContext`] being alive ensures.
pub(crate) struct GlCanvas {
    abstraction: Abstraction,
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
        let abstraction = Abstraction::new(model);
        let mut context = Box::new(MaybeUninit::uninit());
        // SAFETY: the object is written whole by its default function before it is
        // assumed initialised; the box keeps its address, which MuJoCo may
        // remember; a GL context is current on this thread.
        let context: Box<c::mjrContext> = unsafe {
            c::mjr_defaultContext(context.as_mut_ptr());
            let mut context = context.assume_init();
            let scale = c::mjtFontScale::mjFONTSCALE_150 as i32;
            c::mjr_makeContext(model.as_ptr(), &mut *context, scale);
            c::mjr_setBuffer(c::mjtFramebuffer::mjFB_OFFSCREEN as i32, &mut *context);
            context
        };
        let canvas = Self {
            abstraction,
            context,
        };
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
    pub(crate) fn draw(&mut self, view: View<'_>) -> Vec<u8> {
        let size = view.size;
        let mut rgb = vec![0; pixels(size) * 3];
        let scene = self.abstraction.update(view);
        render(scene, &self.context, size, Target::Colours(&mut rgb));
        rgb
    }

    /// Draws how far it is to what the camera sees: 0 at the near plane, 1 at the
    /// far one, as OpenGL keeps it.
    pub(crate) fn depth(&mut self, view: View<'_>) -> Vec<f32> {
        let size = view.size;
        let mut depth = vec![0.0; pixels(size)];
        let scene = self.abstraction.update(view);
        render(scene, &self.context, size, Target::Depths(&mut depth));
        depth
    }

    /// Draws which geom the camera sees, by its place in segmentation images.
    pub(crate) fn segmentation(&mut self, view: View<'_>) -> Vec<Option<Segment>> {
        let size = view.size;
        let mut rgb = vec![0; pixels(size) * 3];
        let scene = self.abstraction.update(view);
        const FLAGS: [c::mjtRndFlag; 2] =
            [c::mjtRndFlag::mjRND_SEGMENT, c::mjtRndFlag::mjRND_IDCOLOR];
        let before = FLAGS.map(|flag| std::mem::replace(&mut scene.flags[flag as usize], 1));
        render(scene, &self.context, size, Target::Colours(&mut rgb));
        for (flag, value) in FLAGS.into_iter().zip(before) {
            scene.flags[flag as usize] = value;
        }
        let segments = self.abstraction.segments();
        let numbers = rgb
            .chunks_exact(3)
            .map(|pixel| u32::from_le_bytes([pixel[0], pixel[1], pixel[2], 0]));
        // 0 is the background, 1 the first.
        numbers
            .map(|number| segments.get(&number.checked_sub(1)?).copied())
            .collect()
    }
}

impl Drop for GlCanvas {
    fn drop(&mut self) {
        // SAFETY: made in `new`, freed once.
        unsafe { c::mjr_freeContext(&mut *self.context) }
    }
}

fn pixels([width, height]: [u32; 2]) -> usize {
    width as usize * height as usize
}

/// Where a picture goes, which has room for all its pixels.
enum Target<'a> {
    Colours(&'a mut [u8]),
    Depths(&'a mut [f32]),
}

fn render(scene: &mut c::mjvScene, context: &c::mjrContext, size: [u32; 2], target: Target<'_>) {
    let viewport = c::mjrRect {
        left: 0,
        bottom: 0,
        width: size[0] as i32,
        height: size[1] as i32,
    };
    let (colours, depths) = match target {
        Target::Colours(rgb) => {
            assert_eq!(rgb.len(), pixels(size) * 3);
            (rgb.as_mut_ptr(), std::ptr::null_mut())
        }
        Target::Depths(depths) => {
            assert_eq!(depths.len(), pixels(size));
            (std::ptr::null_mut(), depths.as_mut_ptr())
        }
    };
    // SAFETY: scene and context are of one model; what is written to has room for
    // all pixels, or is null, which MuJoCo passes over; the viewport lies inside
    // the buffer, as the caller has checked with `holds`.
    unsafe {
        c::mjr_render(viewport, scene, context);
        c::mjr_readPixels(colours, depths, viewport, context);
    }
}
