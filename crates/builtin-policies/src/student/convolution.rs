//! Convolutions: 3 x 3 with zero padding, and 1 x 1.

use crate::student::columns::{Rows, WINDOW};
use crate::student::error::WeightsError;
use crate::student::linear::transposed;
use crate::student::product::{self, Matrix, MatrixMut};
use crate::student::weights::Tensors;

/// A convolution as a matrix, to be multiplied by the columns of its input windows.
#[derive(Debug)]
pub(crate) struct Convolution {
    /// Inputs x outputs, the layout that products read fastest. The inputs of a 3 x 3
    /// convolution are ordered by channel, then by row of the window.
    weight: Vec<f32>,
    outputs: usize,
}

impl Convolution {
    /// Reads `name.weight`, a 3 x 3 convolution.
    pub(crate) fn read_3x3(
        tensors: &mut Tensors<'_>,
        name: &str,
        channels: usize,
        outputs: usize,
    ) -> Result<Self, WeightsError> {
        let shape = [outputs, channels, 3, 3];
        Self::read(tensors, name, &shape, channels * WINDOW)
    }

    /// Reads `name.weight`, a 1 x 1 convolution.
    pub(crate) fn read_1x1(
        tensors: &mut Tensors<'_>,
        name: &str,
        channels: usize,
        outputs: usize,
    ) -> Result<Self, WeightsError> {
        Self::read(tensors, name, &[outputs, channels, 1, 1], channels)
    }

    fn read(
        tensors: &mut Tensors<'_>,
        name: &str,
        shape: &[usize; 4],
        inputs: usize,
    ) -> Result<Self, WeightsError> {
        let weight = tensors.half(&format!("{name}.weight"), shape)?;
        Ok(Self { weight: transposed(&weight, shape[0], inputs), outputs: shape[0] })
    }

    pub(crate) fn outputs(&self) -> usize {
        self.outputs
    }

    /// Adds the contribution of `rows` to `planes`, which has a plane per output channel.
    pub(crate) fn add(&self, rows: Rows<'_>, planes: &mut [f32]) {
        let Rows { columns, input, place } = rows;
        let weight = &self.weight[input * self.outputs..];
        let weight = Matrix::new(weight, columns.rows(), self.outputs).transposed();
        let stride = planes.len() / self.outputs;
        let size = [self.outputs, columns.columns()];
        let mut sums = MatrixMut::with_stride(&mut planes[place..], size, stride);
        product::add(weight, columns, &mut sums);
    }
}
