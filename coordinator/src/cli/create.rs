//! `coordinator campaign create`.

use std::io::Read;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use anyhow::{Context, anyhow};
use clap::{ArgGroup, Args, ValueEnum};
use coordinator::expand::NewCampaign;
use protocol::{
    Axis, CampaignSpec, Level, Nominal, PolicyRoute, Realisation, Record, TaskRef, UnknownName,
    select_tasks,
};

use super::{CommandError, Connection, print_line};

/// Largest specification that is read, bytes.
const MAX_SPEC_BYTES: u64 = 1 << 20;

/// The flags that say what a specification says.
const SPEC_FLAGS: [&str; 10] = [
    "policy",
    "endpoint",
    "tasks",
    "axes",
    "levels",
    "configs",
    "nominal",
    "realisation",
    "replicates",
    "record",
];

#[derive(Args, Debug)]
#[command(group = ArgGroup::new("source").required(true).args(["spec", "name"]))]
pub(super) struct CreateArguments {
    /// File of a specification in JSON; `-` reads standard input.
    #[arg(long, value_name = "FILE", conflicts_with_all = SPEC_FLAGS)]
    spec: Option<PathBuf>,
    /// Name of the campaign; the flags below then say the rest.
    #[arg(long, requires_all = ["policy", "endpoint", "tasks"])]
    name: Option<String>,
    /// Name of the policy at its endpoint.
    #[arg(long)]
    policy: Option<String>,
    /// URL of the gateway, or of the policy itself.
    #[arg(long, value_name = "URL")]
    endpoint: Option<String>,
    /// Tasks: `libero_object/0,libero_spatial/0-3`, a suite, or `all`.
    #[arg(long, value_delimiter = ',')]
    tasks: Vec<String>,
    /// Axes, each alone and all together: names, `metric` (all with numbers),
    /// `all`, or `none`.
    #[arg(long, value_delimiter = ',', default_value = "metric")]
    axes: Vec<String>,
    /// Levels: L1, L2, L3.
    #[arg(long, value_delimiter = ',', default_value = "L2")]
    levels: Vec<String>,
    /// Configurations: `0-9`, `0,3,5-7`.
    #[arg(long, value_delimiter = ',', default_value = "0-9")]
    configs: Vec<String>,
    /// Nominal rollouts: of the configurations' initial states, of all, none.
    #[arg(long, value_enum, default_value_t = NominalChoice::Eval)]
    nominal: NominalChoice,
    /// Where the perturbations' random elements come from: matched, reference.
    #[arg(long, default_value = "matched")]
    realisation: String,
    /// Times that every rollout runs, each with another policy seed.
    #[arg(long, default_value_t = 1)]
    replicates: u32,
    /// Rollouts that are filmed.
    #[arg(long, value_enum, default_value_t = RecordChoice::None)]
    record: RecordChoice,
    #[command(flatten)]
    connection: Connection,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum NominalChoice {
    Eval,
    All,
    None,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum RecordChoice {
    None,
    Failures,
    All,
}

pub(super) async fn create(arguments: CreateArguments) -> Result<(), CommandError> {
    let spec = match &arguments.spec {
        Some(path) => spec_of_file(path)?,
        None => spec_of_flags(&arguments).map_err(CommandError::Usage)?,
    };
    // Expanding here finds every mistake before anybody is asked.
    let campaign =
        NewCampaign::from_spec(&spec).map_err(|error| CommandError::Usage(error.into()))?;
    let created = arguments
        .connection
        .client()?
        .create_campaign(&campaign.spec)
        .await?;
    let name = &campaign.name;
    if created.jobs_added == 0 {
        print_line(&format!(
            "campaign {name} was there already, with this specification: {} rollouts",
            created.jobs_total
        ))?;
    } else {
        let total = created.jobs_total;
        print_line(&format!("campaign {name} created: {total} rollouts"))?;
    }
    Ok(())
}

fn spec_of_file(path: &Path) -> Result<CampaignSpec, CommandError> {
    let mut text = String::new();
    let (name, read) = if path.as_os_str() == "-" {
        let read = std::io::stdin()
            .take(MAX_SPEC_BYTES)
            .read_to_string(&mut text);
        ("standard input".to_owned(), read)
    } else {
        let read = std::fs::File::open(path)
            .and_then(|file| file.take(MAX_SPEC_BYTES).read_to_string(&mut text));
        (path.display().to_string(), read)
    };
    read.with_context(|| format!("read {name}"))
        .map_err(CommandError::Usage)?;
    CampaignSpec::from_json(&text)
        .map_err(|error| CommandError::Usage(anyhow!(error).context(format!("use {name}"))))
}

fn spec_of_flags(arguments: &CreateArguments) -> anyhow::Result<CampaignSpec> {
    let axes = match texts(&arguments.axes).as_slice() {
        ["metric"] => Axis::METRIC.to_vec(),
        ["all"] => Axis::ALL.to_vec(),
        ["none"] => Vec::new(),
        names => parsed(names)?,
    };
    // Without axes there is nothing to have a level.
    let levels: Vec<Level> = match axes.is_empty() {
        true => Vec::new(),
        false => parsed(&texts(&arguments.levels))?,
    };
    let spec = CampaignSpec {
        name: arguments.name.clone().unwrap_or_default(),
        policy: PolicyRoute {
            name: arguments.policy.clone().unwrap_or_default(),
            endpoint: arguments.endpoint.clone().unwrap_or_default(),
        },
        tasks: tasks(&arguments.tasks)?,
        axes: in_order(axes),
        levels: in_order(levels),
        configs: in_order(configs(&arguments.configs)?),
        nominal: match arguments.nominal {
            NominalChoice::Eval => Nominal::Eval,
            NominalChoice::All => Nominal::All,
            NominalChoice::None => Nominal::None,
        },
        realisation: arguments.realisation.parse::<Realisation>()?,
        replicates: arguments.replicates,
        record: match arguments.record {
            RecordChoice::None => Record::None,
            RecordChoice::Failures => Record::Failures,
            RecordChoice::All => Record::All,
        },
    };
    spec.check()?;
    Ok(spec)
}

/// Tasks as [`select_tasks`] reads them, and ranges of a suite's tasks.
fn tasks(given: &[String]) -> anyhow::Result<Vec<TaskRef>> {
    let mut tasks = Vec::new();
    for text in given {
        match text
            .split_once('/')
            .map(|(suite, index)| (suite, range(index)))
        {
            Some((suite, Some((first, last)))) if first != last => {
                for index in first..=last {
                    tasks.extend(select_tasks(&format!("{suite}/{index}"))?);
                }
            }
            _ => tasks.extend(select_tasks(text)?),
        }
    }
    Ok(in_order(tasks))
}

fn configs(given: &[String]) -> anyhow::Result<Vec<u16>> {
    let mut configs = Vec::new();
    for text in given {
        let (first, last) = range(text).with_context(|| {
            format!("read configuration `{text}`: write for example 0-9 or 0,3")
        })?;
        configs.extend(first..=last);
    }
    Ok(configs)
}

/// "3" or "0-9", small numbers only.
fn range(text: &str) -> Option<(u16, u16)> {
    let (first, last) = text.split_once('-').unwrap_or((text, text));
    let (first, last) = (first.parse().ok()?, last.parse().ok()?);
    (first <= last && last < 1_000).then_some((first, last))
}

fn parsed<T: FromStr<Err = UnknownName>>(names: &[&str]) -> Result<Vec<T>, UnknownName> {
    names.iter().map(|name| name.parse()).collect()
}

fn texts(given: &[String]) -> Vec<&str> {
    given.iter().map(String::as_str).collect()
}

/// Each once, in the protocol's order: equal designs have equal specifications.
fn in_order<T: Ord>(mut values: Vec<T>) -> Vec<T> {
    values.sort();
    values.dedup();
    values
}
