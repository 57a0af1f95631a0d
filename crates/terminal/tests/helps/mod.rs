//! Rules of every program's help texts. Shared by the tests of all programs.

const MAX_SHORT_LINES: usize = 45;

pub(crate) struct Help {
    pub(crate) words: String,
    pub(crate) short: String,
    pub(crate) long: String,
}

pub(crate) fn check(program: clap::Command) -> Vec<Help> {
    let mut program = terminal::with_variables(program);
    program.build();
    let mut helps = Vec::new();
    let name = program.get_name().to_owned();
    add_helps(&program, &name, &mut helps);
    helps
}

fn add_helps(command: &clap::Command, words: &str, helps: &mut Vec<Help>) {
    let mut rendered = command.clone();
    let short = rendered.render_help().to_string();
    let lines = short.lines().count();
    assert!(lines <= MAX_SHORT_LINES, "`{words} -h` has {lines} lines:\n{short}");
    let long = rendered.render_long_help().to_string();
    helps.push(Help { words: words.to_owned(), short, long });
    for command in command.get_subcommands() {
        if !command.is_hide_set() && command.get_name() != "help" {
            add_helps(command, &format!("{words} {}", command.get_name()), helps);
        }
    }
}
