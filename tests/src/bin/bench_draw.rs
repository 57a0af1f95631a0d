//! Benchmark of the software renderer against OpenGL: speed and agreement of pixels.
//! The renderers draw the same scenes alternately in one process, frame by frame. Run by
//! `cargo xtask bench draw`; docs/dev/PERFORMANCE.md explains the results.

#![forbid(unsafe_code)]

use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
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
    #[arg(
        long,
        value_delimiter = ',',
        default_value = "libero_goal/8,libero_object/2,libero_spatial/0,libero_10/0"
    )]
    tasks: Vec<String>,
    /// `libero`, `primitives`, or the path of a LIBERO assets folder.
    #[arg(long, default_value = LIBERO)]
    assets: String,
    /// Conditions, separated by commas, for example nominal/i00 or camera/L3/c07. Without a value:
    /// four perturbed cameras and four perturbed lights.
    #[arg(
        long,
        value_delimiter = ',',
        default_value = "nominal/i00",
        num_args = 0..=1,
        default_missing_value = PERTURBED
    )]
    conditions: Vec<String>,
    /// Frames of each camera that are timed, a control step apart.
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u16).range(1..))]
    frames: u16,
    /// Side of a frame, pixels.
    #[arg(long, default_value_t = 256)]
    size: u32,
    /// Times our renderer alone, without OpenGL.
    #[arg(long)]
    alone: bool,
    /// A folder for the frame of each camera that differs most: ours, OpenGL's, and the difference.
    #[arg(long)]
    output: Option<PathBuf>,
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
    worst: Option<Worst>,
}

/// The frame in which the renderers differ most, as each of them draws it.
struct Worst {
    /// Number of pixels that differ by more than [`CLOSE_LEVELS`], and number of pixels that
    /// differ at all.
    differing_pixels: (usize, usize),
    ours: Frame,
    theirs: Frame,
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
    /// Growth of resident memory while our renderer draws the first frame of each camera, by
    /// scene, MiB.
    memory: Vec<f64>,
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
    if !arguments.alone && std::env::var_os(LLVMPIPE_THREADS).is_none_or(|threads| threads != "0") {
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
    println!("{}", header(arguments.alone));
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
    /// The OpenGL renderer; `None` with `--alone`.
    theirs: Option<Simulator>,
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
        let mut theirs = match arguments.alone {
            true => None,
            false => Some(simulator(Renderer::Gl(GlDevice::Auto))?),
        };
        print!("{}", ours.renderer_name()?);
        let mut clock = Clock::ThreadCpu;
        if let Some(theirs) = &mut theirs {
            let name = theirs.renderer_name()?;
            print!(" against {name}");
            if !name.contains("llvmpipe") {
                // A GPU works while the calling thread sleeps.
                clock = Clock::Wall;
            }
        }
        println!();
        Ok(Self { ours, theirs, clock, totals: Totals::default() })
    }

    fn draw(&mut self, row: &benchmark::ManifestRow, arguments: &Arguments) -> Result<()> {
        let clock = self.clock;
        let mut ours = self.ours.begin(row, Realisation::Matched)?;
        let mut theirs = match &mut self.theirs {
            None => None,
            Some(theirs) => Some(theirs.begin(row, Realisation::Matched)?),
        };
        ours.settle()?;
        if let Some(theirs) = &mut theirs {
            theirs.settle()?;
        }
        let mut findings: [Findings; 2] = Default::default();
        let mut memory = 0.0;
        let size = arguments.size;
        for frame in 0..=usize::from(arguments.frames) {
            for (camera, findings) in CAMERAS.iter().zip(&mut findings) {
                let draw = |episode: &mut Episode<'_>| clock.time(|| render(episode, camera, size));
                let before = resident()?;
                let (millis, our_frame) = draw(&mut ours);
                let our_frame = our_frame?;
                if frame == 0 {
                    memory += resident()? - before;
                }
                // The first frame includes the preparation of meshes and textures.
                if frame > 0 {
                    findings.ours.push(millis);
                }
                let Some(theirs) = &mut theirs else { continue };
                let (millis, their_frame) = draw(theirs);
                let their_frame = their_frame?;
                if frame > 0 {
                    findings.theirs.push(millis);
                }
                let differing_pixels = findings.agreement.add(&our_frame, &their_frame);
                let worst = findings.worst.as_ref();
                if worst.is_none_or(|worst| differing_pixels > worst.differing_pixels) {
                    findings.worst =
                        Some(Worst { differing_pixels, ours: our_frame, theirs: their_frame });
                }
            }
            let action = smooth_action(frame);
            ours.step(&action)?;
            if let Some(theirs) = &mut theirs {
                theirs.step(&action)?;
            }
        }
        for (camera, findings) in CAMERAS.iter().zip(&findings) {
            let place = format!("{} {}", row.id, camera.split('_').next_back().unwrap_or(camera));
            println!("{}", self.totals.row(&place, findings)?);
            if let (Some(folder), Some(worst)) = (&arguments.output, &findings.worst) {
                let name = format!("{}_{camera}", row.id.to_string().replace('/', "_"));
                save(folder, &name, &worst.ours, &worst.theirs)?;
            }
        }
        self.totals.add(&row.id.to_string(), &findings);
        self.totals.memory.push(memory);
        Ok(())
    }
}

