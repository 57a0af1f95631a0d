//! Restricted unpickler for initial states. It accepts NumPy arrays and PyTorch tensors of
//! little-endian doubles or floats with one or two dimensions, and lists of them, in protocols 2 to
//! 5, and refuses every other opcode, global or shape, so that a file cannot execute code.

use std::collections::HashMap;
use std::rc::Rc;

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
    List(Vec<Array>),
    /// Number of bytes of each number.
    Dtype(usize),
    Storage(usize, Rc<[u8]>),
    Mark,
}

#[derive(Clone, Copy)]
enum Global {
    Reconstruct,
    Ndarray,
    Dtype,
    Encode,
    FromBuffer,
    Tensor,
    /// A tensor's type of storage: number of bytes of each number.
    Storage(usize),
    OrderedDict,
}

/// Numbers with these strides, in numbers, in the data of an array or of a tensor's storage.
#[derive(Clone)]
struct Array {
    shape: [usize; 2],
    strides: [usize; 2],
    offset: usize,
    /// Number of bytes of each number.
    width: usize,
    data: Rc<[u8]>,
}

impl Array {
    fn new(shape: &Value, is_fortran: bool, width: usize, data: Rc<[u8]>) -> Result<Self, String> {
        let shape = sizes(shape)?;
        let [rows, columns] = matrix_of(&shape, 1)?;
        if rows.checked_mul(columns).and_then(|count| count.checked_mul(width)) != Some(data.len())
        {
            return Err(format!("{} bytes do not make {rows} × {columns} numbers", data.len()));
        }
        let strides = if is_fortran { [1, rows] } else { [columns, 1] };
        Ok(Self { shape: [rows, columns], strides, offset: 0, width, data })
    }

    /// Appends the rows to a matrix; each number comes from bytes of its own.
    fn append(&self, matrix: &mut Matrix) -> Result<(), String> {
        let [rows, columns] = self.shape;
        let needed = rows.checked_mul(columns).and_then(|count| count.checked_mul(self.width));
        if needed.is_none_or(|needed| needed > self.data.len()) {
            return Err(format!(
                "{} bytes do not make {rows} × {columns} numbers",
                self.data.len()
            ));
        }
        if matrix.rows > 0 && matrix.columns != columns {
            return Err(format!("states have {} and {columns} numbers", matrix.columns));
        }
        for index in 0..rows * columns {
            let value = self.value(index / columns, index % columns);
            matrix.values.push(value.ok_or("a tensor is larger than its storage")?);
        }
        matrix.rows += rows;
        matrix.columns = columns;
        Ok(())
    }

    fn value(&self, row: usize, column: usize) -> Option<f64> {
        let [down, right] = self.strides;
        let number = row.checked_mul(down)?.checked_add(column.checked_mul(right)?)?;
        let start = number.checked_add(self.offset)?.checked_mul(self.width)?;
        let bytes = self.data.get(start..start.checked_add(self.width)?)?;
        match self.width {
            4 => Some(f32::from_le_bytes(bytes.try_into().ok()?).into()),
            _ => Some(f64::from_le_bytes(bytes.try_into().ok()?)),
        }
    }
}

fn sizes(tuple: &Value) -> Result<Vec<usize>, String> {
    let Value::Tuple(items) = tuple else {
        return Err("a shape is not a tuple".to_owned());
    };
    let size = |item: &Value| match item {
        Value::Int(size) => usize::try_from(*size).ok(),
        _ => None,
    };
    items.iter().map(|item| size(item).ok_or_else(|| "a shape has no sizes".to_owned())).collect()
}

/// Returns sizes or strides of a matrix; a vector is one row, for which `of_row` is given.
fn matrix_of(sizes: &[usize], of_row: usize) -> Result<[usize; 2], String> {
    match *sizes {
        [columns] => Ok([of_row, columns]),
        [rows, columns] => Ok([rows, columns]),
        _ => Err("the array has neither one nor two dimensions".to_owned()),
    }
}

impl Value {
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
            Self::List(_) => "a list",
            Self::Dtype(_) => "a dtype",
            Self::Storage(..) => "a storage",
            Self::Mark => "a mark",
        }
    }
}

