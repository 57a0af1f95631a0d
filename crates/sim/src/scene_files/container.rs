//! File format of sections: a header with name, length and checksum; a table, which has the number
//! of sections and each one's start and length as native 64-bit integers; and the sections, each
//! aligned as required by MuJoCo's arrays and the software renderer.

use std::fs::File;
use std::io::{self, BufWriter, Read, Seek, SeekFrom, Write};
use std::ops::Range;

use bytes::Bytes;
use memmap2::Mmap;
use twox_hash::XxHash3_128;

use super::NAME_DIGITS;
use crate::mujoco::ALIGNMENT;

const MAGIC: &[u8; 16] = b"rollout scenes\n\0";
/// Fields of the header: name, length of the file, checksum of everything after the header.
const NAME: Range<usize> = 16..16 + NAME_DIGITS;
const LENGTH: Range<usize> = NAME.end..NAME.end + 8;
const CHECKSUM: Range<usize> = LENGTH.end..LENGTH.end + 16;
/// Length of the header, bytes; the checksum covers the rest.
const HEAD: usize = CHECKSUM.end;
const BLOCK: usize = 1 << 20;

/// Writes a file; each section is the concatenation of its parts.
pub(super) fn write(
    out: &mut (impl Write + Seek),
    name: &str,
    sections: &[Vec<&[u8]>],
) -> io::Result<()> {
    let mut table = vec![sections.len() as u64];
    let mut end = HEAD + 8 + 16 * sections.len();
    for parts in sections {
        let length: usize = parts.iter().map(|part| part.len()).sum();
        let start = end.next_multiple_of(ALIGNMENT);
        table.extend([start as u64, length as u64]);
        end = start + length;
    }
    let mut out = ChecksumWriter {
        out: BufWriter::with_capacity(BLOCK, out),
        sum: XxHash3_128::new(),
        position: HEAD,
    };
    out.out.write_all(&[0; HEAD])?;
    out.write(bytemuck::cast_slice(&table))?;
    for parts in sections {
        let gap = out.position.next_multiple_of(ALIGNMENT) - out.position;
        out.write(&[0; ALIGNMENT][..gap])?;
        for part in parts {
            out.write(part)?;
        }
    }
    let mut head = [0; HEAD];
    head[..MAGIC.len()].copy_from_slice(MAGIC);
    head[NAME].copy_from_slice(name.as_bytes());
    head[LENGTH].copy_from_slice(&(end as u64).to_ne_bytes());
    head[CHECKSUM].copy_from_slice(&out.sum.finish_128().to_ne_bytes());
    out.out.seek(SeekFrom::Start(0))?;
    out.out.write_all(&head)?;
    out.out.flush()
}

struct ChecksumWriter<W: Write> {
    out: BufWriter<W>,
    sum: XxHash3_128,
    position: usize,
}

impl<W: Write> ChecksumWriter<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.sum.write(bytes);
        self.position += bytes.len();
        self.out.write_all(bytes)
    }
}

/// Maps the sections; `None` if the file has another format, name, length or checksum.
pub(super) fn map(mut file: &File, name: &str, length: u64) -> io::Result<Option<Vec<Bytes>>> {
    let mut head = [0; HEAD];
    if length < HEAD as u64 {
        return Ok(None);
    }
    file.read_exact(&mut head)?;
    let mut sum = XxHash3_128::new();
    let mut block = vec![0; BLOCK];
    // Reads the file, because a mapping's pages would count towards this process's memory.
    loop {
        match file.read(&mut block)? {
            0 => break,
            read => sum.write(&block[..read]),
        }
    }
    let is_valid = head.starts_with(MAGIC)
        && head[NAME] == *name.as_bytes()
        && head[LENGTH] == length.to_ne_bytes()
        && head[CHECKSUM] == sum.finish_128().to_ne_bytes();
    if !is_valid {
        return Ok(None);
    }
    // SAFETY: the pages are never written to, neither through this mapping, which is read-only,
    // nor in the file: programs of this project write a file once, before it gets its final name,
    // and even its owner has no right to write to it afterwards.
    #[allow(unsafe_code, reason = "mapping a file")]
    let map = unsafe { Mmap::map(file)? };
    Ok(sections(&Bytes::from_owner(map)))
}

fn sections(bytes: &Bytes) -> Option<Vec<Bytes>> {
    let number = |at: usize| {
        let word = bytes.get(at..at.checked_add(8)?)?;
        usize::try_from(u64::from_ne_bytes(word.try_into().ok()?)).ok()
    };
    let count = number(HEAD)?;
    (0..count)
        .map(|section| {
            let entry = HEAD + 8 + section.checked_mul(16)?;
            let (start, length) = (number(entry)?, number(entry + 8)?);
            let end = start.checked_add(length)?;
            (end <= bytes.len()).then(|| bytes.slice(start..end))
        })
        .collect()
}
