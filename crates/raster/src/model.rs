//! Meshes and textures that are prepared once and shared by all canvases that draw them.

use std::sync::Arc;

use crate::error::ModelError;
use crate::mesh::Mesh;
use crate::shapes::{Quality, Shapes};
use crate::texture::Texture;

/// Meshes, planes and textures of a model, ready to be drawn.
#[derive(Debug)]
pub struct Model {
    /// Meshes, by index; may be shared with other models.
    pub meshes: Vec<Arc<Mesh>>,
    /// Planes, each subdivided into a grid of triangles, by index.
    pub planes: Vec<Mesh>,
    /// Textures, by index; may be shared with other models.
    pub textures: Vec<Arc<Texture>>,
    pub(crate) shapes: Shapes,
}

impl Model {
    /// Creates a model with only built-in shapes.
    pub fn new(quality: Quality) -> Result<Self, ModelError> {
        let Quality { slices, stacks, quads } = quality;
        let is_in_range =
            (3..=512).contains(&slices) && (4..=512).contains(&stacks) && (1..=64).contains(&quads);
        if !is_in_range {
            return Err(ModelError::Quality { slices, stacks, quads });
        }
        Ok(Self {
            meshes: Vec::new(),
            planes: Vec::new(),
            textures: Vec::new(),
            shapes: Shapes::new(quality),
        })
    }
}
