//! Card of one rollout on a configuration's page: outcome, video, perturbation, failed attempts and
//! provenance.

use benchmark::attempt::GoalProgress;
use benchmark::{Axis, ManifestRow, RolloutId, seeds};
use maud::{Markup, html};
use queue::read::{FailureLine, ResultLine, RolloutLine};
use queue::rules::lease::FailureReason;
use terminal::counted;

use super::layout::breakable;
use super::trace::Path;
use crate::words::{duration_text, size_text, utc_text};

/// Rollout of a configuration with its result and failed attempts.
pub(super) struct ShownRollout {
    pub(super) id: RolloutId,
    pub(super) row: ManifestRow,
    pub(super) line: RolloutLine,
    pub(super) result: Option<ResultLine>,
    pub(super) failures: Vec<FailureLine>,
    /// Positions of the hand; empty if the result has none.
    pub(super) path: Path,
}

impl ShownRollout {
    /// Returns the size of the rollout's video, bytes; `None` without a video.
    pub(super) fn video_bytes(&self) -> Option<u64> {
        let bytes = self.result.as_ref()?.video_bytes?;
        Some(bytes.unsigned_abs())
    }
}

/// Renders the card. `trace` is the plot of the hand's path, if the result has a path.
pub(super) fn card(
    campaign: &str,
    shown: &ShownRollout,
    replicate: u32,
    trace: Option<Markup>,
) -> Markup {
    let title = shown.id.condition().name();
    let (class, word, detail) = describe_state(shown);
    html! {
        article.rollout id=(shown.id.condition()) aria-label=(title) {
            h2 { (breakable(title)) }
            p.outcome {
                span class={ "badge " (class) } { (word) }
                " " (detail)
            }
            @if let Some(bytes) = shown.video_bytes() {
                (video(campaign, shown, replicate, bytes))
            }
            @if let Some(trace) = trace { (trace) }
            (perturbation_values(shown))
            @if !shown.failures.is_empty() { (failures(shown)) }
            details {
                summary { "Seeds and provenance" }
                (provenance(shown, replicate))
            }
        }
    }
}

/// Renders the shared controls of all videos on a page; hidden until `page.js` shows them.
pub(super) fn video_controls() -> Markup {
    html! {
        div.player #player hidden role="group" aria-label="All videos" {
            button #play type="button" { "Play" }
            input #scrub type="range" min="0" max="1000" value="0" step="1" aria-label="Time";
            output #time for="scrub" { "0.0 s" }
            label {
                "Speed "
                select #speed {
                    @for (rate, name) in [("0.25", "¼"), ("0.5", "½"), ("1", "1"), ("2", "2"), ("4", "4")] {
                        option value=(rate) selected[rate == "1"] { (name) "×" }
                    }
                }
            }
        }
    }
}

/// Returns CSS class, label and detail of a rollout's state.
fn describe_state(shown: &ShownRollout) -> (&'static str, &'static str, String) {
    let budget = shown.row.max_steps;
    let line = &shown.line;
    match (&shown.result, line.state.as_str()) {
        (Some(result), _) => {
            let (class, word, preposition) = match result.outcome.success {
                true => ("succeeded", "✓ success", "after"),
                false => ("failed", "✗ failure", "in"),
            };
            let steps = result.outcome.steps;
            (class, word, format!("{preposition} {steps} of {budget} control steps"))
        }
        (None, "leased") => {
            let steps = line.control_steps.unwrap_or_default();
            let detail = format!("control step {steps} of {budget}");
            ("running", "running", detail)
        }
        (None, "quarantined") => {
            let reason = shown.failures.first().map(|last| last.reason.as_str());
            let detail = match reason == Some(FailureReason::Skipped.as_str()) {
                true => "skipped by an operator".to_owned(),
                false => format!("after {}", counted(line.attempt.0.into(), "attempt")),
            };
            ("quarantined", "quarantined", detail)
        }
        (None, _) => ("empty", "waiting", String::new()),
    }
}

fn video(campaign: &str, shown: &ShownRollout, replicate: u32, bytes: u64) -> Markup {
    let address = video_address(campaign, shown.id, replicate);
    html! {
        (player(campaign, shown.id, replicate))
        p.muted.small {
            "Both cameras as a policy sees them. " a href=(address) download { "MP4" }
            ", " (size_text(bytes))
        }
    }
}

/// Renders the video element of a rollout.
pub(super) fn player(campaign: &str, id: RolloutId, replicate: u32) -> Markup {
    html! {
        video data-keep controls muted playsinline preload="auto"
            src=(video_address(campaign, id, replicate))
            aria-label={ "Video of the rollout, " (id.condition().name()) } {}
    }
}

fn video_address(campaign: &str, id: RolloutId, replicate: u32) -> String {
    format!("/campaigns/{campaign}/videos/{id}?replicate={replicate}")
}

