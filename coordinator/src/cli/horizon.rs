//! A policy as its endpoint describes it. A campaign of a policy that its endpoint does not serve,
//! or whose execution model drops every action of an answer, is refused at its creation, provided
//! that the endpoint can be reached at that time.

use std::collections::BTreeSet;
use std::time::Duration;

use anyhow::{Context, anyhow};
use benchmark::{CampaignSpec, Condition, Execution, Level, Rollouts, execution_at};
use proto::PROTOCOL_VERSION;
use proto::policy::DescribeRequest;
use proto::policy::policy_client::PolicyClient;
use tonic::Code;
use transport::{Access, Peer, ServerKind, Settings, parse_endpoint};

use super::command::{CommandError, Connection, usage};

/// Names of the flags for a policy server, for messages about failed connections.
const SETTINGS: Settings =
    Settings { address: "--endpoint", authority: "--ca", clear: "http://", encrypted: "https://" };
/// Longest wait for the policy's description. It is short, since a campaign may be created before
/// its policy is served.
const DEADLINE: Duration = Duration::from_secs(3);

/// Question to the endpoint of a campaign's policy.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Asks {
    /// The policy and, if an execution model depends on it, the length of its answers.
    Policy,
    /// The length of the policy's answers, if an execution model depends on it.
    Length,
    Nothing,
}

/// Reason why an endpoint does not describe a policy.
enum Problem {
    /// It cannot serve the policy.
    Refused(String),
    /// It may serve the policy later.
    NoAnswer(String),
}

/// Refuses a campaign if its endpoint serves no such policy, or if every delay of one of its [`overlap_models`] is at least as long as the
/// policy's answers in one of the suites. Returns a warning if the policy cannot be reached: if its
/// answers then turn out too short, the first rollout under the campaign's own `overlap` fails,
/// while rollouts of the latency axis run with an arm that holds still.
pub(super) async fn check(
    spec: &CampaignSpec,
    suites: impl IntoIterator<Item = &str>,
    connection: &Connection,
    asks: Asks,
) -> Result<Option<String>, CommandError> {
    let models = overlap_models(spec);
    let longest = models.last();
    if asks == Asks::Nothing || asks == Asks::Length && longest.is_none() {
        return Ok(None);
    }
    let policy = &spec.policy;
    let unknown = |problem: &str| match longest {
        Some(longest) => Some(unknown_length(spec, longest, problem)),
        None => {
            let (name, endpoint) = (&policy.name, &policy.endpoint);
            terminal::complain(&format!(
                "policy {name} at {endpoint} does not answer yet ({problem}): its rollouts wait \
                 until it does; `--no-probe` does not ask"
            ));
            None
        }
    };
    let access = match connection.policy_access() {
        Ok(access) => access,
        Err(error) => return Ok(unknown(&transport::chain(&error))),
    };
    for suite in suites {
        let horizon = match tokio::time::timeout(DEADLINE, horizon(spec, suite, &access)).await {
            Ok(Ok(horizon)) => horizon,
            Ok(Err(Problem::NoAnswer(problem))) => return Ok(unknown(&problem)),
            Ok(Err(Problem::Refused(problem))) => {
                let (name, endpoint) = (&policy.name, &policy.endpoint);
                let refused = anyhow!("{problem}; `--no-probe` creates the campaign nevertheless");
                return Err(usage(refused.context(format!("find policy `{name}` at {endpoint}"))));
            }
            Err(_) => {
                return Ok(unknown(&format!("no answer within {} s", DEADLINE.as_secs())));
            }
        };
        for model in &models {
            let refused = model.check(horizon).with_context(|| {
                let (name, endpoint) = (&policy.name, &policy.endpoint);
                let campaign = &spec.name;
                format!("create campaign {campaign} of policy `{name}` at {endpoint}")
            });
            refused.map_err(usage)?;
        }
    }
    Ok(None)
}

/// Returns the execution models under which rollouts of a campaign drop actions: the campaign's
/// own model, if that is `overlap`, and those of the latency axis, the longest delay last.
fn overlap_models(spec: &CampaignSpec) -> Vec<Execution> {
    let levels: BTreeSet<Level> = match &spec.rollouts {
        Rollouts::Design(design)
            if design.conditions().into_iter().any(Condition::sets_execution) =>
        {
            design.levels.iter().copied().collect()
        }
        Rollouts::Rows(rows) => {
            let ids = rows.iter().map(|row| row.id);
            let latency_ids = ids.filter(|id| id.condition().sets_execution());
            latency_ids.map(|id| id.level()).collect()
        }
        _ => BTreeSet::new(),
    };
    let latency_models = levels.into_iter().filter_map(execution_at);
    let model = Some(spec.execution.clone());
    let model = model.filter(|model| matches!(model, Execution::Overlap { .. }));
    model.into_iter().chain(latency_models).collect()
}

/// Returns the largest number of actions of an answer, from the policy's description. The error is
/// a clause for a message.
async fn horizon(spec: &CampaignSpec, suite: &str, access: &Access) -> Result<usize, Problem> {
    let endpoint = parse_endpoint(&spec.policy.endpoint);
    let endpoint = endpoint.map_err(|error| Problem::NoAnswer(error.to_string()))?;
    let peer = Peer::new(&endpoint, ServerKind::Policy, SETTINGS);
    let connection = access.connect_lazy(endpoint);
    let connection = connection.map_err(|error| Problem::NoAnswer(transport::chain(&error)))?;
    let request = DescribeRequest {
        protocol_version: PROTOCOL_VERSION,
        policy: spec.policy.name.clone(),
        suite: suite.to_owned(),
    };
    let described = PolicyClient::new(connection).describe(request).await;
    match described {
        Ok(described) => Ok(described.into_inner().horizon as usize),
        Err(status) if status.code() == Code::NotFound => {
            Err(Problem::Refused(transport::status_text(&status)))
        }
        Err(status) => Err(Problem::NoAnswer(match peer.diagnose(&status) {
            Some(trouble) => trouble.to_string(),
            None => transport::status_text(&status),
        })),
    }
}

/// Describes why the length of the answers is unknown, and the consequence.
fn unknown_length(spec: &CampaignSpec, model: &Execution, problem: &str) -> String {
    let (name, endpoint) = (&spec.policy.name, &spec.policy.endpoint);
    // A campaign with the latency axis has no `overlap` of its own.
    let consequence = match spec.execution.is_wait() {
        true => format!(
            "the arm holds still in rollouts in which {model} drops every action of an answer"
        ),
        false => format!("rollouts fail if {model} drops every action of an answer"),
    };
    format!(
        "the length of the answers of policy {name} at {endpoint} is unknown yet ({problem}): \
         {consequence}"
    )
}
