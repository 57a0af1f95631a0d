//! MuJoCo's classic look, drawn in software: triangles, lights, textures,
//! mirrors and glass, as MuJoCo's renderer draws them through Mesa's software
//! OpenGL, with the same bits on every machine. No OpenGL, no MuJoCo: a
//! [`Model`] is prepared once, a [`Scene`] is drawn on a [`Canvas`].
//!
//! Every operation is one of IEEE 754's, in a stated order: sums, products,
//! quotients, square roots, and fused multiply-adds where they are called so.
//! None is approximate, none depends on how many lanes a processor has.

#![forbid(unsafe_code)]

mod backdrop;
mod candidates;
mod canvas;
mod clip;
mod drawing;
mod error;
mod fill;
mod frustum;
mod glass;
mod instance;
mod lanes;
mod light;
mod matrix;
mod mesh;
mod mirror;
mod model;
mod picture;
mod place;
mod positions;
mod raster;
mod sample;
mod scene;
mod segments;
mod setup;
mod shade;
mod shapes;
mod surface;
mod texture;
mod values;
mod visible;
mod window;

pub use canvas::Canvas;
pub use error::{DrawError, ModelError};
pub use mesh::{Corner, Mesh, MeshBuilder};
pub use model::Model;
pub use scene::{Camera, Geom, Light, LightKind, Scene, Shape, TextureUse};
pub use segments::segments;
pub use shapes::{Quality, mesh_triangle, plane, plane_grid};
pub use texture::{Texture, TextureKind};

/// This renderer and its version, which changes whenever any frame of any scene
/// changes by a bit.
pub const NAME: &str = "rollout-raster 2";

/// Digest of this crate's sources: models that are kept as bytes are read by the code that
/// prepared them, or prepared again.
pub const SOURCES: &str = env!("RASTER_SOURCES");
