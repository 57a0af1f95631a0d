//! `coordinator gate`: decides whether a policy's success is lower than another's, or than the
//! paper's, with as few rollouts as the decision takes.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Instant;

use anyhow::{Context, anyhow};
use benchmark::{
    CampaignSpec, Condition, Design, Execution, ManifestRow, PolicyRoute, Realisation, Record,
    RolloutId, Rollouts, SpecError, Wanted,
};
use clap::Args;
use coordinator::client::{Client, Service};
use paired::{Bisection, ConditionEvidence, NonInferiority, Outcome, Verdict};
use proto::coordinator::change_campaign_request::Change;
use proto::coordinator::{
    AppendRowsRequest, AppendedRow, ChangeCampaignRequest, CreateCampaignRequest,
};
use report::{Document, Subject};
use serde::Serialize;
use terminal::{counted, decimal, number, number_from};

use super::command::{CommandError, Connection, failure, print_line, usage};
use super::json;
use super::line::{line, operator_notes};
use super::search::{PAUSE_PER_COST, POLL_INTERVAL};
use super::watch::LOG_PERIOD;

/// Rollouts that wait, so that no slot is idle: further ones are added below half of this number.
const WAITING: u64 = 64;
/// Prefix of `--against` for a policy of the paper.
const PUBLISHED: &str = "published:";
/// Exit code if the policies cannot be compared, or the command is mistyped.
pub(crate) const NOT_COMPARABLE: u8 = 3;

/// Printed below the long help.
const EXAMPLES: &str = "\
Exit codes: 0 not worse, 1 worse, 2 undecided within the budget, 3 not comparable or failed.

Examples:
  coordinator gate --policy step-20000 --against step-10000-ctrl
  coordinator gate --policy step-1000,step-2000,step-3000 --against step-0-standard
  coordinator gate --policy pi05 --against published:pi05 \\
      --endpoint http://127.0.0.1:7412 --conditions nominal --budget 500";

#[derive(Args, Debug)]
#[command(after_long_help = EXAMPLES)]
pub(super) struct GateArguments {
    /// Policy to be judged, by its name at the endpoint. Of several, such as the checkpoints of a
    /// training in their order, the first that is worse is found by bisection.
    #[arg(long = "policy", value_name = "POLICY", value_delimiter = ',', required = true)]
    policies: Vec<String>,
    /// What it must not be worse than: a finished campaign of another policy, whose outcomes are
    /// used; or `published:POLICY`, the rates of a policy of the paper.
    #[arg(long, value_name = "CAMPAIGN")]
    against: String,
    /// URL of the gateway, or of the policy itself. [default: that of the other campaign]
    #[arg(long, value_name = "URL")]
    endpoint: Option<String>,
    /// Conditions in which it must not be worse: `nominal`, axes, or `simultaneous`.
    #[arg(long, value_name = "CONDITIONS", value_delimiter = ',', default_value = "nominal")]
    conditions: Vec<Condition>,
    /// Loss that is accepted, percentage points of success.
    #[arg(long, value_name = "POINTS", default_value_t = 2.0,
        value_parser = decimal(0.0..=100.0, "points"))]
    margin: f64,
    /// Maximum number of rollouts of the policy. [default: those of the other campaign]
    #[arg(long, value_name = "N", value_parser = number(1..=u32::MAX, "rollouts"))]
    budget: Option<u32>,
    /// Seed of the random order of the rollouts.
    #[arg(long, default_value_t = 0, value_parser = number_from(0_u64, ""), hide_short_help = true)]
    seed: u64,
    /// Name of the campaign that runs a single policy's rollouts; the same name continues it.
    /// [default: POLICY-against-CAMPAIGN]
    #[arg(long)]
    name: Option<String>,
    /// Print JSON instead of a line.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connection: Connection,
}

/// The other side of the comparison.
struct Reference {
    /// The campaign's results; `None` for published rates.
    subject: Option<Subject>,
    /// Least and greatest success by rollout.
    rates: Vec<(RolloutId, [f64; 2])>,
    rows: BTreeMap<RolloutId, ManifestRow>,
    /// Endpoint, realisation and execution model of the rollouts.
    endpoint: Option<String>,
    realisation: Realisation,
    execution: Execution,
}

