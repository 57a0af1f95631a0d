//! `cargo xtask test`: all tests of the workspace, of the Python packages and of the policy server
//! in TypeScript, and the lints.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Instant;

use anyhow::{Context, Result};
use clap::ValueEnum;

use crate::cargo::{build_program, build_programs, cargo, remove_package_variables};
use crate::demo;
use crate::dist;
use crate::lint;
use crate::process::{capture, run as run_command};
use crate::python;
use crate::setup;
use crate::skipped;
use crate::step::step;
use crate::typescript;
use crate::venv::{environment, optional};
use crate::wheel;

/// A part of the tests that can be run alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Suite {
    /// The tests of all crates, with cargo-nextest where it is installed.
    Rust,
    /// The lints of all crates; with `rust`, they run beside its tests.
    Lints,
    /// The examples of the Rust documentation.
    Examples,
    /// The software renderer with overflow checks.
    Overflow,
    /// Lints of Python, and the package of `policies/`.
    Policies,
    /// The release archive.
    Archive,
    /// The Python packages of `python/` as wheels.
    Wheels,
    /// The launcher of `deploy/ray`.
    Ray,
    /// The demo, with fewer rollouts.
    Demo,
    /// Simulators of the package index behind `rollout-env`; only if named: their environments
    /// take 20 GB, and drawing without a GPU takes tens of minutes.
    Simulators,
}

/// Simulators by the name of the environment, with the requirements that they need and those that
/// they do not declare. Each is installed into an environment of its own.
const SIMULATORS: [(&str, &[&str]); 7] = [
    ("aloha", &["gym-aloha==0.1.5"]),
    ("lerobot", &["lerobot[pusht]==0.4.4"]),
    ("metaworld", &["metaworld==3.1.1", "packaging"]),
    ("pusht", &["gym-pusht==0.1.8"]),
    // robosuite 1.5.2 accepts any later MuJoCo, but does not run with MuJoCo 4.
    ("robosuite", &["robosuite==1.5.2", "mujoco==3.3.7", "gymnasium>=1.1", "h5py"]),
    ("vla_eval", &["vla-eval==0.8.0", "gymnasium[mujoco]>=1.1"]),
    // Last, because it needs a GPU's Vulkan or Mesa 25.
    ("mani_skill", &["mani_skill==3.0.1", "torch"]),
];

/// Packages of optional tests: Kubernetes' schemas, a server of S3's protocol, and Ray.
const SCHEMAS: [&str; 1] = ["kubernetes-validate==1.37.0"];
const S3_SERVER: [&str; 1] = ["moto[server]==5.2.5"];
const RAY: [&str; 2] = ["ray==2.60.0", "pytest>=7"];

/// Tests `raster` with the checks that the profile `dev` omits. The package `workspace-hack`
/// selects the features with which shared dependencies are already compiled.
#[rustfmt::skip]
const OVERFLOW_CHECKS: [&str; 8] = [
    "--config", "profile.dev.package.raster.overflow-checks=true",
    "--config", "profile.dev.package.raster.debug-assertions=true",
    "--package", "raster", "--package", "workspace-hack",
];

/// Lists of suites that run in parallel with each other and with all suites but `rust`, which runs
/// first: each suite uses one core most of the time. The suites of one list run one after another:
/// archive and wheels use the same build tools, which the archive installs. Ray's processes mostly
/// wait.
const LANES: [&[Suite]; 2] = [&[Suite::Archive, Suite::Wheels], &[Suite::Ray]];

