//! A child process's side of the socket to its parent, which is its standard
//! input: so it takes no file descriptor by number, and standard output is left
//! to native libraries, which may print what they like. One JSON value per line,
//! both ways.

use std::io::{self, BufRead, BufReader, Read, Write};
use std::marker::PhantomData;
use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::message::MAX_LINE_BYTES;

/// The way to the parent process.
#[derive(Debug)]
pub struct Parent(UnixStream);

/// Messages of the parent, until it closes its side.
#[derive(Debug)]
pub struct FromParent<T> {
    stream: BufReader<UnixStream>,
    _says: PhantomData<T>,
}

impl Parent {
    /// Takes this process's standard input.
    ///
    /// # Errors
    /// If there is none.
    pub fn connect() -> io::Result<Self> {
        let stdin = io::stdin().as_fd().try_clone_to_owned()?;
        Ok(Self(stdin.into()))
    }

    /// Tells the parent something.
    ///
    /// # Errors
    /// If the parent no longer listens.
    pub fn send<T: Serialize>(&self, value: &T) -> io::Result<()> {
        let mut line = serde_json::to_vec(value)?;
        line.push(b'\n');
        (&self.0).write_all(&line)
    }

    /// Returns the parent's messages from now on. They must be read in one
    /// place.
    ///
    /// # Errors
    /// If this process has too many open files.
    pub fn listen<T: DeserializeOwned>(&self) -> io::Result<FromParent<T>> {
        Ok(FromParent {
            stream: BufReader::new(self.0.try_clone()?),
            _says: PhantomData,
        })
    }
}

impl<T: DeserializeOwned> Iterator for FromParent<T> {
    type Item = io::Result<T>;

    /// An error if the parent says something else than a `T`.
    fn next(&mut self) -> Option<io::Result<T>> {
        let mut line = Vec::new();
        let mut stream = self.stream.by_ref().take(MAX_LINE_BYTES);
        match stream.read_until(b'\n', &mut line) {
            Ok(0) | Err(_) => None,
            Ok(_) => Some(serde_json::from_slice(&line).map_err(io::Error::from)),
        }
    }
}
