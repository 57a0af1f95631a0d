//! Restricted unpickler for released initial states. It accepts only a NumPy array of little-endian
//! doubles with one or two dimensions, and refuses every other opcode, global or shape, so that a
//! file cannot execute code.

use std::collections::HashMap;
use std::rc::Rc;

/// A row-major matrix of doubles.
#[derive(Debug, PartialEq)]
pub(crate) struct Matrix {
    pub(crate) rows: usize,
    pub(crate) columns: usize,
    pub(crate) values: Vec<f64>,
}

/// Value on the unpickler's stack. Copies share their contents, so that a file that reads nested
/// tuples from the memo again and again does not use more memory.
#[derive(Clone)]
enum Value {
    None,
    Bool(bool),
    Int(i64),
    Text(Rc<str>),
    Bytes(Rc<[u8]>),
    Tuple(Rc<[Value]>),
    Global(Global),
    Array(Option<Array>),
    Dtype,
    Mark,
}

#[derive(Clone, Copy)]
enum Global {
    Reconstruct,
    Ndarray,
    Dtype,
    Encode,
}

#[derive(Clone)]
struct Array {
    shape: [usize; 2],
    data: Rc<[u8]>,
}

impl Value {
    /// Returns the kind of the value, for messages.
    fn kind(&self) -> &'static str {
        match self {
            Self::None => "`None`",
            Self::Bool(_) => "a boolean",
            Self::Int(_) => "an integer",
            Self::Text(_) => "a text",
            Self::Bytes(_) => "bytes",
            Self::Tuple(_) => "a tuple",
            Self::Global(_) => "a function",
            Self::Array(_) => "an array",
            Self::Dtype => "a dtype",
            Self::Mark => "a mark",
        }
    }
}

/// Limit on the number of opcodes: four times as many as in a released file. Bounds the nesting of
/// values and the number of decoded texts.
const MAX_OPCODES: usize = 256;

/// Unpickles a matrix.
pub(crate) fn read_matrix(bytes: &[u8]) -> Result<Matrix, String> {
    let value = Machine { input: bytes, stack: Vec::new(), memo: HashMap::new() }.run()?;
    let Value::Array(Some(Array { shape: [rows, columns], data })) = value else {
        return Err("the pickle holds no array of doubles".to_owned());
    };
    if rows.checked_mul(columns).and_then(|count| count.checked_mul(8)) != Some(data.len()) {
        return Err(format!("{} bytes do not make {rows} × {columns} doubles", data.len()));
    }
    let values =
        data.chunks_exact(8).map(|c| f64::from_le_bytes(c.try_into().expect("8 bytes"))).collect();
    Ok(Matrix { rows, columns, values })
}

/// Stack machine that executes a pickle's opcodes.
struct Machine<'a> {
    input: &'a [u8],
    stack: Vec<Value>,
    memo: HashMap<u32, Value>,
}