/// Runs the named suites, or all of them if none is named. Filters select tests of the crates;
/// with filters and no name, only the suite `rust` runs.
pub(crate) fn run(root: &Path, suites: &[Suite], filters: &[String]) -> Result<()> {
    let mut without_simulators = Suite::value_variants().to_vec();
    without_simulators.retain(|suite| *suite != Suite::Simulators);
    let suites = match (suites, filters) {
        ([], []) => without_simulators.as_slice(),
        ([], _) => &[Suite::Rust],
        _ => suites,
    };
    let cache = setup::run(root)?;
    // The end-to-end tests start the real programs.
    let programs = build_programs(root)?;
    // Without a network, the tests that need the assets are skipped with a message.
    if let Err(error) = setup::assets(&programs, "all") {
        println!("  LIBERO's assets: none; tests that need them are skipped: {error:#}");
    }
    let tests = Tests {
        root,
        cache: &cache,
        programs: &programs,
        filters,
        with_lints: suites.contains(&Suite::Lints),
    };
    let mut later = suites.to_vec();
    if suites.contains(&Suite::Rust) {
        tests.run_one(Suite::Rust)?;
        later.retain(|suite| !matches!(suite, Suite::Rust | Suite::Lints));
    }
    let lanes = LANES.map(|lane| take(&mut later, lane));
    std::thread::scope(|threads| {
        let lanes = lanes.map(|lane| threads.spawn(move || tests.run_all(&lane)));
        let outcome = tests.run_all(&later);
        let lane_outcomes = lanes.map(|lane| lane.join().expect("the thread does not panic"));
        lane_outcomes.into_iter().fold(outcome, Result::and)
    })
}

fn take(suites: &mut Vec<Suite>, lane: &[Suite]) -> Vec<Suite> {
    suites.extract_if(.., |suite| lane.contains(suite)).collect()
}

/// Inputs of the suites: folders, the built programs, and options.
#[derive(Clone, Copy)]
struct Tests<'a> {
    root: &'a Path,
    cache: &'a Path,
    programs: &'a Path,
    /// Passed on to the test runner of the crates.
    filters: &'a [String],
    /// Runs the lints beside the tests of the crates.
    with_lints: bool,
}

impl Tests<'_> {
    fn run_all(&self, suites: &[Suite]) -> Result<()> {
        suites.iter().try_for_each(|suite| self.run_one(*suite))
    }

    /// Runs a suite, and prints its outcome. Errors are printed here, because several suites that
    /// run in parallel may fail.
    fn run_one(&self, suite: Suite) -> Result<()> {
        let start = Instant::now();
        let outcome = self.suite(suite);
        let name = suite.to_possible_value();
        let name = name.as_ref().map_or("", |name| name.get_name());
        let seconds = start.elapsed().as_secs();
        match &outcome {
            Ok(()) => println!("Suite {name}: passed in {seconds} s"),
            Err(error) => println!("Suite {name}: failed after {seconds} s: {error:#}"),
        }
        outcome
    }

    fn suite(&self, suite: Suite) -> Result<()> {
        let Self { root, cache, programs, .. } = *self;
        match suite {
            Suite::Rust => self.crates()?,
            Suite::Lints => run_command(&mut lints(root))?,
            // With `--package`, cargo would choose other features for shared dependencies and
            // compile them again.
            Suite::Examples => {
                println!("Testing the examples of the documentation");
                run_command(cargo(root).args(["test", "--quiet", "--doc", "--workspace"]))?;
            }
            Suite::Overflow => {
                println!("Testing the software renderer with overflow checks");
                run_command(cargo(root).args(["test", "--quiet"]).args(OVERFLOW_CHECKS))?;
            }
            Suite::Policies => policies(root, cache, programs)?,
            Suite::Archive => {
                println!("Testing the release archive, with the programs just built");
                dist::test(root, cache, programs)?;
            }
            Suite::Wheels => {
                println!("Testing the Python packages as wheels");
                wheel::test(root, cache, programs)?;
            }
            Suite::Ray => {
                println!("Testing the launcher on Ray");
                ray(root, cache, programs)?;
            }
            Suite::Demo => {
                println!("Testing the demo, with fewer rollouts");
                demo::check(root, programs)?;
            }
            Suite::Simulators => simulators(root, cache)?,
        }
        Ok(())
    }

    /// Runs the tests of all crates, after installing their optional requirements. Lints run beside
    /// them, because many tests wait for single processes.
    fn crates(&self) -> Result<()> {
        let Self { root, cache, programs, filters, with_lints } = *self;
        let python = step("Python environment for policies/", || python::policies(root, cache))?;
        let packages = python::packages(root, cache)?;
        let typescript = typescript::build(root)?;
        step("dependencies against deny.toml", || deny(root))?;
        let schemas = optional("schemas of deploy/", &cache.join("deploy-venv"), &SCHEMAS);
        let bucket = optional("S3 server", &cache.join("s3-venv"), &S3_SERVER);
        println!("Testing");
        let nextest = capture(cargo(root).args(["nextest", "--version"])).is_ok();
        let mut tests = cargo(root);
        match (nextest, with_lints) {
            (true, true) => tests.args(["nextest", "run"]).args(build_tests(root)?),
            (true, false) => tests.args(["nextest", "run"]).args(ALL_TESTS),
            (false, _) => tests.arg("test").args(ALL_TESTS),
        };
        tests
            .args(filters)
            .env("NEXTEST_TEST_THREADS", threads()?.to_string())
            .env("ROLLOUT_PROGRAMS", programs)
            .env("ROLLOUT_PYTHON", &python)
            .env("ROLLOUT_PYTHON_PACKAGES", &packages);
        if let Some(server) = typescript {
            tests.env("ROLLOUT_TYPESCRIPT_POLICY", server);
        }
        if let Some(programs) = &schemas {
            tests.env("ROLLOUT_DEPLOY_PYTHON", programs.join("python"));
        }
        if let Some(programs) = &bucket {
            tests.env("ROLLOUT_S3_SERVER", programs.join("moto_server"));
        }
        std::thread::scope(|threads| {
            let lints = with_lints.then(|| threads.spawn(|| run_command(&mut lints(root))));
            run_command(&mut tests)?;
            match lints {
                Some(lints) => lints.join().expect("the thread of the lints does not panic"),
                None => Ok(()),
            }
        })?;
        if nextest {
            // nextest writes its report to this path, regardless of the build folder.
            let report = root.join("target/nextest/default/junit.xml");
            skipped::check(&report, &root.join("../shared"))?;
        }
        Ok(())
    }
}

