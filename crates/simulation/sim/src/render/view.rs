//! View of a model through one of its cameras.

use crate::mujoco::{Data, Model};

/// A camera of a model, with the state and the picture size to render.
pub(crate) struct View<'a> {
    pub(crate) model: &'a Model,
    /// State of the model.
    pub(crate) data: &'a mut Data,
    pub(crate) camera: usize,
    /// Width and height, pixels.
    pub(crate) size: [u32; 2],
}
