//! `coordinator campaign create`.

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::str::FromStr;
use std::time::Duration;

use anyhow::Context;
use benchmark::family::Lacking;
use benchmark::{
    AXES, Axis, AxisSet, CONTROL_HZ, CampaignSpec, Delays, Design, Directions, Execution,
    ExecutionError, Level, Look, MAX_CONFIGS, MAX_REPLICATES, Nominal, PLACEBO_RADII, Placebo,
    PolicyRoute, Realisation, Record, RendererKind, Rollouts, Stop, StopRule, Strata, TaskKey,
    TaskRef, UnknownName, Wanted, select_tasks,
};
use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{ArgGroup, Args};
use coordinator::client::Service;
use coordinator::video_estimate;
use proto::coordinator::CreateCampaignRequest;
use queue::Created;
use queue::expand::NewCampaign;
use queue::rules::campaign::PRIORITIES;
use serde::de::DeserializeOwned;
use terminal::{counted, decimal, number, number_from, wrapped};

use super::command::{CommandError, Connection, print_line, usage};
use super::files::{read_manifest, read_spec};
use super::forecast;
use super::horizon::{self, Asks};
use super::planning;
use super::variant_flags::{DESIGN_FLAGS, VariantFlags};

/// Flags that conflict with `--spec`, in addition to [`DESIGN_FLAGS`].
#[rustfmt::skip]
const SPEC_FLAGS: [&str; 24] = [
    "policy", "endpoint", "tasks", "rows", "realisation", "replicates", "record", "assets",
    "renderer", "stop", "stop_seed", "stop_strata", "execution", "suite", "protocol", "variants",
    "suites", "dimensions", "difficulties", "paraphrases", "trials", "runnable", "suite_file",
    "look",
];
/// Valid values of `--record`, `--nominal`, `--renderer`, `--directions` and `--stop-strata`.
pub(super) const RECORDS: [&str; 4] = ["none", "failures", "transitions", "all"];
const NOMINALS: [&str; 3] = ["eval", "all", "none"];
const RENDERERS: [&str; 2] = ["software", "gl"];
const DIRECTIONS: [&str; 2] = ["shared", "own"];
const STRATA: [&str; 2] = ["suites", "tasks"];

/// Printed below the long help.
const EXAMPLES: &str = "\
Examples:
  Two tasks under all axes at one level, 64 rollouts:
    coordinator campaign create --name first --policy student \\
        --endpoint http://127.0.0.1:7412 --tasks libero_object/0-1 --axes all --configs 0-3
  The duration of all of LIBERO-CTRL v0.1, without creating the campaign:
    coordinator campaign create --name v01 --policy student \\
        --endpoint http://127.0.0.1:7412 --tasks all --axes all --levels L1,L2,L3 \\
        --nominal all --dry-run
  L2 and its noise floor, the floor in two configurations of each task:
    coordinator campaign create --name floor --policy student \\
        --endpoint http://127.0.0.1:7412 --tasks all --axes all --levels L0,L2 \\
        --placebo-configs 0-1
  The variants of LIBERO-Plus whose files are in a package index, by its official protocol:
    coordinator campaign create --name plus --policy student \\
        --endpoint http://127.0.0.1:7412 --suite libero-plus --runnable
  The sentences of LIBERO-Para that hint at one task:
    coordinator campaign create --name hints --policy student \\
        --endpoint http://127.0.0.1:7412 --suite libero-para --paraphrase hint \\
        --tasks libero_goal/8
  The tasks of a further benchmark, as a suite file describes them:
    coordinator campaign create --name libero_90 --policy student \\
        --endpoint http://127.0.0.1:7412 --suite-file examples/suites/libero_90.json
  Its tasks under two axes:
    coordinator campaign create --name libero_90-L2 --policy student \\
        --endpoint http://127.0.0.1:7412 --suite-file examples/suites/libero_90.json \\
        --axes camera,lighting --configs 0-1
  The specification as a file, to be edited and used:
    coordinator campaign create --name first --policy student \\
        --endpoint http://127.0.0.1:7412 --tasks libero_goal --print-spec > first.json
    coordinator campaign create --spec first.json";

#[derive(Args, Debug)]
#[command(after_long_help = EXAMPLES)]
#[command(group = ArgGroup::new("source").required(true).args(["spec", "name"]))]
#[command(group = ArgGroup::new("rollouts").multiple(true)
    .args(["tasks", "rows", "suite", "suite_file"]))]