/// Returns the number of tests that run at the same time: one for each core, and one of the group
/// `waiting` of .config/nextest.toml.
fn threads() -> Result<usize> {
    let cores = std::thread::available_parallelism().context("count the cores")?;
    Ok(cores.get() + 1)
}

/// Selects all tests. Examples are left out: the lints compile them, and linking them takes a
/// minute.
const ALL_TESTS: [&str; 2] = ["--workspace", "--tests"];

/// Builds the tests, and returns the arguments with which nextest runs them without cargo, whose
/// lock the lints hold while the tests run.
fn build_tests(root: &Path) -> Result<Vec<PathBuf>> {
    let folder = root.join("target/nextest");
    fs::create_dir_all(&folder).with_context(|| format!("make {}", folder.display()))?;
    let list = ["--list-type", "binaries-only", "--message-format", "json"];
    let mut binaries = cargo(root);
    binaries.args(["nextest", "list"]).args(ALL_TESTS).args(list);
    let mut metadata = cargo(root);
    metadata.args(["metadata", "--format-version", "1"]);
    let mut arguments = Vec::new();
    for (option, command) in
        [("--binaries-metadata", &mut binaries), ("--cargo-metadata", &mut metadata)]
    {
        let file = folder.join(format!("{}.json", option.trim_start_matches('-')));
        let text = capture(command.stderr(Stdio::inherit()))?;
        fs::write(&file, text).with_context(|| format!("write {}", file.display()))?;
        arguments.extend([PathBuf::from(option), file]);
    }
    Ok(arguments)
}

/// Returns the command of the lints, at a low priority that leaves the processor to the tests.
fn lints(root: &Path) -> Command {
    let mut lints = Command::new("nice");
    lints.args(["-n", "19"]).arg(cargo(root).get_program());
    remove_package_variables(&mut lints);
    lints.current_dir(root).args(["clippy", "--workspace", "--all-targets", "--quiet"]);
    lints.args(["--", "--deny", "warnings"]);
    lints
}

/// Lints all Python sources, and tests the policies package from its sources.
fn policies(root: &Path, cache: &Path, programs: &Path) -> Result<()> {
    lint::run(root, cache)?;
    let python = step("Python environment for policies/", || python::policies(root, cache))?;
    let mut pytest = Command::new(python);
    run_command(
        pytest
            .args(["-m", "pytest", "--quiet", "-rfs", "-p", "no:cacheprovider"])
            .arg(root.join("policies/tests"))
            .env("POLICY_GATEWAY", programs.join("policy-gateway")),
    )
}

