//! Compares the simulator with reference data of the original LIBERO, task by task, or with the
//! committed recordings of the benchmarks that extend it.
//! Prepared and run by `cargo xtask parity`.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result, ensure};
use benchmark::{Benchmark, Look, TaskRef};
use clap::Parser;
use scene::Sources;
use scene::pack::LIBERO;
use sim::{Drawer, Renderer};
use tests::family::{Comparison, RECORDED, Table, recordings};
use tests::fidelity::{
    CLOSE_LEVELS, Findings, Least, Limits, ReferenceTask, RendererRelation, compare, find_tasks,
};
use tests::files::open_pack;

/// Compare the simulator with reference data of the original LIBERO.
#[derive(Parser)]
struct Arguments {
    /// Folder of reference tasks: SUITE/NN_TASK. `contact/` and `sensitivity.json` beside this
    /// folder are used if they exist.
    #[arg(long, required_unless_present = "family")]
    reference: Option<PathBuf>,
    /// Folder of the same layout whose frames and arrays replace those of the reference.
    #[arg(long, requires = "reference")]
    overlay: Option<PathBuf>,
    /// Look of the scenes that are compared.
    #[arg(long, default_value_t)]
    look: Look,
    /// Compare LIBERO-Plus, LIBERO-PRO and LIBERO-Para with the committed recordings instead.
    /// `ROLLOUT_PRO_ASSETS` names the folder of LIBERO-PRO's assets, `ROLLOUT_PARA` the checkout of
    /// LIBERO-Para.
    #[arg(long, conflicts_with_all = ["reference", "tasks", "renderer", "frames_of_this_machine"])]
    family: bool,
    /// Folder of recorded pictures for `--family`, with a folder for each look [default: those in the
    /// repository]
    #[arg(long, requires = "family")]
    pictures: Option<PathBuf>,
    /// `libero`, `primitives`, or the path of a LIBERO assets folder.
    #[arg(long, default_value = LIBERO)]
    assets: String,
    /// Only these tasks: SUITE/N, separated by commas.
    #[arg(long, value_delimiter = ',')]
    tasks: Vec<String>,
    /// Renderer: `software`, or `gl` for MuJoCo's renderer through OpenGL,
    /// `gl:N` on the N-th device, from 0.
    #[arg(long, default_value_t)]
    renderer: Renderer,
    /// The reference was recorded on this machine: frames must equal it bit for bit, not only
    /// within bounds. Only with `--renderer gl` or `gl:N`.
    #[arg(long)]
    frames_of_this_machine: bool,
    /// Folder with the unpacked packages of robosuite and LIBERO.
    #[arg(long)]
    sources: Option<PathBuf>,
}

