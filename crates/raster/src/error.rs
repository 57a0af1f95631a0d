#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum ModelError {
    #[error(
        "a texture of {width} × {height} texels with {channels} channels does not fit {bytes} \
         bytes: give 3 or 4 bytes a texel, 1 to 16384 texels a side, and cubes as one square or six"
    )]
    Texture { width: usize, height: usize, channels: usize, bytes: usize },
    #[error("these bytes are not a prepared mesh or texture: prepare the mesh or texture again")]
    Bytes,
    #[error(
        "shapes of {slices} slices, {stacks} stacks and {quads} quads cannot be made: give 3 to \
         512 slices, 4 to 512 stacks and 1 to 64 quads"
    )]
    Quality { slices: usize, stacks: usize, quads: usize },
}

#[derive(Debug, thiserror::Error, PartialEq)]
pub enum DrawError {
    #[error("a frame of {width} × {height} pixels cannot be drawn: give 1 to 4096 a side")]
    Size { width: usize, height: usize },
    #[error("the camera's {what} is {value}: {needed}")]
    Camera { what: &'static str, value: f32, needed: &'static str },
    #[error("geom {geom} names {what} {index}, and the model has {count}")]
    Missing {
        /// Index of the geom, in drawing order.
        geom: usize,
        /// Kind of the missing item: mesh, plane or texture.
        what: &'static str,
        index: usize,
        count: usize,
    },
    #[error("the sky names texture {index}, and the model has {count}")]
    MissingSky { index: usize, count: usize },
    #[error("shadow maps of {size} × {size} texels cannot be drawn: give 3 to 16384 a side")]
    Shadows { size: usize },
    #[error(
        "texture {texture} was made from {needed} bytes, and {given} are given: give the bytes \
         that the texture was made from"
    )]
    Texels { texture: usize, given: usize, needed: usize },
}