#[command(group = ArgGroup::new("of_design").multiple(true).args(&DESIGN_FLAGS[1..])
    .requires("designed"))]
#[command(group = ArgGroup::new("designed").multiple(true).args(["tasks", "axes"]))]
#[command(group = ArgGroup::new("of_benchmark").args(["suite", "suite_file"]))]
pub(super) struct CreateArguments {
    /// File of a specification in JSON; `-` reads standard input.
    #[arg(long, value_name = "FILE")]
    #[arg(conflicts_with_all = SPEC_FLAGS.into_iter().chain(DESIGN_FLAGS))]
    spec: Option<PathBuf>,
    /// Name of the campaign, whose specification the flags below define.
    #[arg(long, requires_all = ["policy", "endpoint", "rollouts"])]
    name: Option<String>,
    #[command(flatten)]
    flags: SpecFlags,
    #[command(flatten)]
    design: DesignFlags,
    #[command(flatten)]
    variants: VariantFlags,
    #[command(flatten)]
    stop: StopFlags,
    /// Priority from -100 to 100: campaigns with a higher priority are leased first, and campaigns
    /// with equal priorities share the workers.
    #[arg(long, value_name = "N", default_value_t = 0, allow_negative_numbers = true,
        hide_short_help = true, value_parser = number(PRIORITIES, ""))]
    priority: i32,
    /// Print the number of rollouts, their duration, the disk space of their videos and the
    /// smallest detectable differences, and create nothing.
    #[arg(long)]
    dry_run: bool,
    /// Create the campaign without asking its endpoint for the policy.
    #[arg(long, conflicts_with_all = ["dry_run", "print_spec"], hide_short_help = true)]
    no_probe: bool,
    /// Print the specification in JSON, as --spec reads it, and create nothing.
    #[arg(long, conflicts_with = "dry_run")]
    print_spec: bool,
    /// With --dry-run: print JSON.
    #[arg(long, requires = "dry_run")]
    json: bool,
    #[command(flatten)]
    connection: Connection,
}

/// The flags for the parts of a specification other than its design.
#[derive(Args, Debug)]
#[command(next_help_heading = "Rollouts")]
struct SpecFlags {
    /// Name of the policy at its endpoint.
    #[arg(long)]
    policy: Option<String>,
    /// URL of the gateway, or of the policy itself.
    #[arg(long, value_name = "URL")]
    endpoint: Option<String>,
    /// Tasks: `libero_object/0,libero_spatial/0-3`, a suite, or `all`.
    #[arg(long, value_delimiter = ',', conflicts_with = "rows")]
    tasks: Vec<String>,
    /// Rows to run unchanged, instructions included, instead of a design, as JSON Lines; `-` reads
    /// standard input.
    #[arg(long, value_name = "FILE", conflicts_with_all = DESIGN_FLAGS, hide_short_help = true)]
    rows: Option<PathBuf>,
    /// Source of the perturbations' random elements: `matched`, the same elements for an axis alone
    /// and in combinations; or `reference`, other elements under each condition, as the released
    /// code draws them.
    #[arg(long, default_value = "matched", hide_short_help = true)]
    realisation: Realisation,
    /// Number of runs of every rollout, each with a different policy seed.
    #[arg(long, default_value_t = 1, value_parser = number(1..=MAX_REPLICATES, "times"))]
    replicates: u32,
    /// Rollouts to film: `none`; `failures`; `transitions`, those of configurations whose outcome
    /// changes under simultaneous perturbation, filmed afterwards by `worker film`; or `all`.
    #[arg(long, value_parser = enum_parser::<Record>(RECORDS), default_value = "none")]
    record: Record,
    /// Asset pack required of the workers: `primitives`, `libero`, or the first digits of a pack's
    /// digest. If omitted, the first result determines it.
    #[arg(long, value_name = "PACK", hide_short_help = true)]
    assets: Option<String>,
    /// Renderer required of the workers: `software` or `gl`. If omitted, the first result sets it.
    #[arg(long, value_parser = enum_parser::<RendererKind>(RENDERERS), hide_short_help = true)]
    renderer: Option<RendererKind>,
    /// Look required of the workers: `mujoco-3.3.2` or `mujoco-3.3.3`. If omitted, the first result
    /// sets it.
    #[arg(long, hide_short_help = true)]
    look: Option<Look>,
    /// Motion of the robot while an answer is under way, which takes N control steps of 50 ms:
    /// `wait`; `hold:N`, the arm holds still; `overlap:N`, it continues with the previous answer;
    /// `overlap:N,rtc`, the same, and each query carries the actions that are executed meanwhile.
    /// Instead of N, `@FILE` draws from latencies measured by `policy-gateway check --latency`. If
    /// omitted, the model of the rows of --rows, or else `wait`.
    #[arg(long, value_name = "MODEL", hide_short_help = true, value_parser = execution)]
    execution: Option<Execution>,
}

