//! `coordinator compare`: paired comparisons of policies over the rollouts that both of a pair have run.

use std::path::PathBuf;

use anyhow::anyhow;
use clap::{Arg, ArgAction, ArgMatches, Args, Command, FromArgMatches, value_parser};
use report::{Document, FamilyComparison, Subject};

use super::command::{CommandError, Connection, print_line, usage};
use super::json;

#[derive(Args, Debug)]
pub(super) struct CompareArguments {
    #[command(flatten)]
    sources: Sources,
    /// Print JSON instead of a table.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connection: Connection,
}

#[derive(Clone, Debug)]
enum Source {
    Campaign(String),
    Folder(PathBuf),
}

/// Campaigns and folders in command-line order: the first is A. Implements clap's `Args` by hand,
/// since derived arguments would lose the order between `CAMPAIGN` and `--from`.
#[derive(Clone, Debug)]
struct Sources(Vec<Source>);

impl Args for Sources {
    fn augment_args(command: Command) -> Command {
        let campaigns = Arg::new("campaigns")
            .value_name("CAMPAIGN")
            .num_args(0..)
            .required_unless_present("from")
            .help(
                "Names of campaigns; the first of two is A, and the difference is A - B. Of more \
                 than two, every pair is compared",
            );
        let from = Arg::new("from")
            .long("from")
            .value_name("DIR")
            .action(ArgAction::Append)
            .value_parser(value_parser!(PathBuf))
            .help(
                "Folder with a `rollouts.jsonl`, or that file, in place of a campaign; written by \
                 `export` or by the reference implementation",
            );
        command.arg(campaigns).arg(from)
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl FromArgMatches for Sources {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let names = matches.get_many::<String>("campaigns");
        let names = names.unwrap_or_default().cloned().map(Source::Campaign);
        let folders = matches.get_many::<PathBuf>("from");
        let folders = folders.unwrap_or_default().cloned().map(Source::Folder);
        let indices = |name| matches.indices_of(name).unwrap_or_default();
        let mut sources: Vec<(usize, Source)> =
            indices("campaigns").zip(names).chain(indices("from").zip(folders)).collect();
        sources.sort_by_key(|(index, _)| *index);
        Ok(Self(sources.into_iter().map(|(_, source)| source).collect()))
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

pub(super) async fn compare(arguments: CompareArguments) -> Result<(), CommandError> {
    let sources = arguments.sources.0;
    if sources.len() < 2 {
        return Err(usage(anyhow!(
            "compare policies: one given; name two campaigns or more, or folders with --from"
        )));
    }
    let mut subjects: Vec<Subject> = Vec::new();
    for source in &sources {
        subjects.push(match source {
            Source::Campaign(name) => arguments.connection.client()?.report(name).await?,
            Source::Folder(path) => report::import(path).map_err(usage)?,
        });
    }
    if let [a, b] = subjects.as_slice()
        && let Some(comparison) = FamilyComparison::of(a, b).map_err(anyhow::Error::from)?
    {
        return match arguments.json {
            true => json::print(&comparison),
            false => Ok(print_line(comparison.text().trim_end())?),
        };
    }
    if subjects.iter().any(|subject| subject.protocol.is_some()) {
        return Err(usage(anyhow!(
            "compare a campaign of LIBERO's family with one of LIBERO-CTRL, or more than two: \
             name two campaigns of one benchmark"
        )));
    }
    let document = Document::new(subjects).map_err(anyhow::Error::from)?;
    let [Ok(comparison)] = document.comparisons() else {
        if let [Err(refused)] = document.comparisons() {
            return Err(anyhow::Error::from(refused.clone()).into());
        }
        return match arguments.json {
            true => json::print(&document.comparisons().iter().flatten().collect::<Vec<_>>()),
            false => Ok(print_line(document.pairs().trim_end())?),
        };
    };
    match arguments.json {
        true => json::print(comparison),
        false => Ok(print_line(comparison.text().trim_end())?),
    }
}
