//! Average time of a campaign's rollouts by phase, and its bottleneck, in two lines.

use maud::{Markup, html};
use proto::coordinator::ForecastResponse;

use crate::forecast::{bottleneck, phase_shares};

/// Renders the lines; empty without results. The bottleneck is left out if
/// the campaign is over.
pub(super) fn speed(pace: &ForecastResponse, is_over: bool) -> Markup {
    let bottleneck_text = |speed| bottleneck(speed, pace.slots).filter(|_| !is_over);
    html! {
        @if let Some(speed) = &pace.speed {
            p.spent {
                (sentence(&phase_shares(speed)))
                @if let Some(text) = bottleneck_text(speed) { br; (sentence(&text)) }
            }
        }
    }
}

/// Capitalizes the first letter and appends a full stop.
fn sentence(words: &str) -> String {
    let mut letters = words.chars();
    let first = letters.next().map(|letter| letter.to_uppercase().to_string());
    format!("{}{}.", first.unwrap_or_default(), letters.as_str())
}
