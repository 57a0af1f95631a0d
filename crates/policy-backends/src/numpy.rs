//! NumPy arrays in msgpack messages, in the form of openpi's and vla-eval's servers: a map of
//! `__ndarray__`, `data`, `dtype` and `shape`. Pure functions.

use rmpv::decode::read_value_ref;
use rmpv::encode::write_value;
use rmpv::{Value, ValueRef};
use thiserror::Error;

#[derive(Clone, Copy, Debug)]
pub(super) enum Keys {
    /// Byte strings, as in openpi.
    Bytes,
    /// Text, as in vla-eval.
    Text,
}

#[derive(Clone, Debug, PartialEq)]
pub struct Array {
    /// Length of each dimension.
    pub shape: Vec<usize>,
    /// Elements in row-major order.
    pub numbers: Vec<f32>,
}

/// Reason why a value is not an array of numbers. Messages begin with "its actions".
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum ArrayError {
    #[error("its actions are not an array of numbers")]
    NotAnArray,
    #[error("its actions have dtype {dtype:?}, not <f4 or <f8")]
    Dtype { dtype: String },
}

pub(super) fn array(keys: Keys, dtype: &str, shape: &[usize], data: Vec<u8>) -> Value {
    let shape = shape.iter().map(|&side| Value::from(side)).collect();
    let entries = [
        ("__ndarray__", Value::Boolean(true)),
        ("data", Value::Binary(data)),
        ("dtype", Value::from(dtype)),
        ("shape", Value::Array(shape)),
    ];
    let key = |key: &str| match keys {
        Keys::Bytes => Value::Binary(key.as_bytes().to_vec()),
        Keys::Text => Value::from(key),
    };
    Value::Map(entries.map(|(name, value)| (key(name), value)).into())
}

pub(super) fn map<const N: usize>(entries: [(&str, Value); N]) -> Value {
    Value::Map(entries.map(|(key, value)| (Value::from(key), value)).into())
}

pub(super) fn encode(message: &Value) -> Vec<u8> {
    let mut bytes = vec![];
    write_value(&mut bytes, message).expect("a vector takes every byte");
    bytes
}

pub(super) fn read(bytes: &[u8]) -> Option<ValueRef<'_>> {
    read_value_ref(&mut &*bytes).ok()
}

pub(super) fn numbers(value: &ValueRef<'_>) -> Result<Array, ArrayError> {
    let shape = lookup(value, "shape").and_then(as_shape);
    let dtype = lookup(value, "dtype").and_then(as_text);
    let data = lookup(value, "data").and_then(as_bytes);
    let (Some(shape), Some(dtype), Some(data)) = (shape, dtype, data) else {
        return Err(ArrayError::NotAnArray);
    };
    let numbers: Option<Vec<f32>> = match dtype {
        "<f4" => elements(data)
            .map(|elements| elements.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect()),
        "<f8" => elements(data).map(|elements| {
            elements.iter().map(|bytes| f64::from_le_bytes(*bytes) as f32).collect()
        }),
        other => {
            return Err(ArrayError::Dtype { dtype: other.chars().take(16).collect() });
        }
    };
    let numbers = numbers.ok_or(ArrayError::NotAnArray)?;
    let count = shape.iter().try_fold(1_usize, |count, side| count.checked_mul(*side));
    if count != Some(numbers.len()) {
        return Err(ArrayError::NotAnArray);
    }
    Ok(Array { shape, numbers })
}

/// Splits an array's data into elements of `N` bytes; `None` if bytes remain.
fn elements<const N: usize>(data: &[u8]) -> Option<&[[u8; N]]> {
    let (numbers, []) = data.as_chunks() else {
        return None;
    };
    Some(numbers)
}

/// Returns the entry of a map under a text key or, as in openpi's arrays, a byte-string key.
pub(super) fn lookup<'a, 'b>(map: &'b ValueRef<'a>, key: &str) -> Option<&'b ValueRef<'a>> {
    let ValueRef::Map(entries) = map else {
        return None;
    };
    let is_key =
        |name: &ValueRef<'_>| as_text(name) == Some(key) || as_bytes(name) == Some(key.as_bytes());
    entries.iter().find(|(name, _)| is_key(name)).map(|(_, value)| value)
}

pub(super) fn as_text<'a>(value: &ValueRef<'a>) -> Option<&'a str> {
    match value {
        ValueRef::String(text) => text.into_str(),
        _ => None,
    }
}

fn as_bytes<'a>(value: &ValueRef<'a>) -> Option<&'a [u8]> {
    match value {
        ValueRef::Binary(bytes) => Some(bytes),
        _ => None,
    }
}

fn as_shape(value: &ValueRef<'_>) -> Option<Vec<usize>> {
    let ValueRef::Array(sides) = value else {
        return None;
    };
    let side = |value: &ValueRef<'_>| match value {
        ValueRef::Integer(side) => side.as_u64().and_then(|side| usize::try_from(side).ok()),
        _ => None,
    };
    sides.iter().map(side).collect()
}
