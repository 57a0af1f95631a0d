//! im2col: turns a convolution into a matrix product. Each column holds the inputs of one
//! position of the output.

use std::ops::Range;

use crate::student::product::Matrix;

/// Square planes of numbers, one per channel.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Planes<'a> {
    /// Values by channel, then in row-major order.
    pub(crate) values: &'a [f32],
    pub(crate) side: usize,
}

/// Number of matrix rows per channel: the positions in a 3 x 3 window.
pub(crate) const WINDOW: usize = 9;
/// Matrix row of the centre of the window.
const MIDDLE: usize = 4;
/// Number of output positions gathered at a time.
const PLACES: usize = 256;
/// Number of channels gathered at a time; with [`PLACES`] small enough for the columns to fit in
/// the level-2 cache. The bits of the result depend on this number, because the channels gathered
/// at a time form one run of the product.
const CHANNELS: usize = 16;

/// Columns of a range of output positions, for a range of input channels.
#[derive(Debug)]
pub(crate) struct Part<'a> {
    columns: &'a [f32],
    channels: Range<usize>,
    places: Range<usize>,
}

/// Block of the column matrix, to be multiplied by a convolution's weights.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rows<'a> {
    pub(crate) columns: Matrix<'a>,
    /// Index of the first row among the convolution's inputs.
    pub(crate) input: usize,
    /// Index of the first column among the positions of the output.
    pub(crate) place: usize,
}

impl Part<'_> {
    /// Returns the rows for a 3 x 3 convolution: one per channel and position in the window.
    pub(crate) fn windows(&self) -> Rows<'_> {
        let inputs = self.channels.len() * WINDOW;
        Rows {
            columns: Matrix::new(self.columns, inputs, self.places.len()),
            input: self.channels.start * WINDOW,
            place: self.places.start,
        }
    }

    /// Returns the rows for a 1 x 1 convolution, which are the centres of the windows: one per
    /// channel.
    pub(crate) fn middles(&self) -> Rows<'_> {
        let places = self.places.len();
        let middles = &self.columns[MIDDLE * places..];
        let size = [self.channels.len(), places];
        Rows {
            columns: Matrix::with_strides(middles, size, [WINDOW * places, 1]),
            input: self.channels.start,
            place: self.places.start,
        }
    }
}

/// Scratch memory for gathered columns, reused by all convolutions.
#[derive(Debug, Default)]
pub(crate) struct ColumnBuffers {
    columns: Vec<f32>,
    phases: Vec<f32>,
}

/// Calls `each` with all columns of a convolution, part by part. For each position, the
/// channels come in ascending order.
pub(crate) fn each_part(
    planes: Planes<'_>,
    stride: usize,
    buffers: &mut ColumnBuffers,
    mut each: impl FnMut(Part<'_>),
) {
    let side = planes.side / stride;
    if stride > 1 {
        split(planes, stride, &mut buffers.phases);
    }
    let phases =
        Phases { values: if stride > 1 { &buffers.phases } else { planes.values }, side, stride };
    for rows in ranges(side, (PLACES / side).max(1)) {
        for channels in ranges(phases.channels(), CHANNELS) {
            gather(phases, channels.clone(), rows.clone(), &mut buffers.columns);
            each(Part {
                columns: &buffers.columns,
                channels,
                places: rows.start * side..rows.end * side,
            });
        }
    }
}

/// The last range may be shorter than `step`.
fn ranges(end: usize, step: usize) -> impl Iterator<Item = Range<usize>> {
    let range = move |first| first..end.min(first + step);
    (0..end).step_by(step).map(range)
}

/// Planes split into stride² phases: for stride 2, even rows and even columns, even rows and
/// odd columns, odd rows and even columns, odd rows and odd columns. The inputs at one
/// position of the sliding window are then a single phase, shifted by at most one row or
/// column.
#[derive(Debug, Clone, Copy)]
struct Phases<'a> {
    values: &'a [f32],
    /// Side of a phase, equal to that of the output.
    side: usize,
    stride: usize,
}

impl<'a> Phases<'a> {
    fn channels(&self) -> usize {
        self.values.len() / (self.side * self.side * self.stride * self.stride)
    }

    /// Returns the values of a channel at the window's row `y` and column `x`: their
    /// phase, and its shift in rows down and in columns to the right.
    fn input_values(&self, channel: usize, y: usize, x: usize) -> (&'a [f32], isize, isize) {
        let stride = self.stride;
        let divide = |index: usize| {
            // The first row and column of the window are one before those of its centre.
            let offset = index as isize - 1;
            let phase = offset.rem_euclid(stride as isize) as usize;
            (phase, offset.div_euclid(stride as isize))
        };
        let ((row, down), (column, right)) = (divide(y), divide(x));
        let phase = (channel * stride + row) * stride + column;
        let size = self.side * self.side;
        (&self.values[phase * size..][..size], down, right)
    }
}

