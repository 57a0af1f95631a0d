//! Benchmark of the software renderer against OpenGL: speed and agreement of pixels.
//! The renderers draw the same scenes alternately in one process, frame by frame. Run by
//! `cargo xtask bench draw`; docs/dev/PERFORMANCE.md explains the results.

#![forbid(unsafe_code)]

use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::{Command, ExitCode};

use anyhow::{Context, Result};
use benchmark::{Realisation, RolloutId, TaskRef};
use clap::Parser;
use proto::checks::CAMERAS;
use scene::Sources;
use scene::pack::LIBERO;
use sim::{
    CameraRequest, Episode, Frame, GlDevice, ObservationRequest, Renderer, SimError, Simulator,
    SimulatorConfig,
};
use tests::fidelity::CLOSE_LEVELS;
use tests::files::open_pack;
use tests::measure::{Clock, Spread};
use worker::open_loop::smooth_action;

/// Draw scenes by our renderer and by OpenGL, in turn.
#[derive(Parser)]
struct Arguments {
    /// Tasks: SUITE/N, separated by commas, or `all` for the 40 of the protocol.
    #[arg(long, value_delimiter = ',')]
    #[arg(default_value = "libero_goal/8,libero_object/2,libero_spatial/0,libero_10/0")]
    tasks: Vec<String>,
    /// `libero`, `primitives`, or the path of a LIBERO assets folder.
    #[arg(long, default_value = LIBERO)]
    assets: String,
    /// Conditions, separated by commas, for example nominal/i00 or camera/L3/c07. Without a value:
    /// four perturbed cameras and four perturbed lights.
    #[arg(long, value_delimiter = ',', default_value = "nominal/i00", num_args = 0..=1)]
    #[arg(default_missing_value = PERTURBED)]
    conditions: Vec<String>,
    /// Frames of each camera that are timed, a control step apart.
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u16).range(1..))]
    frames: u16,
    /// Side of a frame, pixels.
    #[arg(long, default_value_t = 256)]
    size: u32,
    /// Folder with the unpacked packages of robosuite and LIBERO.
    #[arg(long)]
    sources: Option<PathBuf>,
}

/// Mild and severe perturbations of the two axes that change the appearance of a scene.
const PERTURBED: &str = "camera/L1/c00,camera/L2/c03,camera/L3/c05,camera/L3/c07,\
                         lighting/L1/c00,lighting/L2/c03,lighting/L3/c05,lighting/L3/c07";
/// Environment variable with the number of llvmpipe's rasteriser threads in addition to the
/// calling thread. Mesa reads it once, when the library is loaded.
const LLVMPIPE_THREADS: &str = "LP_NUM_THREADS";

/// Measurements of one camera of one scene.
#[derive(Default)]
struct Findings {
    /// Milliseconds of each frame, of our renderer and of OpenGL.
    ours: Vec<f64>,
    theirs: Vec<f64>,
    agreement: Agreement,
}

/// Agreement of two renderers' pixels.
#[derive(Default)]
struct Agreement {
    pixels: u64,
    equal: u64,
    /// Number of pixels that differ by at most [`CLOSE_LEVELS`].
    close: u64,
    /// Largest difference of a channel, grey levels.
    largest: u8,
}

/// Results over all scenes.
#[derive(Default)]
struct Totals {
    /// OpenGL's time over ours, each the sum of both cameras' medians, by scene.
    ratios: Vec<(f64, String)>,
    /// Smallest shares of equal and of close pixels, percent, with scene and camera.
    least_equal: Option<(f64, String)>,
    least_close: Option<(f64, String)>,
}

