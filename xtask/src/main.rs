//! The project's commands: `cargo xtask setup|demo|check|test|dist|parity` and others. Each command
//! first completes its prerequisites, and skips those that an earlier command has completed.

#![forbid(unsafe_code)]

mod bench;
mod bench_training;
mod cargo;
mod check;
mod clients;
mod demo;
mod dist;
mod lint;
mod original;
mod packages;
mod process;
mod python;
mod running;
mod setup;
mod skipped;
mod step;
mod test;
mod typescript;
mod venv;
mod wheel;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// The project's own commands.
#[derive(Parser)]
#[command(name = "cargo xtask")]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Fetch and check the requirements for building and simulating; idempotent.
    Setup {
        /// Also check for the libraries of OpenGL rendering (`worker --renderer gl`).
        #[arg(long)]
        gl: bool,
    },
    /// Run a small campaign end to end and print its paired table.
    Demo(demo::Options),
    /// Check format, lints, Python types, documentation and unit tests; takes
    /// minutes.
    Check,
    /// Run all tests and lints, or only the named suites.
    Test {
        /// Suites to run, separated by commas. [default: all; with filters,
        /// `rust`]
        #[arg(long, value_delimiter = ',')]
        suite: Vec<test::Suite>,
        /// Passed on to the test runner, for example a name to filter by.
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        filters: Vec<String>,
    },
    /// Make the release: the archive, tested in a root folder with glibc only, and all wheels.
    Dist(dist::Options),
    /// Run a benchmark; PERFORMANCE.md and RELIABILITY.md in docs/dev describe them.
    #[command(subcommand)]
    Bench(Bench),
    /// Compare the simulator with reference data of the original LIBERO.
    Parity {
        /// Passed on: --reference DIR [--overlay DIR] [--assets PACK_OR_PATH] [--look LOOK]
        /// [--tasks SUITE/N,…] [--renderer software|gl] [--frames-of-this-machine], or --family
        /// [--pictures DIR].
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        arguments: Vec<String>,
    },
}

#[derive(Subcommand)]
enum Bench {
    /// Our renderer and OpenGL's, in turn on the same scenes: time and agreement.
    Draw {
        /// Passed on: [--tasks SUITE/N,…|all] [--conditions [ID,…]] [--assets
        /// PACK_OR_PATH] [--frames N] [--alone] [--output DIR].
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        arguments: Vec<String>,
    },
    /// Time of each phase of a rollout.
    Rollout {
        /// Passed on: --task SUITE/N --execute K [--steps N] [--rollouts N]
        /// [--assets PACK_OR_PATH] [--renderer software|gl] [--actions FILE].
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        arguments: Vec<String>,
    },
    /// The same rollout in this simulator and in the original LIBERO, in turn.
    Compare(bench::Compare),
    /// Rollouts for reinforcement learning, in our and the original LIBERO's environments.
    Training(bench_training::Options),
    /// The coordinator's queue under simulated slots, as a release build.
    Queue {
        /// Passed on: [--jobs N] [--slots N] [--rollout-millis N] [--data DIR].
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        arguments: Vec<String>,
    },
}