impl Machine<'_> {
    /// Executes the opcodes up to `STOP` (`.`). Python's `pickletools` names the others: `PROTO`
    /// (0x80), `GLOBAL` (c), `BINPUT` and `LONG_BINPUT` (q, r), `BINGET` and `LONG_BINGET` (h, j),
    /// `BININT1`, `BININT2` and `BININT` (K, M, J), `BINUNICODE` (X), `NONE` (N), `NEWTRUE` and
    /// `NEWFALSE` (0x88, 0x89), `MARK` (`(`), `TUPLE` and `EMPTY_TUPLE` (t, `)`), `TUPLE1` to
    /// `TUPLE3` (0x85 to 0x87), `REDUCE` (R), `BUILD` (b).
    fn run(mut self) -> Result<Value, String> {
        for _ in 0..MAX_OPCODES {
            let opcode = self.take(1)?[0];
            match opcode {
                0x80 => drop(self.take(1)?),
                b'c' => {
                    let global = self.global()?;
                    self.stack.push(Value::Global(global));
                }
                b'q' => {
                    let slot = u32::from(self.take(1)?[0]);
                    self.memoize(slot)?;
                }
                b'r' => {
                    let slot = self.u32()?;
                    self.memoize(slot)?;
                }
                b'h' => {
                    let slot = u32::from(self.take(1)?[0]);
                    self.recall(slot)?;
                }
                b'j' => {
                    let slot = self.u32()?;
                    self.recall(slot)?;
                }
                b'K' => {
                    let value = i64::from(self.take(1)?[0]);
                    self.stack.push(Value::Int(value));
                }
                b'M' => {
                    let bytes = self.take(2)?;
                    let value = i64::from(u16::from_le_bytes([bytes[0], bytes[1]]));
                    self.stack.push(Value::Int(value));
                }
                b'J' => {
                    let value = i64::from(self.u32()? as i32);
                    self.stack.push(Value::Int(value));
                }
                b'X' => {
                    let text = self.text()?;
                    self.stack.push(Value::Text(text));
                }
                b'N' => self.stack.push(Value::None),
                0x88 => self.stack.push(Value::Bool(true)),
                0x89 => self.stack.push(Value::Bool(false)),
                b'(' => self.stack.push(Value::Mark),
                b't' => self.tuple_to_mark()?,
                b')' => self.stack.push(Value::Tuple(Rc::new([]))),
                0x85..=0x87 => self.tuple(usize::from(opcode - 0x84))?,
                b'R' => self.reduce()?,
                b'b' => self.build()?,
                b'.' => return self.pop(),
                other => return Err(format!("opcode 0x{other:02x} is not allowed")),
            }
        }
        Err("the pickle has more opcodes than an array needs".to_owned())
    }

    fn take(&mut self, count: usize) -> Result<&[u8], String> {
        let (taken, rest) = self
            .input
            .split_at_checked(count)
            .ok_or_else(|| "the pickle ends early (truncated?)".to_owned())?;
        self.input = rest;
        Ok(taken)
    }

    fn u32(&mut self) -> Result<u32, String> {
        Ok(u32::from_le_bytes(self.take(4)?.try_into().expect("4 bytes")))
    }

    fn text(&mut self) -> Result<Rc<str>, String> {
        let length = self.u32()? as usize;
        let text = std::str::from_utf8(self.take(length)?);
        text.map(Rc::from).map_err(|_| "a text is not UTF-8".to_owned())
    }

    fn pop(&mut self) -> Result<Value, String> {
        self.stack.pop().ok_or_else(|| "the stack is empty".to_owned())
    }

    fn memoize(&mut self, slot: u32) -> Result<(), String> {
        let value = self.stack.last().cloned().ok_or("the stack is empty")?;
        self.memo.insert(slot, value);
        Ok(())
    }

    fn recall(&mut self, slot: u32) -> Result<(), String> {
        let value = self.memo.get(&slot).cloned().ok_or("a memo slot is read before it is set")?;
        self.stack.push(value);
        Ok(())
    }

    fn line(&mut self) -> Result<String, String> {
        let end = self.input.iter().position(|byte| *byte == b'\n');
        let end = end.ok_or("the pickle ends early (truncated?)")?;
        let line = String::from_utf8_lossy(self.take(end)?).into_owned();
        self.take(1)?;
        Ok(line)
    }

    fn global(&mut self) -> Result<Global, String> {
        let (module, name) = (self.line()?, self.line()?);
        match (module.as_str(), name.as_str()) {
            ("numpy.core.multiarray" | "numpy._core.multiarray", "_reconstruct") => {
                Ok(Global::Reconstruct)
            }
            ("numpy", "ndarray") => Ok(Global::Ndarray),
            ("numpy", "dtype") => Ok(Global::Dtype),
            ("_codecs", "encode") => Ok(Global::Encode),
            _ => Err(format!("`{module}.{name}` is not allowed")),
        }
    }

    fn tuple(&mut self, count: usize) -> Result<(), String> {
        let start = self.stack.len().checked_sub(count).ok_or("the stack has too few values")?;
        let items = self.stack.split_off(start);
        self.stack.push(Value::Tuple(items.into()));
        Ok(())
    }

    fn tuple_to_mark(&mut self) -> Result<(), String> {
        let mark = self.stack.iter().rposition(|value| matches!(value, Value::Mark));
        let mark = mark.ok_or("a tuple has no start mark")?;
        let items = self.stack.split_off(mark + 1);
        self.stack.pop();
        self.stack.push(Value::Tuple(items.into()));
        Ok(())
    }

    fn reduce(&mut self) -> Result<(), String> {
        let Value::Tuple(arguments) = self.pop()? else {
            return Err("a call has no argument tuple".to_owned());
        };
        let result = match (self.pop()?, &*arguments) {
            (Value::Global(Global::Reconstruct), [Value::Global(Global::Ndarray), ..]) => {
                Value::Array(None)
            }
            (Value::Global(Global::Dtype), [Value::Text(kind), ..]) if &**kind == "f8" => {
                Value::Dtype
            }
            (Value::Global(Global::Dtype), [Value::Text(kind), ..]) => {
                return Err(format!("the numbers are `{kind}`, not doubles (`f8`)"));
            }
            (Value::Global(Global::Encode), [Value::Text(text), Value::Text(encoding)])
                if &**encoding == "latin1" =>
            {
                Value::Bytes(latin1(text)?.into())
            }
            (called, _) => {
                return Err(format!(
                    "calling {} with these arguments is not allowed",
                    called.kind()
                ));
            }
        };
        self.stack.push(result);
        Ok(())
    }

    fn build(&mut self) -> Result<(), String> {
        let Value::Tuple(state) = self.pop()? else {
            return Err("the state of an object is not a tuple".to_owned());
        };
        let built = match (self.pop()?, &*state) {
            (Value::Dtype, [_, Value::Text(order), ..]) if &**order == "<" => Value::Dtype,
            (Value::Dtype, _) => return Err("the doubles are not little-endian".to_owned()),
            (
                Value::Array(None),
                [_, Value::Tuple(shape), Value::Dtype, Value::Bool(false), Value::Bytes(data)],
            ) => match &**shape {
                [Value::Int(rows), Value::Int(columns)] if *rows >= 0 && *columns >= 0 => {
                    let shape = [*rows as usize, *columns as usize];
                    Value::Array(Some(Array { shape, data: data.clone() }))
                }
                [Value::Int(columns)] if *columns >= 0 => {
                    Value::Array(Some(Array { shape: [1, *columns as usize], data: data.clone() }))
                }
                _ => return Err("the array has neither one nor two dimensions".to_owned()),
            },
            (value, _) => {
                return Err(format!("setting this state of {} is not allowed", value.kind()));
            }
        };
        self.stack.push(built);
        Ok(())
    }
}

