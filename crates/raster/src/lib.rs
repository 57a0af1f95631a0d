//! Software renderer that reproduces the pictures of MuJoCo's renderer: triangles, lights, shadows,
//! textures, mirrors and translucency, as MuJoCo draws them through Mesa's software OpenGL, with
//! the same bits on every machine. The crate depends on neither OpenGL nor MuJoCo. A [`Model`] is
//! prepared once; a [`Scene`] is drawn on a [`Canvas`].
//!
//! Every operation is an IEEE 754 operation in a fixed order: sums, products, quotients, square
//! roots, and explicit fused multiply-adds. No approximate instruction is used, and no result
//! depends on the processor's vector width.

#![forbid(unsafe_code)]

mod backdrop;
mod candidates;
mod canvas;
mod cast;
mod clip;
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
mod positions;
mod raster;
mod sample;
mod scene;
mod setup;
mod shade;
mod shadow;
mod shapes;
mod surface;
mod texture;
mod values;
mod visible;
mod window;

pub use canvas::{Canvas, segments};
pub use error::{DrawError, ModelError};
pub use mesh::{Corner, Mesh, MeshBuilder};
pub use model::Model;
pub use scene::{Camera, Geom, Light, LightKind, Scene, Shadows, Shape, TextureUse};
pub use shapes::{Quality, mesh_triangle, plane, plane_grid};
pub use texture::{Texture, TextureKind};

/// Name and version of the renderer. The version changes whenever any bit of any frame of any scene
/// changes.
pub const NAME: &str = "rollout-raster 2";

/// Digest of this crate's sources. Serialised models are only valid for the sources that wrote
/// them, and are prepared again otherwise.
pub const SOURCES: &str = env!("RASTER_SOURCES");
