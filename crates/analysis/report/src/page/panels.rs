//! Figures in a page: panels side by side if there is room.

use maud::{Markup, html};

use crate::figures::Figure;

/// Renders panels with one caption; empty without a panel.
pub(super) fn figure(caption: &str, panels: Vec<Figure>) -> Markup {
    html! {
        @if !panels.is_empty() {
            figure {
                div.panels { @for panel in &panels { (panel.inline()) } }
                figcaption { (caption) }
            }
        }
    }
}
