//! `coordinator why`: diagnosis of a policy whose campaign never succeeds. Runs
//! `policy-gateway doctor` on the policy, endpoint and suite of the campaign.

use std::path::PathBuf;
use std::process::Stdio;

use anyhow::{Context, anyhow};
use clap::Args;
use libero_ctrl::{Condition, Suite};
use report::Subject;
use tokio::process::Command;

use super::command::{CommandError, Connection, failure, print_line};
use super::siblings::sibling;

/// Printed below the long help.
const EXAMPLES: &str = "\
Examples:
  coordinator why first
  coordinator why first --recorded recordings
  coordinator why first --connect https://keeper:7411 --ca ca.pem --token-file operator-token";

#[derive(Args, Debug)]
#[command(after_long_help = EXAMPLES)]
pub(super) struct WhyArguments {
    /// Name of the campaign.
    campaign: String,
    /// Send the policy the observations that `policy-gateway record` wrote into this folder,
    /// instead of synthetic scenes.
    #[arg(long, value_name = "DIR")]
    recorded: Option<PathBuf>,
    #[command(flatten)]
    connection: Connection,
}

/// Runs `policy-gateway doctor`; the command exits with code 1 if the doctor finds faults.
pub(super) async fn why(arguments: WhyArguments) -> Result<(), CommandError> {
    let client = arguments.connection.client()?;
    let status = client.campaign_status(&arguments.campaign).await?;
    let subject = client.report(&arguments.campaign).await?;
    print_line(&success_so_far(&subject))?;
    let url = policy_url(&status.policy_endpoint, &status.policy);
    let mut doctor = Command::new(sibling("policy-gateway")?);
    doctor.args(["doctor", &url]).stdin(Stdio::null());
    match (&arguments.recorded, subject.records.first()) {
        (Some(folder), _) => {
            doctor.arg("--recorded").arg(folder);
        }
        // The doctor has observations of LIBERO's suites only.
        (None, Some(first)) if first.id.task().suite() != Suite::Own => {
            doctor.args(["--suite", &first.id.task().suite().to_string()]);
        }
        (None, _) => {}
    }
    for (flag, file) in arguments.connection.access_files() {
        doctor.arg(flag).arg(file);
    }
    print_line(&format!("policy-gateway doctor {url}"))?;
    let exit_status = doctor.status().await.context("run `policy-gateway doctor`")?;
    match exit_status.code() {
        Some(0) => Ok(()),
        Some(_) => Err(CommandError::FaultsPrinted),
        None => Err(failure(anyhow!("run `policy-gateway doctor`: {exit_status}"))),
    }
}

/// Describes the nominal and perturbed success so far in one sentence, with advice.
fn success_so_far(subject: &Subject) -> String {
    // Returns the numbers of successes and of rollouts with an outcome.
    let count = |is_nominal: bool| {
        let has_condition = |condition: Condition| (condition == Condition::Clean) == is_nominal;
        let records = subject.records.iter().filter(|record| has_condition(record.id.condition()));
        let outcomes: Vec<bool> = records.filter_map(|record| record.outcome.success()).collect();
        let successes = outcomes.iter().filter(|success| **success).count();
        (successes, outcomes.len())
    };
    let (nominal, perturbed) = (count(true), count(false));
    let advice = match nominal {
        (_, 0) => "no nominal rollout has an outcome yet",
        (0, _) => "a policy that never succeeds nominally is usually set up wrongly",
        _ => "the policy succeeds in some rollouts, so at most a part of its setup is wrong",
    };
    format!(
        "campaign {}: {} of {} nominal and {} of {} perturbed rollouts succeed; {advice}",
        subject.origin_name(),
        nominal.0,
        nominal.1,
        perturbed.0,
        perturbed.1
    )
}

/// Returns a campaign's policy address in the syntax of `policy-gateway`, such as
/// `grpc://HOST:PORT/POLICY`.
fn policy_url(endpoint: &str, policy: &str) -> String {
    let endpoint = endpoint.trim_end_matches('/');
    match endpoint.strip_prefix("http://") {
        Some(address) => format!("grpc://{address}/{policy}"),
        None => format!("{endpoint}/{policy}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_campaigns_endpoint_becomes_the_doctors_address() {
        assert_eq!(policy_url("http://h:1", "pi05"), "grpc://h:1/pi05");
        assert_eq!(policy_url("https://h:1/", "pi05"), "https://h:1/pi05");
    }
}
