//! Average time of a campaign's rollouts by phase, and its bottleneck, in two lines.

use maud::{Markup, html};
use proto::coordinator::ForecastResponse;

use crate::forecast::{bottleneck, parts};

/// Renders the lines; empty until a result reports its time by phase. The bottleneck is left out if
/// `is_over`.
pub(super) fn speed(pace: &ForecastResponse, is_over: bool) -> Markup {
    let bound = |speed| bottleneck(speed, pace.slots).filter(|_| !is_over);
    html! {
        @if let Some(speed) = &pace.speed {
            p.spent {
                (sentence(&parts(speed)))
                @if let Some(bound) = bound(speed) { br; (sentence(&bound)) }
            }
        }
    }
}

/// Capitalizes the first letter and appends a full stop.
fn sentence(words: &str) -> String {
    let mut letters = words.chars();
    let first = letters
        .next()
        .map(|letter| letter.to_uppercase().to_string());
    format!("{}{}.", first.unwrap_or_default(), letters.as_str())
}
