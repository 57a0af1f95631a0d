//! Drawing frames off-screen: by our own renderer, or by MuJoCo's through
//! OpenGL.

mod gl;
mod gl_context;

use gl::GlCanvas;
pub use gl_context::{GlContext, GlDevice};

use crate::error::SimError;
use crate::mujoco::{Data, Model};

/// Geoms in one picture at most, as in robosuite; further ones are not drawn.
const MAX_GEOMS: i32 = 1000;
/// Geom groups: collision geometry is not drawn, visual geometry is.
const COLLISION_GROUP: usize = 0;

/// What the software renderer is called.
const SOFTWARE: &str = "rollout-raster 1";

/// Which renderer draws.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Renderer {
    /// Our own, on the processor.
    Software,
    /// MuJoCo's, through OpenGL on a device.
    Gl(GlDevice),
}

impl Default for Renderer {
    fn default() -> Self {
        Self::Gl(GlDevice::Auto)
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

    /// What draws: of OpenGL the driver's words, for example `llvmpipe (…)`.
    pub fn name(&self) -> &str {
        match self {
            Self::Software => SOFTWARE,
            Self::Gl(context) => context.renderer(),
        }
    }
}

/// What a renderer keeps to draw one scene.
pub(crate) enum Canvas {
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
            Drawer::Software => Err(SimError::Graphics {
                problem: format!("{SOFTWARE} is not part of this build"),
                remedy: "draw with --renderer gl",
            }),
            Drawer::Gl(context) => GlCanvas::new(context, model, width, height).map(Self::Gl),
        }
    }

    /// Whether this was made for the renderer, and a picture of this size fits.
    pub(crate) fn suits(&self, drawer: &Drawer, width: u32, height: u32) -> bool {
        match (self, drawer) {
            (Self::Gl(canvas), Drawer::Gl(_)) => canvas.holds(width, height),
            (Self::Gl(_), Drawer::Software) => false,
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
            Self::Gl(canvas) => Ok(canvas.draw(model, data, camera, width, height)),
        }
    }
}
