use crate::student::error::WeightsError;
use crate::student::product::{Matrix, MatrixMut, add};
use crate::student::weights::Tensors;

/// `y = W x + b`.
#[derive(Debug)]
pub(crate) struct Linear {
    /// Inputs x outputs, the layout that products read fastest.
    weight: Vec<f32>,
    bias: Vec<f32>,
    inputs: usize,
    outputs: usize,
}

impl Linear {
    /// Reads `name.weight` and `name.bias`.
    pub(crate) fn read(
        tensors: &mut Tensors<'_>,
        name: &str,
        inputs: usize,
        outputs: usize,
    ) -> Result<Self, WeightsError> {
        let weight = tensors.half(&format!("{name}.weight"), &[outputs, inputs])?;
        Ok(Self {
            weight: transposed(&weight, outputs, inputs),
            bias: tensors.half(&format!("{name}.bias"), &[outputs])?,
            inputs,
            outputs,
        })
    }

    /// Returns a row of outputs for each row of `inputs`; there is a row per query.
    pub(crate) fn apply(&self, inputs: &[f32]) -> Vec<f32> {
        let rows = inputs.len() / self.inputs;
        let mut outputs = self.bias.repeat(rows);
        add(
            Matrix::new(inputs, rows, self.inputs),
            Matrix::new(&self.weight, self.inputs, self.outputs),
            &mut MatrixMut::new(&mut outputs, rows, self.outputs),
        );
        outputs
    }

    pub(crate) fn apply_relu(&self, inputs: &[f32]) -> Vec<f32> {
        let mut outputs = self.apply(inputs);
        for value in &mut outputs {
            *value = relu(*value);
        }
        outputs
    }
}

/// Clamps negative numbers to zero. NaN is preserved, so that it reaches the output.
#[inline]
pub(crate) fn relu(value: f32) -> f32 {
    if value < 0.0 { 0.0 } else { value }
}

pub(crate) fn transposed(values: &[f32], rows: usize, columns: usize) -> Vec<f32> {
    let column = |j: usize| (0..rows).map(move |i| values[i * columns + j]);
    (0..columns).flat_map(column).collect()
}
