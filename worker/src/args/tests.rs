#[path = "../../../crates/terminal/tests/helps/mod.rs"]
mod helps;

use super::*;

fn parse(line: &str) -> Result<Arguments, clap::Error> {
    Arguments::read("0", line.split_whitespace())
}

#[test]
fn short_help_fits_a_screen_and_scene_options_have_their_own_section() {
    let helps = helps::check(Arguments::parser("0"));
    for words in ["worker", "worker rollout", "worker variants"] {
        let help = helps.iter().find(|help| help.words == words);
        let helps::Help { short, long, .. } = help.expect(words);
        assert!(!short.contains("--scenes"), "{short}");
        let section = |title: &str| long.split_once(title).expect(title).1;
        let scenes = section("\nScenes:\n");
        for option in ["--assets", "--sources", "--scenes", "--renderer", "--look"] {
            assert!(scenes.contains(option), "{words}: {long}");
        }
        if words != "worker variants" {
            assert!(section("\nConnection:\n").contains("--token-file"), "{long}");
        }
        assert!(!scenes.contains("--token-file"), "{long}");
    }
}

#[test]
fn a_worker_needs_a_coordinator_and_simulates_libero() {
    let arguments = parse("worker --connect http://h:1 --assets primitives --slots 3");
    let arguments = arguments.expect("a valid command line");
    let slots = |arguments: Arguments| arguments.serve.expect("serve arguments").slots;
    let simulator = arguments.simulator.clone();
    let three = NonZeroUsize::new(3).expect("not zero");
    assert_eq!(slots(arguments), SlotCount::Given(three));
    let auto = "worker --connect http://h:1 --assets primitives --slots auto";
    assert_eq!(slots(parse(auto).expect("a valid command line")), SlotCount::Auto);
    assert_eq!(simulator.renderer, Renderer::default());
    let line = "worker --assets primitives";
    assert_eq!(parse(line).expect_err(line).exit_code(), 2);
    let arguments = parse("worker --connect http://h:1").expect("a valid command line");
    assert_eq!(arguments.simulator.assets, "libero");
}

#[test]
fn a_users_task_needs_initial_states_and_an_actor() {
    let end = "--assets primitives --output out";
    let own = "worker rollout --bddl a.bddl --init a.pruned_init --max-steps 30";
    let arguments = parse(&format!("{own} --actions a.npz {end}")).expect("a valid command line");
    let Some(Command::Rollout(rollout)) = arguments.command else { panic!("{arguments:?}") };
    assert_eq!((rollout.id, rollout.own_task.max_steps), (None, Some(30)));
    for line in [
        format!("{own} {end}"),
        format!("{own} --actions a.npz --endpoint grpc://h:1 {end}"),
        format!("worker rollout --bddl a.bddl --actions a.npz {end}"),
        format!("worker rollout --actions a.npz {end}"),
        format!("worker rollout --id goal/t0/nominal/i00 --init-id 3 --actions a.npz {end}"),
    ] {
        assert_eq!(parse(&line).expect_err(&line).exit_code(), 2, "{line}");
    }
}

fn fetch(line: &str) -> Result<FetchArguments, clap::Error> {
    match parse(line)?.command {
        Some(Command::Assets(AssetsArguments {
            command: Some(AssetsCommand::Fetch(fetch)),
            ..
        })) => Ok(*fetch),
        other => panic!("{other:?}"),
    }
}

#[test]
fn assets_are_fetched_for_all_tasks_or_some_from_one_place() {
    let arguments = fetch("worker assets fetch").expect("a valid command line");
    assert_eq!(arguments.tasks, [TaskChoice::All]);
    let arguments = fetch("worker assets fetch --tasks libero_goal/3,libero_10/0");
    let arguments = arguments.expect("a valid command line");
    assert_eq!(arguments.tasks.len(), 2);
    for wrong in ["--tasks libero_goal/10", "--everything --tasks all", "--index URL --wheels DIR"]
    {
        let line = format!("worker assets fetch {wrong}");
        assert_eq!(fetch(&line).expect_err(wrong).exit_code(), 2);
    }
}