/// The decisions as JSON.
#[derive(Serialize)]
struct Decisions<'a> {
    /// The first policy that is worse; `None` if none is, or if it is unknown.
    first_worse: Option<&'a str>,
    /// In the order in which they were taken.
    decisions: Vec<Decision<'a>>,
}

#[derive(Serialize)]
struct Decision<'a> {
    policy: &'a str,
    against: &'a str,
    campaign: String,
    verdict: Verdict,
    margin: f64,
    rollouts: u64,
    conditions: Vec<ConditionEvidence>,
}

/// Decides; every failure has the exit code of policies that cannot be compared, since 1 and 2 are
/// answers.
pub(super) async fn gate(arguments: GateArguments) -> Result<(), CommandError> {
    match decide(&arguments).await {
        Ok(Verdict::NotWorse) => Ok(()),
        Ok(Verdict::Worse) => Err(CommandError::Answer(None, 1)),
        Ok(Verdict::Undecided) => Err(CommandError::Answer(None, 2)),
        Err(CommandError::Usage(error) | CommandError::Failure(error)) => {
            Err(CommandError::Answer(Some(error), NOT_COMPARABLE))
        }
        Err(answer @ CommandError::Answer(..)) => Err(answer),
    }
}

async fn decide(arguments: &GateArguments) -> Result<Verdict, CommandError> {
    let client = arguments.connection.client()?;
    let reference = Reference::of(&client, &arguments.against).await?;
    let plan =
        NonInferiority::new(reference.rates.iter().copied(), &arguments.conditions, arguments.seed);
    let evidence = plan.evidence(&BTreeMap::new(), 0.0);
    let planned: BTreeSet<Condition> = evidence.iter().map(|of| of.condition).collect();
    if let Some(absent) = arguments.conditions.iter().find(|of| !planned.contains(of)) {
        return Err(usage(anyhow!(
            "judge a policy under `{absent}`: `{}` has no such rollouts; name others with \
             --conditions",
            arguments.against
        )));
    }
    let policies = &arguments.policies;
    if arguments.name.is_some() && policies.len() > 1 {
        return Err(usage(anyhow!(
            "name one campaign for {} policies: leave out --name",
            policies.len()
        )));
    }
    let mut decisions = Vec::new();
    let mut bisection = Bisection::new(policies.len());
    while let Some(next) = bisection.next() {
        let decision = judge(&client, arguments, &reference, &plan, &policies[next]).await?;
        if !arguments.json {
            print_line(&decision.text())?;
        }
        bisection.record(decision.verdict);
        decisions.push(decision);
    }
    let first_worse = bisection.first_worse().map(|first| policies[first].as_str());
    if arguments.json {
        json::print(&Decisions { first_worse, decisions })?;
    } else if let Some(first) = first_worse.filter(|_| policies.len() > 1) {
        print_line(&format!("the first that is worse: {first}"))?;
    }
    Ok(bisection.verdict())
}

async fn judge<'a>(
    client: &Client,
    arguments: &'a GateArguments,
    reference: &Reference,
    plan: &NonInferiority,
    policy: &'a str,
) -> Result<Decision<'a>, CommandError> {
    let plain = arguments.against.replace(':', "-");
    let campaign = arguments.name.clone().unwrap_or(format!("{policy}-against-{plain}"));
    let (evidence, rollouts) = run(client, arguments, reference, plan, policy, &campaign).await?;
    Ok(Decision {
        policy,
        against: &arguments.against,
        campaign,
        verdict: Verdict::of_all(evidence.iter().map(|of| of.verdict)),
        margin: arguments.margin / 100.0,
        rollouts,
        conditions: evidence,
    })
}

