//! Offscreen rendering of colours, depths and segmentation, by the software renderer or by MuJoCo's
//! through OpenGL.

#[allow(unsafe_code, reason = "MuJoCo's renderer, called through its C API")]
mod gl;
#[allow(unsafe_code, reason = "EGL's extensions are C functions found by name")]
mod gl_context;
mod prepare;
mod software;
#[allow(unsafe_code, reason = "other threads may move the value but never use it")]
mod thread_bound;

use std::fmt;
use std::rc::Rc;
use std::str::FromStr;
use std::sync::Arc;

use gl::GlCanvas;
pub use gl_context::{GlContext, GlDevice};
pub(crate) use prepare::{Prepared, digest_of_texture};
use software::SoftwareCanvas;
use thread_bound::ThreadBound;

use crate::error::SimError;
use crate::mujoco::{Data, Model, Segment};

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Renderer {
    /// Software renderer of this project: the same bits on every machine, without OpenGL.
    #[default]
    Software,
    Gl(GlDevice),
}

/// Notation on command lines: `software`, `gl` for OpenGL on the first device that works, or `gl:N`
/// for OpenGL on the N-th device of the driver's list, from 0.
impl fmt::Display for Renderer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Software => f.write_str("software"),
            Self::Gl(GlDevice::Auto) => f.write_str("gl"),
            Self::Gl(GlDevice::Index(index)) => write!(f, "gl:{index}"),
        }
    }
}

/// Parses the output of [`Display`](fmt::Display); the error lists the valid forms.
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

/// A renderer that is ready to draw. It cannot leave the thread that opened it:
///
/// ```compile_fail,E0277
/// let drawer = sim::Drawer::Software;
/// std::thread::spawn(move || drop(drawer));
/// ```
///
/// The canvases of an environment share ownership of the OpenGL context, so a drawer may
/// be dropped at any time.
pub enum Drawer {
    Software,
    Gl(Rc<GlContext>),
}

impl Drawer {
    pub fn open(renderer: Renderer) -> Result<Self, SimError> {
        match renderer {
            Renderer::Software => Ok(Self::Software),
            Renderer::Gl(device) => GlContext::open(device).map(Self::Gl),
        }
    }

    /// Name with version: `rollout-raster 2`, or the driver's, for example `llvmpipe (…)`.
    pub fn name(&self) -> &str {
        match self {
            Self::Software => raster::NAME,
            Self::Gl(context) => context.renderer(),
        }
    }
}

pub(crate) struct LazyDrawer {
    renderer: Renderer,
    drawer: Option<Drawer>,
}

impl LazyDrawer {
    pub(crate) fn new(renderer: Renderer) -> Self {
        Self { renderer, drawer: None }
    }

    pub(crate) fn open(&mut self) -> Result<&Drawer, SimError> {
        let drawer = match self.drawer.take() {
            Some(drawer) => drawer,
            None => Drawer::open(self.renderer)?,
        };
        Ok(self.drawer.insert(drawer))
    }
}

pub(crate) enum Canvas {
    Software(Box<SoftwareCanvas>),
    Gl(ThreadBound<GlCanvas>),
}

impl Canvas {
    /// Creates a canvas for pictures up to this size, pixels.
    pub(crate) fn new(
        drawer: &Drawer,
        model: &mut Model,
        prepared: impl FnOnce(&Model) -> Result<Arc<Prepared>, SimError>,
        [width, height]: [u32; 2],
    ) -> Result<Self, SimError> {
        match drawer {
            Drawer::Software => {
                let canvas = SoftwareCanvas::new(model, prepared(model)?);
                Ok(Self::Software(Box::new(canvas)))
            }
            Drawer::Gl(context) => {
                model.grow_offscreen_buffer(width, height);
                let upload = |model: &Model| GlCanvas::new(context, model, width, height);
                let canvas = match model.lacks_texels() {
                    true => {
                        let texels = prepared(model)?.texels(model);
                        model.with_texels(&texels, upload)?
                    }
                    false => upload(model)?,
                };
                Ok(Self::Gl(ThreadBound::new(canvas)))
            }
        }
    }

    pub(crate) fn is_usable_for(&self, drawer: &Drawer, width: u32, height: u32) -> bool {
        match (self, drawer) {
            (Self::Software(_), Drawer::Software) => true,
            (Self::Gl(canvas), Drawer::Gl(context)) => {
                canvas.get().is_some_and(|canvas| canvas.is_usable_for(context, [width, height]))
            }
            _ => false,
        }
    }

    /// Renders a camera of the model as 8-bit RGB; rows from bottom to top.
    pub(crate) fn draw(&mut self, view: View<'_>) -> Result<Vec<u8>, SimError> {
        match self {
            Self::Software(canvas) => canvas.draw(view),
            Self::Gl(canvas) => canvas.get_mut().draw(view),
        }
    }

    /// Renders depths as in OpenGL: 0 near, 1 far; rows from bottom to top.
    pub(crate) fn depth(&mut self, view: View<'_>) -> Result<Vec<f32>, SimError> {
        match self {
            Self::Software(canvas) => canvas.depth(view),
            Self::Gl(canvas) => canvas.get_mut().depth(view),
        }
    }

    /// Renders the object at the centre of each pixel; rows from bottom to top.
    pub(crate) fn segmentation(
        &mut self,
        view: View<'_>,
    ) -> Result<Vec<Option<Segment>>, SimError> {
        match self {
            Self::Software(canvas) => canvas.segmentation(view),
            Self::Gl(canvas) => canvas.get_mut().segmentation(view),
        }
    }
}

