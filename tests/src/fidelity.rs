//! The simulator against the original: everything that the reference data of a
//! task shows, compared in numbers. Only measures; what is good enough is
//! [`Limits`].

mod frames;
mod motion;
mod reference;

use std::fmt;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use protocol::presets::ENV_SEED;
use scene::{AssetPack, Problem, Sources, compose};
use sim::mujoco::{Model, ObjectKind};
use sim::{Drawer, Environment};

pub use frames::{CLOSE_LEVELS, FrameFindings, FrameLimits, Kinship, Least};
pub use reference::{Array, ReferenceTask, find_tasks, read_npz};

/// How far a task's simulation may be from the original's.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// Model arrays, relative.
    pub arrays: f64,
    /// Joint positions after every smooth step, m or rad.
    pub smooth: f64,
    /// Observed readings, m or rad.
    pub observed: f64,
    /// Frames.
    pub frames: FrameLimits,
    /// Contact-rich steps, in multiples of the original's own sensitivity.
    pub sensitivities: f64,
}

impl Limits {
    /// Everything but the frames is the same on every machine.
    pub fn new(frames: Kinship) -> Self {
        Self {
            arrays: 1e-12,
            smooth: 1e-9,
            observed: 1e-9,
            frames: frames.limits(),
            sensitivities: 100.0,
        }
    }
}

/// What was found for one task.
#[derive(Debug, Clone, Default)]
pub struct Findings {
    /// The first name that differs, if any: ours and the original's.
    pub name: Option<String>,
    /// Largest relative difference of a model array, and which.
    pub arrays: Worst,
    /// Largest difference of joint positions after loading and settling.
    pub settled: Worst,
    /// Largest difference of joint positions after the smooth steps.
    pub smooth: Worst,
    /// Largest difference of observed readings.
    pub observed: Worst,
    /// Success flags that differ, over all steps.
    pub success_flags: usize,
    /// Predicate truths: those that differ, and all.
    pub predicates: (usize, usize),
    /// Contact-rich steps; none where there is no recording.
    pub contact: Option<ContactFindings>,
    /// Frames; none where there are none to compare with.
    pub frames: Option<FrameFindings>,
}

/// Contact-rich steps against the original.
#[derive(Debug, Clone, Copy, Default)]
pub struct ContactFindings {
    /// Largest difference of joint positions.
    pub worst: f64,
    /// The same while the original itself is insensitive; 0 where that was not
    /// measured.
    pub worst_while_calm: f64,
    /// Largest difference in multiples of the original's sensitivity once it is
    /// not calm any more; none where that was not measured.
    pub sensitivities: Option<f64>,
    /// Success flags that differ.
    pub success_flags: usize,
}

/// A largest difference and where it was.
#[derive(Debug, Clone, Default)]
pub struct Worst {
    /// The difference.
    pub value: f64,
    /// Where.
    pub place: String,
}

impl Worst {
    pub(crate) fn see(&mut self, value: f64, place: impl FnOnce() -> String) {
        if exceeds(value, self.value) {
            *self = Self {
                value,
                place: place(),
            };
        }
    }
}

impl fmt::Display for Worst {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.value == 0.0 {
            f.write_str("0")
        } else {
            write!(f, "{:.0e}", self.value)
        }
    }
}

impl Findings {
    /// What exceeds the limits, in words; empty if nothing does.
    pub fn violations(&self, limits: &Limits) -> Vec<String> {
        let mut found = Vec::new();
        let mut check = |what: &str, worst: &Worst, limit: f64| {
            if exceeds(worst.value, limit) {
                found.push(format!("{what}: {:.3e} at {}", worst.value, worst.place));
            }
        };
        check("model arrays", &self.arrays, limits.arrays);
        check("settling", &self.settled, limits.smooth);
        check("smooth steps", &self.smooth, limits.smooth);
        check("observations", &self.observed, limits.observed);
        found.extend(self.name.iter().map(|name| format!("names: {name}")));
        if self.success_flags > 0 {
            found.push(format!("{} success flags differ", self.success_flags));
        }
        if self.predicates.0 > 0 {
            found.push(format!(
                "{} of {} predicates differ",
                self.predicates.0, self.predicates.1
            ));
        }
        if let Some(contact) = &self.contact {
            if let Some(multiple) = contact.sensitivities
                && exceeds(multiple, limits.sensitivities)
            {
                found.push(format!(
                    "contact-rich steps: {multiple:.0} × the original's sensitivity"
                ));
            }
            if exceeds(contact.worst_while_calm, limits.smooth) {
                found.push(format!(
                    "contact-rich steps: {:.3e}",
                    contact.worst_while_calm
                ));
            }
            if contact.success_flags > 0 {
                found.push(format!(
                    "{} contact success flags differ",
                    contact.success_flags
                ));
            }
        }
        if let Some(frames) = &self.frames {
            found.extend(frames.violations(&limits.frames));
        }
        found
    }
}

/// A difference that is no number exceeds every limit.
fn exceeds(value: f64, limit: f64) -> bool {
    value.is_nan() || value > limit
}

/// Compares one task.
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
        let ours: Vec<_> = (0..model.count(kind))
            .map(|id| model.name(kind, id))
            .collect();
        if let Some(id) =
            (0..ours.len().max(expected.len())).find(|id| ours.get(*id) != expected.get(*id))
        {
            let show = |names: &[Option<String>]| {
                names
                    .get(id)
                    .cloned()
                    .flatten()
                    .unwrap_or_else(|| "nothing".to_owned())
            };
            return Ok(Some(format!(
                "{key}[{id}]: {} for {}",
                show(&ours),
                show(&expected)
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
        // Where file names start in the model's text: a matter of folders.
        if name.ends_with("_pathadr") {
            continue;
        }
        let array = ours.iter().find(|array| array.name == name);
        let values = &array
            .with_context(|| format!("no array `{name}` in our model"))?
            .values;
        ensure!(
            values.len() == expected.values.len(),
            "array `{name}` has {} values for {}",
            values.len(),
            expected.values.len()
        );
        for (index, (ours, theirs)) in values.iter().zip(&expected.values).enumerate() {
            let scale = ours.abs().max(theirs.abs()).max(1e-300);
            let difference = if ours == theirs {
                0.0
            } else {
                (ours - theirs).abs() / scale
            };
            worst.see(difference, || {
                format!("{name}[{index}]: {ours} for {theirs}")
            });
        }
    }
    Ok(worst)
}

/// Whether a folder holds reference tasks at all.
pub fn ensure_reference(dir: &Path) -> Result<()> {
    ensure!(
        dir.is_dir(),
        "read the reference {}: no such folder; --reference takes the folder that holds \
         SUITE/NN_TASK folders",
        dir.display()
    );
    Ok(())
}