/// Limit on the number of opcodes: a list of states takes some 25 for each.
const MAX_OPCODES: usize = 8_192;

pub(crate) type ReadStorage<'a> = &'a mut dyn FnMut(&str) -> Result<Vec<u8>, String>;

pub(crate) fn read_matrix(bytes: &[u8], read_storage: ReadStorage<'_>) -> Result<Matrix, String> {
    let (stack, memo, storages) = (Vec::new(), HashMap::new(), HashMap::new());
    let encodable = bytes.len();
    let value = Machine { input: bytes, stack, memo, storages, read_storage, encodable }.run()?;
    let arrays = match value {
        Value::Array(Some(array)) => vec![array],
        Value::List(arrays) => arrays,
        _ => return Err("the pickle holds no array of numbers".to_owned()),
    };
    let mut matrix = Matrix { rows: 0, columns: 0, values: Vec::new() };
    // The rows of a list may share their data, and be far more than it.
    let most = bytes.len() + arrays.iter().map(|array| array.data.len()).max().unwrap_or(0);
    for array in &arrays {
        array.append(&mut matrix)?;
        if matrix.values.len() > most {
            return Err("the states are larger than their data".to_owned());
        }
    }
    Ok(matrix)
}

struct Machine<'a> {
    input: &'a [u8],
    stack: Vec<Value>,
    memo: HashMap<u32, Value>,
    storages: HashMap<Rc<str>, Rc<[u8]>>,
    read_storage: ReadStorage<'a>,
    /// Bytes that may still be encoded: no more than the file has, however often it names a text.
    encodable: usize,
}

