//! Contact sheets: a grid of pictures, each with a line of text above it.

use font8x8::{BASIC_FONTS, UnicodeFonts};

use crate::picture::{Colour, Picture};

/// Height of the line above a picture, pixels.
const LABEL_HEIGHT: usize = 20;
/// Space between cells, pixels.
const GAP: usize = 6;
/// Side of a character, pixels.
const CHARACTER: usize = 8;
/// Space above and below a line's characters, pixels.
const PADDING: usize = (LABEL_HEIGHT - CHARACTER) / 2;

/// Distance between lines of text, pixels.
const LINE_HEIGHT: usize = 16;

const PAGE: Colour = [240, 240, 232];
const PAPER: Colour = [255, 255, 255];
const INK: Colour = [32, 32, 32];

pub(super) struct Sheet {
    columns: usize,
    cell: usize,
    cells: Vec<(String, Picture)>,
}

impl Sheet {
    /// Creates a sheet of square pictures of `cell` pixels.
    pub(super) fn new(columns: usize, cell: usize) -> Self {
        Self { columns, cell, cells: Vec::new() }
    }

    pub(super) fn add(&mut self, label: &str, picture: Picture) {
        self.cells.push((label.to_owned(), picture));
    }

    pub(super) fn add_text(&mut self, label: &str, text: &str) {
        let mut page = Picture::filled(self.cell, self.cell, PAGE);
        let columns = self.cell / CHARACTER - 2;
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

    pub(super) fn finish(self) -> Picture {
        let rows = self.cells.len().div_ceil(self.columns);
        let (wide, high) = (self.cell + GAP, self.cell + LABEL_HEIGHT + GAP);
        let size = (GAP + self.columns * wide, GAP + rows * high);
        let mut sheet = Picture::filled(size.0, size.1, PAPER);
        for (index, (label, picture)) in self.cells.iter().enumerate() {
            let left = GAP + (index % self.columns) * wide;
            let top = GAP + (index / self.columns) * high;
            write_line(&mut sheet, label, left, top + PADDING);
            sheet.paste(picture, left, top + LABEL_HEIGHT);
        }
        sheet
    }
}

fn write_line(sheet: &mut Picture, text: &str, left: usize, top: usize) {
    for (index, character) in text.chars().enumerate() {
        let Some(rows) = BASIC_FONTS.get(character) else {
            continue;
        };
        for (y, bits) in rows.iter().enumerate() {
            for x in 0..CHARACTER {
                if bits & (1 << x) != 0 {
                    sheet.set(left + index * CHARACTER + x, top + y, INK);
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
            sheet.add("A", Picture::filled(10, 10, [9; 3]));
        }
        let picture = sheet.finish();
        assert_eq!((picture.width, picture.height), (6 + 2 * 16, 6 + 2 * 36));
        let pixel = |x: usize, y: usize| picture.pixels[y * picture.width + x];
        assert_eq!([pixel(6, 26), pixel(22, 26), pixel(22, 62)], [[9; 3], [9; 3], PAPER]);
        assert!(picture.pixels.contains(&INK));
    }
}
