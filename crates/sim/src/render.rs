//! Drawing off-screen what a camera sees: colours, depths, and which geom; by our
//! own renderer, or by MuJoCo's through OpenGL.

mod abstraction;
mod gl;
mod gl_context;
mod prepare;
mod software;

use std::fmt;
use std::str::FromStr;

use gl::GlCanvas;
pub use gl_context::{GlContext, GlDevice};
use software::SoftwareCanvas;

use crate::error::SimError;
use crate::mujoco::{Data, Model};

/// Which renderer draws.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Renderer {
    /// Our own: the same bits on every machine, without OpenGL.
    #[default]
    Software,
    /// MuJoCo's, through OpenGL on a device.
    Gl(GlDevice),
}

/// As command lines write it: `software`, `gl` for OpenGL on the first device
/// that works, or `gl:N` for OpenGL on the N-th of the driver's list, from 0.
impl fmt::Display for Renderer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Software => f.write_str("software"),
            Self::Gl(GlDevice::Auto) => f.write_str("gl"),
            Self::Gl(GlDevice::Index(index)) => write!(f, "gl:{index}"),
        }
    }
}

/// Reads what [`Display`](fmt::Display) writes; the error says what may be
/// written.
impl FromStr for Renderer {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let index = text.strip_prefix("gl:").map(str::parse);
        match (text, index) {
            ("software", _) => Ok(Self::Software),
            ("gl", _) => Ok(Self::Gl(GlDevice::Auto)),
            (_, Some(Ok(index))) => Ok(Self::Gl(GlDevice::Index(index))),
            _ => Err("write `software`, `gl`, or `gl:N` for the N-th device, from 0".to_owned()),
        }
    }
}

/// A renderer that is ready to draw, on the thread that opened it.
pub enum Drawer {
    /// Our own.
    Software,
    /// MuJoCo's.
    Gl(Box<GlContext>),
}

impl Drawer {
    /// Gets a renderer ready.
    ///
    /// # Errors
    /// Where OpenGL is asked for and no device gives a context.
    pub fn open(renderer: Renderer) -> Result<Self, SimError> {
        match renderer {
            Renderer::Software => Ok(Self::Software),
            Renderer::Gl(device) => Ok(Self::Gl(Box::new(GlContext::open(device)?))),
        }
    }

    /// What draws, with its version: `rollout-raster 1`, or of OpenGL the driver's
    /// words, for example `llvmpipe (…)`.
    pub fn name(&self) -> &str {
        match self {
            Self::Software => raster::NAME,
            Self::Gl(context) => context.renderer(),
        }
    }
}

/// What is seen in a pixel of a segmentation image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Segment {
    /// Kind of object (`mjtObj`); geoms are 5, sites 6.
    pub kind: i32,
    /// Its id among those of its kind.
    pub id: i32,
}

/// What a camera of a model is to show, and how large.
pub(crate) struct View<'a> {
    pub(crate) model: &'a Model,
    /// A state of the model.
    pub(crate) data: &'a mut Data,
    /// The camera's id.
    pub(crate) camera: usize,
    /// Width and height, pixels.
    pub(crate) size: [u32; 2],
}

/// What a renderer keeps to draw one scene.
pub(crate) enum Canvas {
    Software(Box<SoftwareCanvas>),
    Gl(GlCanvas),
}

impl Canvas {
    /// Prepares a model's meshes and textures, for pictures up to this size,
    /// pixels.
    pub(crate) fn new(
        drawer: &Drawer,
        model: &mut Model,
        width: u32,
        height: u32,
    ) -> Result<Self, SimError> {
        match drawer {
            Drawer::Software => Ok(Self::Software(Box::new(SoftwareCanvas::new(model)?))),
            Drawer::Gl(context) => GlCanvas::new(context, model, width, height).map(Self::Gl),
        }
    }

    /// Whether this was made for the renderer, and a picture of this size fits.
    pub(crate) fn suits(&self, drawer: &Drawer, width: u32, height: u32) -> bool {
        match (self, drawer) {
            (Self::Software(_), Drawer::Software) => true,
            (Self::Gl(canvas), Drawer::Gl(_)) => canvas.holds(width, height),
            _ => false,
        }
    }

    /// Draws what a camera of the model sees; rows from bottom to top.
    pub(crate) fn draw(&mut self, view: View<'_>) -> Result<Vec<u8>, SimError> {
        match self {
            Self::Software(canvas) => canvas.draw(view),
            Self::Gl(canvas) => Ok(canvas.draw(view)),
        }
    }

    /// Draws how far it is to what a camera sees: 0 at the near plane, 1 at the far
    /// one, as OpenGL keeps it; rows from bottom to top.
    pub(crate) fn depth(&mut self, view: View<'_>) -> Result<Vec<f32>, SimError> {
        match self {
            Self::Software(canvas) => canvas.depth(view),
            Self::Gl(canvas) => Ok(canvas.depth(view)),
        }
    }

    /// Draws what a camera sees in the middle of each pixel; rows from bottom to
    /// top.
    pub(crate) fn segmentation(
        &mut self,
        view: View<'_>,
    ) -> Result<Vec<Option<Segment>>, SimError> {
        match self {
            Self::Software(canvas) => canvas.segmentation(view),
            Self::Gl(canvas) => Ok(canvas.segmentation(view)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_renderer_is_named_in_three_ways() {
        for (text, renderer) in [
            ("software", Renderer::Software),
            ("gl", Renderer::Gl(GlDevice::Auto)),
            ("gl:1", Renderer::Gl(GlDevice::Index(1))),
        ] {
            assert_eq!(text.parse(), Ok(renderer));
            assert_eq!(renderer.to_string(), text);
        }
        for wrong in ["", "opengl", "gl:", "gl:x", "Software"] {
            let error = wrong.parse::<Renderer>().expect_err(wrong);
            assert!(error.contains("`gl:N`"), "{error}");
        }
    }
}
