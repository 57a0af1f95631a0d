//! Options from environment variables. Every option that a server program's help shows can also be
//! set as a variable, which suits systemd units and containers: `--min-free-mib` is
//! `ROLLOUT_MIN_FREE_MIB`.
//! The command line takes precedence, and an empty variable counts as unset.

use std::env::{current_dir, home_dir, var_os, vars_os};
use std::ffi::OsString;
use std::path::PathBuf;

use clap::builder::BoolishValueParser;
use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{Arg, ArgAction, ArgMatches, Command};

/// Prefix of the variables' names.
const PREFIX: &str = "ROLLOUT_";
/// Further variables that name folders.
const FOLDERS: [&str; 3] = ["HOME", "TMPDIR", CACHE];
/// The user's cache folder, in place of `~/.cache`.
const CACHE: &str = "XDG_CACHE_HOME";
/// Separator of values of an option that can be repeated.
const SEPARATOR: char = ';';

/// Returns the command with a variable for each option that is not hidden, except those whose
/// variable is empty. Options that already have a variable keep it.
pub fn with_variables(command: Command) -> Command {
    command.mut_args(|arg| {
        let Some(name) = variable(&arg).filter(|name| !is_empty(name)) else {
            return arg;
        };
        // The leak is bounded, because a process parses one command line.
        let arg = arg.env(&*name.leak());
        match arg.get_action() {
            ArgAction::SetTrue => arg.value_parser(BoolishValueParser::new()),
            ArgAction::Append => arg.value_delimiter(SEPARATOR),
            _ => arg,
        }
    })
}

/// Parses the command line of a server program. If its first argument is a subcommand, variables
/// are ignored: they are meant for the server.
pub fn read(program: Command, words: Vec<OsString>) -> Result<ArgMatches, clap::Error> {
    let first = words.get(1).and_then(|word| word.to_str());
    let is_command = |word| word == "help" || program.find_subcommand(word).is_some();
    let program = if first.is_some_and(is_command) { program } else { with_variables(program) };
    parse(program, words)
}

/// Parses a command line. An error about a value from the environment names its variable.
pub fn parse(mut program: Command, words: Vec<OsString>) -> Result<ArgMatches, clap::Error> {
    let variables = vars_os().filter(|(name, _)| {
        name.to_str().is_some_and(|name| name.starts_with(PREFIX) || FOLDERS.contains(&name))
    });
    let here = current_dir().map(PathBuf::into_os_string);
    let mut texts = words.iter().cloned().chain(variables.map(|(_, value)| value)).chain(here);
    if let Some(text) = texts.find(|text| text.to_str().is_none()) {
        let message = format!("read {text:?}: it is not UTF-8; rename the file or folder");
        return Err(program.error(ErrorKind::InvalidUtf8, message));
    }
    let commands = program.clone();
    let matches = program.try_get_matches_from(&words);
    matches.map_err(|error| name_commands(name_variable(error, &words), commands, &words))
}

/// Adds to an error about an unknown command where that command is, or which ones there are.
fn name_commands(mut error: clap::Error, program: Command, words: &[OsString]) -> clap::Error {
    let Some(ContextValue::String(given)) = error.get(ContextKind::InvalidSubcommand).cloned()
    else {
        return error;
    };
    let of_group = |group: &Command| group.find_subcommand(&given).is_some();
    let elsewhere = program.get_subcommands().find(|group| of_group(group));
    // The group in which the command was looked for.
    let mut group = &program;
    for word in words.iter().skip(1).filter_map(|word| word.to_str()) {
        group = group.find_subcommand(word).unwrap_or(group);
    }
    let shown = group.get_subcommands().filter(|command| !command.is_hide_set());
    let names: Vec<&str> = shown.map(Command::get_name).collect();
    let hint = match elsewhere {
        Some(other) => {
            format!("did you mean `{} {} {given}`?", program.get_name(), other.get_name())
        }
        None => format!("valid are {}", names.join(", ")),
    };
    error.insert(ContextKind::Suggested, ContextValue::StyledStrs(vec![hint.into()]));
    error
}

/// Returns `rollout` in the user's cache folder, by the XDG base directory specification: an empty
/// or relative `XDG_CACHE_HOME` counts as unset.
pub fn cache_folder() -> PathBuf {
    cache_folder_of(var_os(CACHE), home_dir())
}

fn cache_folder_of(cache: Option<OsString>, home: Option<PathBuf>) -> PathBuf {
    let absolute = |path: &PathBuf| path.is_absolute();
    let cache = cache.map(PathBuf::from).filter(absolute);
    let cache = cache.or_else(|| Some(home.filter(absolute)?.join(".cache")));
    // A user without a home has no cache: no folder can be made in this one.
    cache.unwrap_or_else(|| "/dev/null".into()).join("rollout")
}

