//! Findings of a comparison, and their limits.

use std::fmt;

use super::frames::{FrameFindings, FrameLimits, RendererRelation};

/// Largest allowed differences of a task's simulation from the original's.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// Model arrays, relative.
    pub arrays: f64,
    /// Joint positions after loading, settling and every smooth step, and in contact-rich steps
    /// while the original is insensitive, m or rad.
    pub smooth: f64,
    /// Observed readings, in their own units.
    pub observed: f64,
    pub frames: FrameLimits,
    /// Joint positions in contact-rich steps, in multiples of the original's own sensitivity.
    pub sensitivities: f64,
}

impl Limits {
    /// Returns the limits; only those of frames depend on the renderer and the machine.
    pub fn new(frames: RendererRelation) -> Self {
        Self {
            arrays: 1e-12,
            smooth: 1e-9,
            observed: 1e-9,
            frames: frames.limits(),
            sensitivities: 100.0,
        }
    }
}

#[derive(Debug, Clone, Default)]
pub struct Findings {
    /// The first name of the model that differs, with the original's; `None` if all names agree.
    pub name: Option<String>,
    /// Largest relative difference of a model array, with the array's name.
    pub arrays: Worst,
    /// Largest difference of joint positions after loading, and after settling, m or rad.
    pub settled: Worst,
    /// Largest difference of joint positions after any smooth step, m or rad.
    pub smooth: Worst,
    /// Largest difference of an observed reading, in its own unit.
    pub observed: Worst,
    /// Success flags that differ, over all steps.
    pub success_flags: usize,
    /// Numbers of differing and of all predicate truth values.
    pub predicates: (usize, usize),
    /// Findings about contact-rich steps; `None` without a recording of such steps.
    pub contact: Option<ContactFindings>,
    /// Findings about frames; `None` without reference frames.
    pub frames: Option<FrameFindings>,
}

/// Comparison of contact-rich steps with the original.
#[derive(Debug, Clone, Copy, Default)]
pub struct ContactFindings {
    /// Largest difference of joint positions, m or rad.
    pub worst: f64,
    /// Largest difference while the original itself is insensitive, m or rad; 0 if the sensitivity
    /// was not measured.
    pub worst_while_insensitive: f64,
    /// Largest difference in multiples of the original's sensitivity after the insensitive
    /// phase; `None` if the original stays insensitive or its sensitivity was not measured.
    pub sensitivities: Option<f64>,
    pub success_flags: usize,
}

/// The largest difference and its location.
#[derive(Debug, Clone, Default)]
pub struct Worst {
    pub value: f64,
    /// Name of the array or step.
    pub place: String,
}

impl Worst {
    pub(super) fn add(&mut self, value: f64, place: impl FnOnce() -> String) {
        if exceeds(value, self.value) {
            *self = Self { value, place: place() };
        }
    }
}

impl fmt::Display for Worst {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.value == 0.0 { f.write_str("0") } else { write!(f, "{:.0e}", self.value) }
    }
}

impl Findings {
    pub fn violations(&self, limits: &Limits) -> Vec<String> {
        let mut found = Vec::new();
        let mut check = |label: &str, worst: &Worst, limit: f64| {
            if exceeds(worst.value, limit) {
                found.push(format!("{label}: {:.3e} at {}", worst.value, worst.place));
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
            found.push(format!("{} of {} predicates differ", self.predicates.0, self.predicates.1));
        }
        if let Some(contact) = &self.contact {
            if let Some(multiple) = contact.sensitivities
                && exceeds(multiple, limits.sensitivities)
            {
                found.push(format!(
                    "contact-rich steps: {multiple:.0} × the original's sensitivity"
                ));
            }
            if exceeds(contact.worst_while_insensitive, limits.smooth) {
                found.push(format!("contact-rich steps: {:.3e}", contact.worst_while_insensitive));
            }
            if contact.success_flags > 0 {
                found.push(format!("{} contact success flags differ", contact.success_flags));
            }
        }
        if let Some(frames) = &self.frames {
            found.extend(frames.violations(&limits.frames));
        }
        found
    }
}

/// Returns true if a value exceeds a limit; NaN exceeds every limit.
fn exceeds(value: f64, limit: f64) -> bool {
    value.is_nan() || value > limit
}
