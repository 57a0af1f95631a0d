//! Parses a page into the steps that a reader performs, in order.

use std::fmt;

use pulldown_cmark::{CodeBlockKind, Event, Parser, Tag, TagEnd};

/// Programs whose names show that a block holds commands, although it is not marked `sh` and so
/// would not be run.
const PROGRAMS: [&str; 11] = [
    "cargo",
    "coordinator",
    "worker",
    "policy-gateway",
    "python",
    "python3",
    "pip",
    "npm",
    "node",
    "openssl",
    "ssh",
];

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Step {
    /// Line of the page where the step begins, from 1.
    pub line: usize,
    pub action: Action,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Action {
    Run {
        commands: Vec<Command>,
        /// Requirement named in a `needs` comment.
        needs: Option<String>,
    },
    /// Writes a file into the folder of the session.
    Write { name: String, text: String },
    /// Skips a block of commands.
    Skip { reason: String },
}

/// A command of a block: one line, or several continued lines.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Command {
    /// Line of the page where the command begins, from 1.
    pub line: usize,
    /// Text of the command, including continued lines.
    pub text: String,
}

#[derive(Debug, PartialEq, Eq)]
pub struct PageError {
    line: usize,
    problem: &'static str,
}

impl fmt::Display for PageError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "line {}: {}", self.line, self.problem)
    }
}

impl std::error::Error for PageError {}

pub fn steps(markdown: &str) -> Result<Vec<Step>, PageError> {
    let mut steps = Vec::new();
    let mut comment: Option<Comment> = None;
    let mut html = String::new();
    let mut block: Option<(usize, String, String)> = None;
    for (event, range) in Parser::new(markdown).into_offset_iter() {
        let line = 1 + markdown[..range.start].matches('\n').count();
        match event {
            Event::Start(Tag::HtmlBlock) => html.clear(),
            Event::Html(text) => html.push_str(&text),
            Event::End(TagEnd::HtmlBlock) => comment = Comment::read(&html),
            Event::Start(Tag::CodeBlock(kind)) => {
                let (language, first) = match kind {
                    CodeBlockKind::Fenced(language) => (language.to_string(), line + 1),
                    CodeBlockKind::Indented => (String::new(), line),
                };
                block = Some((first, language, String::new()));
            }
            Event::Text(text) => match &mut block {
                Some((_, _, content)) => content.push_str(&text),
                None => comment = None,
            },
            Event::End(TagEnd::CodeBlock) => {
                let (first, language, text) = block.take().expect("an open block");
                let action = action(first, &language, &text, comment.take())?;
                steps.extend(action.map(|action| Step { line: first, action }));
            }
            Event::Start(_) => comment = None,
            _ => {}
        }
    }
    Ok(steps)
}

/// Instruction of an HTML comment for the block after it.
#[derive(Debug)]
enum Comment {
    NotRun(String),
    Needs(String),
    File(String),
}

impl Comment {
    fn read(html: &str) -> Option<Self> {
        let inside = html.trim().strip_prefix("<!--")?.strip_suffix("-->")?;
        let (key, value) = inside.trim().split_once(':')?;
        let value = value.split_whitespace().collect::<Vec<_>>().join(" ");
        match key {
            "not run" => Some(Self::NotRun(value)),
            "needs" => Some(Self::Needs(value)),
            "file" => Some(Self::File(value)),
            _ => None,
        }
    }
}

fn action(
    first: usize,
    language: &str,
    text: &str,
    comment: Option<Comment>,
) -> Result<Option<Action>, PageError> {
    let error = |problem| PageError { line: first, problem };
    match (language, comment) {
        ("sh", Some(Comment::NotRun(reason))) if reason.is_empty() => {
            Err(error("a block that is not run needs a reason"))
        }
        ("sh", Some(Comment::NotRun(reason))) => Ok(Some(Action::Skip { reason })),
        ("sh", Some(Comment::File(_))) => Err(error("commands are run, not written into a file")),
        ("sh", needs) => {
            let needs = match needs {
                Some(Comment::Needs(requirement)) => Some(requirement),
                _ => None,
            };
            let commands = commands(first, text);
            Ok(Some(Action::Run { commands, needs }))
        }
        (_, Some(Comment::File(name))) => Ok(Some(Action::Write { name, text: text.to_owned() })),
        (_, Some(_)) => Err(error("the comment of this block is for blocks marked `sh`")),
        ("", None) if text.lines().any(is_command) => {
            Err(error("a block with commands must be marked `sh`"))
        }
        (_, None) => Ok(None),
    }
}

/// Returns true if a line is a command of one of [`PROGRAMS`]. Drawings and tables may also
/// begin with a program's name but contain runs of spaces.
fn is_command(line: &str) -> bool {
    let command = line.split(" #").next().unwrap_or_default().trim_end();
    let mut words = command.split(' ');
    let first = words.next().unwrap_or_default();
    PROGRAMS.contains(&first) && words.next().is_some() && !command.contains("  ")
}

/// Splits a block into commands. Lines that end with a backslash continue on the next, and
/// here-documents continue to their end.
fn commands(first: usize, text: &str) -> Vec<Command> {
    let mut commands: Vec<Command> = Vec::new();
    let mut open: Option<Command> = None;
    for (index, line) in text.lines().enumerate() {
        let command = match open.take() {
            Some(mut command) => {
                command.text.push('\n');
                command.text.push_str(line);
                command
            }
            None if line.trim().is_empty() || line.trim_start().starts_with('#') => continue,
            None => Command { line: first + index, text: line.to_owned() },
        };
        if is_incomplete(&command.text) {
            open = Some(command);
        } else {
            commands.push(command);
        }
    }
    commands.extend(open);
    commands
}

/// Returns true if the command continues on the next line.
fn is_incomplete(command: &str) -> bool {
    let mut lines = command.lines();
    let first = lines.next().unwrap_or_default();
    if let Some((_, word)) = first.split_once("<<") {
        let word = word.split_whitespace().next().unwrap_or_default();
        let word = word.trim_matches(['\'', '"', '-']);
        return !lines.any(|line| line.trim_start() == word);
    }
    command.ends_with('\\')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unmarked_commands_and_comments_that_do_not_match_their_block_are_refused() {
        for page in [
            "```\ncoordinator report x   # first\n```\n",
            "    cargo xtask demo\n",
            "<!-- not run: -->\n```sh\na\n```\n",
            "<!-- not run: hours -->\n```toml\na\n```\n",
            "<!-- file: a -->\n```sh\na\n```\n",
        ] {
            assert!(steps(page).is_err(), "{page}");
        }
        let drawing = "```\nworker            coordinator         policy-gateway\n```\n";
        assert_eq!(steps(drawing), Ok(Vec::new()));
    }
}
