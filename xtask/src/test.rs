//! `cargo xtask test`: all tests of the workspace, of the Python packages and of the policy server
//! in TypeScript.

use std::path::Path;
use std::process::Command;
use std::time::Instant;

use anyhow::Result;
use clap::ValueEnum;

use crate::cargo::{build_program, build_programs, cargo};
use crate::demo;
use crate::deploy;
use crate::dist;
use crate::lint;
use crate::process::{capture, run as run_command};
use crate::python;
use crate::ray;
use crate::s3;
use crate::setup;
use crate::skipped;
use crate::step::step;
use crate::typescript;
use crate::wheel;

/// A part of the tests that can be run alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Suite {
    /// The tests of all crates, with cargo-nextest where it is installed.
    Rust,
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
}

/// Runs the named suites, or all of them if none is named. Filters select tests of the crates;
/// with filters and no name, only the suite `rust` runs.
pub(crate) fn run(root: &Path, suites: &[Suite], filters: &[String]) -> Result<()> {
    let suites = match (suites, filters) {
        ([], []) => Suite::value_variants(),
        ([], _) => &[Suite::Rust],
        _ => suites,
    };
    let cache = setup::run(root)?;
    // The end-to-end tests start the real programs.
    let programs = build_programs(root)?;
    // Without a network, the tests that need the assets are skipped with a message.
    if let Err(error) = setup::assets(&programs, "all") {
        println!("  none: {error:#}");
    }
    for suite in suites {
        let start = Instant::now();
        match suite {
            Suite::Rust => rust(root, &cache, &programs, filters)?,
            // With `--package`, cargo would choose other features for shared dependencies and
            // compile them again.
            Suite::Examples => {
                println!("Testing the examples of the documentation");
                run_command(cargo(root).args(["test", "--quiet", "--doc", "--workspace"]))?;
            }
            Suite::Overflow => {
                println!("Testing the software renderer with overflow checks");
                let arguments = ["--quiet", "--profile", "checked", "--package", "raster"];
                run_command(cargo(root).arg("test").args(arguments))?;
            }
            Suite::Policies => policies(root, &cache, &programs)?,
            Suite::Archive => {
                println!("Testing the release archive, with the programs just built");
                dist::test(root, &cache, &programs, deploy::schemas(&cache).as_deref())?;
            }
            Suite::Wheels => {
                println!("Testing the Python packages as wheels");
                wheel::test(root, &cache, &programs)?;
            }
            Suite::Ray => {
                println!("Testing the launcher on Ray");
                ray::test(root, &cache, &programs)?;
            }
            Suite::Demo => {
                println!("Testing the demo, with fewer rollouts");
                demo::check(root, &programs)?;
            }
        }
        let name = suite.to_possible_value();
        let name = name.as_ref().map_or("", |name| name.get_name());
        println!("Suite {name}: passed in {} s", start.elapsed().as_secs());
    }
    Ok(())
}

/// Runs the tests of all crates, after installing their optional requirements.
fn rust(root: &Path, cache: &Path, programs: &Path, filters: &[String]) -> Result<()> {
    let python = step("Python environment for policies/", || {
        python::environment(root, cache)
    })?;
    let packages = python::packages(root, cache)?;
    let typescript = typescript::build(root)?;
    step("browser for the live page's tests", || {
        // If there is no browser, these tests are skipped with a message.
        let outcome = setup::browser().map(str::to_owned);
        Ok(outcome.unwrap_or_else(|error| format!("none: {error:#}")))
    })?;
    step("Slurm for the tests of deploy/", || {
        // If there is no Slurm, these tests are skipped with a message.
        let outcome = setup::slurm().map(str::to_owned);
        Ok(outcome.unwrap_or_else(|error| format!("none: {error:#}")))
    })?;
    step("built-in pack matches its source", || {
        let mut generator = Command::new("python3");
        capture(
            generator
                .arg(root.join("assets/primitives_source"))
                .arg("--check"),
        )
        .map(|_| "yes")
    })?;
    step("dependencies against deny.toml", || deny(root))?;
    let schemas = deploy::schemas(cache);
    let bucket = s3::server(cache);
    println!("Testing");
    let nextest = capture(cargo(root).args(["nextest", "--version"])).is_ok();
    let mut tests = cargo(root);
    match nextest {
        true => tests.args(["nextest", "run"]),
        false => tests.arg("test"),
    };
    // Leaves out the examples: the lints compile them, and linking them takes a minute.
    tests
        .args(["--workspace", "--lib", "--bins", "--tests"])
        .args(filters)
        .env("ROLLOUT_PROGRAMS", programs)
        .env("ROLLOUT_PYTHON", &python)
        .env("ROLLOUT_PYTHON_PACKAGES", &packages);
    if let Some(server) = typescript {
        tests.env("ROLLOUT_TYPESCRIPT_POLICY", server);
    }
    if let Some(python) = &schemas {
        tests.env("ROLLOUT_DEPLOY_PYTHON", python);
    }
    if let Some(server) = &bucket {
        tests.env("ROLLOUT_S3_SERVER", server);
    }
    run_command(&mut tests)?;
    if nextest {
        // nextest writes its report to this path, regardless of the build folder.
        let report = root.join("target/nextest/default/junit.xml");
        skipped::check(&report, &root.join("../shared"))?;
    }
    Ok(())
}

