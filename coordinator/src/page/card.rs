//! One rollout among its siblings: what it came to, what was perturbed, its
//! video, and where it all came from.

use maud::{Markup, html};
use protocol::{Axis, Condition, seeds};

use super::configuration::{Shown, card_title};
use super::perturbation;
use crate::store::page::OutcomeLine;
use crate::words::{duration_text, size_text, utc_text};

/// The card, with a picture of how the hand moved if there is one.
pub(super) fn card(campaign: &str, shown: &Shown, replicate: u32, trace: Option<Markup>) -> Markup {
    let title = card_title(shown.id);
    let (class, word, detail) = standing(shown);
    html! {
        article.rollout aria-label=(title) {
            h2 { (title) }
            p.outcome {
                span class={ "badge " (class) } { (word) }
                " " (detail)
            }
            @if let Some(bytes) = shown.line.video_bytes {
                (video(campaign, shown, replicate, bytes.unsigned_abs()))
            }
            @if let Some(trace) = trace { (trace) }
            (perturbed(shown))
            @if !shown.failures.is_empty() { (failures(shown)) }
            details {
                summary { "Seeds and provenance" }
                (origin(shown, replicate))
            }
        }
    }
}

/// The one control of all videos of a page; its script shows it.
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

/// Class, word and what else is to be said of how a rollout stands.
fn standing(shown: &Shown) -> (&'static str, &'static str, String) {
    let budget = shown.row.max_steps;
    match (&shown.outcome, shown.line.state.as_str()) {
        (Some(outcome), _) if outcome.success => {
            let steps = outcome.steps;
            (
                "succeeded",
                "✓ success",
                format!("after {steps} of {budget} control steps"),
            )
        }
        (Some(outcome), _) => {
            let steps = outcome.steps;
            (
                "failed",
                "✗ failure",
                format!("in {steps} of {budget} control steps"),
            )
        }
        (None, "leased") => {
            let steps = shown.line.control_steps.unwrap_or_default();
            ("running", "running", format!("control step {steps}"))
        }
        (None, "quarantined") => {
            let times = shown.line.charged_attempts;
            (
                "aside",
                "set aside",
                format!("after {times} failed attempts"),
            )
        }
        (None, _) => ("empty", "waiting", String::new()),
    }
}

fn video(campaign: &str, shown: &Shown, replicate: u32, bytes: u64) -> Markup {
    let address = format!(
        "/campaigns/{campaign}/videos/{}?replicate={replicate}",
        shown.id
    );
    html! {
        video data-keep controls muted playsinline preload="auto" src=(address)
            aria-label={ "Video of the rollout, " (card_title(shown.id)) } {}
        p.muted.small { a href=(address) download { "MP4" } ", " (size_text(bytes)) }
    }
}

/// What was perturbed, in words.
fn perturbed(shown: &Shown) -> Markup {
    let axes: Vec<Axis> = match shown.id.condition() {
        Condition::Clean => Vec::new(),
        Condition::Single(axis) => vec![axis],
        Condition::Combination => {
            let mut axes = shown.row.perturbation.axes();
            axes.extend(shown.row.variant_id.is_some().then_some(Axis::Language));
            axes
        }
    };
    let is_many = axes.len() > 1;
    let is_told = shown.row.instruction != shown.id.task().instruction();
    html! {
        @if is_told { p.instruction { "Told: “" (shown.row.instruction) "”" } }
        @if axes.is_empty() { p.muted { "Nothing is perturbed." } }
        @for axis in axes {
            @let lines = perturbation::lines(&shown.row, axis);
            @if is_many { h3 { (axis) } }
            ul.values { @for line in lines { li { (line) } } }
        }
    }
}

/// Attempts that brought no result.
fn failures(shown: &Shown) -> Markup {
    let count = shown.failures.len();
    html! {
        details {
            summary {
                (count) @if count == 1 { " attempt" } @else { " attempts" } " without a result"
            }
            ol.failures {
                @for failure in &shown.failures {
                    @let line = &failure.line;
                    li value=(line.attempt) {
                        code { (line.reason) } ", " (utc_text(line.failed_ms)) ", "
                        code { (line.worker_id) }
                        @if !line.charged { ", charged to nobody" }
                        pre { (line.error) }
                    }
                }
            }
        }
    }
}

/// Everything that the outcome came from.
fn origin(shown: &Shown, replicate: u32) -> Markup {
    let line = &shown.line;
    let seed = seeds::rollout_seed(&shown.id);
    let mut facts: Vec<(&str, String)> = vec![
        ("rollout", shown.id.to_string()),
        ("replicate", replicate.to_string()),
        ("initial state", shown.row.init_id.to_string()),
        ("policy seed", line.policy_seed.cast_unsigned().to_string()),
        ("rollout seed", seed.to_string()),
        (
            "attempts",
            format!("{}, {} charged", line.attempt, line.charged_attempts),
        ),
    ];
    if line.stale_reports > 0 {
        facts.push(("late reports", format!("{}, refused", line.stale_reports)));
    }
    if let (None, Some(worker)) = (&shown.outcome, &line.lease_owner) {
        facts.push(("worker", worker.to_string()));
    }
    if let Some(outcome) = &shown.outcome {
        facts.extend(of_outcome(outcome));
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

fn of_outcome(outcome: &OutcomeLine) -> Vec<(&'static str, String)> {
    let from = &outcome.provenance;
    let privileged = if from.policy_privileged {
        ", sees the simulator's state"
    } else {
        ""
    };
    let residual = outcome.ik_residual_mm.map(|mm| format!("{mm:.2} mm"));
    let divergent = match outcome.divergences {
        0 => String::new(),
        times => format!("{times} reports of another outcome"),
    };
    vec![
        (
            "committed",
            format!(
                "attempt {}, {}",
                outcome.attempt,
                utc_text(outcome.committed_ms)
            ),
        ),
        ("divergent", divergent),
        ("worker", outcome.worker_id.to_string()),
        ("took", duration_text(outcome.wall_secs)),
        ("policy asked", format!("{} times", outcome.policy_queries)),
        ("actions clipped", outcome.clipped_actions.to_string()),
        ("inverse kinematics off by", residual.unwrap_or_default()),
        ("policy", format!("{}{privileged}", from.policy_name)),
        ("checkpoint", from.policy_checkpoint.clone()),
        ("checkpoint digest", from.policy_checkpoint_digest.clone()),
        ("batches", from.batch_mode.clone()),
        ("realisation", from.realisation.clone()),
        (
            "assets",
            format!("{} {}", from.asset_pack, short(&from.asset_pack_digest)),
        ),
        ("simulator", format!("MuJoCo {}", from.mujoco_version)),
        ("renderer", from.renderer.clone()),
        ("fingerprint", short(&from.fingerprint)),
        ("machine", from.host.clone()),
        ("worker's program", from.program_version.clone()),
        ("scene", short(&outcome.scene_digest)),
        ("initial state's bytes", short(&outcome.init_state_digest)),
        ("perturbation", digests(&outcome.perturbation_digests)),
        ("first frames", short(&outcome.first_frame_digest)),
    ]
}

/// The first digits of a digest.
fn short(digest: &str) -> String {
    match digest.is_ascii() && digest.len() > 16 {
        true => format!("{}…", &digest[..16]),
        false => digest.to_owned(),
    }
}

/// `camera:HEX,sensor:HEX`, each shortened.
fn digests(list: &str) -> String {
    let each = list.split(',').filter_map(|entry| entry.split_once(':'));
    let each = each.map(|(axis, digest)| format!("{axis} {}", short(digest)));
    each.collect::<Vec<_>>().join(", ")
}
