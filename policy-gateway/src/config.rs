//! A gateway's configuration, which consists of routes. An invalid configuration is refused before
//! any back-end is created; [`mod@file`] reads a configuration from TOML.

use std::{collections::BTreeMap, path::PathBuf, str::FromStr, time::Duration};

use policy_backends::{BackendSpec, DEFAULT_ANSWER_WITHIN, recorder::RecordInto};
use serde::Deserialize;
use transport::{Access, AccessError, Role};

mod error;
pub mod file;
mod name;

pub use error::{ConfigError, MAX_REPLICAS};
pub use name::{MAX_ROUTE_NAME_BYTES, RouteName, RouteNameError};

/// Routes of a gateway: at least one route; the names are distinct.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Config {
    routes: Vec<RouteSpec>,
}

impl Config {
    /// Checks the routes individually and against each other.
    pub fn new(routes: Vec<RouteSpec>) -> Result<Self, ConfigError> {
        if routes.is_empty() {
            return Err(ConfigError::NoRoute);
        }
        for (index, route) in routes.iter().enumerate() {
            if routes[..index].iter().any(|earlier| earlier.name == route.name) {
                return Err(ConfigError::DuplicateRoute { name: route.name.clone() });
            }
            route.check()?;
        }
        Ok(Self { routes })
    }

    /// Returns the routes in the given order.
    pub fn routes(&self) -> &[RouteSpec] {
        &self.routes
    }
}

/// Route of a gateway. As a flag: `NAME=BACKEND`, or `NAME=BACKEND,BACKEND` for replicas.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RouteSpec {
    /// Name of the route, as in the `policy` of requests.
    pub name: RouteName,
    /// Servers of the policy, by checkpoint.
    pub checkpoints: CheckpointSpecs,
    /// Batching and distribution of queries.
    pub batching: Batching,
    /// Longest time for which a server may answer no query while a call is in flight.
    pub answer_within: Duration,
    /// Certificate authority and token for the route's servers.
    pub access: AccessFiles,
    /// Destination of recordings, for a route with a single server.
    pub record: Option<RecordInto>,
}

/// Files that authenticate a policy's servers and the gateway to each other.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct AccessFiles {
    /// Certificate authority of the TLS servers, PEM.
    pub ca: Option<PathBuf>,
    /// File with the token for the servers, as `worker TOKEN` or `operator TOKEN`.
    pub token_file: Option<PathBuf>,
}

impl AccessFiles {
    pub fn read(&self) -> Result<Access, AccessError> {
        let roles = [Role::Worker, Role::Operator];
        Access::from_files(self.ca.as_deref(), self.token_file.as_deref(), &roles)
    }
}

/// Replicas of a route, by checkpoint.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CheckpointSpecs {
    /// One checkpoint for all suites.
    One(Vec<BackendSpec>),
    /// A checkpoint per suite, by the suite's name.
    PerSuite(BTreeMap<String, Vec<BackendSpec>>),
}

/// Batching of queries and choice of the replica.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Batching {
    /// Batches queries if the server declares batches, else sends them one by one. Takes the
    /// replica with the least load.
    #[default]
    Dynamic,
    /// Sends queries one by one, to the replica with the least load.
    Single,
    /// Sends queries one by one, and all sessions of a seed to the same replica: for policies
    /// whose low-order bits depend on batch or replica.
    Deterministic,
}

impl Batching {
    /// Returns the batch mode, as recorded with every result of a policy whose largest batch is
    /// `batch_size`.
    pub fn describe(self, batch_size: usize) -> String {
        match self {
            Self::Deterministic => "deterministic".to_owned(),
            Self::Dynamic if batch_size > 1 => format!("up to {batch_size}"),
            Self::Dynamic | Self::Single => "single".to_owned(),
        }
    }
}

