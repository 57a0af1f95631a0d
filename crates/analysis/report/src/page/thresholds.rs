//! Sections on thresholds: the survival curves of each measuring campaign and the numbers
//! of configurations behind them.

use adaptive::radii::Curve;
use maud::{Markup, html};

use super::panels::figure;
use super::tables::{plain, table, with};
use crate::document::Document;
use crate::figures;
use crate::threshold_report::{Measured, ThresholdReport};
use crate::words;

/// Sections of every subject that measures thresholds.
pub(super) fn sections(document: &Document) -> Markup {
    let reports = document.analyses.iter();
    let reports = reports.filter_map(|analysis| analysis.thresholds.as_ref());
    html! { @for report in reports { (section(report)) } }
}

fn section(report: &ThresholdReport) -> Markup {
    html! {
        section {
            h2 { "How far" }
            p { code { (report.measured_by) } " " (report.progress_in_words()) "." }
            (figure("How many configurations still succeed, by how strongly they are perturbed: \
                nominally, and at every radius up to this one that was run. L1, L2 and L3 are the \
                paper's levels. A configuration fails somewhere between two radii that were run: \
                the dashed lines are the least and the most that still succeed, wherever that is. \
                The diamond is where half of all configurations still succeed, the whisker its 95 % \
                interval.",
                figures::of_thresholds(report)))
            (half_success(&report.curves))
            (not_monotone(&report.thresholds))
        }
    }
}

fn half_success(curves: &[Curve]) -> Markup {
    let heads = [
        "condition.",
        "n",
        "half still succeed at radius",
        "nominal fails",
        "beyond the largest radius",
        "not monotone",
        "left out",
    ];
    let row = |curve: &Curve| {
        vec![
            plain(curve.condition.label()),
            plain(curve.n),
            with(
                words::half_success(curve),
                &words::half_success_interval(&curve.half_success),
            ),
            plain(curve.nominal_fails),
            plain(curve.beyond),
            plain(curve.not_monotone),
            plain(curve.left_out),
        ]
    };
    let drawn = curves.iter().filter(|curve| curve.n > 0);
    table("Half-success radius", &heads, drawn.map(row).collect())
}

/// Renders the table of configurations that succeed again beyond a failure.
fn not_monotone(thresholds: &[Measured]) -> Markup {
    let heads = [
        "task.",
        "condition.",
        "configuration",
        "succeeds at.",
        "fails at.",
    ];
    let row = |measured: &Measured| {
        vec![
            plain(measured.task),
            plain(measured.condition.label()),
            plain(measured.config),
            plain(measured.radii(true)),
            plain(measured.radii(false)),
        ]
    };
    let not_monotone = thresholds
        .iter()
        .filter(|measured| !measured.recovers_at.is_empty());
    let rows: Vec<Vec<Markup>> = not_monotone.map(row).collect();
    html! {
        @if !rows.is_empty() {
            h3 { "Not monotone: they succeed again beyond a failure" }
            (table("Not monotone", &heads, rows))
        }
    }
}
