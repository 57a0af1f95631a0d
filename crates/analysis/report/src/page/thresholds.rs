//! Sections on thresholds: the survival curves of each measuring campaign and the numbers
//! of configurations behind them.

use adaptive::radii::Curve;
use maud::{Markup, html};

use super::figure;
use super::markup::{plain, table, with_note};
use crate::document::Document;
use crate::figures;
use crate::threshold_report::{Measured, ThresholdReport};
use crate::words;

/// Renders the sections of every subject that measures thresholds.
pub(super) fn sections(document: &Document) -> Markup {
    let reports = document.analyses.iter();
    let reports = reports.filter_map(|analysis| analysis.thresholds.as_ref());
    html! { @for report in reports { (section(report)) } }
}

fn section(report: &ThresholdReport) -> Markup {
    html! {
        section {
            h2 { "Thresholds" }
            p { code { (report.measured_by) } " " (report.describe_progress()) "." }
            (figure("Share of configurations that still succeed, by radius of the perturbation: a \
                configuration counts up to a radius if it succeeds nominally and at every radius \
                that was run, up to and including this one. L1, L2 and L3 are the paper's levels. \
                A configuration fails somewhere between two radii that were run: the dashed lines \
                are the smallest and the largest possible share. The diamond marks the radius at \
                which half of all configurations still succeed; the whisker is the 95 % interval \
                of this radius.",
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
            with_note(
                words::half_success(curve),
                &words::half_success_interval(&curve.half_success),
            ),
            plain(curve.nominal_fails),
            plain(curve.beyond),
            plain(curve.not_monotone),
            plain(curve.left_out),
        ]
    };
    let not_empty = curves.iter().filter(|curve| curve.n > 0);
    table("Half-success radius", &heads, not_empty.map(row).collect())
}

/// Renders the table of configurations that succeed again beyond a failure.
fn not_monotone(thresholds: &[Measured]) -> Markup {
    let heads = ["task.", "condition.", "configuration", "succeeds at.", "fails at."];
    let row = |measured: &Measured| {
        vec![
            plain(measured.task),
            plain(measured.condition.label()),
            plain(measured.config),
            plain(measured.radii(true)),
            plain(measured.radii(false)),
        ]
    };
    let not_monotone = thresholds.iter().filter(|measured| !measured.recovers_at.is_empty());
    let rows: Vec<Vec<Markup>> = not_monotone.map(row).collect();
    html! {
        @if !rows.is_empty() {
            h3 { "Not monotone: configurations that succeed again beyond a failure" }
            (table("Not monotone", &heads, rows))
        }
    }
}
