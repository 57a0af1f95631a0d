//! The committed recordings.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use benchmark::Benchmark;

/// Folder of the recordings and of the committed pictures.
pub const RECORDED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/family");

/// Values of the original in one case, as `record_chosen.py` describes them. The earlier recordings
/// `states.txt` and `pro.txt` have fewer values.
#[derive(Debug, Clone, Default)]
pub struct Recording {
    /// Suite and variant of LIBERO-Plus, suite and task of LIBERO-PRO, or name of a BDDL file of
    /// LIBERO-Para.
    pub name: String,
    /// Number of the case, which names its pictures.
    pub number: Option<usize>,
    /// True if no code was changed after the case was first compared.
    pub is_held_out: bool,
    /// SHA-256 of the prompt.
    pub prompt: Option<String>,
    /// SHA-256 of the BDDL file's sentence, as the original's parser reads it.
    pub sentence: Option<String>,
    /// States, camera pose, and the next number of NumPy's generator, by kind.
    pub numbers: BTreeMap<String, Vec<f64>>,
}

pub fn recordings(benchmark: Benchmark) -> Result<Vec<Recording>> {
    let mut found = Found::default();
    match benchmark {
        Benchmark::Plus => found.read("states.txt", Found::add_states)?,
        Benchmark::Pro => found.read("pro.txt", Found::add_pro)?,
        Benchmark::Para => {}
    }
    let file = format!("chosen_{}.txt", benchmark.tag());
    found.read(&file, Found::add_chosen)?;
    Ok(found.0)
}

#[derive(Default)]
struct Found(Vec<Recording>);

impl Found {
    fn read(
        &mut self,
        file: &str,
        mut add: impl FnMut(&mut Self, &str) -> Option<()>,
    ) -> Result<()> {
        let path = Path::new(RECORDED).join(file);
        let read = std::fs::read_to_string(&path);
        let text = read.with_context(|| format!("read {}", path.display()))?;
        for (number, line) in (1..).zip(text.lines()) {
            let added = add(self, line);
            added.with_context(|| format!("read {file}: line {number} is malformed"))?;
        }
        ensure!(!self.0.is_empty(), "read {file}: it has no recording");
        Ok(())
    }

    fn recording_mut(&mut self, name: &str) -> &mut Recording {
        let known = self.0.iter().position(|recording| recording.name == name);
        let index = known.unwrap_or_else(|| {
            let name = name.to_owned();
            self.0.push(Recording { name, ..Recording::default() });
            self.0.len() - 1
        });
        &mut self.0[index]
    }

    /// Adds a line of `states.txt`. Two kinds are left out: `noise`, the generator's next number
    /// after corrupted pictures of 256 × 256, and `reset-only`, the state after a reset and fifteen
    /// control steps without action.
    fn add_states(&mut self, line: &str) -> Option<()> {
        let (name, rest) = line.split_once(' ')?;
        let (kind, numbers) = rest.split_once(' ')?;
        if matches!(kind, "camera" | "reset" | "official" | "draw") {
            let numbers = decimals(numbers)?;
            self.recording_mut(name).numbers.insert(kind.to_owned(), numbers);
        }
        Some(())
    }

    fn add_pro(&mut self, line: &str) -> Option<()> {
        let mut fields = line.splitn(4, ' ');
        let name = format!("{}/{}", fields.next()?, fields.next()?);
        let kind = match fields.next()? {
            "0" => "official",
            "1" => "trial-1",
            _ => return None,
        };
        let numbers = decimals(fields.next()?)?;
        self.recording_mut(&name).numbers.insert(kind.to_owned(), numbers);
        Some(())
    }

    fn add_chosen(&mut self, line: &str) -> Option<()> {
        let (name, rest) = line.split_once(' ')?;
        let (kind, value) = rest.split_once(' ')?;
        let recording = self.recording_mut(name);
        let numbers = match kind {
            "case" => {
                let mut fields = value.split(' ');
                recording.number = Some(fields.next()?.parse().ok()?);
                recording.is_held_out = fields.next_back() == Some("held-out");
                return Some(());
            }
            "prompt" => {
                recording.prompt = Some(value.to_owned());
                return Some(());
            }
            "sentence" => {
                recording.sentence = Some(value.to_owned());
                return Some(());
            }
            "draw" if value == "-" => return Some(()),
            "camera" | "draw" => decimals(value)?,
            "reset" | "official" | "trial-1" => doubles(value)?,
            _ => return None,
        };
        recording.numbers.insert(kind.to_owned(), numbers);
        Some(())
    }
}

fn decimals(text: &str) -> Option<Vec<f64>> {
    text.split(' ').map(|field| field.parse().ok()).collect()
}

fn doubles(text: &str) -> Option<Vec<f64>> {
    let bytes = STANDARD.decode(text).ok()?;
    let (doubles, rest) = bytes.as_chunks::<8>();
    let doubles = doubles.iter().map(|bytes| f64::from_le_bytes(*bytes));
    rest.is_empty().then(|| doubles.collect())
}