/// Reads an execution model. `@FILE` is replaced by the latencies in the file.
fn execution(text: &str) -> Result<Execution, String> {
    let Some((model, file)) = text.split_once(":@") else {
        return text.parse().map_err(|error: ExecutionError| error.to_string());
    };
    let (file, rtc_suffix) = match file.strip_suffix(",rtc") {
        Some(file) => (file, ",rtc"),
        None => (file, ""),
    };
    let read = || -> anyhow::Result<Execution> {
        let text = std::fs::read_to_string(file).with_context(|| format!("read `{file}`"))?;
        let delays = Delays::from_json(&text).with_context(|| format!("use `{file}`"))?;
        Ok(format!("{model}:{delays}{rtc_suffix}").parse()?)
    };
    read().map_err(|error| transport::chain(&*error))
}

/// The flags of a campaign that may end early.
#[derive(Args, Debug)]
#[command(next_help_heading = "Ending early")]
struct StopFlags {
    /// Rule under which the campaign ends early, as soon as the rule holds at every level:
    /// `width(M) < X` or `M excludes X`, or several joined by ` and `. Both refer to the 95 %
    /// interval of M: S_sim, the success under simultaneous perturbation; R_e, the share of
    /// emergent failures; R_c, of compensated successes; R_d = R_c + R_e; or I = R_c - R_e. X is a
    /// fraction, such as 0.08 for 8 points. The rule concerns only the configurations of this
    /// campaign: `I excludes 0` is evidence that a complete run of these configurations would have
    /// unequal numbers of emergent failures and compensated successes. It is no evidence about
    /// other tasks or directions.
    #[arg(long, value_name = "RULE", hide_short_help = true)]
    stop: Option<StopRule>,
    /// Seed of the random order in which a campaign with --stop runs its configurations.
    #[arg(long, value_name = "SEED", requires = "stop", default_value_t = 0, hide_short_help = true,
        value_parser = number_from(0_u64, ""))]
    stop_seed: u64,
    /// Strata of the random order: `suites` or `tasks`, one configuration of each stratum per
    /// round.
    #[arg(long, requires = "stop", value_parser = enum_parser::<Strata>(STRATA),
        hide_short_help = true)]
    stop_strata: Option<Strata>,
}

/// The flags for a design, which conflict with `--rows`.
#[derive(Args, Debug)]
#[command(next_help_heading = "Design")]
struct DesignFlags {
    #[arg(long, help = axes_help(), value_delimiter = ',')]
    axes: Vec<String>,
    /// Further conditions of several axes: names joined by +, such as `camera+robot`; `pairs`; or
    /// `all`, every subset of the axes.
    #[arg(long, value_delimiter = ',')]
    subsets: Vec<String>,
    /// Levels: L1, L2, L3, or any radius, such as `r2.5`; and L0, the placebo: the same conditions,
    /// too weak to affect a policy, which measure the noise floor.
    #[arg(long, value_delimiter = ',', default_value = "L2")]
    levels: Vec<String>,
    /// Configurations: `0-9`, `0,3,5-7`. Those from 10 on are drawn from --design-seed.
    #[arg(long, value_delimiter = ',', default_value = "0-9")]
    configs: Vec<String>,
    /// Nominal rollouts: `eval`, from the configurations' initial states; `all`, all 50; `none`.
    #[arg(long, value_parser = enum_parser::<Nominal>(NOMINALS), default_value = "eval")]
    nominal: Nominal,
    /// Seed of the configurations beyond the protocol's ten.
    #[arg(long, value_name = "SEED", default_value_t = 0, hide_short_help = true,
        value_parser = number_from(0_u64, ""))]
    design_seed: u64,
    /// Directions: `shared`, a configuration has the same direction in all tasks, as in the paper;
    /// or `own`, each task has its own directions, drawn from --design-seed, so that results
    /// generalise beyond ten directions.
    #[arg(long, value_parser = enum_parser::<Directions>(DIRECTIONS), default_value = "shared",
        hide_short_help = true)]
    directions: Directions,
    /// Configurations to run at L0, a subset of --configs; all of them if omitted.
    #[arg(long, value_delimiter = ',', hide_short_help = true)]
    placebo_configs: Vec<String>,
    /// Radius of L0, from 0.001 to 0.5.
    #[arg(long, value_name = "RADIUS", hide_short_help = true, default_value_t = 0.02,
        value_parser = decimal(PLACEBO_RADII[0]..=PLACEBO_RADII[1], "units"))]
    placebo_radius: f64,
}

