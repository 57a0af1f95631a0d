//! The project's commands: `cargo xtask setup|demo|check|test|dist|parity` and others. Each command
//! first completes its prerequisites, and skips those that an earlier command has completed.

#![forbid(unsafe_code)]

mod bench;
mod bench_build;
mod bench_python;
mod bench_training;
mod cargo;
mod check;
mod clients;
mod demo;
mod deploy;
mod dist;
mod lint;
mod original;
mod packages;
mod process;
mod python;
mod ray;
mod running;
mod s3;
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
        /// Also install the libraries for OpenGL rendering (`worker --renderer gl`).
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
    /// Build the Python packages' wheels.
    Wheel {
        /// Folder to copy them into. [default: they stay in
        /// target/wheels/release]
        #[arg(long)]
        output: Option<PathBuf>,
    },
    /// Make the release archive, and test it in a root folder with glibc only.
    Dist(dist::Options),
    /// Take the pictures of the live page in docs/screenshots.
    Screenshots,
    /// Run a benchmark; docs/PERFORMANCE.md and docs/PYTHON.md describe most of them.
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
    /// Waiting times for the demo's report, for `.ci/run`, and for the queue's tests after a changed
    /// line.
    Build(bench_build::Options),
    /// The paired report of 62,400 rollouts, six policies with all intervals.
    Report {
        /// Use the release profile instead of the development profile.
        #[arg(long)]
        release: bool,
    },
    /// The simulator on one task, compared with MuJoCo alone.
    Sim {
        /// Passed on: --task SUITE/N [--assets PACK_OR_PATH] [--steps N].
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        arguments: Vec<String>,
    },
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
    /// This project's environments in Python and the original LIBERO's, in turn.
    Python(bench_python::Options),
    /// Rollouts for reinforcement learning, in our and the original LIBERO's environments.
    Training(bench_training::Options),
    /// A whole machine: runs `worker bench`.
    Machine {
        /// Passed on: [--assets PACK_OR_PATH] [--task SUITE/N] [--execute K]
        /// [--slots LIST] [--secs S] [--renderer software|gl].
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        arguments: Vec<String>,
    },
    /// Memory and start time of slots whose compiled scenes are files.
    Scenes {
        /// Passed on: [--slots N] [--tasks SUITE/N,…] [--assets PACK_OR_PATH]
        /// [--scenes DIR|off] [--python FILE].
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        arguments: Vec<String>,
    },
    /// The coordinator's queue under simulated slots, as a release build.
    Queue {
        /// Passed on: [--jobs N] [--slots N] [--rollout-millis N] [--data DIR].
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        arguments: Vec<String>,
    },
    /// A million jobs of four campaigns under 2,000 slots over TLS, with a coordinator that is
    /// killed and restored; a figure shows memory, disk use and times. A release build.
    Soak {
        /// Passed on: [--jobs N] [--slots N] [--workers N] [--minutes N] [--figure FILE].
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        arguments: Vec<String>,
    },
    /// The gateway in front of a simulated policy server, as a release build.
    Gateway {
        /// Passed on: [--slots N] [--batch-millis N] [--max-batch N] [--rate N]
        /// [--secs N] [--rounds N], or `slots --address HOST:PORT`.
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
        Command::Wheel { output } => wheels(output.as_deref()),
        Command::Dist(options) => dist::run(&root(), &options),
        Command::Screenshots => test::screenshots(&root()),
        Command::Bench(Bench::Build(options)) => bench_build::run(&root(), &options),
        Command::Bench(Bench::Report { release }) => test::bench_report(&root(), release),
        Command::Bench(Bench::Sim { arguments }) => test::program(&root(), "bench_sim", &arguments),
        Command::Bench(Bench::Draw { arguments }) => {
            test::program(&root(), "bench_draw", &arguments)
        }
        Command::Bench(Bench::Rollout { arguments }) => {
            test::program(&root(), "bench_rollout", &arguments)
        }
        Command::Bench(Bench::Scenes { arguments }) => {
            test::program(&root(), "bench_scenes", &arguments)
        }
        Command::Bench(Bench::Compare(options)) => bench::compare(&root(), &options),
        Command::Bench(Bench::Python(options)) => bench_python::run(&root(), &options),
        Command::Bench(Bench::Training(options)) => bench_training::run(&root(), &options),
        Command::Bench(Bench::Machine { arguments }) => test::worker_bench(&root(), &arguments),
        Command::Bench(Bench::Queue { arguments }) => bench_queue(&arguments),
        Command::Bench(Bench::Soak { arguments }) => bench_soak(&arguments),
        Command::Bench(Bench::Gateway { arguments }) => bench_gateway(&arguments),
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

fn wheels(output: Option<&Path>) -> anyhow::Result<()> {
    let cache = setup::run(&root())?;
    wheel::run(&root(), &cache, output)
}

/// Runs the queue's benchmark, which needs no simulator and so no setup. Uses the release profile,
/// because SQLite takes most of the time and the development profile hardly optimises it.
fn bench_queue(arguments: &[String]) -> anyhow::Result<()> {
    let mut program = cargo::cargo(&root());
    program.args(["run", "--quiet", "--release", "--package", "coordinator"]);
    program.args(["--example", "bench_queue", "--"]);
    process::run(program.args(arguments))
}

/// Runs the coordinator's soak test: the real program under the load of an example.
fn bench_soak(arguments: &[String]) -> anyhow::Result<()> {
    let package = ["--release", "--package", "coordinator"];
    let mut coordinator = cargo::cargo(&root());
    coordinator.args(["build", "--quiet"]).args(package);
    process::run(coordinator.args(["--bin", "coordinator"]))?;
    let mut program = cargo::cargo(&root());
    program.args(["run", "--quiet"]).args(package);
    program.args(["--example", "soak", "--"]);
    process::run(program.args(arguments))
}

/// Runs the gateway's benchmark, which needs no simulator: the real program under the load of an
/// example.
fn bench_gateway(arguments: &[String]) -> anyhow::Result<()> {
    let package = ["--release", "--package", "policy-gateway"];
    let mut gateway = cargo::cargo(&root());
    gateway.args(["build", "--quiet"]).args(package);
    process::run(gateway.args(["--bin", "policy-gateway"]))?;
    let mut program = cargo::cargo(&root());
    program.args(["run", "--quiet"]).args(package);
    program.args(["--example", "bench_gateway", "--"]);
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
        let pages = std::fs::read_dir(root().join("docs")).expect("the pages");
        let pages = pages.map(|page| page.expect("a page").path());
        let readmes = ["README.md", "policies/README.md", "fuzz/README.md"];
        let all = pages.chain(readmes.map(|page| root().join(page)));
        let pages = all.filter(|page| page.extension().is_some_and(|extension| extension == "md"));
        let (mut commands, mut mentions) = (Vec::new(), Vec::new());
        for page in pages {
            let text = std::fs::read_to_string(page).expect("a page");
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
