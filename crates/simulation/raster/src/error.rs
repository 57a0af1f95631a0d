//! Errors of models and of frames.

/// Reason why data is not accepted into a model.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum ModelError {
    /// A texture's dimensions do not fit its bytes, or are out of range.
    #[error(
        "a texture of {width} × {height} texels with {channels} channels does not fit {bytes} \
         bytes: give 3 or 4 bytes a texel, 1 to 16384 texels a side, and cubes as one square or six"
    )]
    Texture {
        /// Width, texels.
        width: usize,
        /// Height, texels.
        height: usize,
        /// Bytes per texel.
        channels: usize,
        /// Bytes that were given.
        bytes: usize,
    },
    /// The bytes are not a prepared mesh or texture.
    #[error("these bytes are not a prepared mesh or texture: prepare the mesh or texture again")]
    Bytes,
    /// The number of pieces of a shape is out of range.
    #[error(
        "shapes of {slices} slices, {stacks} stacks and {quads} quads cannot be made: give 3 to \
         512 slices, 4 to 512 stacks and 1 to 64 quads"
    )]
    Quality {
        /// Pieces around an axis.
        slices: usize,
        /// Pieces along an axis.
        stacks: usize,
        /// Pieces along a side.
        quads: usize,
    },
}

/// Reason why a frame cannot be drawn.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum DrawError {
    /// Frame without pixels, or with too many.
    #[error("a frame of {width} × {height} pixels cannot be drawn: give 1 to 4096 a side")]
    Size {
        /// Width, pixels.
        width: usize,
        /// Height, pixels.
        height: usize,
    },
    /// The camera's view frustum is empty or invalid.
    #[error("the camera's {what} is {value}: {needed}")]
    Camera {
        /// Name of the invalid camera parameter.
        what: &'static str,
        /// Value of the parameter.
        value: f32,
        /// Requirement that the value violates.
        needed: &'static str,
    },
    /// Geom that refers to a mesh, plane or texture that the model does not have.
    #[error("geom {geom} names {what} {index}, and the model has {count}")]
    Missing {
        /// Index of the geom, in drawing order.
        geom: usize,
        /// Kind of the missing item: mesh, plane or texture.
        what: &'static str,
        /// Index of the missing item.
        index: usize,
        /// Number of such items in the model.
        count: usize,
    },
    /// Sky that refers to a texture that the model does not have.
    #[error("the sky names texture {index}, and the model has {count}")]
    MissingSky {
        /// Index of the missing texture.
        index: usize,
        /// Number of textures in the model.
        count: usize,
    },
    /// Shadow maps of invalid size.
    #[error("shadow maps of {size} × {size} texels cannot be drawn: give 3 to 16384 a side")]
    Shadows {
        /// Side of the maps, texels.
        size: usize,
    },
    /// The bytes given for a texture are not as many as its largest level has.
    #[error(
        "texture {texture} was made from {needed} bytes, and {given} are given: give the bytes \
         that the texture was made from"
    )]
    Texels {
        /// Index of the texture in the model.
        texture: usize,
        /// Bytes that were given.
        given: usize,
        /// Bytes of the texture's largest level.
        needed: usize,
    },
}
