//! What is to be drawn.

use crate::mujoco::{Data, Model};

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