fn split(planes: Planes<'_>, stride: usize, phases: &mut Vec<f32>) {
    let side = planes.side / stride;
    let size = side * side;
    phases.resize(planes.values.len(), 0.0);
    let channels = phases.chunks_exact_mut(size * stride * stride);
    let planes = planes.values.chunks_exact(planes.side * planes.side);
    for (plane, phases) in planes.zip(channels) {
        for (row, line) in plane.chunks_exact(side * stride).enumerate() {
            for column in 0..stride {
                let phase = row % stride * stride + column;
                let to = &mut phases[phase * size + row / stride * side..][..side];
                for (value, from) in to.iter_mut().zip(line.chunks_exact(stride)) {
                    *value = from[column];
                }
            }
        }
    }
}

/// Fills `columns` for a range of channels and the positions in `rows` of the output. For each
/// channel, matrix row `3 * y + x` of nine holds the inputs at the window's row `y` and column
/// `x` for every position; zero beyond the border.
fn gather(phases: Phases<'_>, channels: Range<usize>, rows: Range<usize>, columns: &mut Vec<f32>) {
    let places = rows.len() * phases.side;
    columns.resize(channels.len() * WINDOW * places, 0.0);
    for (channel, window) in channels.zip(columns.chunks_exact_mut(WINDOW * places)) {
        for (offset, values) in window.chunks_exact_mut(places).enumerate() {
            let (phase, down, right) = phases.input_values(channel, offset / 3, offset % 3);
            shift(phase, phases.side, rows.start, down, right, values);
        }
    }
}

/// Fills `values` with the rows of `phase` from `first + down` on, shifted left by `right`
/// columns, with zeros beyond the border.
fn shift(phase: &[f32], side: usize, first: usize, down: isize, right: isize, values: &mut [f32]) {
    // Copies all rows at once. This leaves a value of an adjacent row at the left or right
    // edge, which is overwritten below.
    let from = (first as isize + down) * side as isize + right;
    let before = usize::try_from(-from).unwrap_or(0).min(values.len());
    let from = usize::try_from(from).unwrap_or(0).min(phase.len());
    let count = (values.len() - before).min(phase.len() - from);
    values[..before].fill(0.0);
    values[before..before + count].copy_from_slice(&phase[from..from + count]);
    values[before + count..].fill(0.0);
    let edge = match right {
        -1 => 0,
        0 => return,
        _ => side - 1,
    };
    for line in values.chunks_exact_mut(side) {
        line[edge] = 0.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Reference implementation by definition, with zero padding.
    fn expected(planes: Planes<'_>, channels: usize, stride: usize) -> Vec<f32> {
        let (side, out) = (planes.side as isize, planes.side / stride);
        let mut columns = Vec::new();
        for channel in 0..channels {
            for offset in 0..9 {
                for place in 0..out * out {
                    let y = (place / out * stride + offset / 3) as isize - 1;
                    let x = (place % out * stride + offset % 3) as isize - 1;
                    let is_inside = (0..side).contains(&y) && (0..side).contains(&x);
                    let at = channel as isize * side * side + y * side + x;
                    columns.push(if is_inside { planes.values[at as usize] } else { 0.0 });
                }
            }
        }
        columns
    }

    #[test]
    fn columns_hold_the_values_of_each_window() {
        let values: Vec<f32> = (1..=3 * 8 * 8).map(|value| value as f32).collect();
        let planes = Planes { values: &values, side: 8 };
        for stride in [1, 2] {
            let side = 8 / stride;
            let all_columns = expected(planes, 3, stride);
            let mut split_planes = Vec::new();
            split(planes, stride, &mut split_planes);
            let phases = Phases { values: &split_planes, side, stride };
            // Stale contents from an earlier use.
            let mut found = vec![9.0; 1000];
            gather(phases, 0..3, 0..side, &mut found);
            assert_eq!(found, all_columns, "stride {stride}");
            for rows in [0..1, 1..3, side - 1..side] {
                gather(phases, 1..3, rows.clone(), &mut found);
                let lines = all_columns.chunks(side * side).skip(WINDOW);
                let part = |line: &[f32]| line[rows.start * side..rows.end * side].to_vec();
                let part: Vec<f32> = lines.flat_map(part).collect();
                assert_eq!(found, part, "stride {stride}, rows {rows:?}");
            }
        }
    }
}
