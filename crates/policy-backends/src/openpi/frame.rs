//! Frames as openpi's LIBERO client sends them. The client would pad a frame that is not square, but
//! LIBERO's frames are square.

pub use proto::resize::resize;

/// Side of the frames that openpi's LIBERO client sends, pixels.
pub const SIDE: usize = 224;

#[cfg(test)]
mod tests {
    use sha2::{Digest, Sha256};

    use super::*;
    use crate::observations::rotated;

    // The expected values are from Pillow 13.0.0, through `resize_with_pad` of openpi-client
    // 0.1.2.

    fn pattern(side: usize) -> Vec<u8> {
        let pixel = |x: usize, y: usize| {
            let level = x * 7 + y * 13 + (x * y) / 7;
            [0, 50, 100].map(|colour| ((level + colour) % 256) as u8)
        };
        let rows = (0..side).map(|y| (0..side).map(move |x| pixel(x, y)));
        rows.flatten().flatten().collect()
    }

    #[test]
    fn a_prepared_frame_equals_that_of_openpis_client_bit_for_bit() {
        let prepared = resize(&rotated(&pattern(256)), [256; 2], [SIDE; 2]);
        let at = |x: usize, y: usize| &prepared[3 * (y * SIDE + x)..][..3];
        assert_eq!(at(0, 0), [45, 88, 138]);
        assert_eq!(at(100, 100), [105, 55, 105]);
        let digest = hex::encode(Sha256::digest(&prepared));
        assert_eq!(digest, "9a4c9d135a8b82e596068dd9c126a3bccc9514f89fa7a4e358f2cf4f526b2cf3");
    }

    #[test]
    fn edge_windows_use_only_existing_pixels() {
        let resized = [
            6, 56, 106, 15, 65, 115, 23, 73, 123, 22, 72, 122, 31, 81, 131, 39, 89, 139, 37, 87,
            137, 46, 96, 146, 55, 105, 155,
        ];
        assert_eq!(resize(&pattern(4), [4; 2], [3; 2]), resized);
    }

    #[test]
    fn a_rotated_frame_has_its_first_pixel_last() {
        let mut frame = vec![0; 3 * SIDE * SIDE];
        frame[0] = 9;
        assert_eq!(rotated(&frame)[3 * SIDE * SIDE - 3..], [9, 0, 0]);
    }

    #[test]
    fn a_frame_of_the_right_size_is_unchanged() {
        assert_eq!(resize(&[7; 3 * SIDE * SIDE], [SIDE; 2], [SIDE; 2]), vec![7; 3 * SIDE * SIDE]);
    }
}
