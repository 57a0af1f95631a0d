//! How fast our renderer draws, and how well it agrees with OpenGL's: both draw
//! the same scenes in turn in one process. `cargo xtask bench draw` calls it.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result};
use clap::Parser;
use protocol::{Realisation, TaskRef};
use scene::{AssetPack, Sources};
use sim::{Frame, GlDevice, Renderer, Simulator, SimulatorConfig};
use tests::motion::smooth_action;

/// Draw scenes by our renderer and by OpenGL, in turn.
#[derive(Parser)]
struct Arguments {
    /// Tasks: SUITE/N, separated by commas.
    #[arg(
        long,
        value_delimiter = ',',
        default_value = "libero_goal/8,libero_object/2,libero_spatial/0,libero_10/0"
    )]
    tasks: Vec<TaskRef>,
    /// `primitives`, or a LIBERO assets folder.
    #[arg(long, default_value = "primitives")]
    assets: String,
    /// Conditions: `clean`, or such as camera/L3/c07.
    #[arg(long, value_delimiter = ',', default_value = "clean/i00")]
    conditions: Vec<String>,
    /// Frames of each camera, a control step apart.
    #[arg(long, default_value_t = 10)]
    frames: usize,
    /// Side of a frame, pixels.
    #[arg(long, default_value_t = 256)]
    size: u32,
    /// Leaves OpenGL out, and only times.
    #[arg(long)]
    alone: bool,
    /// A folder for the frames that differ most, with their differences.
    #[arg(long)]
    output: Option<PathBuf>,
    /// Folder with the unpacked sources.
    #[arg(long)]
    sources: Option<PathBuf>,
}

const CAMERAS: [&str; 2] = ["agentview", "robot0_eye_in_hand"];

/// What came of one camera of one scene.
#[derive(Default)]
struct Findings {
    ours: Vec<f64>,
    theirs: Vec<f64>,
    equal: f64,
    within_two: f64,
    largest: u8,
    pixels: f64,
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    println!(
        "{:<18} {:<20} {:<8} {:>9} {:>9} {:>8} {:>7} {:>7} {:>6}",
        "task", "condition", "camera", "equal %", "within 2", "largest", "ours", "OpenGL", "ratio"
    );
    for task in &arguments.tasks {
        for condition in &arguments.conditions {
            draw_task(*task, condition, &arguments)
                .with_context(|| format!("draw {task} {condition}"))?;
        }
    }
    Ok(())
}

fn simulator(arguments: &Arguments, renderer: Renderer) -> Result<Simulator> {
    let dir = arguments.sources.clone();
    let sources = Sources::open(&dir.unwrap_or_else(Sources::default_dir))?;
    Ok(Simulator::new(SimulatorConfig {
        pack: AssetPack::open(&arguments.assets, &sources)?,
        sources,
        renderer,
        cached_scenes: 1,
    }))
}

fn draw_task(task: TaskRef, condition: &str, arguments: &Arguments) -> Result<()> {
    let id = format!(
        "{}/t{}/{condition}",
        task.suite().short_name(),
        task.index()
    );
    let row = worker::single::row_of(id.parse()?)?;
    let mut ours = simulator(arguments, Renderer::Software)?;
    let mut theirs = simulator(arguments, Renderer::Gl(GlDevice::Auto))?;
    let mut ours = ours.begin(&row, Realisation::Matched)?;
    let mut theirs = match arguments.alone {
        true => None,
        false => Some(theirs.begin(&row, Realisation::Matched)?),
    };
    ours.settle()?;
    if let Some(theirs) = &mut theirs {
        theirs.settle()?;
    }
    let mut findings: [Findings; 2] = Default::default();
    let size = arguments.size;
    for frame in 0..=arguments.frames {
        for (camera, findings) in CAMERAS.iter().zip(&mut findings) {
            let (millis, own) = timed(|| ours.photograph(camera, size, size));
            let own = own?;
            // The first one prepares meshes and textures.
            if frame > 0 {
                findings.ours.push(millis);
            }
            let Some(theirs) = &mut theirs else { continue };
            let (millis, other) = timed(|| theirs.photograph(camera, size, size));
            if frame > 0 {
                findings.theirs.push(millis);
            }
            let other = other?;
            findings.compare(&own, &other);
            if let Some(folder) = arguments.output.as_deref().filter(|_| frame == 0) {
                let name = format!("{}_{}_{camera}", id.replace('/', "_"), frame);
                save(folder, &name, &own, &other)?;
            }
        }
        let action = smooth_action(frame);
        ours.step(&action)?;
        if let Some(theirs) = &mut theirs {
            theirs.step(&action)?;
        }
    }
    for (camera, findings) in CAMERAS.iter().zip(&mut findings) {
        let (ours, theirs) = (median(&mut findings.ours), median(&mut findings.theirs));
        println!(
            "{:<18} {:<20} {:<8} {:>9.4} {:>9.4} {:>8} {:>7.2} {:>7.2} {:>6.2}",
            task.to_string(),
            condition,
            camera.split('_').next_back().unwrap_or(camera),
            findings.equal / findings.pixels * 100.0,
            findings.within_two / findings.pixels * 100.0,
            findings.largest,
            ours,
            theirs,
            theirs / ours,
        );
    }
    Ok(())
}

impl Findings {
    fn compare(&mut self, ours: &Frame, theirs: &Frame) {
        for (a, b) in ours.rgb.chunks_exact(3).zip(theirs.rgb.chunks_exact(3)) {
            let difference = a.iter().zip(b).map(|(a, b)| a.abs_diff(*b)).max();
            let difference = difference.unwrap_or(0);
            self.equal += f64::from(u8::from(difference == 0));
            self.within_two += f64::from(u8::from(difference <= 2));
            self.largest = self.largest.max(difference);
            self.pixels += 1.0;
        }
    }
}

/// Both frames and where they differ, brightened, side by side.
fn save(folder: &Path, name: &str, ours: &Frame, theirs: &Frame) -> Result<()> {
    std::fs::create_dir_all(folder)?;
    let (width, height) = (ours.width, ours.height);
    let mut picture = image::RgbImage::new(width * 3, height);
    for y in 0..height {
        for x in 0..width {
            let at = (((height - 1 - y) * width + x) * 3) as usize;
            let (a, b) = (&ours.rgb[at..at + 3], &theirs.rgb[at..at + 3]);
            let off: [u8; 3] =
                std::array::from_fn(|channel| a[channel].abs_diff(b[channel]).saturating_mul(50));
            picture.put_pixel(x, y, image::Rgb([a[0], a[1], a[2]]));
            picture.put_pixel(width + x, y, image::Rgb([b[0], b[1], b[2]]));
            picture.put_pixel(2 * width + x, y, image::Rgb(off));
        }
    }
    picture.save(folder.join(format!("{name}.png")))?;
    Ok(())
}

/// Milliseconds that the work took, and its result.
fn timed<T>(work: impl FnOnce() -> T) -> (f64, T) {
    let start = Instant::now();
    let result = work();
    (start.elapsed().as_secs_f64() * 1e3, result)
}

fn median(millis: &mut [f64]) -> f64 {
    millis.sort_by(f64::total_cmp);
    millis.get(millis.len() / 2).copied().unwrap_or_default()
}
