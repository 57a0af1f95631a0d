//! Renders previews of a configuration's perturbations, without a policy: a grid of axes and
//! levels, and a sheet of the ten presets of each axis except language.

mod sheet;

use std::path::{Path, PathBuf};

use benchmark::presets::PRESETS;
use benchmark::{
    ActsOn, Axis, AxisSet, Condition, Level, ManifestRow, Perturbation, Realisation, RolloutId,
    TaskRef, paraphrase, row_of,
};
use sheet::Sheet;
use sim::{CameraRequest, Episode, ObservationRequest, SimError, Simulator};

use crate::picture::Picture;

/// Control steps of the fixed motion that shows the actuation axis.
const MOTION_STEPS: usize = 40;

/// Cells per row of a sheet of presets.
const PRESETS_PER_ROW: usize = 5;
/// Side of a frame, pixels, as policies usually ask for.
const FRAME: u32 = 256;

pub struct Request {
    pub task: TaskRef,
    /// Index of the configuration, which selects preset and initial state.
    pub config: u16,
    /// Level of the sheets of presets.
    pub level: Level,
    /// Source of random elements.
    pub realisation: Realisation,
}

/// Reason why the preview failed.
#[derive(Debug, thiserror::Error)]
pub enum PreviewError {
    #[error(transparent)]
    Simulate(#[from] SimError),
    #[error("write {}: {problem}", path.display())]
    Write { path: PathBuf, problem: String },
}

/// Writes all previews into a folder, and returns their paths in order.
pub fn write(
    simulator: &mut Simulator,
    request: &Request,
    folder: &Path,
) -> Result<Vec<PathBuf>, PreviewError> {
    std::fs::create_dir_all(folder).map_err(|error| write_error(folder, &error))?;
    let mut written = Vec::new();
    let mut save = |name: String, picture: &Picture| {
        let path = folder.join(name);
        picture.save(&path).map_err(|error| write_error(&path, &error))?;
        written.push(path);
        Ok::<(), PreviewError>(())
    };
    save("grid.png".to_owned(), &grid(simulator, request)?)?;
    for axis in Axis::every().filter(|axis| !axis.def().parameters.is_empty()) {
        save(format!("presets_{axis}.png"), &presets_sheet(simulator, request, axis)?)?;
    }
    Ok(written)
}

fn write_error(path: &Path, problem: &dyn std::fmt::Display) -> PreviewError {
    PreviewError::Write { path: path.to_owned(), problem: problem.to_string() }
}

/// Renders the grid: one row for each axis alone and one for simultaneous, with a column for
/// the nominal scene and for each level. The language axis is shown as text.
fn grid(simulator: &mut Simulator, request: &Request) -> Result<Picture, PreviewError> {
    let seen = Axis::every().filter(|axis| axis.def().acts_on != ActsOn::Answers);
    let rows = seen.map(Condition::Single).chain([Condition::Simultaneous]);
    let mut sheet = Sheet::new(1 + Level::PERTURBED.len(), FRAME as usize);
    for condition in rows {
        if condition == Condition::Single(Axis::Language) {
            sheet.add_text("language: nominal", &request.task.instruction());
            for level in Level::PERTURBED {
                let words = paraphrase(request.task, level, request.config).text;
                sheet.add_text(&format!("language {level}"), &words);
            }
            continue;
        }
        let nominal = row(request.task, condition, None, request.config);
        sheet
            .add(&format!("{}: nominal", condition.name()), picture(simulator, request, &nominal)?);
        for level in Level::PERTURBED {
            let row = row(request.task, condition, Some(level), request.config);
            sheet.add(&format!("{} {level}", condition.name()), picture(simulator, request, &row)?);
        }
    }
    Ok(sheet.finish())
}

fn presets_sheet(
    simulator: &mut Simulator,
    request: &Request,
    axis: Axis,
) -> Result<Picture, PreviewError> {
    let mut sheet = Sheet::new(PRESETS_PER_ROW, FRAME as usize);
    for config in 0..PRESETS {
        let row = row(request.task, Condition::Single(axis), Some(request.level), config);
        let label = format!("{axis} {} c{config:02}", request.level);
        sheet.add(&label, picture(simulator, request, &row)?);
    }
    Ok(sheet.finish())
}

/// Renders the policy's first view in the rollout of a manifest row. Actuation shows only in motion:
/// for a condition that changes actions, the view after a fixed motion is rendered, also in the
/// nominal column, so that the pictures of a row differ in the perturbation only.
fn picture(
    simulator: &mut Simulator,
    request: &Request,
    row: &ManifestRow,
) -> Result<Picture, PreviewError> {
    let mut episode = simulator.begin(row, request.realisation)?;
    episode.settle()?;
    let changes_actions = |axis: Axis| axis.def().acts_on == ActsOn::Actions;
    if row.id.condition().axes(AxisSet::ALL).axes().any(changes_actions) {
        for step in 0..MOTION_STEPS {
            episode.step(&motion(step))?;
        }
    }
    Ok(upright_view(&mut episode)?)
}

fn upright_view(episode: &mut Episode<'_>) -> Result<Picture, SimError> {
    let camera = CameraRequest { name: "agentview".to_owned(), width: FRAME, height: FRAME };
    let request = ObservationRequest { cameras: vec![camera], privileged: false };
    let frame = episode.observe(&request)?.frames.remove(0);
    Ok(Picture::upright(&frame))
}

/// Returns a condition's row. Without a level the row is unperturbed, but has the initial state and
/// id of the perturbed row at L1, so that only the perturbation differs.
fn row(task: TaskRef, condition: Condition, level: Option<Level>, config: u16) -> ManifestRow {
    let id = RolloutId::perturbed(task, condition, level.unwrap_or(Level::L1), config)
        .expect("a perturbed condition at a level");
    let row = row_of(id).expect("a row of the protocol");
    match level {
        Some(_) => row,
        None => ManifestRow { perturbation: Perturbation::default(), ..row },
    }
}

/// Returns the action of a step in a descending circle, which shows gain, bias and misalignment.
fn motion(step: usize) -> [f64; 7] {
    let phase = std::f64::consts::TAU * step as f64 / MOTION_STEPS as f64;
    [0.5 * phase.cos(), 0.5 * phase.sin(), -0.25, 0.0, 0.0, 0.1, -1.0]
}
