//! Progress bar of job counts with one segment per state, its legend and its text alternative.

use maud::{Markup, html};
use queue::read::Counts;

/// Width of a bar in SVG user units.
const WIDTH: f64 = 1_000.0;

/// Segments of a bar: CSS class, count and label.
fn segments(counts: &Counts) -> [(&'static str, u64, &'static str); 5] {
    let failed = counts.committed.saturating_sub(counts.succeeded);
    [
        ("succeeded", counts.succeeded, "succeeded"),
        ("failed", failed, "failed"),
        ("quarantined", counts.quarantined, "quarantined"),
        ("running", counts.leased, "running"),
        ("empty", counts.queued, "waiting"),
    ]
}

/// Renders a bar, whose empty part stands for waiting jobs; `description` is its text alternative.
pub(super) fn bar(counts: &Counts, description: &str) -> Markup {
    let scale = WIDTH / (counts.total().max(1) as f64);
    let mut end = 0.0;
    let placed = segments(counts).map(|(class, count, _)| {
        let (x, width) = (end, count as f64 * scale);
        end += width;
        (class, x, width)
    });
    html! {
        svg.bar role="img" aria-label=(description) viewBox="0 0 1000 10" preserveAspectRatio="none" {
            rect.empty width="1000" height="10" {}
            @for (class, x, width) in placed {
                @if width > 0.0 && class != "empty" {
                    rect class=(class) x=(format!("{x:.1}")) width=(format!("{width:.1}"))
                        height="10" {}
                }
            }
        }
    }
}

/// Renders the legend: colour, count and label of each segment.
pub(super) fn legend(counts: &Counts) -> Markup {
    html! {
        ul.legend {
            @for (class, count, label) in segments(counts) {
                li { span class={ "key " (class) } {} strong { (count) } " " (label) }
            }
        }
    }
}

/// Describes the bar for screen readers.
pub(super) fn describe(counts: &Counts) -> String {
    format!(
        "{} of {} rollouts have a result, {} of them succeeded; {} are running, {} wait, {} are \
         quarantined",
        counts.committed,
        counts.total(),
        counts.succeeded,
        counts.leased,
        counts.queued,
        counts.quarantined
    )
}
