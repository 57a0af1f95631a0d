//! Several calls in one input: for each message the number of its method, its
//! length in two bytes (little-endian), and its bytes. With [`MORE`] added to
//! the number it goes into the call before, after that one's messages.

/// Most calls that are made for one input.
pub(crate) const MAX_CALLS: usize = 32;
/// Added to a method's number: another message of the same call.
pub(crate) const MORE: u8 = 0x80;

/// One call.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Call<'a> {
    /// The method's number; any is possible.
    pub(crate) method: u8,
    /// Its messages: at least one, and more where it takes a stream.
    pub(crate) messages: Vec<&'a [u8]>,
}

/// Reads an input. Everything is one: a length that is too large takes what is
/// there.
pub(crate) fn read(mut input: &[u8]) -> Vec<Call<'_>> {
    let mut calls: Vec<Call<'_>> = Vec::new();
    while let [number, low, high, rest @ ..] = input {
        let length = usize::from(u16::from_le_bytes([*low, *high]));
        let (message, after) = rest.split_at(length.min(rest.len()));
        input = after;
        if number & MORE != 0
            && let Some(call) = calls.last_mut()
        {
            call.messages.push(message);
        } else if calls.len() < MAX_CALLS {
            let method = number & !MORE;
            let messages = vec![message];
            calls.push(Call { method, messages });
        } else {
            break;
        }
    }
    calls
}

/// Writes one message of an input.
///
/// # Panics
/// If it is longer than 65,535 bytes.
pub(crate) fn write(number: u8, message: &[u8]) -> Vec<u8> {
    let length = u16::try_from(message.len()).expect("a short message");
    [&[number], &length.to_le_bytes()[..], message].concat()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_written_script_reads_back_and_any_bytes_read_as_a_script() {
        let input = [write(1, b"one"), write(2, b""), write(2 | MORE, b"more")].concat();
        let call = |method, messages: &[&'static [u8]]| Call {
            method,
            messages: messages.to_vec(),
        };
        assert_eq!(read(&input), [call(1, &[b"one"]), call(2, &[b"", b"more"])]);
        assert_eq!(read(&[MORE, 9, 0, 7]), [call(0, &[&[7]])]);
        assert_eq!(read(&[1, 2]), []);
        assert_eq!(read(&[0; 1000]).len(), MAX_CALLS);
    }
}