pub(super) async fn create(arguments: CreateArguments) -> Result<(), CommandError> {
    let (spec, left_out) = match &arguments.spec {
        Some(path) => (read_spec(path)?, Lacking::default()),
        None => spec_of_flags(&arguments)?,
    };
    // Expanding the specification here reports its errors before the coordinator is contacted.
    let campaign = NewCampaign::from_spec(&spec).map_err(usage)?;
    let name = &campaign.name;
    if arguments.print_spec {
        let spec = serde_json::to_string_pretty(&spec).map_err(anyhow::Error::from)?;
        return Ok(print_line(&spec)?);
    }
    let tasks = campaign.tasks();
    let suites = tasks.iter().copied();
    let suites = suites.filter_map(|task| TaskKey::simulator_of(task).or(task.split('/').next()));
    let suites: BTreeSet<&str> = suites.collect();
    let asks = match (arguments.no_probe, arguments.dry_run) {
        (true, _) => Asks::Nothing,
        (false, true) => Asks::Length,
        (false, false) => Asks::Policy,
    };
    let unknown = horizon::check(&spec, suites, &arguments.connection, asks).await?;
    if arguments.dry_run {
        let client = arguments.connection.client_retrying_for(Duration::ZERO)?;
        let planning = planning::plan(&campaign);
        let answer = forecast::request(&client, &campaign).await;
        if arguments.json {
            return forecast::print(&campaign, answer, &planning);
        }
        let total = counted(campaign.jobs.len() as u64, "rollout");
        print_line(&format!("campaign {name} would have {total}"))?;
        print_left_out(&left_out)?;
        print_placebo(&campaign)?;
        print_stop(&spec, &campaign)?;
        print_execution(&spec, unknown.as_deref())?;
        print_line(&forecast::describe(&answer, &campaign.policy))?;
        if let Some(words) = planning::describe(&planning) {
            print_line(&words)?;
        }
        return print_video_estimate(&campaign);
    }
    let client = arguments.connection.client()?;
    let request =
        CreateCampaignRequest { spec: campaign.spec.clone(), priority: arguments.priority };
    let created: Created = client.ask(request, Service::create_campaign).await?;
    let verb = match created.jobs_added {
        0 => "exists already, with this specification",
        _ => "created",
    };
    let total = counted(created.jobs_total, "rollout");
    print_line(&format!("campaign {name} {verb}: {total}"))?;
    print_left_out(&left_out)?;
    print_stop(&spec, &campaign)?;
    print_execution(&spec, unknown.as_deref())?;
    if created.priority != arguments.priority {
        let kept = created.priority;
        print_line(&format!(
            "campaign {name} keeps priority {kept}: `coordinator campaign set` changes it"
        ))?;
    }
    print_video_estimate(&campaign)
}

/// Prints `unknown`, the warning that the policy or the length of its answers is unknown, and
/// then the execution model of the rollouts unless it is `wait`.
fn print_execution(spec: &CampaignSpec, unknown: Option<&str>) -> Result<(), CommandError> {
    if let Some(unknown) = unknown {
        print_line(&wrapped("", 2, unknown))?;
    }
    let (Some(delays), execution) = (spec.execution.delays(), &spec.execution) else {
        return Ok(());
    };
    let milliseconds = |steps: u16| u32::from(steps) * 1000 / CONTROL_HZ;
    let delay_text = match (delays.shortest(), delays.longest()) {
        (shortest, longest) if shortest == longest => format!("{} ms", milliseconds(shortest)),
        (shortest, longest) => {
            format!("{} to {} ms", milliseconds(shortest), milliseconds(longest))
        }
    };
    print_line(&format!("execution model {execution}: an answer takes effect after {delay_text}"))?;
    Ok(())
}

