//! Reduces the detail of frames: scales them down and up again with the filters of common
//! libraries. Pure functions.

use std::fmt;

use proto::policy::Image;

use crate::doctor::situation::resized;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Filter {
    /// Bilinear filter, as in Pillow and TensorFlow.
    Bilinear,
    /// Mean of the covered pixels, then repetition.
    Mean,
    /// Nearest pixel, then repetition.
    Nearest,
}

impl Filter {
    pub(super) const ALL: [Self; 3] = [Self::Bilinear, Self::Mean, Self::Nearest];

    /// Scales a frame to a smaller size, and back.
    pub(super) fn apply(self, [width, height]: [u32; 2], image: &mut Image) {
        if self == Self::Bilinear {
            let small = resized(image, width, height);
            *image = resized(&small, image.width, image.height);
            return;
        }
        let (large, small) = ([image.width, image.height], [width, height]);
        let (large, small) =
            (large.map(|number| number as usize), small.map(|number| number as usize));
        if image.rgb.len() != 3 * large[0] * large[1] {
            return;
        }
        // `cell` is the small frame's cell that covers a position of the large frame; `positions`
        // are those of the large frame that a cell is computed from.
        let cell = |index: usize, axis: usize| (2 * index + 1) * small[axis] / (2 * large[axis]);
        let begin = |cell: usize, axis: usize| cell * large[axis] / small[axis];
        let positions = |cell: usize, axis: usize| match self {
            Self::Nearest => {
                let middle = (2 * cell + 1) * large[axis] / (2 * small[axis]);
                middle..middle + 1
            }
            _ => begin(cell, axis)..begin(cell + 1, axis),
        };
        let mean = |column: usize, row: usize, channel: usize| {
            let (columns, rows) = (positions(column, 0), positions(row, 1));
            let count = columns.len() * rows.len();
            let levels = rows.flat_map(|row| {
                let line = row * large[0];
                columns.clone().map(move |column| 3 * (line + column) + channel)
            });
            let sum: usize = levels.map(|index| usize::from(image.rgb[index])).sum();
            ((sum + count / 2) / count) as u8
        };
        let mut cells = Vec::with_capacity(3 * small[0] * small[1]);
        for row in 0..small[1] {
            for column in 0..small[0] {
                cells.extend((0..3).map(|channel| mean(column, row, channel)));
            }
        }
        let mut restored = Vec::with_capacity(image.rgb.len());
        for row in 0..large[1] {
            for column in 0..large[0] {
                let index = 3 * (cell(row, 1) * small[0] + cell(column, 0));
                restored.extend_from_slice(&cells[index..index + 3]);
            }
        }
        image.rgb = restored.into();
    }
}

impl fmt::Display for Filter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Bilinear => "bilinear",
            Self::Mean => "means of pixels",
            Self::Nearest => "nearest pixels",
        })
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub(crate) fn image(rgb: &[u8]) -> Image {
        Image {
            camera: "agentview".to_owned(),
            width: 2,
            height: 2,
            rgb: rgb.iter().flat_map(|value| [*value; 3]).collect::<Vec<u8>>().into(),
        }
    }

    #[test]
    fn mean_and_nearest_filters_scale_a_frame_down_and_back() {
        for (filter, expected) in [(Filter::Mean, [2; 4]), (Filter::Nearest, [3; 4])] {
            let mut scaled = image(&[1, 2, 2, 3]);
            filter.apply([1, 1], &mut scaled);
            assert_eq!(scaled, image(&expected), "{filter:?}");
        }
    }
}
