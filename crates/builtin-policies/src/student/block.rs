//! A residual block, modulated by the text embedding (FiLM).

use crate::student::columns::{self, ColumnBuffers, Planes};
use crate::student::convolution::Convolution;
use crate::student::error::WeightsError;
use crate::student::linear::Linear;
use crate::student::norm::{Film, GroupNorm};
use crate::student::weights::Tensors;

/// Two 3 x 3 convolutions and a 1 x 1 shortcut.
#[derive(Debug)]
pub(crate) struct Block {
    stride: usize,
    conv1: Convolution,
    norm1: GroupNorm,
    /// Layer that maps the text to each channel's factor − 1 and shift.
    pub(crate) film: Linear,
    conv2: Convolution,
    norm2: GroupNorm,
    skip: Convolution,
}

/// Scratch memory for intermediate values, reused by all blocks.
#[derive(Debug, Default)]
pub(crate) struct Workspace {
    pub(crate) buffers: ColumnBuffers,
    hidden: Vec<f32>,
    skipped: Vec<f32>,
}

#[derive(Debug, Clone, Copy)]
pub(crate) struct Shape {
    pub(crate) inputs: usize,
    pub(crate) outputs: usize,
    /// Stride of the first convolution: 2 halves the sides, 1 keeps them.
    pub(crate) stride: usize,
}

impl Block {
    /// Reads the tensors with the prefix `name`. `text` is the width of the text embedding that
    /// modulates the block.
    pub(crate) fn read(
        tensors: &mut Tensors<'_>,
        name: &str,
        shape: Shape,
        text: usize,
    ) -> Result<Self, WeightsError> {
        let Shape { inputs, outputs, stride } = shape;
        let part = |part: &str| format!("{name}.{part}");
        Ok(Self {
            stride,
            conv1: Convolution::read_3x3(tensors, &part("conv1"), inputs, outputs)?,
            norm1: GroupNorm::read(tensors, &part("norm1"), outputs)?,
            film: Linear::read(tensors, &part("film"), text, 2 * outputs)?,
            conv2: Convolution::read_3x3(tensors, &part("conv2"), outputs, outputs)?,
            norm2: GroupNorm::read(tensors, &part("norm2"), outputs)?,
            skip: Convolution::read_1x1(tensors, &part("skip"), inputs, outputs)?,
        })
    }

    pub(crate) fn apply(
        &self,
        input: Planes<'_>,
        film: Film<'_>,
        work: &mut Workspace,
        output: &mut Vec<f32>,
    ) {
        let side = input.side / self.stride;
        let size = self.conv1.outputs() * side * side;
        zeros(&mut work.hidden, size);
        zeros(&mut work.skipped, size);
        columns::each_part(input, self.stride, &mut work.buffers, |part| {
            let (hidden, skipped) = (&mut work.hidden, &mut work.skipped);
            self.conv1.add(part.windows(), hidden);
            self.skip.add(part.middles(), skipped);
        });
        self.norm1.film_relu(&mut work.hidden, film);
        zeros(output, size);
        let hidden = Planes { values: &work.hidden, side };
        columns::each_part(hidden, 1, &mut work.buffers, |part| {
            self.conv2.add(part.windows(), output);
        });
        self.norm2.add_relu(output, &work.skipped);
    }
}

pub(crate) fn zeros(values: &mut Vec<f32>, size: usize) {
    values.clear();
    values.resize(size, 0.0);
}
