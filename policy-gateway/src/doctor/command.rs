//! `policy-gateway compare` and `policy-gateway doctor`: command-line arguments, and the course of
//! both commands.

use std::{path::PathBuf, time::Duration};

use benchmark::Suite;
use clap::Args;
use policy_backends::{BackendSpec, DEFAULT_ANSWER_WITHIN};
use serde::Serialize;
use terminal::number;
use thiserror::Error;
use transport::{Access, AccessError, ClientArguments, Role};

use crate::doctor::{
    compare::compare,
    diagnosis::{self, Measures, Point},
    looks::{self, RecordedLook},
    recorded,
    report::{self, ComparisonJson, DescribedServer, ExaminationJson},
    server::{ExaminationError, Server},
    situation::Situation,
    synthetic,
    verdict::Finding,
};

/// Options of both commands: the situations, the credentials and the form of the output.
#[derive(Clone, Debug, Args)]
struct CommonOptions {
    /// Send the observations that `policy-gateway record` recorded in this folder, in
    /// place of synthetic scenes
    #[arg(long, value_name = "DIR")]
    recorded: Option<PathBuf>,

    /// Suite of the synthetic tasks
    #[arg(long, value_name = "SUITE", default_value_t = Suite::Object, conflicts_with = "recorded")]
    suite: Suite,

    /// Print JSON
    #[arg(long)]
    json: bool,

    #[command(flatten)]
    access: ClientArguments,
}

/// `compare`.
#[derive(Clone, Debug, Args)]
pub struct Compare {
    /// One server, as in --route: grpc://HOST:PORT[/POLICY], ws://HOST:PORT,
    /// builtin:expert …
    #[arg(value_name = "URL-A")]
    a: BackendSpec,

    /// The other server
    #[arg(value_name = "URL-B")]
    b: BackendSpec,

    #[command(flatten)]
    options: CommonOptions,
}

/// `doctor`.
#[derive(Clone, Debug, Args)]
pub struct Doctor {
    /// The server, as in --route: grpc://HOST:PORT[/POLICY], ws://HOST:PORT,
    /// builtin:expert …
    #[arg(value_name = "URL")]
    url: BackendSpec,

    /// Seconds that a gateway waits for an answer (its answer_within_secs)
    #[arg(long, value_name = "SECS", default_value_t = DEFAULT_ANSWER_WITHIN.as_secs(),
        value_parser = number(1..=3600_u64, "seconds"))]
    answer_within: u64,

    /// Recordings of the same sessions in one look each, given twice: says which look the policy
    /// was probably trained on, for example by recordings of builtin:expert-with-frames
    #[arg(long, value_name = "LOOK=DIR")]
    look: Vec<RecordedLook>,

    /// Episodes to play in order to detect growing memory
    #[arg(long, value_name = "N", default_value_t = 30,
        value_parser = number(0..=100_000_u32, "episodes"))]
    episodes: u32,

    #[command(flatten)]
    options: CommonOptions,
}

/// Reason why a command failed. The message follows "failed to …".
#[derive(Debug, Error)]
pub enum CommandError {
    #[error(transparent)]
    Access(#[from] AccessError),
    #[error(transparent)]
    Examination(#[from] ExaminationError),
}

impl Compare {
    /// Compares two servers, and passes the output to `print`. Returns true if they answer alike.
    pub async fn run(&self, print: &dyn Fn(&str)) -> Result<bool, CommandError> {
        let access = self.options.access()?;
        let recorded = self.options.recorded()?;
        let suite = self.options.suite_of(recorded.as_deref());
        let a = Server::connect(&self.a, &access, &suite).await?;
        let b = Server::connect(&self.b, &access, &suite).await?;
        let situations = recorded.unwrap_or_else(|| {
            let cameras = synthetic::cameras(&[&a.described, &b.described]);
            synthetic::situations(self.options.suite, &cameras)
        });
        let described = [&a, &b].map(|server| DescribedServer::new(&server.url, &server.described));
        if !self.options.json {
            for (letter, server) in ["A", "B"].iter().zip(&described) {
                print(&server.line(letter));
            }
        }
        let comparison = compare(a, b, situations).await?;
        if self.options.json {
            let [a, b] = described;
            print(&json(&ComparisonJson::new(a, b, &comparison)));
        } else {
            for line in report::comparison(&comparison) {
                print(&line);
            }
        }
        Ok(comparison.differences.is_empty())
    }
}

impl Doctor {
    /// Diagnoses a server, and passes the output to `print`. Returns true if no check failed.
    pub async fn run(&self, print: &dyn Fn(&str)) -> Result<bool, CommandError> {
        let access = self.options.access()?;
        let recorded = self.options.recorded()?;
        let looks = match self.look.as_slice() {
            [] => Vec::new(),
            folders => looks::sessions(folders)?,
        };
        let suite = self.options.suite_of(recorded.as_deref());
        let server = Server::connect(&self.url, &access, &suite).await?;
        let situations = recorded.unwrap_or_else(|| {
            let cameras = synthetic::cameras(&[&server.described]);
            synthetic::situations(self.options.suite, &cameras)
        });
        let described = DescribedServer::new(&server.url, &server.described);
        if !self.options.json {
            print(&described.line(""));
        }
        let measures = Measures {
            answer_within: Duration::from_secs(self.answer_within),
            episodes: self.episodes,
        };
        let mut findings = vec![];
        let mut report = |finding: &Finding<Point>| {
            if !self.options.json {
                print(&report::finding(finding));
            }
            findings.push(finding.clone());
        };
        let examined = diagnosis::examine(&server, &situations, &looks, measures, &mut report);
        let is_sound = examined.await?;
        match self.options.json {
            true => print(&json(&ExaminationJson::new(described, &findings))),
            false if is_sound => print("no fault found"),
            false => print("faults found: see FAIL above"),
        }
        Ok(is_sound)
    }
}

impl CommonOptions {
    fn access(&self) -> Result<Access, AccessError> {
        self.access.access(&[Role::Operator, Role::Worker])
    }

    fn recorded(&self) -> Result<Option<Vec<Situation>>, ExaminationError> {
        let folder = self.recorded.as_deref();
        let situations = folder.map(|folder| recorded::situations(folder, synthetic::COUNT));
        Ok(situations.transpose()?)
    }

    /// Returns the suite for which the servers describe themselves: that of the first recorded
    /// situation, or `--suite` without recordings.
    fn suite_of(&self, recorded: Option<&[Situation]>) -> String {
        let first = recorded.and_then(|situations| situations.first());
        first.map_or_else(|| self.suite.name().to_owned(), |situation| situation.suite.clone())
    }
}

fn json(value: &impl Serialize) -> String {
    serde_json::to_string_pretty(value).expect("numbers and text are JSON")
}