/// Tests the launcher of `deploy/ray` on Ray itself, if Ray can be installed.
fn ray(root: &Path, cache: &Path, programs: &Path) -> Result<()> {
    let Some(tools) = optional("Ray for the tests of deploy/ray", &cache.join("ray"), &RAY) else {
        println!("  skipped deploy/ray/tests: no Ray");
        return Ok(());
    };
    let mut pytest = Command::new(tools.join("python"));
    pytest
        .args(["-m", "pytest", "--quiet", "-rfs", "-p", "no:cacheprovider"])
        .arg(root.join("deploy/ray/tests"))
        .env("ROLLOUT_PROGRAMS", programs);
    run_command(&mut pytest)
}

/// Tests `rollout-env` with each simulator, in the simulator's environment, and prints the table of
/// the simulators.
fn simulators(root: &Path, cache: &Path) -> Result<()> {
    setup::opengl()?;
    let mut table: Vec<String> = Vec::new();
    let tested = SIMULATORS.into_iter().try_for_each(|(name, packages)| {
        println!("Testing rollout-env with {name}");
        let dir = cache.join("simulators").join(name);
        step(name, || environment(&dir, &[packages, &["imageio", "pytest>=7"]].concat()))?;
        let python = || {
            let mut python = Command::new(dir.join("bin/python"));
            python.env("PYTHONPATH", root.join("python/rollout_env"));
            python
        };
        run_command(
            python()
                .args(["-m", "pytest", "--quiet", "-rfs", "-p", "no:cacheprovider", "-k", name])
                .arg(root.join("python/tests/env/test_simulators.py")),
        )?;
        let rows = capture(python().arg(root.join("python/bench/pipe.py")).arg(name))?;
        let headings = if table.is_empty() { 0 } else { 2 };
        // LeRobot prints to standard output too.
        let rows = rows.lines().filter(|line| line.starts_with('|')).skip(headings);
        table.extend(rows.map(str::to_owned));
        Ok(())
    });
    println!("{}", table.join("\n"));
    tested
}

/// Checks licences, sources, bans and advisories of the dependencies, if cargo-deny is installed.
fn deny(root: &Path) -> Result<String> {
    if capture(cargo(root).args(["deny", "--version"])).is_err() {
        return Ok("skipped: no cargo-deny (`cargo install --locked cargo-deny`)".to_owned());
    }
    let check = ["deny", "--offline", "check"];
    capture(cargo(root).args(check).args(["bans", "licenses", "sources"]))?;
    // The advisory database is a git repository, which `cargo deny fetch` downloads.
    let fetched = capture(cargo(root).args(["deny", "fetch"])).is_ok();
    match fetched {
        true => capture(cargo(root).args(check).arg("advisories")).map(|_| "yes".to_owned()),
        false => Ok("yes; advisories skipped: the database cannot be fetched".to_owned()),
    }
}

/// Builds and runs a program. Checks for the OpenGL libraries only if the program draws through
/// OpenGL with these arguments.
pub(crate) fn program(root: &Path, name: &str, arguments: &[String]) -> Result<()> {
    setup::run(root)?;
    if draws_through_opengl(name, arguments) {
        setup::opengl()?;
    }
    println!("Running {name}");
    let mut program = Command::new(build_program(root, name)?);
    run_command(program.current_dir(root).args(arguments))
}

fn draws_through_opengl(name: &str, arguments: &[String]) -> bool {
    match name {
        "bench_draw" => true,
        _ => {
            let after = arguments.iter().skip_while(|argument| *argument != "--renderer").nth(1);
            let joined = arguments.iter().find_map(|argument| argument.strip_prefix("--renderer="));
            joined.or(after.map(String::as_str)).is_some_and(|renderer| renderer.starts_with("gl"))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::draws_through_opengl;

    #[test]
    fn opengl_is_checked_only_for_programs_that_use_it() {
        let checks_opengl = |name: &str, arguments: &str| {
            let arguments: Vec<String> = arguments.split_whitespace().map(str::to_owned).collect();
            draws_through_opengl(name, &arguments)
        };
        assert!(!checks_opengl("parity", "--reference glass --assets gl"));
        assert!(!checks_opengl("parity", "--renderer software"));
        assert!(checks_opengl("parity", "--renderer gl"));
        assert!(checks_opengl("parity", "--renderer=gl:1 --reference DIR"));
        assert!(!checks_opengl("parity", "--renderer"));
        assert!(checks_opengl("bench_draw", "--tasks all"));
    }
}