impl Reference {
    async fn of(client: &Client, against: &str) -> Result<Self, CommandError> {
        if let Some(policy) = against.strip_prefix(PUBLISHED) {
            let rows = Design::v0_1().expand().map_err(SpecError::from).map_err(usage)?;
            let rate = |row: &ManifestRow| {
                let rate = report::published_rate(policy, row.id);
                rate.map(|rate| (row.id, [rate; 2]))
            };
            let rates: Vec<_> = rows.iter().filter_map(rate).collect();
            if rates.is_empty() {
                return Err(usage(anyhow!(
                    "find `{policy}` in the paper; it measured {}",
                    report::published_policies().join(", ")
                )));
            }
            return Ok(Self {
                subject: None,
                rates,
                rows: rows.into_iter().map(|row| (row.id, row)).collect(),
                endpoint: None,
                realisation: Realisation::Matched,
                execution: Execution::Wait,
            });
        }
        let status = client.campaign_status(against).await?;
        let open = status.rollouts.queued + status.rollouts.leased;
        if !status.is_finished || open > 0 {
            return Err(failure(anyhow!(
                "compare with campaign `{against}`: {} have no outcome; wait until it is finished",
                counted(open, "rollout")
            )));
        }
        let spec = client.specification(against).await?;
        let rows = spec.expand().map_err(usage)?.into_iter();
        let rows: BTreeMap<_, _> = rows.map(|row| (row.id, row)).collect();
        let subject = client.report(against).await?;
        let first = subject.records.iter().filter(|record| record.replicate == 0);
        let rates = first.filter_map(|record| match record.outcome {
            Outcome::Missing => None,
            Outcome::Quarantined => Some((record.id, [0.0, 1.0])),
            known => known.success().map(|success| (record.id, [f64::from(u8::from(success)); 2])),
        });
        Ok(Self {
            // Rows that were added later are not in the specification.
            rates: rates.filter(|(id, _)| rows.contains_key(id)).collect(),
            rows,
            endpoint: Some(status.endpoint),
            realisation: spec.realisation,
            execution: spec.execution,
            subject: Some(subject),
        })
    }
}

/// Runs rollouts of the policy until the evidence decides or the budget is spent. Nothing but the
/// campaign is stored, so that the same command continues it. Returns the evidence and the number
/// of the campaign's rollouts.
async fn run(
    client: &Client,
    arguments: &GateArguments,
    reference: &Reference,
    plan: &NonInferiority,
    policy: &str,
    name: &str,
) -> Result<(Vec<ConditionEvidence>, u64), CommandError> {
    let budget = arguments.budget.map_or(u64::MAX, u64::from);
    let mut shown: Option<Instant> = None;
    let mut status = match client.list_campaigns().await?.into_iter().find(|of| of.name == name) {
        Some(status) if status.policy == policy => Some(status),
        Some(status) => {
            return Err(usage(anyhow!(
                "judge `{policy}` in campaign `{name}`: it is one of `{}`; choose another name with --name",
                status.policy
            )));
        }
        None => None,
    };
    let mut is_comparable = reference.subject.is_none();
    loop {
        let began = Instant::now();
        let subject = match &status {
            Some(_) => Some(client.report(name).await?),
            None => None,
        };
        let records = subject.iter().flat_map(|subject| &subject.records);
        let outcomes: BTreeMap<RolloutId, Outcome> =
            records.map(|record| (record.id, record.outcome)).collect();
        let known = outcomes.values().filter(|outcome| **outcome != Outcome::Missing).count();
        if !is_comparable && known > 0 {
            check_comparable(subject.clone(), reference)?;
            is_comparable = true;
        }
        let evidence = plan.evidence(&outcomes, arguments.margin / 100.0);
        let verdict = Verdict::of_all(evidence.iter().map(|of| of.verdict));
        let open = outcomes.len() - known;
        let mut rows = Vec::new();
        let mut is_exhausted = true;
        let is_over = status.as_ref().is_some_and(|status| status.state.is_over());
        if verdict == Verdict::Undecided && !is_over {
            let waiting = status.as_ref().map_or(0, |status| status.rollouts.queued);
            let mut room = if waiting < WAITING / 2 { WAITING - waiting } else { 0 };
            let mut used = outcomes.len() as u64;
            for unit in plan.open_units(&evidence) {
                let new = unit.iter().filter(|id| !outcomes.contains_key(id));
                let new: Vec<&ManifestRow> = new.map(|id| &reference.rows[id]).collect();
                let count = new.len() as u64;
                if count == 0 {
                    continue;
                }
                if used + count > budget {
                    break;
                }
                is_exhausted = false;
                if room == 0 {
                    break;
                }
                rows.extend(new);
                room = room.saturating_sub(count);
                used += count;
            }
        }
        if verdict != Verdict::Undecided || is_over || (is_exhausted && open == 0) {
            if open > 0 && !is_over {
                let change = Change::Cancel.into();
                let request = ChangeCampaignRequest { campaign: name.to_owned(), change };
                client.call(request, Service::change_campaign).await?;
            }
            return Ok((evidence, known as u64));
        }
        add(client, arguments, reference, (policy, name), rows, status.is_some()).await?;
        let now = client.campaign_status(name).await?;
        if shown.is_none_or(|shown| shown.elapsed() >= LOG_PERIOD) {
            let notes = operator_notes(&now).map_or_else(String::new, |notes| notes + "\n");
            eprintln!("{notes}{}", line(&now));
            shown = Some(Instant::now());
        }
        status = Some(now);
        tokio::time::sleep(POLL_INTERVAL.max(began.elapsed() * PAUSE_PER_COST)).await;
    }
}