fn print_left_out(left_out: &Lacking) -> Result<(), CommandError> {
    if left_out.count() > 0 {
        let count = counted(left_out.count() as u64, "variant");
        print_line(&format!(
            "the campaign leaves out {count}, whose files are missing:\n{left_out}"
        ))?;
    }
    Ok(())
}

/// Prints the number of rollouts at the placebo level, which measure the noise floor.
fn print_placebo(campaign: &NewCampaign) -> Result<(), CommandError> {
    let placebo = campaign.jobs.iter().filter(|job| job.is_placebo()).count();
    if placebo > 0 {
        let placebo_rollouts = counted(placebo as u64, "rollout");
        print_line(&format!("  including {placebo_rollouts} at the placebo level L0"))?;
    }
    Ok(())
}

fn print_stop(spec: &CampaignSpec, campaign: &NewCampaign) -> Result<(), CommandError> {
    if let Some(Stop { rule, seed, strata }) = &spec.stop {
        let strata = strata.name().replace('_', " ");
        print_line(&format!(
            "the campaign ends early once {rule} at every level; configurations run in the order \
             of seed {seed}, in rounds of {strata}"
        ))?;
        let configurations =
            counted(campaign.stoppable_configurations.unwrap_or_default() as u64, "configuration");
        print_line(&wrapped(
            "  ",
            4,
            &format!(
                "the confidence is 95 % at each level, over all looks (evaluations of the rule) \
                 together, and for these {configurations} only: other tasks, initial states and \
                 directions may differ. A difference that ends a campaign is likely to be larger \
                 at the last look than over the whole campaign"
            ),
        ))?;
    }
    Ok(())
}

fn print_video_estimate(campaign: &NewCampaign) -> Result<(), CommandError> {
    if let Some(words) = video_estimate::describe(campaign) {
        print_line(&words)?;
    }
    Ok(())
}

fn spec_of_flags(arguments: &CreateArguments) -> Result<(CampaignSpec, Lacking), CommandError> {
    let chosen_tasks = tasks(&arguments.flags.tasks).map_err(usage)?;
    let is_perturbed = !arguments.design.axes.is_empty();
    let of_suite_file = || is_perturbed.then(|| design_of_flags(arguments)).transpose();
    let (rollouts, left_out) =
        match (&arguments.flags.rows, arguments.variants.rows(&chosen_tasks, of_suite_file)?) {
            (Some(path), _) => (Rollouts::Rows(read_manifest(path)?), Lacking::default()),
            (None, Some((rows, left_out))) => (Rollouts::Rows(rows), left_out),
            (None, None) => {
                (Rollouts::Design(design_of_flags(arguments).map_err(usage)?), Lacking::default())
            }
        };
    let execution = arguments.flags.execution.clone().unwrap_or_else(|| rollouts.execution());
    let spec = CampaignSpec {
        name: arguments.name.clone().unwrap_or_default(),
        policy: PolicyRoute {
            name: arguments.flags.policy.clone().unwrap_or_default(),
            endpoint: arguments.flags.endpoint.clone().unwrap_or_default(),
        },
        rollouts,
        purpose: None,
        realisation: arguments.flags.realisation,
        replicates: arguments.flags.replicates,
        record: arguments.flags.record,
        wanted: Wanted {
            assets: arguments.flags.assets.clone(),
            renderer: arguments.flags.renderer,
            look: arguments.flags.look,
        },
        stop: arguments.stop.stop.clone().map(|rule| Stop {
            strata: arguments.stop.stop_strata.unwrap_or_default(),
            rule,
            seed: arguments.stop.stop_seed,
        }),
        execution,
    };
    spec.check().map_err(usage)?;
    Ok((spec, left_out))
}

fn axes_help() -> String {
    let others = AXES.iter().filter(|def| !def.is_combined);
    let others: Vec<String> = others.map(|def| format!("`{}`, {}", def.name, def.about)).collect();
    format!(
        "Axes, each run alone and all simultaneously: names, `metric` (all but language; the \
         default for --tasks), `all`, or `none`. Appended after a comma, and never combined with other axes: {}",
        others.join("; ")
    )
}