/// Adds the variable's name to an error if the invalid value comes from the environment.
fn name_variable(mut error: clap::Error, words: &[OsString]) -> clap::Error {
    let is_about_value =
        matches!(error.kind(), ErrorKind::InvalidValue | ErrorKind::ValueValidation);
    let Some(ContextValue::String(argument)) = error.get(ContextKind::InvalidArg) else {
        return error;
    };
    // For example `--listen <ADDR>`.
    let flag = argument.split_whitespace().next().unwrap_or_default();
    let is_given = words.iter().filter_map(|word| word.to_str()).any(|word| {
        let rest = word.strip_prefix(flag);
        rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('='))
    });
    let name = variable_name(flag.trim_start_matches('-'));
    if is_about_value && !is_given && var_os(&name).is_some() {
        let hint = format!("the value comes from the environment variable {name}");
        let suggestion = ContextValue::StyledStrs(vec![hint.into()]);
        error.insert(ContextKind::Suggested, suggestion);
    }
    error
}

/// Returns the name of an option's variable; `None` if the argument has no long name, is hidden or
/// already has a variable.
fn variable(arg: &Arg) -> Option<String> {
    let is_public = !arg.is_hide_set() && arg.get_env().is_none();
    arg.get_long().filter(|_| is_public).map(variable_name)
}

/// The empty string restores an option's default.
fn is_empty(variable: &String) -> bool {
    var_os(variable).is_some_and(|value| value.is_empty())
}

fn variable_name(long: &str) -> String {
    format!("{PREFIX}{}", long.replace('-', "_").to_uppercase())
}

#[cfg(test)]
mod tests {
    use std::os::unix::ffi::OsStringExt;

    use super::*;

    #[test]
    fn the_cache_is_never_in_the_current_folder() {
        for (cache, home, expected) in [
            (Some("/c"), Some("/h"), "/c/rollout"),
            (Some(""), Some("/h"), "/h/.cache/rollout"),
            (Some("relative"), Some("/h"), "/h/.cache/rollout"),
            (None, Some("/h"), "/h/.cache/rollout"),
            (None, Some(""), "/dev/null/rollout"),
            (None, None, "/dev/null/rollout"),
        ] {
            let folder = cache_folder_of(cache.map(OsString::from), home.map(PathBuf::from));
            assert_eq!(folder, PathBuf::from(expected), "{cache:?} {home:?}");
        }
    }

    /// Regression: a slot was never told its work, and results were lost after the last step.
    #[test]
    fn arguments_that_are_not_utf_8_are_refused() {
        let word = OsString::from_vec(b"n\xe4me".to_vec());
        let error = parse(program(), vec!["server".into(), word]).expect_err("Latin-1");
        assert!(error.to_string().contains("is not UTF-8"), "{error}");
    }

    fn program() -> Command {
        Command::new("server")
            .arg(Arg::new("connect").long("connect").env("SERVER_URL"))
            .arg(Arg::new("min").long("min-free-mib").default_value("1"))
            .arg(Arg::new("wide").long("wide").action(ArgAction::SetTrue))
            .arg(Arg::new("route").long("route").action(ArgAction::Append))
            .arg(Arg::new("secret").long("secret").hide(true))
            .arg(Arg::new("folder"))
            .subcommand(Command::new("list").arg(Arg::new("all").long("all")))
    }

    fn variables(command: &Command) -> Vec<(&str, Option<&str>)> {
        let name = |arg: &Arg| arg.get_env().map(|name| name.to_str().expect("UTF-8").to_owned());
        let arguments = command.get_arguments();
        arguments
            .map(|arg| (arg.get_id().as_str(), name(arg).map(|variable| &*variable.leak())))
            .collect()
    }

    #[test]
    fn every_public_option_gets_a_variable_unless_it_has_one() {
        let command = with_variables(program());
        assert_eq!(
            variables(&command),
            [
                ("connect", Some("SERVER_URL")),
                ("min", Some("ROLLOUT_MIN_FREE_MIB")),
                ("wide", Some("ROLLOUT_WIDE")),
                ("route", Some("ROLLOUT_ROUTE")),
                ("secret", None),
                ("folder", None),
            ]
        );
        let list = command.find_subcommand("list").expect("the subcommand");
        assert_eq!(variables(list), [("all", None)]);
    }

    fn words(line: &str) -> Vec<OsString> {
        line.split(' ').map(OsString::from).collect()
    }

    #[test]
    fn command_line_takes_precedence_over_variables() {
        let matches = read(program(), words("server --wide --route a --route b;c"));
        let matches = matches.expect("valid arguments");
        assert!(matches.get_flag("wide"));
        let routes: Vec<&String> = matches.get_many("route").expect("some").collect();
        assert_eq!(routes, ["a", "b", "c"]);
    }

    #[test]
    fn a_subcommand_ignores_the_variables_of_the_server() {
        let matches = read(program(), words("server list --all x")).expect("valid arguments");
        assert_eq!(matches.subcommand_name(), Some("list"));
    }

    #[test]
    fn an_unknown_command_is_answered_with_where_it_is_or_which_there_are() {
        let program = || {
            let campaign = Command::new("campaign").subcommand(Command::new("status"));
            let campaign = campaign.subcommand(Command::new("cancel"));
            Command::new("server").subcommands([Command::new("list"), campaign])
        };
        for (words, expected) in [
            (&["server", "status"][..], "did you mean `server campaign status`?"),
            (&["server", "campaign", "stop"], "valid are status, cancel"),
            (&["server", "show"], "valid are list, campaign"),
        ] {
            let words = words.iter().map(OsString::from).collect();
            let error = parse(program(), words).expect_err("no such command").to_string();
            assert!(error.contains(expected), "{error}");
        }
    }
}