/// Adds rows to the campaign, or creates it with them.
async fn add(
    client: &Client,
    arguments: &GateArguments,
    reference: &Reference,
    (policy, name): (&str, &str),
    rows: Vec<&ManifestRow>,
    exists: bool,
) -> Result<(), CommandError> {
    if rows.is_empty() {
        return Ok(());
    }
    if exists {
        let row = |row| {
            let manifest_row = serde_json::to_string(row)?;
            Ok(AppendedRow { manifest_row, replicates: Vec::new() })
        };
        let rows: anyhow::Result<Vec<_>> = rows.into_iter().map(row).collect();
        let campaign = name.to_owned();
        let request = AppendRowsRequest { campaign, rows: rows?, ..AppendRowsRequest::default() };
        client.call(request, Service::append_rows).await?;
        return Ok(());
    }
    let endpoint = arguments.endpoint.clone().or(reference.endpoint.clone());
    let endpoint =
        endpoint.ok_or_else(|| usage(anyhow!("find policy `{policy}`: give its --endpoint")))?;
    let spec = CampaignSpec {
        name: name.to_owned(),
        policy: PolicyRoute { name: policy.to_owned(), endpoint },
        rollouts: Rollouts::Rows(rows.into_iter().cloned().collect()),
        purpose: None,
        realisation: reference.realisation,
        replicates: 1,
        record: Record::None,
        wanted: Wanted::default(),
        stop: None,
        execution: reference.execution.clone(),
    };
    spec.check().map_err(usage)?;
    let spec = serde_json::to_string(&spec).context("write the specification")?;
    client.call(CreateCampaignRequest { spec, priority: 0 }, Service::create_campaign).await?;
    Ok(())
}

/// Refuses results that differ from the reference's in pack, look, renderer, sentences or state.
fn check_comparable(subject: Option<Subject>, reference: &Reference) -> Result<(), CommandError> {
    let subjects = subject.into_iter().chain(reference.subject.clone()).collect();
    let document = Document::new(subjects).map_err(anyhow::Error::from)?;
    match document.comparisons() {
        [Err(refused)] => Err(failure(refused.clone())),
        [Ok(comparison)] if !comparison.statistics.unpaired.is_empty() => {
            Err(failure(anyhow!("compare: {}", comparison.statistics.left_out().join("; "))))
        }
        _ => Ok(()),
    }
}

impl Decision<'_> {
    fn text(&self) -> String {
        let verdict = match self.verdict {
            Verdict::NotWorse => "is not worse than",
            Verdict::Worse => "is worse than",
            Verdict::Undecided => "is undecided against",
        };
        let points = |fraction: f64| format!("{:+.1}", fraction * 100.0);
        let conditions = self.conditions.iter().map(|of| {
            let difference = of.difference.map_or("–".to_owned(), points);
            let [low, high] = of.interval.map(points);
            format!("{} {difference} [{low}, {high}]", of.condition)
        });
        format!(
            "{} {verdict} {} by more than {} points after {}: {}",
            self.policy,
            self.against,
            self.margin * 100.0,
            counted(self.rollouts, "rollout"),
            conditions.collect::<Vec<_>>().join(", ")
        )
    }
}