pub(crate) struct View<'a> {
    pub(crate) model: &'a Model,
    pub(crate) data: &'a mut Data,
    pub(crate) camera: usize,
    /// Width and height, pixels.
    pub(crate) size: [u32; 2],
}

#[cfg(test)]
mod tests {
    use std::panic::{AssertUnwindSafe, catch_unwind};

    use super::*;
    use crate::mujoco::{Data, ObjectKind};

    const SCENE: &str = include_str!("fingerprint.mjcf");

    fn canvas(drawer: &Drawer, model: &mut Model) -> Canvas {
        let prepare = |model: &Model| Prepared::from_model(model).map(Arc::new);
        Canvas::new(drawer, model, prepare, [64, 48]).expect("a canvas")
    }

    fn scene() -> (Model, Data) {
        let model = Model::compile(SCENE).expect("a model");
        let mut data = Data::new(&model).expect("a state");
        data.forward(&model);
        (model, data)
    }

    fn view<'a>(model: &'a Model, data: &'a mut Data) -> View<'a> {
        View {
            camera: model.id(ObjectKind::Camera, "front").expect("a camera"),
            model,
            data,
            size: [64, 48],
        }
    }

    /// Returns two OpenGL renderers, each with its own context; `None` without OpenGL.
    fn opengl(test: &str) -> Option<[Drawer; 2]> {
        let open = || Drawer::open(Renderer::Gl(GlDevice::Auto));
        match (open(), open()) {
            (Ok(first), Ok(second)) => Some([first, second]),
            (Err(error), _) | (_, Err(error)) => {
                println!("skipped {test}: {error}");
                None
            }
        }
    }

    #[test]
    fn a_canvas_outlives_the_renderer_that_it_was_made_with() {
        let Some([drawer, _]) = opengl("a_canvas_outlives_the_renderer_that_it_was_made_with")
        else {
            return;
        };
        let (mut model, mut data) = scene();
        let mut canvas = canvas(&drawer, &mut model);
        let before = canvas.draw(view(&model, &mut data)).expect("a picture");
        assert!(before.iter().any(|channel| *channel != before[0]));
        drop(drawer);
        let after = canvas.draw(view(&model, &mut data)).expect("a picture");
        assert!(before == after, "the picture has changed");
        drop(model);
        drop(canvas);
    }

    #[test]
    fn each_canvas_is_drawn_and_freed_in_its_own_context() {
        let drawers = opengl("each_canvas_is_drawn_and_freed_in_its_own_context");
        let Some([first_drawer, second_drawer]) = drawers else {
            return;
        };
        let (mut model, mut data) = scene();
        let mut first = canvas(&first_drawer, &mut model);
        let picture = first.draw(view(&model, &mut data)).expect("a picture");
        let mut second = canvas(&second_drawer, &mut model);
        assert!(first.is_usable_for(&first_drawer, 64, 48));
        assert!(!first.is_usable_for(&second_drawer, 64, 48));
        for _ in 0..2 {
            for canvas in [&mut first, &mut second] {
                let redrawn = canvas.draw(view(&model, &mut data)).expect("a picture");
                assert!(redrawn == picture, "the picture has changed");
            }
        }
        drop(second);
        drop(second_drawer);
        let redrawn = first.draw(view(&model, &mut data)).expect("a picture");
        assert!(redrawn == picture, "the picture has changed");
    }

    #[test]
    fn a_picture_too_large_for_any_buffer_does_not_fit() {
        let Some([drawer, _]) = opengl("a_picture_too_large_for_any_buffer_does_not_fit") else {
            return;
        };
        let (mut model, _) = scene();
        let canvas = canvas(&drawer, &mut model);
        for size in [4096, i32::MAX as u32 + 1, u32::MAX] {
            assert!(!canvas.is_usable_for(&drawer, size, 48), "{size} pixels wide");
        }
    }

    #[test]
    fn no_canvas_draws_a_scene_of_another_model() {
        let mut drawers = vec![Drawer::Software];
        drawers.extend(opengl("no_canvas_draws_a_scene_of_another_model").into_iter().flatten());
        for drawer in &drawers {
            let (mut own, mut data) = scene();
            let (other, mut foreign) = scene();
            let mut canvas = canvas(drawer, &mut own);
            canvas.draw(view(&own, &mut data)).expect("a picture");
            let mut panic_message = |model: &Model, data: &mut Data| {
                let drawn = AssertUnwindSafe(|| canvas.draw(view(model, data)));
                let message = catch_unwind(drawn).expect_err("another model");
                message.downcast_ref::<&str>().copied().unwrap_or_default().to_owned()
            };
            let scene = "this scene was made for another model";
            assert_eq!(panic_message(&other, &mut foreign), scene);
            assert_eq!(panic_message(&other, &mut data), scene);
            let state = "this is a state of another model";
            assert_eq!(panic_message(&own, &mut foreign), state);
        }
    }

    #[test]
    fn renderers_are_parsed_and_displayed_in_three_forms() {
        for (text, renderer) in [
            ("software", Renderer::Software),
            ("gl", Renderer::Gl(GlDevice::Auto)),
            ("gl:1", Renderer::Gl(GlDevice::Index(1))),
        ] {
            assert_eq!(text.parse(), Ok(renderer));
            assert_eq!(renderer.to_string(), text);
        }
        for invalid in ["", "opengl", "gl:", "gl:x", "Software"] {
            let error = invalid.parse::<Renderer>().expect_err(invalid);
            assert!(error.contains("`gl:N`"), "{error}");
        }
    }
}
