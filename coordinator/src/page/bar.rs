//! A campaign's jobs as a bar, one piece for each state, and in words.

use maud::{Markup, html};
use queue::read::Counts;

/// Width of a bar in its own units.
const WIDTH: f64 = 1_000.0;

/// The bar of a campaign's jobs.
pub(super) fn bar(counts: &Counts) -> Markup {
    pieces(
        counts.total(),
        &[
            ("succeeded", counts.succeeded),
            ("failed", counts.committed.saturating_sub(counts.succeeded)),
            ("aside", counts.quarantined),
            ("running", counts.leased),
        ],
        &words(counts),
    )
}

/// A bar of pieces, each with its class and its length; what they leave of
/// `total` stays empty.
pub(super) fn pieces(total: u64, pieces: &[(&str, u64)], words: &str) -> Markup {
    let scale = WIDTH / (total.max(1) as f64);
    let mut x = 0.0;
    let placed: Vec<(&str, f64, f64)> = pieces
        .iter()
        .map(|&(class, length)| {
            let place = (class, x, length as f64 * scale);
            x += place.2;
            place
        })
        .collect();
    html! {
        svg.bar role="img" aria-label=(words) viewBox="0 0 1000 10" preserveAspectRatio="none" {
            rect.empty width="1000" height="10" {}
            @for (class, x, width) in placed {
                @if width > 0.0 {
                    rect class=(class) x=(format!("{x:.1}")) width=(format!("{width:.1}"))
                        height="10" {}
                }
            }
        }
    }
}

/// The counts behind the bar, with the colours' meaning.
pub(super) fn legend(counts: &Counts) -> Markup {
    let entries = [
        ("succeeded", counts.succeeded, "succeeded"),
        (
            "failed",
            counts.committed.saturating_sub(counts.succeeded),
            "failed",
        ),
        ("aside", counts.quarantined, "quarantined"),
        ("running", counts.leased, "running"),
        ("empty", counts.queued, "waiting"),
    ];
    html! {
        ul.legend {
            @for (class, count, word) in entries {
                li { span class={ "key " (class) } {} strong { (count) } " " (word) }
            }
        }
    }
}

fn words(counts: &Counts) -> String {
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
