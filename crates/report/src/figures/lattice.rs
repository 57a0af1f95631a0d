//! Lattice diagram of one configuration under every subset of the axes: the nominal
//! rollout on top, all axes at the bottom, a line for each added axis.

use std::collections::BTreeMap;

use benchmark::{Axis, AxisSet, RolloutId};
use maud::{Markup, html};
use paired::adaptive::subsets::{Explanation, SubsetOutcome, Verdict};

use super::Figure;
use super::svg::{HEAD, WIDE, diamond, line, number, square, text};

const LABEL_WIDTH: f64 = 64.0;
const LAYER_HEIGHT: f64 = 76.0;
const LEGEND_HEIGHT: f64 = 86.0;
/// Radius of the ring around a minimal subset.
const RING_RADIUS: f64 = 11.0;
/// Distance from a node to the words below it.
const LABEL_DISTANCE: f64 = 26.0;

/// Maps a subset of the axes to the URL of its rollout.
pub type SubsetLink<'a> = &'a dyn Fn(AxisSet) -> Option<String>;

/// Draws the lattice of a configuration, identified by its simultaneous rollout, in a
/// campaign of the axes `full`. With an explanation, minimal subsets have a ring.
pub fn lattice(
    configuration: RolloutId,
    full: AxisSet,
    outcomes: &[SubsetOutcome],
    explanation: Option<&Explanation>,
    link: SubsetLink,
) -> Figure {
    let verdicts: BTreeMap<AxisSet, Verdict> =
        outcomes.iter().map(|outcome| (outcome.set, outcome.verdict)).collect();
    let answers = explanation.map_or(&[][..], |explanation| explanation.answers.as_slice());
    let minimal: Vec<AxisSet> = answers
        .iter()
        .flat_map(|answer| answer.minimal.iter().map(|minimal| minimal.set))
        .collect();
    let subsets = full.subsets();
    let places = places(full, &subsets);
    let bottom = HEAD + LAYER_HEIGHT * (full.len() + 1) as f64;
    let with_outcome = verdicts.values().filter(|verdict| verdict.success().is_some()).count();
    let node = |set: AxisSet| {
        let verdict = verdicts.get(&set).copied().unwrap_or(Verdict::NotRun);
        let is_minimal = minimal.contains(&set);
        let content = node(set, full, verdict, is_minimal, places[&set]);
        html! {
            @match link(set) {
                Some(address) => a href=(address) { (content) },
                None => g { (content) },
            }
        }
    };
    let body = html! {
        (text(0.0, 15.0, "head", "Every subset of the axes"))
        (text(WIDE, 15.0, "small muted end",
            &format!("{with_outcome} of {} subsets have an outcome", subsets.len())))
        @for size in 0..=full.len() {
            @let y = HEAD + LAYER_HEIGHT * (size as f64 + 0.5);
            @let words = match size { 1 => "1 axis".to_owned(), size => format!("{size} axes") };
            (text(0.0, y + 4.0, "small muted", &words))
        }
        @for (&set, &[x, y]) in &places {
            @for axis in full.without(set).axes() {
                (line("edge", [x, y], places[&set.union(AxisSet::of(axis))]))
            }
        }
        @for set in &subsets { (node(*set)) }
        (legend(bottom + 12.0, !minimal.is_empty()))
    };
    let title = format!("{configuration}: outcomes under every subset of the axes");
    let name = format!("lattice-{configuration}");
    let mut figure = Figure::new(&name, title, bottom + LEGEND_HEIGHT, body).wide();
    figure.has_links = true;
    figure
}

/// Returns the position of each subset: one centred row per number of axes.
fn places(full: AxisSet, subsets: &[AxisSet]) -> BTreeMap<AxisSet, [f64; 2]> {
    let mut places = BTreeMap::new();
    for size in 0..=full.len() {
        let layer = || subsets.iter().filter(|set| set.len() == size);
        let step = (WIDE - LABEL_WIDTH) / layer().count() as f64;
        let y = HEAD + LAYER_HEIGHT * (size as f64 + 0.5);
        for (place, set) in layer().enumerate() {
            places.insert(*set, [LABEL_WIDTH + step * (place as f64 + 0.5), y]);
        }
    }
    places
}

