//! Tables of a campaign of LIBERO's family. A full stop at the end of a head is not shown: it makes
//! [`table`] align the column as text.

use maud::{Markup, html};

use super::tables::table;
use crate::family::Family;

/// Renders the tables as sections of a page.
pub(super) fn sections(family: &Family) -> Markup {
    let lines = family.lines(true);
    let losses = lines.iter().map(|line| markup(&line.losses())).collect();
    let successes = family.success_lines(true).into_iter();
    let successes = successes.map(|line| markup(&line.counts())).collect();
    let pride = family.pride_cells().map(|cells| markup(&cells)).collect();
    html! {
        section {
            @match family.is_paired {
                true => h2 { (family.benchmark) " under protocol " (family.protocol) },
                false => h2 { "Suite file " (family.protocol) },
            }
            @for sentence in family.caveats() { p { (sentence) } }
            (table(
                "Successes",
                &["variants.", "rollouts", "successes", "percent", "95 % interval"],
                successes,
            ))
        }
        @if !family.pride.is_empty() {
            section {
                h2 { "PRIDE" }
                (table("PRIDE", &["weight.", "percent", "95 % interval"], pride))
            }
        }
        section {
            @if family.is_paired {
                h2 { "Comparison with the unperturbed rollouts" }
                (table(
                    "Losses",
                    &["variants.", "pairs", "broken", "gained", "loss", "95 % interval"],
                    losses,
                ))
            }
            @for sentence in family.legend() { p { (sentence) } }
        }
        @if let (false, [heads, rows @ ..]) =
            (family.published.is_empty(), family.published_table().as_slice())
        {
            section {
                h2 { "Comparison with the published table" }
                (table(
                    "Published",
                    &heads.iter().map(String::as_str).collect::<Vec<_>>(),
                    rows.iter().map(|row| markup(row)).collect(),
                ))
                p { (Family::published_note()) }
            }
        }
    }
}

fn markup(cells: &[String]) -> Vec<Markup> {
    cells.iter().map(|cell| html! { (cell) }).collect()
}
