//! Weights file: reads its tensors and checks that they match the network.

use std::collections::BTreeSet;

use half::f16;
use safetensors::{Dtype, SafeTensors};

use crate::student::error::WeightsError;

/// Values of `format` in the metadata: for networks that locate points on a grid of 16 x 16,
/// and for those with a grid of 32 x 32 and a wider head.
const COARSE: &str = "rollout-student/1";
const FINE: &str = "rollout-student/2";

/// Tensors of a file; each must be taken by a layer.
#[derive(Debug)]
pub(crate) struct Tensors<'a> {
    file: SafeTensors<'a>,
    name: String,
    /// Look of the frames that the network was trained on.
    look: Option<String>,
    is_fine: bool,
    /// Names of the tensors not taken so far.
    remaining: BTreeSet<String>,
    parameters: usize,
}

impl<'a> Tensors<'a> {
    pub(crate) fn open(bytes: &'a [u8]) -> Result<Self, WeightsError> {
        let unreadable = |_| WeightsError::Unreadable { bytes: bytes.len() };
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(unreadable)?;
        let file = SafeTensors::deserialize(bytes).map_err(unreadable)?;
        let entry = |key: &str| header.metadata().as_ref()?.get(key).cloned();
        let found = entry("format");
        let is_fine = match found.as_deref() {
            Some(COARSE) => false,
            Some(FINE) => true,
            _ => {
                return Err(WeightsError::Format { found, expected: [COARSE, FINE] });
            }
        };
        let name = entry("name").filter(|name| !name.is_empty());
        Ok(Self {
            name: name.ok_or(WeightsError::Name)?,
            look: entry("look"),
            remaining: file.names().into_iter().map(str::to_owned).collect(),
            file,
            is_fine,
            parameters: 0,
        })
    }

    pub(crate) fn name(&self) -> &str {
        &self.name
    }

    pub(crate) fn look(&self) -> Option<&str> {
        self.look.as_deref()
    }

    /// Returns true for a grid of 32 x 32 and a wide head.
    pub(crate) fn is_fine(&self) -> bool {
        self.is_fine
    }

    pub(crate) fn parameters(&self) -> usize {
        self.parameters
    }

    /// Takes a trained tensor, which is stored in half precision.
    pub(crate) fn half(&mut self, tensor: &str, shape: &[usize]) -> Result<Vec<f32>, WeightsError> {
        let data = self.take(tensor, shape, Dtype::F16, "F16")?;
        let (halves, _) = data.as_chunks();
        let values = halves.iter().map(|half| f16::from_le_bytes(*half).to_f32());
        let values = finite(tensor, values)?;
        self.parameters += values.len();
        Ok(values)
    }

    /// Takes a tensor stored in single precision.
    pub(crate) fn single(
        &mut self,
        tensor: &str,
        shape: &[usize],
    ) -> Result<Vec<f32>, WeightsError> {
        let data = self.take(tensor, shape, Dtype::F32, "F32")?;
        let (singles, _) = data.as_chunks();
        finite(tensor, singles.iter().copied().map(f32::from_le_bytes))
    }

    /// Checks that all tensors were taken.
    pub(crate) fn finish(self) -> Result<(), WeightsError> {
        match self.remaining.into_iter().next() {
            Some(tensor) => Err(WeightsError::Unknown { tensor }),
            None => Ok(()),
        }
    }

    fn take(
        &mut self,
        tensor: &str,
        shape: &[usize],
        dtype: Dtype,
        kind: &'static str,
    ) -> Result<&'a [u8], WeightsError> {
        let view = self.file.tensor(tensor);
        let view = view.map_err(|_| WeightsError::Missing {
            tensor: tensor.to_owned(),
            expected: shape.to_vec(),
            kind,
        })?;
        if view.shape() != shape {
            return Err(WeightsError::Shape {
                tensor: tensor.to_owned(),
                found: view.shape().to_vec(),
                expected: shape.to_vec(),
            });
        }
        if view.dtype() != dtype {
            return Err(WeightsError::Type {
                tensor: tensor.to_owned(),
                found: view.dtype().to_string(),
                expected: kind,
            });
        }
        self.remaining.remove(tensor);
        Ok(view.data())
    }
}

/// Collects values and checks that they are finite. Replaces -0 by +0: products are added to
/// biases, and `product` requires that these sums do not start from -0.
fn finite(
    tensor: &str,
    values: impl ExactSizeIterator<Item = f32>,
) -> Result<Vec<f32>, WeightsError> {
    let mut found = Vec::with_capacity(values.len());
    for (place, value) in values.enumerate() {
        if !value.is_finite() {
            return Err(WeightsError::NotFinite {
                tensor: tensor.to_owned(),
                place,
                value: value.to_string(),
            });
        }
        found.push(value + 0.0);
    }
    Ok(found)
}
