//! Contact sheets: a grid of pictures, each with a line of text above it.

use font8x8::{BASIC_FONTS, UnicodeFonts};
use image::{Rgb, RgbImage};

/// Height of the line above a picture, pixels.
const LABEL_HEIGHT: u32 = 20;
/// Space between cells, pixels.
const GAP: u32 = 6;
/// Side of a character, pixels.
const CHARACTER: u32 = 8;
/// Space above and below a line's characters, pixels.
const PADDING: u32 = (LABEL_HEIGHT - CHARACTER) / 2;

/// Distance between lines of text, pixels.
const LINE_HEIGHT: u32 = 16;

const PAGE: Rgb<u8> = Rgb([240, 240, 232]);
const PAPER: Rgb<u8> = Rgb([255, 255, 255]);
const INK: Rgb<u8> = Rgb([32, 32, 32]);

/// Contact sheet under construction.
pub(super) struct Sheet {
    columns: usize,
    cell: u32,
    cells: Vec<(String, RgbImage)>,
}

impl Sheet {
    /// Creates a sheet of square pictures of `cell` pixels.
    pub(super) fn new(columns: usize, cell: u32) -> Self {
        Self { columns, cell, cells: Vec::new() }
    }

    pub(super) fn add(&mut self, label: &str, picture: RgbImage) {
        self.cells.push((label.to_owned(), picture));
    }

    /// Adds a cell with text in place of a picture.
    pub(super) fn add_text(&mut self, label: &str, text: &str) {
        let mut page = RgbImage::from_pixel(self.cell, self.cell, PAGE);
        let columns = (self.cell / CHARACTER) as usize - 2;
        let mut lines = vec![String::new()];
        for word in text.split(' ') {
            let line = lines.last_mut().expect("never empty");
            match line.len() {
                0 => line.push_str(word),
                used if used + 1 + word.len() <= columns => line.extend([" ", word]),
                _ => lines.push(word.to_owned()),
            }
        }
        for (index, line) in (1..).zip(&lines) {
            write_line(&mut page, line, CHARACTER, index * LINE_HEIGHT);
        }
        self.cells.push((label.to_owned(), page));
    }

    /// Composes all cells into one picture, row by row.
    pub(super) fn finish(self) -> RgbImage {
        let rows = self.cells.len().div_ceil(self.columns) as u32;
        let (wide, high) = (self.cell + GAP, self.cell + LABEL_HEIGHT + GAP);
        let size = (GAP + self.columns as u32 * wide, GAP + rows * high);
        let mut sheet = RgbImage::from_pixel(size.0, size.1, PAPER);
        for (index, (label, picture)) in self.cells.iter().enumerate() {
            let left = GAP + (index % self.columns) as u32 * wide;
            let top = GAP + (index / self.columns) as u32 * high;
            write_line(&mut sheet, label, left, top + PADDING);
            let below = i64::from(top + LABEL_HEIGHT);
            image::imageops::replace(&mut sheet, picture, i64::from(left), below);
        }
        sheet
    }
}

fn write_line(sheet: &mut RgbImage, text: &str, left: u32, top: u32) {
    for (index, character) in text.chars().enumerate() {
        let Some(rows) = BASIC_FONTS.get(character) else {
            continue;
        };
        for (y, bits) in rows.iter().enumerate() {
            for x in 0..CHARACTER {
                let (column, row) = (left + index as u32 * CHARACTER + x, top + y as u32);
                if bits & (1 << x) != 0 && column < sheet.width() && row < sheet.height() {
                    sheet.put_pixel(column, row, INK);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_form_a_grid_with_labels_above() {
        let mut sheet = Sheet::new(2, 10);
        for _ in 0..3 {
            sheet.add("A", RgbImage::from_pixel(10, 10, Rgb([9, 9, 9])));
        }
        let picture = sheet.finish();
        assert_eq!(picture.dimensions(), (6 + 2 * 16, 6 + 2 * 36));
        assert_eq!(*picture.get_pixel(6, 26), Rgb([9, 9, 9]));
        assert_eq!(*picture.get_pixel(22, 26), Rgb([9, 9, 9]));
        assert_eq!(*picture.get_pixel(22, 62), PAPER);
        assert!(picture.pixels().any(|pixel| *pixel == INK));
    }
}