fn design_of_flags(arguments: &CreateArguments) -> anyhow::Result<Design> {
    let mut axes = Vec::new();
    let given = arguments.design.axes.iter().map(String::as_str);
    for name in given.chain(arguments.design.axes.is_empty().then_some("metric")) {
        match name {
            "metric" => axes.extend(Axis::METRIC),
            "all" => axes.extend(Axis::ALL),
            "none" | "" => {}
            name => axes.push(name.parse()?),
        }
    }
    // A design without axes has no perturbation to which a level could apply.
    let levels: Vec<Level> = match axes.is_empty() {
        true => Vec::new(),
        false => parse_names(&arguments.design.levels)?,
    };
    let combined = axes.iter().copied().collect::<AxisSet>().combined();
    let subsets = subsets(&arguments.design.subsets, combined)?;
    let design = Design {
        tasks: tasks(&arguments.flags.tasks)?,
        axes,
        subsets,
        levels,
        configs: configs(&arguments.design.configs)?,
        nominal: arguments.design.nominal,
        seed: arguments.design.design_seed,
        directions: arguments.design.directions,
        placebo: placebo(&arguments.design)?,
    };
    Ok(design.in_order())
}

fn placebo(flags: &DesignFlags) -> anyhow::Result<Placebo> {
    let radius = flags.placebo_radius;
    Ok(Placebo {
        radius: Level::of_radius(radius)
            .with_context(|| format!("read --placebo-radius {radius}: write for example 0.02"))?,
        configs: match flags.placebo_configs.is_empty() {
            true => None,
            false => Some(configs(&flags.placebo_configs)?),
        },
    })
}

/// Parses `--subsets`. `all` stands for the proper subsets of `axes` with two or more axes, `pairs`
/// for those with two.
fn subsets(given: &[String], axes: AxisSet) -> Result<Vec<AxisSet>, UnknownName> {
    let is_proper_combination = |set: &AxisSet| set.len() > 1 && *set != axes;
    let all = axes.subsets().into_iter().filter(is_proper_combination);
    match given.join(",").as_str() {
        "all" => Ok(all.collect()),
        "pairs" => Ok(all.filter(|set| set.len() == 2).collect()),
        _ => parse_names(given),
    }
}

/// Parses `--tasks`: the selections of [`select_tasks`], and ranges such as `libero_object/0-3`.
pub(super) fn tasks(given: &[String]) -> anyhow::Result<Vec<TaskRef>> {
    let mut tasks = Vec::new();
    for text in given {
        if let Some((suite, indices)) = text.split_once('/')
            && let Some((first, last)) = range(indices)
            && first != last
        {
            for index in first..=last {
                tasks.extend(select_tasks(&format!("{suite}/{index}"))?);
            }
        } else {
            tasks.extend(select_tasks(text)?);
        }
    }
    Ok(tasks)
}

pub(super) fn configs(given: &[String]) -> anyhow::Result<Vec<u16>> {
    let mut configs = Vec::new();
    for text in given {
        let (first, last) = range(text).with_context(|| {
            format!(
                "read configuration `{text}`: write numbers or ranges up to {}, for example 0-9 \
                 or 0,3",
                MAX_CONFIGS - 1
            )
        })?;
        configs.extend(first..=last);
    }
    Ok(configs)
}

/// Parses `3` or `0-9`; `None` if the range is malformed or exceeds [`MAX_CONFIGS`].
fn range(text: &str) -> Option<(u16, u16)> {
    let (first, last) = text.split_once('-').unwrap_or((text, text));
    let (first, last) = (first.parse().ok()?, last.parse().ok()?);
    (first <= last && last <= MAX_CONFIGS).then_some((first, last))
}

/// Returns a parser of an enum by its name in a specification; `names` lists the valid values.
pub(super) fn enum_parser<T>(
    names: impl Into<PossibleValuesParser>,
) -> impl TypedValueParser<Value = T>
where
    T: DeserializeOwned + Clone + Send + Sync + 'static,
{
    names.into().try_map(|name| serde_json::from_value(name.into()))
}

pub(super) fn parse_names<T: FromStr<Err = UnknownName>>(
    names: &[String],
) -> Result<Vec<T>, UnknownName> {
    names.iter().map(|name| name.parse()).collect()
}