fn main() -> ExitCode {
    match run(&Arguments::parse()) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("error: failed to {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: &Arguments) -> Result<bool> {
    ensure!(
        !arguments.frames_of_this_machine || arguments.renderer != Renderer::Software,
        "compare frames bit for bit: the reference was drawn by OpenGL, so --frames-of-this-machine \
         takes --renderer gl or gl:N"
    );
    let sources = arguments.sources.clone().unwrap_or_else(Sources::default_dir);
    let sources = Sources::open(&sources)?;
    let Some(reference) = &arguments.reference else {
        return family(arguments, sources);
    };
    let tasks = select(find_tasks(reference, arguments.overlay.as_deref())?, &arguments.tasks)?;
    let references = tasks.iter().map(|task| task.id().parse());
    let references = references.collect::<Result<Vec<TaskRef>, _>>()?;
    let pack = open_pack(&arguments.assets, &sources, references)?.with_look(arguments.look);
    let drawer = Drawer::open(arguments.renderer)?;
    let version = sim::mujoco::version();
    println!("MuJoCo {version}, drawn by {}, look {}", drawer.name(), arguments.look);
    let limits =
        Limits::new(RendererRelation::for_drawer(&drawer, arguments.frames_of_this_machine));
    println!(
        "frames: at least {} % of pixels equal and {} % within {CLOSE_LEVELS} levels, compared with {}",
        limits.frames.equal * 100.0,
        limits.frames.close * 100.0,
        limits.frames.relation
    );
    println!("{HEADER}");
    let (mut passed, mut multiples) = (0, Vec::new());
    for task in &tasks {
        match compare(task, &sources, &pack, &drawer) {
            Ok(findings) => {
                let violations = findings.violations(&limits);
                println!("{}", row(task, &findings, violations.is_empty()));
                for violation in &violations {
                    println!("    {violation}");
                }
                passed += usize::from(violations.is_empty());
                multiples.extend(findings.contact.and_then(|contact| contact.sensitivities));
            }
            Err(error) => println!("{:<18} failed to {error:#}", task.id()),
        }
    }
    if let Some(multiple) = multiples.iter().copied().reduce(f64::max) {
        println!(
            "contact-rich steps: within {multiple:.1} times the original's own sensitivity to \
             rounding ({} of {} tasks; in the other tasks the original has none, or it was not \
             measured)",
            multiples.len(),
            tasks.len()
        );
    }
    println!("{passed} of {} tasks agree with the original", tasks.len());
    Ok(passed == tasks.len())
}

/// Prints the table that docs/dev/FIDELITY.md summarises.
fn family(arguments: &Arguments, sources: Sources) -> Result<bool> {
    let pack = open_pack(&arguments.assets, &sources, TaskRef::all())?.with_look(arguments.look);
    let pictures = arguments.pictures.as_deref();
    let pictures = pictures.unwrap_or(Path::new(RECORDED));
    let mut comparison = Comparison::new(sources, pack, pictures)?;
    let (mut table, mut agree) = (Table::default(), true);
    for benchmark in Benchmark::ALL {
        for recording in recordings(benchmark)? {
            match comparison.compare(benchmark, &recording)? {
                Ok(findings) => {
                    table.add(benchmark, recording.is_held_out, &findings);
                    for violation in findings.violations() {
                        println!("{}: {violation}", recording.name);
                        agree = false;
                    }
                }
                Err(skipped) => println!("skipped {}: {}", recording.name, skipped.0),
            }
        }
    }
    print!("{table}");
    Ok(agree)
}

fn select(all: Vec<ReferenceTask>, wanted: &[String]) -> Result<Vec<ReferenceTask>> {
    if wanted.is_empty() {
        return Ok(all);
    }
    let find = |id: &String| {
        let task = all.iter().find(|task| task.id() == *id).cloned();
        task.with_context(|| format!("find task {id} in the reference: it has no such folder"))
    };
    wanted.iter().map(find).collect()
}

/// Heads of the columns that [`row`] fills. `names`: `same` if all names of the model are equal.
/// `arrays`: largest relative difference of the model's arrays. `settle`, `smooth`, `contact`:
/// largest differences of joint positions, m or rad. `obs.`: largest difference of a reading, in
/// its own unit. `predicates`: number of equal truth values, and number of all. `frames`,
/// `within 2`: smallest shares of a frame's pixels that are equal, and that differ by at most two
/// grey levels. `largest`: largest difference of a channel, grey levels. The last column, without a
/// head, is `ok` if all limits hold, else `NO`.
const HEADER: &str = "task              names arrays settle smooth contact obs.   predicates frames   within 2  largest";

fn row(task: &ReferenceTask, findings: &Findings, agrees: bool) -> String {
    let contact = findings.contact.map_or("-".to_owned(), |contact| short(contact.worst));
    let frames = findings.frames.as_ref().map_or("-".to_owned(), |frames| {
        format!("{} {} {:<7}", percent(&frames.equal), percent(&frames.close), frames.largest)
    });
    let (differ, all) = findings.predicates;
    format!(
        "{:<17} {:<5} {:<6} {:<6} {:<6} {:<7} {:<6} {:<10} {} {}",
        task.id(),
        if findings.name.is_none() { "same" } else { "DIFF" },
        short(findings.arrays.value),
        short(findings.settled.value),
        short(findings.smooth.value),
        contact,
        short(findings.observed.value),
        if all == 0 { "-".to_owned() } else { format!("{}/{all}", all - differ) },
        frames,
        if agrees { "ok" } else { "NO" },
    )
}

fn percent(least: &Least) -> String {
    format!("{:<8}", format!("{:.3}%", least.percent()))
}

fn short(value: f64) -> String {
    if value == 0.0 { "0".to_owned() } else { format!("{value:.0e}") }
}
