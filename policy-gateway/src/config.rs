//! A gateway's configuration, which consists of routes. An invalid configuration is refused before
//! any back-end is created. A configuration file:
//!
//! ```toml
//! [policy.pi05]
//! replicas = ["grpc://gpu1:5000", "grpc://gpu2:5000"]
//!
//! [policy.openvla-oft]
//! batching = "deterministic"
//! answer_within_secs = 20
//!
//! [policy.openvla-oft.suites]
//! libero_goal = ["grpc://gpu3:5001"]
//! libero_spatial = ["grpc://gpu3:5002"]
//!
//! [policy.hosted]
//! replicas = ["https://gpu4:5000"]
//! ca = "gpu4-ca.pem"
//! token_file = "gpu4-token"
//! ```

use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Duration;

use benchmark::plain_words;
use policy_backends::recorder::RecordInto;
use policy_backends::spec::BackendSpecError;
use policy_backends::{BackendSpec, DEFAULT_ANSWER_WITHIN};
use serde::Deserialize;
use thiserror::Error;
use transport::{Access, AccessError, Role};

/// Largest number of replicas of one checkpoint.
pub const MAX_REPLICAS: usize = 64;
/// Longest route name, bytes.
pub const MAX_ROUTE_NAME_BYTES: usize = 64;
const MAX_ANSWER_WITHIN_SECS: f64 = 3600.0;

/// Reason why a configuration is invalid. The message follows "failed to …".
#[derive(Debug, Error)]
pub enum ConfigError {
    #[error("find a route: give at least one --route NAME=BACKEND, or a [policy.NAME] in --config")]
    NoRoute,
    #[error("read {path:?}: give the path of a gateway's configuration, as in docs/POLICIES.md")]
    Unreadable { path: PathBuf, source: std::io::Error },
    #[error("read line {line} of {path:?} as a gateway's configuration: {problem}")]
    Toml { path: PathBuf, line: usize, problem: String },
    #[error("use {path:?}")]
    InFile { path: PathBuf, source: Box<ConfigError> },
    #[error(
        "find a server for policy {name}: give `replicas`, or a `suites` table, with at least one \
         server each"
    )]
    NoReplica { name: RouteName },
    #[error("choose between `replicas` and `suites` of policy {name}: give one of them")]
    ReplicasAndSuites { name: RouteName },
    #[error(
        "take more than {MAX_REPLICAS} replicas of one checkpoint of policy {name}: serve the \
         others under another policy's name"
    )]
    TooManyReplicas { name: RouteName },
    #[error("tell two replicas of policy {name} apart: {replica} is given twice")]
    DuplicateReplica { name: RouteName, replica: String },
    #[error("use answer_within_secs = {secs} of policy {name}: take a positive number up to 3600")]
    AnswerWithin { name: RouteName, secs: f64 },
    #[error("read route {text:?}: write NAME=BACKEND, for example expert=builtin:expert")]
    Form { text: String },
    #[error(
        "use {name:?} as a route's name: take 1 to {MAX_ROUTE_NAME_BYTES} letters, digits, '.', \
         '_' and '-'"
    )]
    Name { name: String },
    #[error("tell two routes named {name} apart: give each its own name")]
    DuplicateRoute { name: RouteName },
    /// The text does not specify a back-end.
    #[error(transparent)]
    Backend(#[from] BackendSpecError),
    #[error(
        "trust {replica} of policy {name}: give the certificate authority that signed its \
         certificate, as `ca = \"FILE\"` in --config"
    )]
    NoAuthority { name: RouteName, replica: String },
}

/// Name of a route: letters, digits, `.`, `_` and `-`.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RouteName(String);

impl RouteName {
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
            Err(ConfigError::Name { name: text.to_owned() })
        }
    }
}

impl fmt::Display for RouteName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// Routes of a gateway: at least one route; the names are distinct.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Config {
    routes: Vec<RouteSpec>,
}

impl Config {
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

    pub fn routes(&self) -> &[RouteSpec] {
        &self.routes
    }
}

