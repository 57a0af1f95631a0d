//! Confidence sequences of campaigns that may end early.

use libero_ctrl::Measure;
use maud::{Markup, html};

use super::findings::sentence;
use super::tables::{plain, table};
use crate::document::Document;
use crate::sequential::percent_text;

/// Renders the section; empty if no campaign may end early.
pub(super) fn section(document: &Document) -> Markup {
    let analyses = document.analyses.iter();
    let campaigns = analyses
        .filter_map(|analysis| Some((analysis.label.as_str(), analysis.sequential.as_ref()?)));
    let campaigns: Vec<_> = campaigns.collect();
    let mut heads = vec!["policy", "level", "configurations"];
    heads.extend(["S_sim %", "R_e %", "R_c %", "R_d %", "I points"]);
    let rows = campaigns.iter().flat_map(|(label, sequential)| {
        sequential.levels.iter().map(move |(level, intervals)| {
            let used = format!("{} of {}", sequential.used, sequential.configurations);
            let mut row = vec![plain(label), plain(level), plain(used)];
            let estimate_cell = |measure| {
                let [ends, estimate] = [
                    percent_text(measure, *intervals.get(&measure)?),
                    sequential.estimate_text(*level, measure),
                ];
                Some(plain(format!("{estimate} {ends}").replace('-', "−")))
            };
            let cells =
                Measure::ALL.map(|measure| estimate_cell(measure).unwrap_or_else(|| plain("–")));
            row.extend(cells);
            row
        })
    });
    html! {
        @if !campaigns.is_empty() {
            section {
                h2 { "Confidence sequences" }
                (table("Confidence sequences", &heads, rows.collect()))
                @for (label, sequential) in &campaigns {
                    p.muted { (label) ": " (sentence(&sequential.explanation())) }
                }
            }
        }
    }
}
