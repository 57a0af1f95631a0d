//! Length of a policy's answers, as its endpoint describes it. A campaign whose execution model
//! drops every action of an answer is refused at its creation, provided that the policy can be
//! reached at that time.

use std::collections::BTreeSet;
use std::time::Duration;

use anyhow::Context;
use libero_ctrl::{CampaignSpec, Condition, Delays, Execution, Level, Rollouts, delay_at};
use proto::PROTOCOL_VERSION;
use proto::policy::DescribeRequest;
use proto::policy::policy_client::PolicyClient;
use transport::{Access, parse_endpoint};

use super::command::{CommandError, Connection, usage};

/// Longest wait for the policy's description. It is short, since a campaign may be created before
/// its policy is served.
const DEADLINE: Duration = Duration::from_secs(3);

/// Refuses a campaign if every delay of one of its [`overlap_models`] is at least as long as the
/// policy's answers in one of the suites. Returns a warning if the policy cannot be reached: if its
/// answers then turn out too short, the first rollout under the campaign's own `overlap` fails,
/// while rollouts of the latency axis run with an arm that holds still.
pub(super) async fn check(
    spec: &CampaignSpec,
    suites: impl IntoIterator<Item = &str>,
    connection: &Connection,
) -> Result<Option<String>, CommandError> {
    let models = overlap_models(spec);
    let Some(longest) = models.last() else {
        return Ok(None);
    };
    let access = match connection.policy_access() {
        Ok(access) => access,
        Err(error) => {
            return Ok(Some(unknown_length(spec, longest, &transport::chain(&error))));
        }
    };
    let policy = &spec.policy;
    for suite in suites {
        let horizon = match tokio::time::timeout(DEADLINE, horizon(spec, suite, &access)).await {
            Ok(Ok(horizon)) => horizon,
            Ok(Err(problem)) => return Ok(Some(unknown_length(spec, longest, &problem))),
            Err(_) => {
                let problem = format!("no answer within {} s", DEADLINE.as_secs());
                return Ok(Some(unknown_length(spec, longest, &problem)));
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
        Rollouts::Design(design) if design.latency => design.levels.iter().copied().collect(),
        Rollouts::Manifest(rows) => {
            let ids = rows.iter().map(|row| row.id);
            let latency_ids = ids.filter(|id| id.condition() == Condition::Latency);
            latency_ids.map(|id| id.level()).collect()
        }
        _ => BTreeSet::new(),
    };
    let latency_models = levels.into_iter().filter_map(|level| {
        let delays = Delays::fixed(delay_at(level)?)?;
        Some(Execution::Overlap { delays, rtc: false })
    });
    let model = Some(spec.execution.clone());
    let model = model.filter(|model| matches!(model, Execution::Overlap { .. }));
    model.into_iter().chain(latency_models).collect()
}

/// Returns the largest number of actions of an answer, from the policy's description. The error is
/// a clause for a message.
async fn horizon(spec: &CampaignSpec, suite: &str, access: &Access) -> Result<usize, String> {
    let endpoint = parse_endpoint(&spec.policy.endpoint).map_err(|error| error.to_string())?;
    let connection = access.connect_lazy(endpoint);
    let connection = connection.map_err(|error| transport::chain(&error))?;
    let request = DescribeRequest {
        protocol_version: PROTOCOL_VERSION,
        policy: spec.policy.name.clone(),
        suite: suite.to_owned(),
    };
    let described = PolicyClient::new(connection).describe(request).await;
    let described = described.map_err(|status| transport::status_text(&status))?;
    Ok(described.into_inner().horizon as usize)
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