/// Route of a gateway. As a flag: `NAME=BACKEND`, or `NAME=BACKEND,BACKEND` for replicas.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RouteSpec {
    /// Name of the route, as in the `policy` of requests.
    pub name: RouteName,
    /// Servers of each suite's checkpoint; those of the empty name serve all suites.
    pub checkpoints: BTreeMap<String, Vec<BackendSpec>>,
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
    pub fn new(name: RouteName, replicas: Vec<BackendSpec>) -> Self {
        Self {
            name,
            checkpoints: BTreeMap::from([(String::new(), replicas)]),
            batching: Batching::default(),
            answer_within: DEFAULT_ANSWER_WITHIN,
            access: AccessFiles::default(),
            record: None,
        }
    }

    fn check(&self) -> Result<(), ConfigError> {
        let name = || self.name.clone();
        let pools = self.checkpoints.values();
        if self.checkpoints.is_empty() || pools.clone().any(Vec::is_empty) {
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
        let replicas: Vec<&str> = replicas.split(',').collect();
        Ok(Self::new(name.parse()?, backends(&replicas)?))
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Document {
    #[serde(default)]
    policy: BTreeMap<String, Table>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Table {
    #[serde(default)]
    replicas: Vec<String>,
    #[serde(default)]
    suites: BTreeMap<String, Vec<String>>,
    #[serde(default)]
    batching: Batching,
    answer_within_secs: Option<f64>,
    ca: Option<PathBuf>,
    token_file: Option<PathBuf>,
}

pub fn read(path: &Path) -> Result<Config, ConfigError> {
    let text = std::fs::read_to_string(path)
        .map_err(|source| ConfigError::Unreadable { path: path.to_owned(), source })?;
    let document = toml::from_str::<Document>(&text).map_err(|error| ConfigError::Toml {
        path: path.to_owned(),
        line: line_of(&text, error.span().map_or(0, |span| span.start)),
        problem: plain_words(error.message()),
    })?;
    let routes = document.policy.into_iter().map(|(name, table)| route(&name, table));
    routes
        .collect::<Result<_, _>>()
        .and_then(Config::new)
        .map_err(|source| ConfigError::InFile { path: path.to_owned(), source: source.into() })
}

/// Returns the line number of a byte, from 1.
fn line_of(text: &str, byte: usize) -> usize {
    let before = text.bytes().take(byte);
    1 + before.filter(|byte| *byte == b'\n').count()
}

fn route(name: &str, table: Table) -> Result<RouteSpec, ConfigError> {
    let name: RouteName = name.parse()?;
    let secs = table.answer_within_secs;
    let answer_within = match secs {
        None => DEFAULT_ANSWER_WITHIN,
        Some(secs) if secs > 0.0 && secs <= MAX_ANSWER_WITHIN_SECS => Duration::from_secs_f64(secs),
        Some(secs) => return Err(ConfigError::AnswerWithin { name, secs }),
    };
    let suites = match (table.replicas.is_empty(), table.suites.is_empty()) {
        (false, false) => return Err(ConfigError::ReplicasAndSuites { name }),
        (_, true) => BTreeMap::from([(String::new(), table.replicas)]),
        (true, false) => table.suites,
    };
    let suites = suites.into_iter().map(|(suite, replicas)| Ok((suite, backends(&replicas)?)));
    let checkpoints = suites.collect::<Result<_, ConfigError>>()?;
    let access = AccessFiles { ca: table.ca, token_file: table.token_file };
    let batching = table.batching;
    Ok(RouteSpec { checkpoints, batching, answer_within, access, ..RouteSpec::new(name, vec![]) })
}

fn backends(texts: &[impl AsRef<str>]) -> Result<Vec<BackendSpec>, BackendSpecError> {
    texts.iter().map(|text| text.as_ref().parse()).collect()
}

#[cfg(test)]
mod tests {
    use std::io::Write;

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
        check("x=builtin:nope", "noop, expert, student, student-boxes");
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

    fn read_text(text: &str) -> Result<Config, ConfigError> {
        let mut file = tempfile::NamedTempFile::new().expect("a file");
        file.write_all(text.as_bytes()).expect("written");
        read(file.path())
    }

    fn check_file(text: &str, expected: &str) {
        let error = read_text(text).expect_err(text);
        let message = format!("{:#}", anyhow::Error::from(error));
        assert!(message.contains(expected), "{text}: {message}");
    }

    #[test]
    fn policies_with_replicas_and_checkpoints_per_suite_are_read() {
        let config = read_text(
            r#"
            [policy.pi05]
            replicas = ["grpc://a:1", "grpc://b:1/pi05"]

            [policy.oft]
            batching = "deterministic"
            answer_within_secs = 0.5
            [policy.oft.suites]
            libero_goal = ["grpc://a:2"]
            "#,
        )
        .expect("a configuration");
        let [oft, pi05] = config.routes() else {
            panic!("two routes, by name: {config:?}");
        };
        assert_eq!(oft.batching, Batching::Deterministic);
        assert_eq!(oft.answer_within, Duration::from_millis(500));
        let goal = vec!["grpc://a:2".parse().expect("a back-end")];
        let suites = BTreeMap::from([("libero_goal".to_owned(), goal)]);
        assert_eq!(oft.checkpoints, suites);
        assert_eq!(pi05.answer_within, DEFAULT_ANSWER_WITHIN);
        assert_eq!(pi05.checkpoints[""].len(), 2);
    }

    #[test]
    fn an_invalid_file_is_refused_with_the_faulty_line() {
        check_file("", "find a route");
        check_file("[policy.x]", "find a server for policy x");
        check_file("[policy.x]\nreplicas = [\"ftp://a:1\"]", "ftp://a:1");
        check_file("[policy.x]\nreplicas = [\"wss://a:1\"]", "`ca =");
        let unknown = "line 2 of";
        check_file("[policy.x]\nreplica = []", unknown);
        check_file("[policy.x]\nreplica = []", "there is no field `replica`");
        check_file("[policy.x]\nbatching = \"big\"", "write one of `dynamic`");
        check_file("[policy.\"a b\"]", "letters, digits");
        check_file(
            "[policy.x]\nreplicas = [\"grpc://a:1\"]\nanswer_within_secs = 0",
            "answer_within_secs = 0",
        );
        check_file(
            "[policy.x]\nreplicas = [\"grpc://a:1\"]\n[policy.x.suites]\ng = [\"grpc://a:2\"]",
            "`replicas` and `suites`",
        );
        check_file("[policy.x.suites]\ng = []", "find a server for policy x");
    }
}
