//! Matrix products with the same bits on every machine.
//!
//! `C` becomes `C + A B`. Each element of `C` is computed independently:
//!
//! 1. The inner dimension is cut into runs of [`RUN`]; the last run may be shorter.
//! 2. A run is summed from +0 in ascending order, each step a fused multiply-add.
//! 3. The run's sum is added to the element.
//!
//! Products are always added to `C`, which never holds -0. When overwriting `C`, the
//! library's AVX-512 kernel would keep a sum of -0, which underflowing products can
//! leave, while its AVX2 kernel returns +0. Adding -0 or +0 to an element other than -0
//! gives the same result.

/// Length of the runs of the inner dimension that are summed before `C` is updated. The
/// value is the library's own; the tests below fail if it changes.
const RUN: usize = 256;

/// Adds `a b` to `c`: by `matrixmultiply` if its kernel for this processor uses fused multiply-adds,
/// otherwise by a plain loop, which is slow.
pub(crate) fn add(a: Matrix<'_>, b: Matrix<'_>, c: &mut MatrixMut<'_>) {
    assert_eq!(a.columns, b.rows, "inner dimensions");
    assert_eq!((a.rows, b.columns), (c.rows, c.columns), "outer dimensions");
    #[cfg(target_arch = "x86_64")]
    let is_fused = is_x86_feature_detected!("fma") && is_x86_feature_detected!("avx2");
    #[cfg(target_arch = "aarch64")]
    let is_fused = std::arch::is_aarch64_feature_detected!("neon");
    #[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
    let is_fused = false;
    if is_fused { add_with_library(a, b, c) } else { add_plainly(a, b, c) }
}

#[derive(Debug, Clone, Copy)]
pub(crate) struct Matrix<'a> {
    values: &'a [f32],
    rows: usize,
    columns: usize,
    row_stride: usize,
    column_stride: usize,
}

impl<'a> Matrix<'a> {
    /// `values` are stored row by row.
    pub(crate) fn new(values: &'a [f32], rows: usize, columns: usize) -> Self {
        Self::with_strides(values, [rows, columns], [columns, 1])
    }

    /// Creates a view; `size` and `strides` are for rows and columns.
    pub(crate) fn with_strides(values: &'a [f32], size: [usize; 2], strides: [usize; 2]) -> Self {
        let [rows, columns] = size;
        let [row_stride, column_stride] = strides;
        assert!(rows > 0 && columns > 0, "an empty matrix: {size:?}");
        let last = (rows - 1) * row_stride + (columns - 1) * column_stride;
        assert!(last < values.len(), "{size:?} with strides {strides:?} in {}", values.len());
        Self { values, rows, columns, row_stride, column_stride }
    }

    pub(crate) fn rows(&self) -> usize {
        self.rows
    }

    pub(crate) fn columns(&self) -> usize {
        self.columns
    }

    pub(crate) fn transposed(self) -> Self {
        Self {
            rows: self.columns,
            columns: self.rows,
            row_stride: self.column_stride,
            column_stride: self.row_stride,
            ..self
        }
    }

    fn at(&self, row: usize, column: usize) -> f32 {
        self.values[row * self.row_stride + column * self.column_stride]
    }
}

/// A mutable view of a matrix with strided rows.
#[derive(Debug)]
pub(crate) struct MatrixMut<'a> {
    values: &'a mut [f32],
    rows: usize,
    columns: usize,
    row_stride: usize,
}

impl<'a> MatrixMut<'a> {
    pub(crate) fn new(values: &'a mut [f32], rows: usize, columns: usize) -> Self {
        Self::with_stride(values, [rows, columns], columns)
    }

    /// Creates a view of `size` rows and columns; rows are `row_stride` elements apart.
    pub(crate) fn with_stride(values: &'a mut [f32], size: [usize; 2], row_stride: usize) -> Self {
        let [rows, columns] = size;
        assert!(rows > 0 && columns > 0, "an empty matrix: {size:?}");
        assert!(row_stride >= columns, "rows that overlap");
        assert!(
            (rows - 1) * row_stride + columns <= values.len(),
            "{size:?} with stride {row_stride} in {}",
            values.len()
        );
        Self { values, rows, columns, row_stride }
    }
}

#[allow(unsafe_code)]
fn add_with_library(a: Matrix<'_>, b: Matrix<'_>, c: &mut MatrixMut<'_>) {
    // SAFETY: the constructors of the matrices check that every element lies in its
    // slice, and `add` checks that the sizes match. `c` is borrowed exclusively,
    // and its elements do not alias, since its rows do not overlap. Slices are at most
    // isize::MAX bytes long, and so are strides.
    unsafe {
        matrixmultiply::sgemm(
            a.rows,
            a.columns,
            b.columns,
            1.0,
            a.values.as_ptr(),
            a.row_stride as isize,
            a.column_stride as isize,
            b.values.as_ptr(),
            b.row_stride as isize,
            b.column_stride as isize,
            1.0,
            c.values.as_mut_ptr(),
            c.row_stride as isize,
            1,
        );
    }
}

