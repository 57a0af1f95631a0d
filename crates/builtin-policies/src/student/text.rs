//! Text embedding: words and bigrams of the instruction, hashed into a table.

pub(crate) const BUCKETS: usize = 4096;
pub(crate) const WIDTH: usize = 48;

/// Sums the table's rows of all words and bigrams of `instruction` in the order of the text:
/// a word, then the bigram that it ends.
pub(crate) fn embed(table: &[f32], instruction: &str) -> [f32; WIDTH] {
    let mut vector = [0.0; WIDTH];
    let mut add = |bucket: usize| {
        let row = &table[bucket * WIDTH..][..WIDTH];
        for (sum, value) in vector.iter_mut().zip(row) {
            *sum += value;
        }
    };
    let mut previous: Option<String> = None;
    for word in words(instruction) {
        add(bucket(word.bytes()));
        if let Some(previous) = previous {
            let pair = previous.bytes().chain([b' ']).chain(word.bytes());
            add(bucket(pair));
        }
        previous = Some(word);
    }
    vector
}

/// Splits a text into runs of ASCII letters and digits, in lower case.
fn words(instruction: &str) -> impl Iterator<Item = String> {
    instruction
        .split(|sign: char| !sign.is_ascii_alphanumeric())
        .filter(|word| !word.is_empty())
        .map(str::to_ascii_lowercase)
}

/// Returns the 32-bit FNV-1a hash modulo the number of rows.
fn bucket(bytes: impl Iterator<Item = u8>) -> usize {
    let hash = bytes
        .fold(0x811c_9dc5_u32, |hash, byte| (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193));
    hash as usize % BUCKETS
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_runs_of_ascii_letters_and_digits() {
        let found: Vec<_> = words("Put the chef's Moka-Pot\ton 2 PLATES, é\u{212a}!").collect();
        let expected = ["put", "the", "chef", "s", "moka", "pot", "on", "2", "plates"];
        assert_eq!(found, expected);
        assert_eq!(words(" -- ").count(), 0);
    }

    /// Published values of FNV-1a.
    #[test]
    fn buckets_are_fnv_1a() {
        let published: [(&str, u32); 3] =
            [("", 0x811c_9dc5), ("a", 0xe40c_292c), ("foobar", 0xbf9c_f968)];
        for (text, hash) in published {
            assert_eq!(bucket(text.bytes()), hash as usize % BUCKETS, "{text:?}");
        }
    }

    #[test]
    fn words_and_pairs_are_added_as_often_as_they_occur() {
        let row = |text: &str| bucket(text.bytes());
        let mut table = vec![0.0; BUCKETS * WIDTH];
        for (text, value) in [("the", 1.0), ("pot", 10.0), ("the pot", 100.0), ("pot the", 1000.0)]
        {
            table[row(text) * WIDTH..][..WIDTH].fill(value);
        }
        assert_eq!(embed(&table, "the pot")[0], 111.0);
        assert_eq!(embed(&table, "The pot, the POT")[WIDTH - 1], 1222.0);
        assert_eq!(embed(&table, "")[0], 0.0);
        assert_eq!(embed(&table, "a mug")[0], 0.0);
    }
}
