//! Time of a campaign's rollouts, and what would make them faster, in two lines.

use maud::{Markup, html};
use proto::coordinator::ForecastResponse;

use crate::forecast::{bottleneck, parts};

/// The lines; nothing before a rollout that says where its time went. `is_over`
/// once nothing is left to become faster.
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

/// Words as a sentence.
fn sentence(words: &str) -> String {
    let mut letters = words.chars();
    let first = letters
        .next()
        .map(|letter| letter.to_uppercase().to_string());
    format!("{}{}.", first.unwrap_or_default(), letters.as_str())
}
