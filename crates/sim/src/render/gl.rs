//! MuJoCo's own renderer, through OpenGL. The scenes of a simulator share an OpenGL context; each
//! has its own frame buffers.

use std::mem::MaybeUninit;
use std::rc::Rc;

use mujoco_rs::mujoco_c as c;

use crate::error::SimError;
use crate::mujoco::{Model, Segment, VisualScene};

use super::View;
use super::gl_context::GlContext;

/// Belongs to an OpenGL context, and is freed before it.
pub(crate) struct GlCanvas {
    visual_scene: VisualScene,
    context: Box<c::mjrContext>,
    opengl: Rc<GlContext>,
}

impl GlCanvas {
    /// The model's offscreen buffer must have at least this size, pixels.
    pub(crate) fn new(
        opengl: &Rc<GlContext>,
        model: &Model,
        width: u32,
        height: u32,
    ) -> Result<Self, SimError> {
        opengl.make_current()?;
        let visual_scene = VisualScene::new(model);
        let mut context = Box::new(MaybeUninit::uninit());
        // SAFETY: the object is written whole by its default function before it is assumed
        // initialised; the boxed object does not move, since MuJoCo may store its address; a GL
        // context is current on this thread.
        let context: Box<c::mjrContext> = unsafe {
            c::mjr_defaultContext(context.as_mut_ptr());
            let mut context = context.assume_init();
            let scale = c::mjtFontScale::mjFONTSCALE_150 as i32;
            c::mjr_makeContext(model.as_ptr(), &mut *context, scale);
            c::mjr_setBuffer(c::mjtFramebuffer::mjFB_OFFSCREEN as i32, &mut *context);
            context
        };
        let canvas = Self { visual_scene, context, opengl: Rc::clone(opengl) };
        let offscreen = c::mjtFramebuffer::mjFB_OFFSCREEN as i32;
        if canvas.context.currentBuffer != offscreen || !canvas.fits([width, height]) {
            return Err(SimError::Graphics {
                problem: format!("no off-screen buffer of {width} × {height}"),
                remedy: "try a smaller picture or another device with --renderer gl:N",
            });
        }
        Ok(canvas)
    }

    pub(crate) fn is_usable_for(&self, opengl: &Rc<GlContext>, size: [u32; 2]) -> bool {
        Rc::ptr_eq(&self.opengl, opengl) && self.fits(size)
    }

    fn fits(&self, size: [u32; 2]) -> bool {
        let buffer_size = [self.context.offWidth, self.context.offHeight];
        size.into_iter().zip(buffer_size).all(|(side, limit)| i64::from(side) <= i64::from(limit))
    }

    pub(crate) fn draw(&mut self, view: View<'_>) -> Result<Vec<u8>, SimError> {
        let mut rgb = vec![0; pixels(view.size) * 3];
        self.render(view, &[], Target::Colours(&mut rgb))?;
        Ok(rgb)
    }

    pub(crate) fn depth(&mut self, view: View<'_>) -> Result<Vec<f32>, SimError> {
        let mut depth = vec![0.0; pixels(view.size)];
        self.render(view, &[], Target::Depths(&mut depth))?;
        Ok(depth)
    }

    pub(crate) fn segmentation(
        &mut self,
        view: View<'_>,
    ) -> Result<Vec<Option<Segment>>, SimError> {
        const FLAGS: [c::mjtRndFlag; 2] =
            [c::mjtRndFlag::mjRND_SEGMENT, c::mjtRndFlag::mjRND_IDCOLOR];
        let mut rgb = vec![0; pixels(view.size) * 3];
        self.render(view, &FLAGS, Target::Colours(&mut rgb))?;
        let segments = self.visual_scene.segments();
        let numbers =
            rgb.chunks_exact(3).map(|pixel| u32::from_le_bytes([pixel[0], pixel[1], pixel[2], 0]));
        // 0 is the background; any other number is a geom's id plus 1.
        Ok(numbers.map(|number| segments.get(&number.checked_sub(1)?).copied()).collect())
    }

    fn render(
        &mut self,
        view: View<'_>,
        flags: &[c::mjtRndFlag],
        target: Target<'_>,
    ) -> Result<(), SimError> {
        assert!(self.fits(view.size), "a picture that fits the buffers");
        let pixels = pixels(view.size);
        let viewport = c::mjrRect {
            left: 0,
            bottom: 0,
            width: view.size[0] as i32,
            height: view.size[1] as i32,
        };
        let (colours, depths) = match target {
            Target::Colours(rgb) => {
                assert_eq!(rgb.len(), pixels * 3);
                (rgb.as_mut_ptr(), std::ptr::null_mut())
            }
            Target::Depths(depths) => {
                assert_eq!(depths.len(), pixels);
                (std::ptr::null_mut(), depths.as_mut_ptr())
            }
        };
        self.opengl.make_current()?;
        let scene = self.visual_scene.update(view.model, view.data, view.camera);
        let before = scene.flags;
        for flag in flags {
            scene.flags[*flag as usize] = 1;
        }
        // SAFETY: scene and context are of one model, and their OpenGL context is
        // current; each target has room for all pixels, or is null, which MuJoCo
        // skips; the viewport lies inside the buffer. Sizes were asserted above.
        unsafe {
            c::mjr_render(viewport, scene, &*self.context);
            c::mjr_readPixels(colours, depths, viewport, &*self.context);
        }
        scene.flags = before;
        Ok(())
    }
}

impl Drop for GlCanvas {
    fn drop(&mut self) {
        // In another context, the same names would refer to other objects. A lost context has
        // already lost its objects.
        if self.opengl.make_current().is_ok() {
            // SAFETY: made in `new`, freed once, in its OpenGL context.
            unsafe { c::mjr_freeContext(&mut *self.context) }
        }
    }
}

fn pixels([width, height]: [u32; 2]) -> usize {
    width as usize * height as usize
}

enum Target<'a> {
    Colours(&'a mut [u8]),
    Depths(&'a mut [f32]),
}
