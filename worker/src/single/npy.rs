//! Arrays in NumPy's format NPY, version 1.0 to 3.0: the header is a Python literal such as
//! `{'descr': '<f8', 'fortran_order': False, 'shape': (6, 7), }`.

use std::io::{self, Read, Write};

/// Longest accepted header, bytes; NumPy writes 118.
const MAX_HEADER_BYTES: usize = 64 << 10;
const MAGIC: &[u8; 6] = b"\x93NUMPY";
/// NumPy pads headers such that the values begin at a multiple of this.
const ALIGNMENT: usize = 64;

/// Header of an array file: type, order and shape of the values that follow.
pub(super) struct Header {
    /// Type of the values, such as `<f8`.
    descr: String,
    pub(super) shape: Vec<usize>,
}

impl Header {
    /// Reads the header of an array in C order. The error is a sentence about the file.
    pub(super) fn read(file: &mut impl Read) -> Result<Self, String> {
        let failed = |_| "it is too short for an array".to_owned();
        let mut start = [0; 8];
        file.read_exact(&mut start).map_err(failed)?;
        let (magic, version) = (&start[..6], start[6]);
        if magic != MAGIC || !(1..=3).contains(&version) {
            return Err("it is no array in NumPy's format".to_owned());
        }
        // The length has two bytes in version 1, four in later ones.
        let mut length = [0; 4];
        let bytes = if version == 1 { 2 } else { 4 };
        file.read_exact(&mut length[..bytes]).map_err(failed)?;
        let length = u32::from_le_bytes(length) as usize;
        if length > MAX_HEADER_BYTES {
            return Err("its header is too long: it is no array of numbers".to_owned());
        }
        let mut text = vec![0; length];
        file.read_exact(&mut text).map_err(failed)?;
        Self::parse(&String::from_utf8_lossy(&text))
    }

    fn parse(text: &str) -> Result<Self, String> {
        let value = |key: &str| {
            let (_, rest) = text.split_once(&format!("'{key}':"))?;
            Some(rest.trim_start())
        };
        let descr = value("descr").and_then(|rest| rest.strip_prefix('\''));
        let descr = descr.and_then(|rest| rest.split_once('\''));
        let shape = value("shape").and_then(|rest| rest.strip_prefix('(')?.split_once(')'));
        let order = value("fortran_order");
        let (Some((descr, _)), Some((shape, _)), Some(order)) = (descr, shape, order) else {
            return Err("it is a structured array, or no array".to_owned());
        };
        if !order.starts_with("False") {
            return Err("it is in Fortran order: write it with numpy.ascontiguousarray".to_owned());
        }
        let sizes = shape.split(',').map(str::trim).filter(|size| !size.is_empty());
        let sizes: Result<_, _> = sizes.map(str::parse).collect();
        let shape = sizes.map_err(|_| format!("its shape is ({shape})"))?;
        Ok(Self { descr: descr.to_owned(), shape })
    }

    pub(super) fn floats(&self, file: &mut impl Read, count: usize) -> Result<Vec<f64>, String> {
        let bytes = match self.descr.as_str() {
            "<f8" | "<f4" => usize::from(self.descr.as_bytes()[2] - b'0'),
            other => return Err(format!("it holds {other}, not floats")),
        };
        let mut data = vec![0; count * bytes];
        file.read_exact(&mut data).map_err(|error| error.to_string())?;
        Ok(match bytes {
            8 => data.as_chunks().0.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect(),
            _ => data.as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes).into()).collect(),
        })
    }
}

/// Writes an array of values of this type, encoded, in C order.
pub(super) fn write(
    out: &mut impl Write,
    descr: &str,
    shape: &[usize],
    encoded: &[u8],
) -> io::Result<()> {
    let sizes: String = shape.iter().map(|size| format!("{size}, ")).collect();
    let text = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({sizes}), }}");
    let before = MAGIC.len() + 4;
    let length = (before + text.len() + 1).next_multiple_of(ALIGNMENT) - before;
    out.write_all(MAGIC)?;
    out.write_all(&[1, 0])?;
    out.write_all(&u16::try_from(length).expect("a short header").to_le_bytes())?;
    writeln!(out, "{text:<0$}", length - 1)?;
    out.write_all(encoded)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrays_round_trip_and_headers_of_numpy_are_read() {
        let mut file = Vec::new();
        let encoded: Vec<u8> = [1.5, -2.0_f64].iter().flat_map(|x| x.to_le_bytes()).collect();
        write(&mut file, "<f8", &[1, 2], &encoded).unwrap();
        assert_eq!((file.len() - encoded.len()) % ALIGNMENT, 0);
        let mut rest = &file[..];
        let header = Header::read(&mut rest).unwrap();
        assert_eq!(header.shape, [1, 2]);
        assert_eq!(header.floats(&mut rest, 2).unwrap(), [1.5, -2.0]);
        for (text, expected) in [
            ("{'descr': '<f4', 'fortran_order': False, 'shape': (3,), }", Ok(vec![3])),
            ("{'descr': '<f4', 'fortran_order': False, 'shape': (), }", Ok(vec![])),
            ("{'descr': '<f4', 'fortran_order': True, 'shape': (3,), }", Err("Fortran order")),
            ("{'descr': '<f4', 'fortran_order': False, 'shape': (-3,), }", Err("its shape")),
            ("{'descr': [('a', '<f4')], 'fortran_order': False, 'shape': (3,), }", Err("struct")),
            (&"{".repeat(75), Err("no array")),
        ] {
            match (Header::parse(text), expected) {
                (Ok(header), Ok(shape)) => assert_eq!(header.shape, shape, "{text}"),
                (Err(found), Err(words)) => assert!(found.contains(words), "{text}: {found}"),
                (found, _) => panic!("{text}: {:?}", found.map(|header| header.shape)),
            }
        }
    }
}