fn add_plainly(a: Matrix<'_>, b: Matrix<'_>, c: &mut MatrixMut<'_>) {
    let mut sums = vec![0.0_f32; c.columns];
    for i in 0..c.rows {
        let row = &mut c.values[i * c.row_stride..][..c.columns];
        for run in (0..a.columns).step_by(RUN) {
            sums.fill(0.0);
            for k in run..a.columns.min(run + RUN) {
                let factor = a.at(i, k);
                for (j, sum) in sums.iter_mut().enumerate() {
                    *sum = factor.mul_add(b.at(k, j), *sum);
                }
            }
            for (element, sum) in row.iter_mut().zip(&sums) {
                *element += sum;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    type Add = fn(Matrix<'_>, Matrix<'_>, &mut MatrixMut<'_>);

    fn numbers(seed: u64, count: usize) -> Vec<f32> {
        // SplitMix64; exponents vary, so that the order of summation affects the bits.
        let mut state = seed;
        let mut next = move || {
            state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let z = (state ^ (state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            z ^ (z >> 31)
        };
        (0..count)
            .map(|_| {
                let unit = (next() >> 40) as f32 / (1 << 23) as f32 - 1.0;
                unit * [1.0, 1e-3, 30.0, 1e-30, 0.0][(next() % 5) as usize]
            })
            .collect()
    }

    fn bits(values: &[f32]) -> Vec<u32> {
        values.iter().map(|value| value.to_bits()).collect()
    }

    /// Computes an element by the definition in the module documentation.
    fn by_definition(a: Matrix<'_>, b: Matrix<'_>, c: f32, row: usize, column: usize) -> f32 {
        let inner: Vec<usize> = (0..a.columns).collect();
        inner.chunks(256).fold(c, |element, run| {
            let sum =
                run.iter().fold(0.0_f32, |sum, k| a.at(row, *k).mul_add(b.at(*k, column), sum));
            element + sum
        })
    }

    fn check(rows: usize, depth: usize, columns: usize, seed: u64, transposed: bool) {
        let left = numbers(seed, rows * depth);
        let right = numbers(seed + 1, depth * columns);
        let bias = numbers(seed + 2, rows);
        // Replaces -0 by +0, as the network does for its biases.
        let start: Vec<f32> = bias.iter().flat_map(|bias| vec![bias + 0.0; columns]).collect();
        let a = if transposed {
            Matrix::new(&left, depth, rows).transposed()
        } else {
            Matrix::new(&left, rows, depth)
        };
        let b = Matrix::new(&right, depth, columns);
        let compute = |add: Add| {
            let mut c = start.clone();
            add(a, b, &mut MatrixMut::new(&mut c, rows, columns));
            bits(&c)
        };
        let expected: Vec<f32> = (0..rows * columns)
            .map(|index| by_definition(a, b, start[index], index / columns, index % columns))
            .collect();
        let size = [rows, depth, columns];
        assert_eq!(compute(add_plainly), bits(&expected), "plainly, {size:?}");
        let found = compute(add);
        assert_eq!(found, bits(&expected), "on this machine, {size:?}");
    }

    #[test]
    fn products_are_sums_of_fused_steps_in_the_documented_order() {
        // The network's depths, and depths on both sides of the end of a run.
        for (index, depth) in
            [1, 27, 96, 128, 255, 256, 257, 288, 432, 512, 832, 1152].into_iter().enumerate()
        {
            check(48, depth, 40, index as u64, true);
            check(3, depth, 384, 100 + index as u64, false);
        }
        // Exceeds the library's blocks of 64 rows and 1024 columns.
        check(130, 300, 1030, 7, true);
    }

    #[test]
    fn underflow_leaves_no_negative_zero() {
        let (left, right) = ([-1e-30_f32; 256], [1e-30_f32; 256]);
        for columns in [1, 7, 8, 16, 17] {
            for rows in [1, 8, 16, 17] {
                let right = vec![right[0]; 256 * columns];
                let left = vec![left[0]; 256 * rows];
                for add in [add_plainly as Add, add] {
                    let mut c = vec![0.0; rows * columns];
                    add(
                        Matrix::new(&left, rows, 256),
                        Matrix::new(&right, 256, columns),
                        &mut MatrixMut::new(&mut c, rows, columns),
                    );
                    assert!(c.iter().all(|value| value.to_bits() == 0));
                }
            }
        }
    }

    #[test]
    fn adding_to_a_part_of_a_matrix_leaves_the_rest_unchanged() {
        let (left, right) = (numbers(1, 20 * 30), numbers(2, 30 * 9));
        let (a, b) = (Matrix::new(&left, 20, 30), Matrix::new(&right, 30, 9));
        let mut whole = vec![0.0; 20 * 9];
        add(a, b, &mut MatrixMut::new(&mut whole, 20, 9));
        let mut parts = vec![7.0; 20 * 11];
        for row in parts.chunks_mut(11) {
            row[1..10].fill(0.0);
        }
        for (first, width) in [(0, 4), (4, 5)] {
            let b = Matrix::with_strides(&right[first..], [30, width], [9, 1]);
            let mut c = MatrixMut::with_stride(&mut parts[1 + first..], [20, width], 11);
            add(a, b, &mut c);
        }
        for (part, whole) in parts.chunks(11).zip(whole.chunks(9)) {
            assert_eq!(bits(&part[1..10]), bits(whole));
            assert_eq!((part[0], part[10]), (7.0, 7.0));
        }
    }

    #[test]
    #[should_panic(expected = "in 11")]
    fn a_matrix_that_is_longer_than_its_slice_is_refused() {
        Matrix::new(&[0.0; 11], 3, 4);
    }

    #[test]
    #[should_panic(expected = "inner dimensions")]
    fn matrices_that_do_not_fit_are_refused() {
        let (a, mut c) = ([0.0; 4], [0.0; 6]);
        let (a, b) = (Matrix::new(&a, 2, 2), Matrix::new(&a, 1, 3));
        add(a, b, &mut MatrixMut::new(&mut c, 2, 3));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn products_of_any_size_equal_the_reference_bit_for_bit(
            rows in 1..40_usize,
            depth in 1..600_usize,
            columns in 1..40_usize,
            seed: u32,
            transposed: bool,
        ) {
            check(rows, depth, columns, u64::from(seed), transposed);
        }
    }
}
