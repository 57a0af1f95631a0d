//! What a gateway is told at its start: its routes. Responsible for reading
//! them and for refusing what cannot be meant, before anything is opened.

use std::{fmt, str::FromStr};

use thiserror::Error;

use crate::{
    backend::grpc::{AddressError, GrpcAddress},
    builtin::{Builtin, UnknownBuiltin},
};

/// HTTP/2 window of one call, bytes: an observation of two 256×256 frames fits
/// twenty times, so that no call waits for a window update.
pub const STREAM_WINDOW_BYTES: u32 = 8 << 20;
/// HTTP/2 window of one connection, bytes.
pub const CONNECTION_WINDOW_BYTES: u32 = 32 << 20;
/// Longest route name, bytes.
pub const MAX_ROUTE_NAME_BYTES: usize = 64;

/// The routes of a gateway: at least one, each name once.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Config {
    routes: Vec<RouteSpec>,
}

impl Config {
    /// Checks the routes against each other.
    ///
    /// # Errors
    /// When there is none, or a name occurs twice.
    pub fn new(routes: Vec<RouteSpec>) -> Result<Self, ConfigError> {
        if routes.is_empty() {
            return Err(ConfigError::NoRoute);
        }
        for (at, route) in routes.iter().enumerate() {
            if routes[..at]
                .iter()
                .any(|earlier| earlier.name == route.name)
            {
                return Err(ConfigError::Twice {
                    name: route.name.clone(),
                });
            }
        }
        Ok(Self { routes })
    }

    /// In the order given.
    pub fn routes(&self) -> &[RouteSpec] {
        &self.routes
    }
}

/// One route as written: `NAME=BACKEND`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RouteSpec {
    /// What a request's `policy` says.
    pub name: RouteName,
    /// What answers.
    pub backend: BackendSpec,
}

impl FromStr for RouteSpec {
    type Err = ConfigError;

    fn from_str(text: &str) -> Result<Self, ConfigError> {
        let (name, backend) = text.split_once('=').ok_or_else(|| ConfigError::Form {
            text: text.to_owned(),
        })?;
        Ok(Self {
            name: name.parse()?,
            backend: backend.parse()?,
        })
    }
}

/// Name of a route: letters, digits, `.`, `_` and `-`.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RouteName(String);

impl RouteName {
    /// As written.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl FromStr for RouteName {
    type Err = ConfigError;

    fn from_str(text: &str) -> Result<Self, ConfigError> {
        let allowed = |byte: u8| byte.is_ascii_alphanumeric() || b"._-".contains(&byte);
        if (1..=MAX_ROUTE_NAME_BYTES).contains(&text.len()) && text.bytes().all(allowed) {
            Ok(Self(text.to_owned()))
        } else {
            Err(ConfigError::Name {
                name: text.to_owned(),
            })
        }
    }
}

impl fmt::Display for RouteName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// What answers for a route: `builtin:NAME` or `grpc://HOST:PORT[/POLICY]`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum BackendSpec {
    /// A policy inside the gateway.
    Builtin(Builtin),
    /// A policy server elsewhere.
    Grpc(GrpcAddress),
}

impl FromStr for BackendSpec {
    type Err = ConfigError;

    fn from_str(text: &str) -> Result<Self, ConfigError> {
        if let Some(name) = text.strip_prefix("builtin:") {
            Ok(Self::Builtin(name.parse()?))
        } else if let Some(address) = text.strip_prefix("grpc://") {
            Ok(Self::Grpc(address.parse()?))
        } else {
            Err(ConfigError::Backend {
                text: text.to_owned(),
            })
        }
    }
}

/// Why routes cannot be served. Reads after "failed to …".
#[derive(Debug, Error)]
pub enum ConfigError {
    /// Nothing to serve.
    #[error("find a route: give at least one --route NAME=BACKEND")]
    NoRoute,
    /// Not `NAME=BACKEND`.
    #[error("read route {text:?}: write NAME=BACKEND, for example expert=builtin:expert")]
    Form {
        /// As written.
        text: String,
    },
    /// A name that would be hard to quote.
    #[error(
        "use {name:?} as a route's name: take 1 to {MAX_ROUTE_NAME_BYTES} letters, digits, '.', \
         '_' and '-'"
    )]
    Name {
        /// As written.
        name: String,
    },
    /// The same name for two routes.
    #[error("tell two routes named {name} apart: give each its own name")]
    Twice {
        /// The name.
        name: RouteName,
    },
    /// No such kind.
    #[error("read back-end {text:?}: write grpc://HOST:PORT or builtin:NAME")]
    Backend {
        /// As written.
        text: String,
    },
    /// `builtin:` and something unknown.
    #[error(transparent)]
    Builtin(#[from] UnknownBuiltin),
    /// `grpc://` and no address.
    #[error(transparent)]
    Address(#[from] AddressError),
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(route: &str, expected: &str) {
        let error = route.parse::<RouteSpec>().expect_err(route).to_string();
        assert!(error.contains(expected), "{route}: {error}");
    }

    #[test]
    fn a_route_that_cannot_be_meant_is_refused_with_what_to_write() {
        check("expert", "NAME=BACKEND");
        check("=builtin:noop", "letters, digits");
        check("a b=builtin:noop", "letters, digits");
        check("x=builtin:nope", "noop and expert");
        check("x=ws://host:1", "grpc://HOST:PORT or builtin:NAME");
        check("x=grpc://host", "grpc://HOST:PORT");
    }

    #[test]
    fn a_gateway_needs_a_route_and_each_name_once() {
        let route = |text: &str| text.parse::<RouteSpec>().expect(text);
        assert!(matches!(Config::new(vec![]), Err(ConfigError::NoRoute)));
        let twice = vec![route("x=builtin:noop"), route("x=grpc://h:1")];
        assert!(matches!(Config::new(twice), Err(ConfigError::Twice { .. })));
        let two = vec![route("x=builtin:noop"), route("y=grpc://h:1")];
        assert_eq!(Config::new(two.clone()).expect("two routes").routes(), two);
    }
}
