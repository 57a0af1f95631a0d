//! Drawing frames off-screen: by our own renderer, or by MuJoCo's through
//! OpenGL.

mod gl;
mod gl_context;
mod software;

use std::fmt;
use std::str::FromStr;

use gl::GlCanvas;
pub use gl_context::{GlContext, GlDevice};
use software::SoftwareCanvas;

use crate::error::SimError;
use crate::mujoco::{Data, Model};

/// Geoms in one picture at most, as in robosuite; further ones are not drawn.
const MAX_GEOMS: i32 = 1000;
/// Geom groups: collision geometry is not drawn, visual geometry is.
const COLLISION_GROUP: usize = 0;

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
    pub(crate) fn draw(
        &mut self,
        model: &Model,
        data: &mut Data,
        camera: usize,
        width: u32,
        height: u32,
    ) -> Result<Vec<u8>, SimError> {
        match self {
            Self::Software(canvas) => canvas.draw(model, data, camera, width, height),
            Self::Gl(canvas) => Ok(canvas.draw(model, data, camera, width, height)),
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