impl RouteSpec {
    /// Creates a route with one server and default settings.
    pub fn new(name: RouteName, backend: BackendSpec) -> Self {
        Self {
            name,
            checkpoints: CheckpointSpecs::One(vec![backend]),
            batching: Batching::default(),
            answer_within: DEFAULT_ANSWER_WITHIN,
            access: AccessFiles::default(),
            record: None,
        }
    }

    fn check(&self) -> Result<(), ConfigError> {
        let name = || self.name.clone();
        let pools: Vec<&[BackendSpec]> = match &self.checkpoints {
            CheckpointSpecs::One(replicas) => vec![replicas],
            CheckpointSpecs::PerSuite(suites) => suites.values().map(Vec::as_slice).collect(),
        };
        if pools.is_empty() || pools.iter().any(|replicas| replicas.is_empty()) {
            return Err(ConfigError::NoReplica { name: name() });
        }
        for replicas in pools {
            if replicas.len() > MAX_REPLICAS {
                return Err(ConfigError::TooManyReplicas { name: name() });
            }
            for (index, replica) in replicas.iter().enumerate() {
                if replica.is_encrypted() && self.access.ca.is_none() {
                    return Err(ConfigError::NoAuthority {
                        name: name(),
                        replica: replica.to_string(),
                    });
                }
                if replicas[..index].contains(replica) {
                    return Err(ConfigError::DuplicateReplica {
                        name: name(),
                        replica: replica.to_string(),
                    });
                }
            }
        }
        Ok(())
    }
}

impl FromStr for RouteSpec {
    type Err = ConfigError;

    fn from_str(text: &str) -> Result<Self, ConfigError> {
        let (name, replicas) =
            text.split_once('=').ok_or_else(|| ConfigError::Form { text: text.to_owned() })?;
        let name = name.parse()?;
        let replicas = replicas.split(',').map(str::parse);
        Ok(Self {
            name,
            checkpoints: CheckpointSpecs::One(replicas.collect::<Result<_, _>>()?),
            batching: Batching::default(),
            answer_within: DEFAULT_ANSWER_WITHIN,
            access: AccessFiles::default(),
            record: None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(route: &str, expected: &str) {
        let config = route.parse().and_then(|route| Config::new(vec![route]));
        let error = config.expect_err(route).to_string();
        assert!(error.contains(expected), "{route}: {error}");
    }

    #[test]
    fn an_invalid_route_is_refused_with_the_valid_form() {
        check("expert", "NAME=BACKEND");
        check("=builtin:noop", "letters, digits");
        check("a b=builtin:noop", "letters, digits");
        check("x=builtin:nope", "noop, expert, expert-with-frames, student, student-boxes");
        check("x=http://host:1", "grpc://HOST:PORT");
        check("x=ws://host", "ws://HOST:PORT");
        check("x=vla-eval://host", "vla-eval://HOST:PORT");
        check("x=https://host:1", "`ca = \"FILE\"`");
        check("x=vla-evals://host:1", "`ca = \"FILE\"`");
        check("x=grpc://host", "grpc://HOST:PORT");
        check("x=grpc://host:1,", "grpc://HOST:PORT");
    }

    #[test]
    fn a_configuration_needs_a_route_distinct_names_and_distinct_servers() {
        let route = |text: &str| text.parse::<RouteSpec>().expect(text);
        assert!(matches!(Config::new(vec![]), Err(ConfigError::NoRoute)));
        let twice = vec![route("x=builtin:noop"), route("x=grpc://h:1")];
        assert!(matches!(Config::new(twice), Err(ConfigError::DuplicateRoute { .. })));
        let same = vec![route("x=grpc://h:1,grpc://h:1")];
        let error = Config::new(same).expect_err("one server twice");
        assert!(error.to_string().contains("grpc://h:1 is given twice"));
        let two = vec![route("x=builtin:noop"), route("y=grpc://h:1")];
        assert_eq!(Config::new(two.clone()).expect("two routes").routes(), two);
    }
}