impl Machine<'_> {
    /// Executes the opcodes up to `STOP` (`.`). Python's `pickletools` names the others: `PROTO`
    /// and `FRAME` (0x80, 0x95), `GLOBAL` and `STACK_GLOBAL` (c, 0x93), `BINPUT`, `LONG_BINPUT` and
    /// `MEMOIZE` (q, r, 0x94), `BINGET` and `LONG_BINGET` (h, j), `BININT1`, `BININT2` and `BININT`
    /// (K, M, J), `BINUNICODE` and `SHORT_BINUNICODE` (X, 0x8c), `BINBYTES`, `SHORT_BINBYTES`,
    /// `BINBYTES8` and `BYTEARRAY8` (B, C, 0x8e, 0x96), `NONE` (N), `NEWTRUE` and `NEWFALSE` (0x88,
    /// 0x89), `MARK` (`(`), `TUPLE` and `EMPTY_TUPLE` (t, `)`), `TUPLE1` to `TUPLE3` (0x85 to
    /// 0x87), `EMPTY_LIST`, `APPEND` and `APPENDS` (], a, e), `BINPERSID` (Q), `REDUCE` (R),
    /// `BUILD` (b).
    fn run(mut self) -> Result<Value, String> {
        for _ in 0..MAX_OPCODES {
            let opcode = self.take(1)?[0];
            match opcode {
                0x80 => drop(self.take(1)?),
                0x95 => drop(self.take(8)?),
                b'c' => {
                    let (module, name) = (self.line()?, self.line()?);
                    self.stack.push(Value::Global(global(&module, &name)?));
                }
                0x93 => {
                    let (Value::Text(name), Value::Text(module)) = (self.pop()?, self.pop()?)
                    else {
                        return Err("a function's name is not a text".to_owned());
                    };
                    self.stack.push(Value::Global(global(&module, &name)?));
                }
                0x94 => {
                    let slot = u32::try_from(self.memo.len()).unwrap_or(u32::MAX);
                    self.memoize(slot)?;
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
                b'X' | 0x8c => {
                    let text =
                        std::str::from_utf8(self.counted(if opcode == b'X' { 4 } else { 1 })?);
                    let text = text.map(Rc::from).map_err(|_| "a text is not UTF-8")?;
                    self.stack.push(Value::Text(text));
                }
                b'C' | b'B' | 0x8e | 0x96 => {
                    let size = match opcode {
                        b'C' => 1,
                        b'B' => 4,
                        _ => 8,
                    };
                    let bytes = self.counted(size)?.into();
                    self.stack.push(Value::Bytes(bytes));
                }
                b']' => self.stack.push(Value::List(Vec::new())),
                b'a' => {
                    let item = self.pop()?;
                    self.append([item])?;
                }
                b'e' => {
                    let items = self.since_mark()?;
                    self.append(items)?;
                }
                b'Q' => self.storage()?,
                b'N' => self.stack.push(Value::None),
                0x88 => self.stack.push(Value::Bool(true)),
                0x89 => self.stack.push(Value::Bool(false)),
                b'(' => self.stack.push(Value::Mark),
                b't' => {
                    let items = self.since_mark()?;
                    self.tuple(items)?;
                }
                b')' => self.stack.push(Value::Tuple(Rc::new([]))),
                0x85..=0x87 => {
                    let start = self.stack.len().checked_sub(usize::from(opcode - 0x84));
                    let items = self.stack.split_off(start.ok_or("the stack has too few values")?);
                    self.tuple(items)?;
                }
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

    /// Returns bytes that follow their number, which has `size` bytes itself.
    fn counted(&mut self, size: usize) -> Result<&[u8], String> {
        let mut count = [0; 8];
        count[..size].copy_from_slice(self.take(size)?);
        self.take(usize::try_from(u64::from_le_bytes(count)).unwrap_or(usize::MAX))
    }

    fn pop(&mut self) -> Result<Value, String> {
        self.stack.pop().ok_or_else(|| "the stack is empty".to_owned())
    }

    fn memoize(&mut self, slot: u32) -> Result<(), String> {
        let value = match self.stack.last().ok_or("the stack is empty")? {
            // Nothing refers to a list of states, which grows after this.
            Value::List(_) => Value::None,
            value => value.clone(),
        };
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

    fn since_mark(&mut self) -> Result<Vec<Value>, String> {
        let mark = self.stack.iter().rposition(|value| matches!(value, Value::Mark));
        let items = self.stack.split_off(mark.ok_or("values have no start mark")? + 1);
        self.stack.pop();
        Ok(items)
    }

    /// Pushes a tuple. Deeper ones than an array needs could exhaust the memory or the stack.
    fn tuple(&mut self, items: Vec<Value>) -> Result<(), String> {
        let is_tuple = |value: &Value| matches!(value, Value::Tuple(_));
        let nests =
            |value: &Value| matches!(value, Value::Tuple(items) if items.iter().any(is_tuple));
        if items.iter().any(nests) {
            return Err("its tuples are nested deeper than an array needs".to_owned());
        }
        self.stack.push(Value::Tuple(items.into()));
        Ok(())
    }

    fn append(&mut self, items: impl IntoIterator<Item = Value>) -> Result<(), String> {
        let Some(Value::List(list)) = self.stack.last_mut() else {
            return Err("values are appended to something that is not a list".to_owned());
        };
        for item in items {
            let Value::Array(Some(array)) = item else {
                return Err(format!("the list holds {}, not only arrays", item.kind()));
            };
            list.push(array);
        }
        Ok(())
    }

    fn storage(&mut self) -> Result<(), String> {
        let Value::Tuple(id) = self.pop()? else {
            return Err("a persistent id is not a tuple".to_owned());
        };
        let [Value::Text(_), Value::Global(Global::Storage(width)), Value::Text(key), ..] = &*id
        else {
            return Err("a persistent id is not that of a storage of numbers".to_owned());
        };
        if !self.storages.contains_key(key) {
            let data = (self.read_storage)(key)?.into();
            self.storages.insert(Rc::clone(key), data);
        }
        self.stack.push(Value::Storage(*width, Rc::clone(&self.storages[key])));
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
            (Value::Global(Global::Dtype), [Value::Text(kind), ..]) => match &**kind {
                "f8" => Value::Dtype(8),
                "f4" => Value::Dtype(4),
                _ => return Err(format!("the numbers are `{kind}`, not `f8` or `f4`")),
            },
            (
                Value::Global(Global::FromBuffer),
                [Value::Bytes(data), Value::Dtype(width), shape, Value::Text(order)],
            ) => Value::Array(Some(Array::new(shape, &**order == "F", *width, data.clone())?)),
            (
                Value::Global(Global::Tensor),
                [Value::Storage(width, data), Value::Int(offset), shape, strides, ..],
            ) => Value::Array(Some(Array {
                shape: matrix_of(&sizes(shape)?, 1)?,
                strides: matrix_of(&sizes(strides)?, 0)?,
                offset: usize::try_from(*offset).map_err(|_| "a tensor's offset is negative")?,
                width: *width,
                data: data.clone(),
            })),
            (Value::Global(Global::OrderedDict), []) => Value::None,
            (Value::Global(Global::Encode), [Value::Text(text), Value::Text(encoding)])
                if &**encoding == "latin1" =>
            {
                let rest = self.encodable.checked_sub(text.len());
                self.encodable = rest.ok_or("it requests more bytes than it has")?;
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
            (Value::Dtype(width), [_, Value::Text(order), ..]) if &**order == "<" => {
                Value::Dtype(width)
            }
            (Value::Dtype(_), _) => return Err("the numbers are not little-endian".to_owned()),
            (
                Value::Array(None),
                [_, shape, Value::Dtype(width), Value::Bool(is_fortran), Value::Bytes(data)],
            ) => Value::Array(Some(Array::new(shape, *is_fortran, *width, data.clone())?)),
            (value, _) => {
                return Err(format!("setting this state of {} is not allowed", value.kind()));
            }
        };
        self.stack.push(built);
        Ok(())
    }
}

fn global(module: &str, name: &str) -> Result<Global, String> {
    match (module, name) {
        ("numpy.core.multiarray" | "numpy._core.multiarray", "_reconstruct") => {
            Ok(Global::Reconstruct)
        }
        ("numpy.core.numeric" | "numpy._core.numeric", "_frombuffer") => Ok(Global::FromBuffer),
        ("numpy", "ndarray") => Ok(Global::Ndarray),
        ("numpy", "dtype") => Ok(Global::Dtype),
        ("_codecs", "encode") => Ok(Global::Encode),
        ("torch._utils", "_rebuild_tensor_v2") => Ok(Global::Tensor),
        ("torch", "DoubleStorage") => Ok(Global::Storage(8)),
        ("torch", "FloatStorage") => Ok(Global::Storage(4)),
        ("collections", "OrderedDict") => Ok(Global::OrderedDict),
        _ => Err(format!("`{module}.{name}` is not allowed")),
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

    fn no_storage(key: &str) -> Result<Vec<u8>, String> {
        Err(format!("no storage {key}"))
    }

    #[test]
    fn anything_but_an_array_is_refused() {
        let check = |bytes: &[u8], expected: &str| {
            let problem = read_matrix(bytes, &mut no_storage).unwrap_err();
            assert!(problem.contains(expected), "{problem}");
        };
        check(b"\x80\x02cos\nsystem\nq\x00.", "`os.system` is not allowed");
        check(b"\x80\x02}q\x00.", "opcode 0x7d is not allowed");
        check(b"\x80\x02]K\x01a.", "the list holds an integer");
        check(b"\x80\x02K\x01.", "holds no array of numbers");
        check(b"\x80\x02X\xff\xff\xff\x7f", "truncated");
        check(b"", "truncated");
    }

    /// The same matrix, as users' scripts save it with NumPy 2 and PyTorch.
    #[test]
    fn arrays_tensors_and_lists_of_every_protocol_are_read() {
        let forms: [(&str, &[u8]); 4] = [
            (
                "floats, protocol 3",
                b"\x80\x03cnumpy._core.multiarray\n_reconstruct\nq\0cnumpy\nndarray\nq\x01K\0\
                  \x85q\x02C\x01bq\x03\x87q\x04Rq\x05(K\x01K\x02K\x03\x86q\x06cnumpy\ndtype\nq\
                  \x07X\x02\0\0\0f4q\x08\x89\x88\x87q\x09Rq\n(K\x03X\x01\0\0\0<q\x0bNNNJ\xff\xff\
                  \xff\xffJ\xff\xff\xff\xffK\0tq\x0cb\x89C\x18\0\0\x80?\0\0\0@\0\0@@\0\0\x80@\0\
                  \0\xa0@\0\0\xd0@q\x0dtq\x0eb.",
            ),
            (
                "a list, protocol 4",
                b"\x80\x04\x95\xdb\0\0\0\0\0\0\0]\x94(\x8c\x16numpy._core.multiarray\x94\x8c\x0c\
                  _reconstruct\x94\x93\x94\x8c\x05numpy\x94\x8c\x07ndarray\x94\x93\x94K\0\x85\
                  \x94C\x01b\x94\x87\x94R\x94(K\x01K\x03\x85\x94h\x04\x8c\x05dtype\x94\x93\x94\
                  \x8c\x02f8\x94\x89\x88\x87\x94R\x94(K\x03\x8c\x01<\x94NNNJ\xff\xff\xff\xffJ\
                  \xff\xff\xff\xffK\0t\x94b\x89C\x18\0\0\0\0\0\0\xf0?\0\0\0\0\0\0\0@\0\0\0\0\0\0\
                  \x08@\x94t\x94bh\x03h\x06K\0\x85\x94h\x08\x87\x94R\x94(K\x01K\x03\x85\x94h\x10\
                  \x89C\x18\0\0\0\0\0\0\x10@\0\0\0\0\0\0\x14@\0\0\0\0\0\0\x1a@\x94t\x94be.",
            ),
            (
                "Fortran order, protocol 5",
                b"\x80\x05\x95\xa6\0\0\0\0\0\0\0\x8c\x13numpy._core.numeric\x94\x8c\x0b_frombuff\
                  er\x94\x93\x94(\x960\0\0\0\0\0\0\0\0\0\0\0\0\0\xf0?\0\0\0\0\0\0\x10@\0\0\0\0\0\
                  \0\0@\0\0\0\0\0\0\x14@\0\0\0\0\0\0\x08@\0\0\0\0\0\0\x1a@\x94\x8c\x05numpy\x94\
                  \x8c\x05dtype\x94\x93\x94\x8c\x02f8\x94\x89\x88\x87\x94R\x94(K\x03\x8c\x01<\
                  \x94NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\0t\x94bK\x02K\x03\x86\x94\x8c\x01F\
                  \x94t\x94R\x94.",
            ),
            (
                "a tensor",
                b"\x80\x02ctorch._utils\n_rebuild_tensor_v2\nq\0((X\x07\0\0\0storageq\x01ctorch\
                  \nDoubleStorage\nq\x02X\x01\0\0\x000q\x03X\x03\0\0\0cpuq\x04K\x06tq\x05QK\0K\x02\
                  K\x03\x86q\x06K\x03K\x01\x86q\x07\x89ccollections\nOrderedDict\nq\x08)Rq\x09tq\
                  \nRq\x0b.",
            ),
        ];
        let values = [1.0, 2.0, 3.0, 4.0, 5.0, 6.5];
        let mut storage = |key: &str| match key {
            "0" => Ok(values.iter().copied().flat_map(f64::to_le_bytes).collect()),
            _ => no_storage(key),
        };
        for (form, bytes) in forms {
            let read = read_matrix(bytes, &mut storage).expect(form);
            let expected = Matrix { rows: 2, columns: 3, values: values.to_vec() };
            assert_eq!(read, expected, "{form}");
        }
    }

    #[test]
    fn a_small_file_cannot_use_much_memory() {
        // Each round nests the previous tuple twice.
        let mut bytes = b"\x80\x02)q\x00".to_vec();
        for _ in 0..40 {
            bytes.extend(b"h\x00h\x00\x86q\x00");
        }
        bytes.extend(b"R");
        let problem = read_matrix(&bytes, &mut no_storage).unwrap_err();
        assert!(problem.contains("nested deeper"), "{problem}");
        let endless = [b")".as_slice(), &b"N".repeat(100_000)].concat();
        let problem = read_matrix(&endless, &mut no_storage).unwrap_err();
        assert!(problem.contains("more opcodes"), "{problem}");
    }
}
