//! Meshes and textures that are prepared once and shared by all canvases that draw them.

use std::sync::Arc;

use crate::error::ModelError;
use crate::mesh::Mesh;
use crate::shapes::{Quality, Shapes};
use crate::texture::Texture;

/// The meshes, planes and textures of a model, ready to be drawn.
#[derive(Debug)]
pub struct Model {
    /// Meshes, named by their place; other models may have the same.
    pub meshes: Vec<Arc<Mesh>>,
    /// Planes with a grid, named by their place.
    pub planes: Vec<Mesh>,
    /// Textures, named by their place; other models may have the same.
    pub textures: Vec<Arc<Texture>>,
    pub(crate) shapes: Shapes,
}

impl Model {
    /// A model of built-in shapes only, to be filled.
    ///
    /// # Errors
    /// If shapes cannot be made of this many pieces.
    pub fn new(quality: Quality) -> Result<Self, ModelError> {
        let Quality {
            slices,
            stacks,
            quads,
        } = quality;
        let possible =
            (3..=512).contains(&slices) && (4..=512).contains(&stacks) && (1..=64).contains(&quads);
        if !possible {
            return Err(ModelError::Quality {
                slices,
                stacks,
                quads,
            });
        }
        Ok(Self {
            meshes: Vec::new(),
            planes: Vec::new(),
            textures: Vec::new(),
            shapes: Shapes::new(quality),
        })
    }
}
