//! Reads a gateway's configuration file:
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

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    time::Duration,
};

use libero_ctrl::plain_words;
use policy_backends::{BackendSpec, DEFAULT_ANSWER_WITHIN, spec::BackendSpecError};
use serde::Deserialize;

use super::{AccessFiles, Batching, CheckpointSpecs, Config, ConfigError, RouteName, RouteSpec};

/// Longest `answer_within_secs`.
const MAX_ANSWER_WITHIN_SECS: f64 = 3600.0;

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

/// Reads a configuration from a file.
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
    let checkpoints = match (table.replicas.is_empty(), table.suites.is_empty()) {
        (false, false) => return Err(ConfigError::ReplicasAndSuites { name }),
        (_, true) => CheckpointSpecs::One(backends(&table.replicas)?),
        (true, false) => {
            let suites = table.suites.into_iter();
            let suites = suites.map(|(suite, replicas)| Ok((suite, backends(&replicas)?)));
            CheckpointSpecs::PerSuite(suites.collect::<Result<_, ConfigError>>()?)
        }
    };
    Ok(RouteSpec {
        name,
        checkpoints,
        batching: table.batching,
        answer_within,
        access: AccessFiles { ca: table.ca, token_file: table.token_file },
        record: None,
    })
}

fn backends(texts: &[String]) -> Result<Vec<BackendSpec>, BackendSpecError> {
    texts.iter().map(|text| text.parse()).collect()
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    fn read_text(text: &str) -> Result<Config, ConfigError> {
        let mut file = tempfile::NamedTempFile::new().expect("a file");
        file.write_all(text.as_bytes()).expect("written");
        read(file.path())
    }

    fn check(text: &str, expected: &str) {
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
        assert_eq!(oft.checkpoints, CheckpointSpecs::PerSuite(suites));
        assert_eq!(pi05.answer_within, DEFAULT_ANSWER_WITHIN);
        assert!(matches!(&pi05.checkpoints, CheckpointSpecs::One(two) if two.len() == 2));
    }

    #[test]
    fn an_invalid_file_is_refused_with_the_faulty_line() {
        check("", "find a route");
        check("[policy.x]", "find a server for policy x");
        check("[policy.x]\nreplicas = [\"ftp://a:1\"]", "ftp://a:1");
        check("[policy.x]\nreplicas = [\"wss://a:1\"]", "`ca =");
        let unknown = "line 2 of";
        check("[policy.x]\nreplica = []", unknown);
        check("[policy.x]\nreplica = []", "there is no field `replica`");
        check("[policy.x]\nbatching = \"big\"", "write one of `dynamic`");
        check("[policy.\"a b\"]", "letters, digits");
        check(
            "[policy.x]\nreplicas = [\"grpc://a:1\"]\nanswer_within_secs = 0",
            "answer_within_secs = 0",
        );
        check(
            "[policy.x]\nreplicas = [\"grpc://a:1\"]\n[policy.x.suites]\ng = [\"grpc://a:2\"]",
            "`replicas` and `suites`",
        );
        check("[policy.x.suites]\ng = []", "find a server for policy x");
    }
}
