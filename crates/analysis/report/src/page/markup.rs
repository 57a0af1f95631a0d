//! Markup of tables. A table wider than the page scrolls in its own box.

use std::fmt::Display;

use maud::{Markup, Render, html};
use paired::{Interval, NoInterval};

use crate::words::{points, points_interval};

/// Renders a table in a scrolling box that the keyboard reaches; empty without rows. A
/// column whose head ends with a full stop is aligned as text, every other column as numbers.
pub(crate) fn table(name: &str, heads: &[&str], rows: Vec<Vec<Markup>>) -> Markup {
    let class = |column: usize| heads[column].ends_with('.').then_some("words");
    html! {
        @if !rows.is_empty() {
            div.scroll tabindex="0" role="region" aria-label=(name) {
                table {
                    thead {
                        tr {
                            @for (column, head) in heads.iter().enumerate() {
                                th scope="col" class=[class(column)] {
                                    (head.trim_end_matches('.'))
                                }
                            }
                        }
                    }
                    tbody {
                        @for row in &rows {
                            tr {
                                th scope="row" { (row[0]) }
                                @for (column, value) in row.iter().enumerate().skip(1) {
                                    td class=[class(column)] { (value) }
                                }
                            }
                        }
                    }
                }
            }
        }
    }
}

pub(super) fn plain(value: impl Display) -> Markup {
    html! { (value.to_string()) }
}

/// Renders a value, or a dash for `None`.
pub(super) fn or_dash(value: Option<impl Render>) -> Markup {
    html! { @if let Some(value) = value { (value) } @else { span.muted { "–" } } }
}

/// Renders a value with a line of smaller type below it.
pub(super) fn with_note(value: impl Display, below: &str) -> Markup {
    html! { (value.to_string()) @if !below.is_empty() { small { (below.trim_start()) } } }
}

pub(super) fn difference(
    difference: f64,
    interval: Option<Interval>,
    reason: Option<NoInterval>,
) -> Markup {
    with_note(points(difference), &points_interval(interval, reason))
}