fn node(set: AxisSet, full: AxisSet, verdict: Verdict, is_minimal: bool, at: [f64; 2]) -> Markup {
    let [x, y] = at;
    let ring = if is_minimal { "; minimal" } else { "" };
    html! {
        title { (name(set, full)) ": " (describe(verdict)) (ring) }
        @if is_minimal {
            circle class="ring" cx=(number(x)) cy=(number(y)) r=(number(RING_RADIUS)) {}
        }
        (shape(verdict, at))
        (text(x, y + LABEL_DISTANCE, "tiny middle", &label(set, full)))
    }
}

/// Draws a node, whose shape and colour show the verdict.
fn shape(verdict: Verdict, [x, y]: [f64; 2]) -> Markup {
    let circle = |class: &str, radius: f64| {
        html! { circle class=(class) cx=(number(x)) cy=(number(y)) r=(number(radius)) {} }
    };
    match verdict {
        Verdict::Success => circle("succeeds", 6.0),
        Verdict::Failure => square(x, y, "fails"),
        Verdict::Quarantined | Verdict::Undecided => diamond(x, y, "aside"),
        Verdict::NotRun | Verdict::Pending | Verdict::Short { .. } => circle("not-run", 4.0),
    }
}

fn describe(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Success => "succeeds",
        Verdict::Failure => "fails",
        Verdict::Quarantined => "in quarantine",
        Verdict::Undecided => "undecided",
        Verdict::NotRun => "not run",
        Verdict::Pending | Verdict::Short { .. } => "waits for rollouts",
    }
}

fn name(set: AxisSet, full: AxisSet) -> &'static str {
    match set.is_empty() {
        true => "nominal",
        false if set == full => "simultaneous",
        false => set.name(),
    }
}

/// Returns the label below a node: `nominal`, `simultaneous`, the single axis, `all but` the absent
/// axis, or two letters for each axis.
fn label(set: AxisSet, full: AxisSet) -> String {
    match set.len() {
        1 => name(set, full).to_owned(),
        _ if set.is_empty() || set == full => name(set, full).to_owned(),
        _ if full.len() - set.len() == 1 => format!("all but {}", full.without(set)),
        _ => set.axes().map(abbreviation).collect(),
    }
}

fn abbreviation(axis: Axis) -> String {
    let [first, second] = [0, 1].map(|letter| &axis.name()[letter..=letter]);
    first.to_uppercase() + second
}

fn legend(top: f64, has_minimal: bool) -> Markup {
    let entries = [
        (Verdict::Success, "succeeds"),
        (Verdict::Failure, "fails"),
        (Verdict::NotRun, "not run, or waits for rollouts"),
        (Verdict::Quarantined, "quarantined or undecided"),
    ];
    let names = Axis::ALL.map(|axis| format!("{} {axis}", abbreviation(axis)));
    html! {
        @for (index, (verdict, meaning)) in entries.into_iter().enumerate() {
            @let x = LABEL_WIDTH + [0.0, 120.0, 220.0, 440.0][index];
            (shape(verdict, [x + 6.0, top + 5.0]))
            (text(x + 20.0, top + 9.0, "small", meaning))
        }
        @if has_minimal {
            circle class="ring" cx=(number(LABEL_WIDTH + 6.0)) cy=(number(top + 58.0))
                r=(number(RING_RADIUS)) {}
            (text(LABEL_WIDTH + 24.0, top + 62.0, "small",
                "minimal: it changes the outcome, and no smaller subset that was run does"))
        }
        (text(LABEL_WIDTH, top + 34.0, "small muted", &names.join(", ")))
    }
}
