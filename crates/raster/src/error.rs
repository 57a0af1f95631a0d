//! What cannot be drawn, and why.

/// Why something is no part of a model.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum ModelError {
    /// A texture whose numbers do not fit one another.
    #[error(
        "a texture of {width} × {height} texels with {channels} channels does not fit {bytes} \
         bytes: give 3 or 4 bytes a texel, 1 to 16384 texels a side, and cubes as one square or six"
    )]
    Texture {
        /// Texels.
        width: usize,
        /// Texels.
        height: usize,
        /// Bytes a texel.
        channels: usize,
        /// Bytes that were given.
        bytes: usize,
    },
    /// Bytes that no mesh or texture was written as.
    #[error("these bytes are of no prepared mesh or texture: prepare it again")]
    Bytes,
    /// Shapes of no pieces.
    #[error(
        "shapes of {slices} slices, {stacks} stacks and {quads} quads cannot be made: give 3 to 512 slices, 4 to 512 stacks and 1 to 64 quads"
    )]
    Quality {
        /// Around an axis.
        slices: usize,
        /// Along an axis.
        stacks: usize,
        /// Along a side.
        quads: usize,
    },
}

/// Why a frame cannot be drawn.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum DrawError {
    /// A frame without pixels, or with too many.
    #[error("a frame of {width} × {height} pixels cannot be drawn: give 1 to 4096 a side")]
    Size {
        /// Pixels.
        width: usize,
        /// Pixels.
        height: usize,
    },
    /// A camera that sees no space.
    #[error("the camera's {what} is {value}: {needed}")]
    Camera {
        /// Which of its numbers.
        what: &'static str,
        /// That number.
        value: f32,
        /// What it must be.
        needed: &'static str,
    },
    /// A thing that names what the model does not have.
    #[error("geom {geom} names {what} {index}, and the model has {count}")]
    Missing {
        /// Which thing, in drawing order.
        geom: usize,
        /// Of which kind: mesh, plane or texture.
        what: &'static str,
        /// Its number.
        index: usize,
        /// How many there are.
        count: usize,
    },
    /// A texture without the bytes that it was made from.
    #[error(
        "texture {texture} was made from {needed} bytes, and {given} are given: give the same ones"
    )]
    Texels {
        /// Its place in the model.
        texture: usize,
        /// Bytes that were given.
        given: usize,
        /// Bytes of its largest level.
        needed: usize,
    },
}