impl Agreement {
    /// Adds a frame. Returns the number of its pixels that differ by more than
    /// [`CLOSE_LEVELS`], and the number of its pixels that differ at all.
    fn add(&mut self, ours: &Frame, theirs: &Frame) -> (usize, usize) {
        let (mut far, mut differ) = (0, 0);
        for (a, b) in ours.rgb.chunks_exact(3).zip(theirs.rgb.chunks_exact(3)) {
            let difference = a.iter().zip(b).map(|(a, b)| a.abs_diff(*b)).max();
            let difference = difference.unwrap_or_default();
            self.pixels += 1;
            self.equal += u64::from(difference == 0);
            self.close += u64::from(difference <= CLOSE_LEVELS);
            self.largest = self.largest.max(difference);
            far += usize::from(difference > CLOSE_LEVELS);
            differ += usize::from(difference > 0);
        }
        (far, differ)
    }

    /// Converts a count to percent of all pixels, rounded down, so that 100 means all.
    fn percent(&self, count: u64) -> f64 {
        (count as f64 / self.pixels as f64 * 1e6).floor() / 1e4
    }
}

/// Returns the heads of the table's columns: the median times of our renderer and of OpenGL, in
/// milliseconds; the median and the range of OpenGL's time over ours; the shares of equal pixels
/// and of pixels within [`CLOSE_LEVELS`], percent; and the largest difference, grey levels.
fn header(alone: bool) -> String {
    let ours = format!("{:<36} {:>8}", "scene and camera", "ours");
    match alone {
        true => ours,
        false => format!(
            "{ours} {:>8} {:>6} {:>15} {:>9} {:>9} {:>8}",
            "OpenGL", "ratio", "spread", "equal %", "within 2", "largest"
        ),
    }
}

impl Totals {
    /// Adds one scene and camera; returns its line of the table.
    fn row(&mut self, place: &str, findings: &Findings) -> Result<String> {
        let ours = Spread::from_values(&findings.ours).context("find a timed frame")?;
        let line = format!("{place:<36} {:>8.2}", ours.median);
        if findings.theirs.is_empty() {
            return Ok(line);
        }
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
            "{line} {:>8.2} {:>6.2} {:>15} {equal:>9.4} {close:>9.4} {:>8}",
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
        if let Some(memory) = Spread::from_values(&self.memory) {
            println!(
                "resident memory that our first frames of a scene took: median {:.1} MiB, most {:.1}",
                memory.median, memory.most
            );
        }
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

/// Returns the resident memory of this process, MiB.
fn resident() -> Result<f64> {
    let path = "/proc/self/status";
    let status = std::fs::read_to_string(path).with_context(|| format!("read {path}"))?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let kib = line.and_then(|rest| rest.split_whitespace().next());
    let kib: f64 = kib.with_context(|| format!("find VmRSS in {path}"))?.parse()?;
    Ok(kib / 1024.0)
}

/// Saves a picture of three panes: our frame, OpenGL's, and their difference times 50.
fn save(folder: &Path, name: &str, ours: &Frame, theirs: &Frame) -> Result<()> {
    std::fs::create_dir_all(folder).with_context(|| format!("make {}", folder.display()))?;
    let (width, height) = (ours.width, ours.height);
    let mut picture = image::RgbImage::new(width * 3, height);
    for y in 0..height {
        for x in 0..width {
            let at = (((height - 1 - y) * width + x) * 3) as usize;
            let (a, b) = (&ours.rgb[at..at + 3], &theirs.rgb[at..at + 3]);
            let difference: [u8; 3] =
                std::array::from_fn(|channel| a[channel].abs_diff(b[channel]).saturating_mul(50));
            picture.put_pixel(x, y, image::Rgb([a[0], a[1], a[2]]));
            picture.put_pixel(width + x, y, image::Rgb([b[0], b[1], b[2]]));
            picture.put_pixel(2 * width + x, y, image::Rgb(difference));
        }
    }
    let path = folder.join(format!("{name}.png"));
    picture.save(&path).with_context(|| format!("write {}", path.display()))
}
