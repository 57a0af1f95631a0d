//! View of a model through one of its cameras.

use crate::mujoco::{Data, Model};

/// Camera of a model, with the state and the size in which it is drawn.
pub(crate) struct View<'a> {
    pub(crate) model: &'a Model,
    /// A state of the model.
    pub(crate) data: &'a mut Data,
    /// The camera's id.
    pub(crate) camera: usize,
    /// Width and height, pixels.
    pub(crate) size: [u32; 2],
}