fn main() -> ExitCode {
    match run(&Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: failed to {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: &Arguments) -> Result<()> {
    if std::env::var_os(LLVMPIPE_THREADS).is_none_or(|threads| threads != "0") {
        return rerun_on_one_thread();
    }
    let tasks = tasks(&arguments.tasks)?;
    let rows = tasks
        .iter()
        .flat_map(|task| arguments.conditions.iter().map(move |at| (*task, at)))
        .map(|(task, condition)| row_of(task, condition))
        .collect::<Result<Vec<_>>>()?;
    let mut bench = Bench::new(arguments)?;
    println!("{}", bench.clock);
    // Median times in milliseconds, OpenGL's time over ours with its range, shares of equal pixels
    // and of pixels within [`CLOSE_LEVELS`], and the largest difference, grey levels.
    println!(
        "{:<36} {:>8} {:>8} {:>6} {:>15} {:>9} {:>9} {:>8}",
        "scene and camera", "ours", "OpenGL", "ratio", "spread", "equal %", "within 2", "largest"
    );
    for row in &rows {
        bench.draw(row, arguments).with_context(|| format!("draw {}", row.id))?;
    }
    bench.totals.print();
    Ok(())
}

/// Re-executes this program with llvmpipe restricted to the calling thread; otherwise the
/// CPU time of that thread would exclude llvmpipe's helper threads. The variable is set for a
/// new process because a process with threads must not change its own environment.
fn rerun_on_one_thread() -> Result<()> {
    let program = std::env::current_exe().context("find this program's own file")?;
    let error =
        Command::new(&program).args(std::env::args_os().skip(1)).env(LLVMPIPE_THREADS, "0").exec();
    Err(error)
        .with_context(|| format!("start {} again with {LLVMPIPE_THREADS}=0", program.display()))
}

fn tasks(names: &[String]) -> Result<Vec<TaskRef>> {
    if names == ["all"] {
        return Ok(TaskRef::all().collect());
    }
    let parse = |name: &String| -> Result<TaskRef> {
        let task = name.parse();
        task.with_context(|| format!("read task `{name}` of --tasks: SUITE/N, or `all` alone"))
    };
    names.iter().map(parse).collect()
}

fn row_of(task: TaskRef, condition: &str) -> Result<benchmark::ManifestRow> {
    let suite = task.suite().short_name();
    let id = format!("{suite}/t{}/{condition}", task.index());
    let id: RolloutId = id.parse().with_context(|| {
        format!("read condition `{condition}` of --conditions: nominal/i00, camera/L3/c07, …")
    })?;
    Ok(benchmark::row_of(id)?)
}

/// Renders a square frame of one camera, `side` pixels wide.
fn render(episode: &mut Episode<'_>, camera: &str, side: u32) -> Result<Frame, SimError> {
    let request = ObservationRequest {
        cameras: vec![CameraRequest { name: camera.to_owned(), width: side, height: side }],
        privileged: false,
    };
    Ok(episode.observe(&request)?.frames.remove(0))
}

/// Both renderers, each with its own simulator.
struct Bench {
    ours: Simulator,
    theirs: Simulator,
    clock: Clock,
    totals: Totals,
}

impl Bench {
    fn new(arguments: &Arguments) -> Result<Self> {
        let simulator = |renderer| -> Result<Simulator> {
            let dir = arguments.sources.clone();
            let sources = Sources::open(&dir.unwrap_or_else(Sources::default_dir))?;
            Ok(Simulator::new(SimulatorConfig {
                pack: open_pack(&arguments.assets, &sources, tasks(&arguments.tasks)?)?,
                sources,
                renderer,
                cached_scenes: 1,
            }))
        };
        let mut ours = simulator(Renderer::Software)?;
        let mut theirs = simulator(Renderer::Gl(GlDevice::Auto))?;
        let name = theirs.renderer_name()?;
        println!("{} against {name}", ours.renderer_name()?);
        // A GPU works while the calling thread sleeps.
        let clock = if name.contains("llvmpipe") { Clock::ThreadCpu } else { Clock::Wall };
        Ok(Self { ours, theirs, clock, totals: Totals::default() })
    }

    fn draw(&mut self, row: &benchmark::ManifestRow, arguments: &Arguments) -> Result<()> {
        let clock = self.clock;
        let mut ours = self.ours.begin(row, Realisation::Matched)?;
        let mut theirs = self.theirs.begin(row, Realisation::Matched)?;
        ours.settle()?;
        theirs.settle()?;
        let mut findings: [Findings; 2] = Default::default();
        let size = arguments.size;
        for frame in 0..=usize::from(arguments.frames) {
            for (camera, findings) in CAMERAS.iter().zip(&mut findings) {
                let draw = |episode: &mut Episode<'_>| clock.time(|| render(episode, camera, size));
                let (our_millis, our_frame) = draw(&mut ours);
                let (their_millis, their_frame) = draw(&mut theirs);
                // The first frame includes the preparation of meshes and textures.
                if frame > 0 {
                    findings.ours.push(our_millis);
                    findings.theirs.push(their_millis);
                }
                findings.agreement.add(&our_frame?, &their_frame?);
            }
            let action = smooth_action(frame);
            ours.step(&action)?;
            theirs.step(&action)?;
        }
        for (camera, findings) in CAMERAS.iter().zip(&findings) {
            let place = format!("{} {}", row.id, camera.split('_').next_back().unwrap_or(camera));
            println!("{}", self.totals.row(&place, findings)?);
        }
        self.totals.add(&row.id.to_string(), &findings);
        Ok(())
    }
}

impl Agreement {
    fn add(&mut self, ours: &Frame, theirs: &Frame) {
        for (a, b) in ours.rgb.chunks_exact(3).zip(theirs.rgb.chunks_exact(3)) {
            let difference = a.iter().zip(b).map(|(a, b)| a.abs_diff(*b)).max();
            let difference = difference.unwrap_or_default();
            self.pixels += 1;
            self.equal += u64::from(difference == 0);
            self.close += u64::from(difference <= CLOSE_LEVELS);
            self.largest = self.largest.max(difference);
        }
    }

    /// Converts a count to percent of all pixels, rounded down, so that 100 means all.
    fn percent(&self, count: u64) -> f64 {
        (count as f64 / self.pixels as f64 * 1e6).floor() / 1e4
    }
}

impl Totals {
    /// Adds one scene and camera; returns its line of the table.
    fn row(&mut self, place: &str, findings: &Findings) -> Result<String> {
        let ours = Spread::from_values(&findings.ours).context("find a timed frame")?;
        let theirs = Spread::from_values(&findings.theirs).context("find a timed frame")?;
        let pairs = findings.theirs.iter().zip(&findings.ours);
        let ratios: Vec<f64> = pairs.map(|(theirs, ours)| theirs / ours).collect();
        let ratio = Spread::from_values(&ratios).context("find a timed frame")?;
        let agreement = &findings.agreement;
        let equal = agreement.percent(agreement.equal);
        let close = agreement.percent(agreement.close);
        for (least, share) in [(&mut self.least_equal, equal), (&mut self.least_close, close)] {
            if least.as_ref().is_none_or(|(least, _)| share < *least) {
                *least = Some((share, place.to_owned()));
            }
        }
        Ok(format!(
            "{place:<36} {:>8.2} {:>8.2} {:>6.2} {:>15} {equal:>9.4} {close:>9.4} {:>8}",
            ours.median,
            theirs.median,
            ratio.median,
            format!("{:.2}–{:.2}", ratio.least, ratio.most),
            agreement.largest,
        ))
    }

    /// Adds a scene's ratio of OpenGL's time to ours, each the sum of both cameras' medians.
    fn add(&mut self, scene: &str, findings: &[Findings; 2]) {
        let sum = |times: fn(&Findings) -> &[f64]| -> Option<f64> {
            let medians =
                findings.iter().map(|findings| Some(Spread::from_values(times(findings))?.median));
            medians.sum()
        };
        if let (Some(ours), Some(theirs)) =
            (sum(|findings| &findings.ours), sum(|findings| &findings.theirs))
        {
            self.ratios.push((theirs / ours, scene.to_owned()));
        }
    }

    fn print(&self) {
        let ratios: Vec<f64> = self.ratios.iter().map(|(ratio, _)| *ratio).collect();
        let Some(spread) = Spread::from_values(&ratios) else {
            return;
        };
        let smallest = self.ratios.iter().min_by(|a, b| a.0.total_cmp(&b.0));
        let smallest = smallest.map_or("", |(_, place)| place);
        if let (Some((equal, equal_at)), Some((close, close_at))) =
            (&self.least_equal, &self.least_close)
        {
            println!(
                "agreement: at least {equal:.4} % equal ({equal_at}), at least {close:.4} % within \
                 {CLOSE_LEVELS} levels ({close_at})"
            );
        }
        println!(
            "both cameras, OpenGL's time over ours: median {:.2} over {} scenes, smallest {:.2} \
             ({smallest}), largest {:.2}",
            spread.median,
            ratios.len(),
            spread.least,
            spread.most,
        );
    }
}