/// Renders the execution model unless it is `wait`, the instruction if it differs from the task's,
/// and the perturbation of each axis.
fn perturbation_values(shown: &ShownRollout) -> Markup {
    let axes: Vec<Axis> = shown.row.axes().axes().collect();
    // The row's instruction is empty if only the variant's BDDL file holds it.
    let instruction = &shown.row.instruction;
    let is_different = !instruction.is_empty() && *instruction != shown.id.task().instruction();
    let values = |axis| {
        html! { ul.values { @for line in shown.row.describe(axis) { li { (line) } } } }
    };
    html! {
        @if !shown.row.execution.is_wait() {
            p.muted { "Execution model " code { (shown.row.execution) } }
        }
        @if is_different { p.instruction { "Instruction: “" (instruction) "”" } }
        @match axes.as_slice() {
            [] if shown.id.variant().is_some() => {
                @if let Some(variant) = shown.id.variant() {
                    @match variant.benchmark() {
                        Some(benchmark) => {
                            p.muted { (benchmark) ", change " code { (variant.change()) } }
                        }
                        None => p.muted { "Suite " code { (variant.change()) } },
                    }
                }
            }
            [] => p.muted { "Nothing is perturbed." },
            [axis] => (values(*axis)),
            // Collapsed, since the cards of the single axes show the same values.
            axes => details {
                summary { (axes.len()) " axes perturbed" }
                @for axis in axes { h3 { (axis) } (values(*axis)) }
            },
        }
    }
}

/// Renders the attempts that ended without a result.
fn failures(shown: &ShownRollout) -> Markup {
    let count = shown.failures.len();
    html! {
        details {
            summary {
                (count) @if count == 1 { " attempt" } @else { " attempts" } " without a result"
            }
            ol.failures {
                @for failure in &shown.failures {
                    li value=(failure.attempt) {
                        code { (failure.reason) } ", " (utc_text(failure.failed_at)) ", "
                        code { (failure.worker_id) }
                        @if !failure.is_charged { ", not charged" }
                        pre { (failure.error) }
                    }
                }
            }
        }
    }
}

/// Renders the rollout's seeds and attempts, and the provenance of its outcome: worker, policy,
/// assets, programs and digests.
fn provenance(shown: &ShownRollout, replicate: u32) -> Markup {
    let line = &shown.line;
    let seed = seeds::rollout_seed(&shown.id);
    let attempts = format!("{}, {} charged", line.attempt, line.charged_attempts);
    let mut facts: Vec<(&str, String)> = vec![
        ("rollout", shown.id.to_string()),
        ("replicate", replicate.to_string()),
        ("initial state", shown.row.init_id.to_string()),
        ("policy seed", line.policy_seed.cast_unsigned().to_string()),
        ("rollout seed", seed.to_string()),
        ("attempts", attempts),
    ];
    if line.stale_reports > 0 {
        facts.push(("late reports", format!("{}, refused", line.stale_reports)));
    }
    if let (None, Some(worker)) = (&shown.result, &line.lease_owner) {
        facts.push(("worker", worker.to_string()));
    }
    if let Some(result) = &shown.result {
        facts.extend(result_facts(result));
    }
    html! {
        dl.facts {
            @for (name, value) in facts.iter().filter(|(_, value)| !value.is_empty()) {
                dt { (name) }
                dd { (value) }
            }
        }
    }
}

/// Describes how many goal predicates held.
fn goal(goal: GoalProgress) -> String {
    let GoalProgress { predicates, at_end, at_most } = goal;
    format!("{at_end} of {predicates} predicates held at the end, at most {at_most} at once")
}

fn result_facts(result: &ResultLine) -> Vec<(&'static str, String)> {
    let (provenance, pin) = (&result.provenance, &result.provenance.pin);
    let outcome = &result.outcome;
    let privileged = match provenance.policy_privileged {
        true => ", sees the simulator's state",
        false => "",
    };
    let residual = outcome.ik.map(|ik| format!("{:.2} mm", ik.residual_mm));
    let divergent = match result.divergences {
        0 => String::new(),
        count => format!("{count} reports of another outcome"),
    };
    let committed = utc_text(result.committed_ms);
    let pack_digest = short_digest(&pin.asset_pack_digest);
    vec![
        ("committed", format!("attempt {}, {committed}", result.number)),
        ("divergent", divergent),
        ("attempt id", result.attempt.to_string()),
        ("worker", result.worker_id.to_string()),
        ("duration", duration_text(outcome.wall_secs)),
        ("policy queries", outcome.policy_queries.to_string()),
        ("actions clipped", outcome.clipped_actions.to_string()),
        ("goal", goal(outcome.goal)),
        ("prompt", outcome.prompt.clone().unwrap_or_default()),
        ("inverse kinematics off by", residual.unwrap_or_default()),
        ("policy", format!("{}{privileged}", provenance.policy_name)),
        ("checkpoint", provenance.policy_checkpoint.clone()),
        ("checkpoint digest", provenance.policy_checkpoint_digest.clone()),
        ("policy settings", provenance.policy_settings_in_words()),
        ("batches", provenance.batch_mode.clone()),
        ("realisation", provenance.realisation.clone()),
        ("assets", format!("{} {pack_digest}", pin.asset_pack)),
        ("simulator", format!("MuJoCo {}", pin.mujoco_version)),
        ("renderer", pin.renderer.clone()),
        ("look", pin.look.to_string()),
        ("fingerprint", short_digest(&provenance.fingerprint)),
        ("machine", provenance.host.clone()),
        ("worker's program", provenance.program_version.clone()),
        ("scene", short_digest(&outcome.digests.scene)),
        ("initial state's bytes", short_digest(&outcome.digests.init_state)),
        ("first frames", short_digest(&outcome.digests.first_frame)),
    ]
}

/// Truncates a digest to its first 16 characters.
fn short_digest(digest: &str) -> String {
    match digest.is_ascii() && digest.len() > 16 {
        true => format!("{}…", &digest[..16]),
        false => digest.to_owned(),
    }
}
