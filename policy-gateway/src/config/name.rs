//! Names of routes.

use std::{fmt, str::FromStr};

use thiserror::Error;

/// Longest route name, bytes.
pub const MAX_ROUTE_NAME_BYTES: usize = 64;

/// Name of a route: letters, digits, `.`, `_` and `-`.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RouteName(String);

impl RouteName {
    /// Returns the name as written.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl FromStr for RouteName {
    type Err = RouteNameError;

    fn from_str(text: &str) -> Result<Self, RouteNameError> {
        let allowed = |byte: u8| byte.is_ascii_alphanumeric() || b"._-".contains(&byte);
        if (1..=MAX_ROUTE_NAME_BYTES).contains(&text.len()) && text.bytes().all(allowed) {
            Ok(Self(text.to_owned()))
        } else {
            Err(RouteNameError { name: text.to_owned() })
        }
    }
}

impl fmt::Display for RouteName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// The route's name is empty or too long, or has characters that are not allowed.
#[derive(Debug, Error)]
#[error(
    "use {name:?} as a route's name: take 1 to {MAX_ROUTE_NAME_BYTES} letters, digits, '.', '_' \
     and '-'"
)]
pub struct RouteNameError {
    pub name: String,
}