fn main() -> ExitCode {
    let outcome = match Arguments::parse().command {
        Command::Setup { gl } => set_up(gl),
        Command::Demo(options) => demo::run(&root(), &options),
        Command::Check => check::run(&root()),
        Command::Test { suite, filters } => test::run(&root(), &suite, &filters),
        Command::Dist(options) => dist::run(&root(), &options),
        Command::Bench(Bench::Draw { arguments }) => {
            test::program(&root(), "bench_draw", &arguments)
        }
        Command::Bench(Bench::Rollout { arguments }) => {
            test::program(&root(), "bench_rollout", &arguments)
        }
        Command::Bench(Bench::Compare(options)) => bench::compare(&root(), &options),
        Command::Bench(Bench::Training(options)) => bench_training::run(&root(), &options),
        Command::Bench(Bench::Queue { arguments }) => bench_queue(&arguments),
        Command::Parity { arguments } => test::program(&root(), "parity", &arguments),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: failed to {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn set_up(gl: bool) -> anyhow::Result<()> {
    setup::run(&root())?;
    if gl {
        setup::opengl()?;
    }
    // Builds the demo's programs together, so that the demo compiles nothing more.
    let programs = cargo::build_only(&root(), &demo::PROGRAMS)?;
    setup::assets(&programs, "all").map(drop)
}

/// Runs the queue's benchmark, which needs no simulator and so no setup. Uses the release profile,
/// because SQLite takes most of the time and the development profile hardly optimises it.
fn bench_queue(arguments: &[String]) -> anyhow::Result<()> {
    let mut program = cargo::cargo(&root());
    program.args(["run", "--quiet", "--release", "--package", "coordinator"]);
    program.args(["--example", "bench_queue", "--"]);
    process::run(program.args(arguments))
}

/// Returns the workspace's folder. Prefers the variable set by `cargo run`, because two clones
/// with a common build folder share one compiled xtask.
fn root() -> PathBuf {
    let package = std::env::var_os("CARGO_MANIFEST_DIR");
    let package = package.unwrap_or_else(|| env!("CARGO_MANIFEST_DIR").into());
    Path::new(&package).parent().expect("xtask is in the workspace").to_owned()
}

#[cfg(test)]
mod tests {
    use clap::error::ErrorKind;

    use super::*;

    /// Collects the mentions of `cargo xtask` in the pages: commands in code blocks, and in
    /// sentences, which may name a command without its arguments.
    fn documented() -> (Vec<String>, Vec<String>) {
        let mut git = std::process::Command::new("git");
        git.args(["ls-files", "*.md"]).current_dir(root());
        let pages = process::capture(&mut git).expect("a checkout");
        let (mut commands, mut mentions) = (Vec::new(), Vec::new());
        for page in pages.lines() {
            let text = std::fs::read_to_string(root().join(page)).expect("a page");
            let mut in_code_block = false;
            let mut sentences = String::new();
            for line in text.lines() {
                if line.starts_with("```") {
                    in_code_block = !in_code_block;
                } else if in_code_block {
                    commands.extend(line.find("cargo xtask").map(|at| line[at..].to_owned()));
                } else {
                    sentences.push_str(line.trim());
                    sentences.push(' ');
                }
            }
            let quoted = sentences.split('`').skip(1).step_by(2);
            let commands_in_text = quoted
                .filter(|mention| mention.starts_with("cargo xtask") && !mention.contains('…'));
            mentions.extend(commands_in_text.map(str::to_owned));
        }
        (commands, mentions)
    }

    #[test]
    fn every_documented_command_is_accepted() {
        let parse = |command: &str| {
            let words = command.split_whitespace();
            let words = words.take_while(|word| !["#", "&&"].contains(word)).skip(1);
            Arguments::try_parse_from(words).map(drop)
        };
        let (commands, mentions) = documented();
        assert!(commands.len() > 8, "{commands:?}");
        for command in commands {
            parse(&command).unwrap_or_else(|error| panic!("`{command}`: {error}"));
        }
        assert!(mentions.len() > 8, "{mentions:?}");
        for mention in mentions {
            match parse(&mention) {
                Err(error) if error.kind() != ErrorKind::MissingRequiredArgument => {
                    panic!("`{mention}`: {error}")
                }
                _ => {}
            }
        }
    }

    #[test]
    fn test_filters_need_no_dashes_before_them() {
        for words in
            [&["xtask", "test", "undisturbed"][..], &["xtask", "test", "--", "undisturbed"]]
        {
            let Command::Test { suite, filters } = Arguments::parse_from(words).command else {
                panic!("{words:?}");
            };
            assert_eq!((&suite[..], &filters[..]), (&[][..], &["undisturbed".to_owned()][..]));
        }
    }
}
