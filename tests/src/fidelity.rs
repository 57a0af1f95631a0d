//! Numerical comparison of the simulator with the original LIBERO, by the reference data of a
//! task.

mod findings;
mod frames;
mod motion;
mod reference;

use anyhow::{Context, Result, ensure};
use benchmark::presets::ENV_SEED;
use scene::{AssetPack, Problem, Sources, compose};
use sim::mujoco::{Model, ObjectKind};
use sim::{Drawer, Environment};

pub use findings::{ContactFindings, Findings, Limits, Worst};
pub use frames::{
    CLOSE_LEVELS, FrameFindings, FrameLimits, Least, RendererRelation, SAME_ARITHMETIC,
    read_upright,
};
pub use reference::{Array, ReferenceTask, find_tasks, read_npz};

pub fn compare(
    task: &ReferenceTask,
    sources: &Sources,
    pack: &AssetPack,
    drawer: &Drawer,
) -> Result<Findings> {
    let mut environment = build(task, sources, pack)?;
    let mut findings = Findings {
        name: differing_name(environment.model(), task)?,
        arrays: differing_array(environment.model(), task)?,
        ..Findings::default()
    };
    let mut frames = frames::Comparison::new(task, drawer);
    motion::compare_smooth(task, &mut environment, &mut findings, &mut frames)?;
    findings.frames = frames.result();
    motion::compare_predicates(task, &mut environment, &mut findings)?;
    findings.contact = motion::compare_contact(task, &mut environment)?;
    Ok(findings)
}

fn build(task: &ReferenceTask, sources: &Sources, pack: &AssetPack) -> Result<Environment> {
    let path = sources.dir().join("libero").join(task.bddl());
    let text =
        std::fs::read_to_string(&path).with_context(|| format!("read {}", path.display()))?;
    let problem = Problem::parse(&text).with_context(|| path.display().to_string())?;
    let scene = compose(&problem, pack, sources, ENV_SEED)?;
    Ok(Environment::new(scene, pack, sources)?)
}

fn differing_name(model: &Model, task: &ReferenceTask) -> Result<Option<String>> {
    let kinds = [
        ("bodies", ObjectKind::Body),
        ("joints", ObjectKind::Joint),
        ("geoms", ObjectKind::Geom),
        ("sites", ObjectKind::Site),
        ("cameras", ObjectKind::Camera),
        ("actuators", ObjectKind::Actuator),
        ("sensors", ObjectKind::Sensor),
        ("lights", ObjectKind::Light),
    ];
    for (key, kind) in kinds {
        let expected = task.names(key)?;
        let ours: Vec<_> = (0..model.count(kind)).map(|id| model.name(kind, id)).collect();
        if let Some(id) =
            (0..ours.len().max(expected.len())).find(|id| ours.get(*id) != expected.get(*id))
        {
            let name_at = |names: &[Option<String>]| {
                names.get(id).cloned().flatten().unwrap_or_else(|| "nothing".to_owned())
            };
            return Ok(Some(format!(
                "{key}[{id}]: {} instead of {}",
                name_at(&ours),
                name_at(&expected)
            )));
        }
    }
    Ok(None)
}

fn differing_array(model: &Model, task: &ReferenceTask) -> Result<Worst> {
    let reference = task.arrays("model_arrays.npz")?;
    let ours = model.arrays();
    let mut worst = Worst::default();
    for (name, expected) in &reference {
        // Offsets of file names in the model's string table depend on folder names.
        if name.ends_with("_pathadr") {
            continue;
        }
        let array = ours.iter().find(|array| array.name == name);
        let values = &array.with_context(|| format!("no array `{name}` in our model"))?.values;
        ensure!(
            values.len() == expected.values.len(),
            "array `{name}` has {} values instead of {}",
            values.len(),
            expected.values.len()
        );
        for (index, (ours, theirs)) in values.iter().zip(&expected.values).enumerate() {
            let scale = ours.abs().max(theirs.abs()).max(1e-300);
            let difference = if ours == theirs { 0.0 } else { (ours - theirs).abs() / scale };
            worst.add(difference, || format!("{name}[{index}]: {ours} instead of {theirs}"));
        }
    }
    Ok(worst)
}
