//! Runs all commands of a page.

use std::fs;
use std::time::Instant;

use super::folder::{Folder, Requirement, checkout};
use super::page::{Action, Command, Step, steps};
use super::session::{Failure, Session};

/// Path that marks a command as reading the reference data.
const SHARED: &str = "../shared";

/// Runs the commands of a page of the checkout, and prints the skipped ones with the reason.
pub fn run_page(page: &str) {
    let text = fs::read_to_string(checkout().join(page)).expect("the page");
    let failures = failures(page, &text);
    assert!(failures.is_empty(), "\n{}", failures.join("\n"));
}

/// Runs the commands of a page and returns descriptions of the failures with line, command and
/// output. Continues after a failure if the shell is still usable.
pub fn failures(page: &str, text: &str) -> Vec<String> {
    let steps = steps(text).unwrap_or_else(|error| panic!("{page}, {error}"));
    let folder = Folder::make();
    let mut session = Session::start(&folder);
    let mut failures = Vec::new();
    for step in &steps {
        match handling(step) {
            Handling::Run(commands) => {
                for command in commands {
                    let start = Instant::now();
                    let outcome = session.run(&command.text);
                    let secs = start.elapsed().as_secs_f64();
                    println!("ran {page}:{}: {secs:.1} s", command.line);
                    let Err(failure) = outcome else {
                        continue;
                    };
                    failures.push(describe_failure(page, command, &failure));
                    if failure.is_fatal {
                        return failures;
                    }
                }
            }
            Handling::Write(name, text) => {
                fs::write(folder.checkout().join(name), text).expect("the page's file");
            }
            Handling::Report(label, reason) => println!("{label}: {page}:{}: {reason}", step.line),
        }
    }
    if let Err(failure) = session.finish() {
        failures.push(format!("{page}: {}\n{}", failure.problem, failure.output));
    }
    failures
}

/// Handling of a step on this machine.
enum Handling<'a> {
    Run(&'a [Command]),
    Write(&'a str, &'a str),
    Report(&'static str, String),
}

fn handling(step: &Step) -> Handling<'_> {
    match &step.action {
        Action::Skip { reason } => Handling::Report("not run", reason.clone()),
        Action::Write { name, text } => Handling::Write(name, text),
        Action::Run { commands, needs } => {
            let reads_shared = commands.iter().any(|command| command.text.contains(SHARED));
            let named = needs.as_deref().map(|word| {
                Requirement::parse(word)
                    .unwrap_or_else(|| panic!("line {}: unknown requirement {word:?}", step.line))
            });
            let requirements =
                named.into_iter().chain(reads_shared.then_some(Requirement::ReferenceData));
            match requirements.filter_map(Requirement::unmet_reason).next() {
                Some(reason) => Handling::Report("skipped", reason),
                None => Handling::Run(commands),
            }
        }
    }
}

fn describe_failure(page: &str, command: &Command, failure: &Failure) -> String {
    let Command { line, text } = command;
    let Failure { problem, output, .. } = failure;
    format!("{page}:{line}: {problem}\n{text}\n--- output:\n{output}\n---")
}
