//! A child process's side of the socket to its parent. The socket is the child's standard input,
//! so that no file descriptor is passed by number, and native libraries can print to standard
//! output. Messages are JSON values, one per line, in both directions.

use std::io::{self, BufRead, BufReader, Read, Write};
use std::marker::PhantomData;
use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::message::MAX_LINE_BYTES;

#[derive(Debug)]
pub struct Parent(UnixStream);

/// Iterator over the parent's messages, which ends when the parent closes the connection.
#[derive(Debug)]
pub struct FromParent<T> {
    stream: BufReader<UnixStream>,
    _message: PhantomData<T>,
}

impl Parent {
    /// Opens the connection on this process's standard input.
    pub fn connect() -> io::Result<Self> {
        let stdin = io::stdin().as_fd().try_clone_to_owned()?;
        Ok(Self(stdin.into()))
    }

    pub fn send<T: Serialize>(&self, value: &T) -> io::Result<()> {
        let mut line = serde_json::to_vec(value)?;
        line.push(b'\n');
        (&self.0).write_all(&line)
    }

    /// Returns an iterator over the parent's messages. To be called once, since two iterators would
    /// each get a part of the messages.
    pub fn listen<T: DeserializeOwned>(&self) -> io::Result<FromParent<T>> {
        Ok(FromParent { stream: BufReader::new(self.0.try_clone()?), _message: PhantomData })
    }
}

impl<T: DeserializeOwned> Iterator for FromParent<T> {
    type Item = io::Result<T>;

    /// Returns an error for a message that is not a `T`.
    fn next(&mut self) -> Option<io::Result<T>> {
        let mut line = Vec::new();
        let mut stream = self.stream.by_ref().take(MAX_LINE_BYTES);
        match stream.read_until(b'\n', &mut line) {
            Ok(0) | Err(_) => None,
            Ok(_) => Some(serde_json::from_slice(&line).map_err(io::Error::from)),
        }
    }
}