/// Lints all Python sources, and tests the policies package from its sources.
fn policies(root: &Path, cache: &Path, programs: &Path) -> Result<()> {
    lint::run(root, cache)?;
    let python = step("Python environment for policies/", || {
        python::environment(root, cache)
    })?;
    let mut pytest = Command::new(python);
    run_command(
        pytest
            .args(["-m", "pytest", "--quiet", "-rfs", "-p", "no:cacheprovider"])
            .arg(root.join("policies/tests"))
            .env("POLICY_GATEWAY", programs.join("policy-gateway")),
    )
}

/// Checks licences, sources, bans and advisories of the dependencies, if cargo-deny is installed.
fn deny(root: &Path) -> Result<String> {
    if capture(cargo(root).args(["deny", "--version"])).is_err() {
        return Ok("skipped: no cargo-deny (`cargo install --locked cargo-deny`)".to_owned());
    }
    let check = ["deny", "--offline", "check"];
    capture(
        cargo(root)
            .args(check)
            .args(["bans", "licenses", "sources"]),
    )?;
    // The advisory database is a git repository, which `cargo deny fetch` downloads.
    let fetched = capture(cargo(root).args(["deny", "fetch"])).is_ok();
    match fetched {
        true => capture(cargo(root).args(check).arg("advisories")).map(|_| "yes".to_owned()),
        false => Ok("yes; advisories skipped: the database cannot be fetched".to_owned()),
    }
}

/// Builds and runs `worker bench`.
pub(crate) fn worker_bench(root: &Path, arguments: &[String]) -> Result<()> {
    program(root, "worker", &[&["bench".to_owned()], arguments].concat())
}

/// Builds and runs a program. Installs the OpenGL libraries if its arguments select that renderer;
/// the software renderer needs none.
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
    let has = |wanted: &str| arguments.iter().any(|argument| argument == wanted);
    match name {
        "bench_draw" => !has("--alone"),
        _ => {
            let after = arguments
                .iter()
                .skip_while(|argument| *argument != "--renderer")
                .nth(1);
            let joined = arguments
                .iter()
                .find_map(|argument| argument.strip_prefix("--renderer="));
            joined
                .or(after.map(String::as_str))
                .is_some_and(|renderer| renderer.starts_with("gl"))
        }
    }
}

/// Takes the screenshots of the live page for the documentation.
pub(crate) fn screenshots(root: &Path) -> Result<()> {
    setup::run(root)?;
    step("browser", setup::browser)?;
    let programs = build_programs(root)?;
    println!("Taking pictures");
    let mut program = Command::new(programs.join("screenshots"));
    program
        .env("ROLLOUT_PROGRAMS", &programs)
        .arg("--outcomes")
        .arg(root.join("examples/openvla_oft/rollouts.jsonl"));
    program.arg("--output").arg(root.join("docs/screenshots"));
    run_command(&mut program)
}

/// Runs the benchmark of the statistics, which needs no simulator.
pub(crate) fn bench_report(root: &Path, release: bool) -> Result<()> {
    let mut program = cargo(root);
    program.args([
        "run",
        "--quiet",
        "--package",
        "paired",
        "--example",
        "bench",
    ]);
    run_command(program.args(release.then_some("--release")))
}

#[cfg(test)]
mod tests {
    use super::draws_through_opengl;

    #[test]
    fn opengl_is_installed_only_for_programs_that_use_it() {
        let installs_opengl = |name: &str, arguments: &str| {
            let arguments: Vec<String> = arguments.split_whitespace().map(str::to_owned).collect();
            draws_through_opengl(name, &arguments)
        };
        assert!(!installs_opengl("parity", "--reference glass --assets gl"));
        assert!(!installs_opengl("parity", "--renderer software"));
        assert!(installs_opengl("parity", "--renderer gl"));
        assert!(installs_opengl("parity", "--renderer=gl:1 --reference DIR"));
        assert!(!installs_opengl("parity", "--renderer"));
        assert!(installs_opengl("worker", "bench --renderer gl"));
        assert!(!installs_opengl("worker", "bench"));
        assert!(installs_opengl("bench_draw", "--tasks all"));
        assert!(!installs_opengl("bench_draw", "--alone"));
    }
}