fn latin1(text: &str) -> Result<Vec<u8>, String> {
    text.chars()
        .map(|c| u8::try_from(u32::from(c)).map_err(|_| "the bytes are not Latin-1".to_owned()))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn anything_but_an_array_is_refused() {
        let check = |bytes: &[u8], expected: &str| {
            let problem = read_matrix(bytes).unwrap_err();
            assert!(problem.contains(expected), "{problem}");
        };
        check(b"\x80\x02cos\nsystem\nq\x00.", "`os.system` is not allowed");
        check(b"\x80\x02]q\x00.", "opcode 0x5d is not allowed");
        check(b"\x80\x02K\x01.", "holds no array of doubles");
        check(b"\x80\x02X\xff\xff\xff\x7f", "truncated");
        check(b"", "truncated");
    }

    #[test]
    fn a_small_file_cannot_use_much_memory() {
        // Each round nests the previous tuple twice.
        let mut bytes = b"\x80\x02)q\x00".to_vec();
        for _ in 0..40 {
            bytes.extend(b"h\x00h\x00\x86q\x00");
        }
        bytes.extend(b"R");
        let problem = read_matrix(&bytes).unwrap_err();
        assert!(problem.contains("not allowed"), "{problem}");
        let endless = [b")".as_slice(), &b"\x85".repeat(100_000)].concat();
        let problem = read_matrix(&endless).unwrap_err();
        assert!(problem.contains("more opcodes"), "{problem}");
    }
}
