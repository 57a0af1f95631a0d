//! Encoding of several calls in one input. Each message has its method's number, its length in two
//! bytes (little-endian) and its bytes. [`MORE`] added to the number appends the message to the
//! preceding call.

/// Calls of one input; a further one ends it.
pub(crate) const MAX_CALLS: usize = 32;
/// Flag on a method's number: a further message of the same call.
pub(crate) const MORE: u8 = 0x80;

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Call<'a> {
    /// Number of the method; may be out of range.
    pub(crate) method: u8,
    /// Messages: at least one, and several for a streaming method.
    pub(crate) messages: Vec<&'a [u8]>,
}

/// Parses an input. Every input is valid: a message that is longer than the rest of the input ends
/// with the input, an incomplete header at the end is ignored, and [`MORE`] without a preceding
/// call begins a call.
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

/// Encodes one message of an input.
pub(crate) fn write(number: u8, message: &[u8]) -> Vec<u8> {
    let length = u16::try_from(message.len()).expect("a short message");
    [&[number], &length.to_le_bytes()[..], message].concat()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_script_round_trips_and_any_bytes_are_a_script() {
        let input = [write(1, b"one"), write(2, b""), write(2 | MORE, b"more")].concat();
        let call =
            |method, messages: &[&'static [u8]]| Call { method, messages: messages.to_vec() };
        assert_eq!(read(&input), [call(1, &[b"one"]), call(2, &[b"", b"more"])]);
        assert_eq!(read(&[MORE, 9, 0, 7]), [call(0, &[&[7]])]);
        assert_eq!(read(&[1, 2]), []);
        assert_eq!(read(&[0; 1000]).len(), MAX_CALLS);
    }
}
