//! Explanation of an outcome as text and as films side by side: the minimal subset of axes that
//! changes it, and the largest proper subsets that do not.

use benchmark::{AxisSet, RolloutId};
use maud::{Markup, html};
use paired::Transition;
use paired::adaptive::subsets::{Answer, Explanation, MinimalSubset};

use super::card::player;
use super::lattice_view::{LatticeView, Source};
use super::layout::breakable;

/// Rendered films and their number.
#[derive(Default)]
pub(super) struct Films {
    pub(super) markup: Markup,
    pub(super) count: usize,
}

/// Renders an answer as list items: each minimal subset, and its supersets that do not change the
/// outcome.
pub(super) fn describe_answer(answer: &Answer, transition: Transition) -> Markup {
    let (changed, unchanged) = verbs(transition);
    html! {
        @for minimal in &answer.minimal {
            li {
                @if !answer.start.is_empty() { "Under " (subset_name(answer.start)) " it fails. " }
                "Under " strong { (subset_name(minimal.set)) } " it " (changed)
                // The first sentence says already that the rollout fails under the start.
                @if answer.start.is_empty() || minimal.below != [answer.start] {
                    ", and " (unchanged) " under " (subset_names(&minimal.below))
                }
                @if minimal.is_established() {
                    ": all of these axes are needed."
                } @else {
                    @let open = minimal.open.len();
                    "; " (open) @if open == 1 { " smaller subset was" } @else { " smaller subsets were" }
                    " not run, so fewer axes might suffice."
                }
            }
        }
        @for pair in &answer.non_monotone {
            li {
                "Further axes reverse this: under " (subset_name(pair.superset)) " it " (unchanged)
                ", although under " (subset_name(pair.minimal)) " it " (changed) "."
            }
        }
    }
}

/// Renders, for each answer, the films of its smallest minimal subset, preferably of one that is
/// certainly minimal.
pub(super) fn films(lattice: &LatticeView, explanation: &Explanation) -> Films {
    let mut films = Films::default();
    let mut parts = Vec::new();
    for answer in &explanation.answers {
        let rank = |minimal: &&MinimalSubset| (!minimal.is_established(), minimal.set);
        if let Some(minimal) = answer.minimal.iter().min_by_key(rank) {
            let (count, part) = side_by_side(lattice, minimal, explanation.transition);
            films.count += count;
            parts.push(part);
        }
    }
    films.markup = html! { @for part in parts { (part) } };
    films
}

/// Rollout that shows the outcome under one subset; `is_filmed` is true if its video exists.
struct Film<'a> {
    source: &'a Source,
    id: RolloutId,
    replicate: u32,
    set: AxisSet,
    success: bool,
    is_filmed: bool,
}

fn side_by_side(
    lattice: &LatticeView,
    minimal: &MinimalSubset,
    transition: Transition,
) -> (usize, Markup) {
    let sets = [minimal.set].into_iter().chain(minimal.below.iter().copied());
    let shown: Vec<Film> = sets.filter_map(|set| find_film(lattice, set)).collect();
    let filmed: Vec<&Film> = shown.iter().filter(|film| film.is_filmed).collect();
    let is_shown = |set: &AxisSet| filmed.iter().any(|film| film.set == *set);
    let below: Vec<AxisSet> = minimal.below.iter().copied().filter(is_shown).collect();
    let (changed, unchanged) = verbs(transition);
    let markup = html! {
        h3 { "In films" }
        @if is_shown(&minimal.set) && !below.is_empty() {
            p {
                "The same initial state and the same perturbations: under " (subset_name(minimal.set))
                " it " (changed) "; beside it, under " (subset_names(&below)) ", it " (unchanged) "."
            }
        }
        @if !filmed.is_empty() { div.rollouts.films { @for film in &filmed { (card(film)) } } }
        (remedies(lattice, &shown))
    };
    (filmed.len(), markup)
}

/// Returns a rollout with the known outcome of a subset, preferably a filmed one.
fn find_film(lattice: &LatticeView, set: AxisSet) -> Option<Film<'_>> {
    let success = lattice.outcomes.verdict(set).success()?;
    let full = lattice.outcomes.full();
    let all = lattice.sources().flat_map(|source| {
        let rows = source.rollouts_under(set, full);
        rows.map(move |(id, row)| (source, id, row))
    });
    let mut matching: Vec<_> = all.filter(|(_, _, row)| row.job.success == Some(success)).collect();
    matching.sort_by_key(|(_, _, row)| (!row.is_filmed, row.job.replicate));
    let (source, id, row) = matching.into_iter().next()?;
    Some(Film { source, id, replicate: row.job.replicate, set, success, is_filmed: row.is_filmed })
}

fn card(film: &Film) -> Markup {
    let (class, word) = match film.success {
        true => ("succeeded", "✓ success"),
        false => ("failed", "✗ failure"),
    };
    let title = match film.set.is_empty() {
        true => "nominal",
        false => film.set.name(),
    };
    let campaign = film.source.campaign.name.as_str();
    html! {
        article.rollout aria-label={ "Film: " (title) } {
            h2 { (breakable(title)) }
            p.outcome { span class={ "badge " (class) } { (word) } }
            (player(campaign, film.id, film.replicate))
        }
    }
}

/// Renders the commands that produce the missing films.
fn remedies(lattice: &LatticeView, shown: &[Film]) -> Markup {
    let mut missing: Vec<&Source> = Vec::new();
    for film in shown.iter().filter(|film| !film.is_filmed) {
        let is_other = |source: &&Source| source.campaign.id != film.source.campaign.id;
        if missing.iter().all(is_other) {
            missing.push(film.source);
        }
    }
    let explains = |source: &Source| {
        let explaining = lattice.explaining.as_ref();
        explaining.is_some_and(|explaining| explaining.campaign.id == source.campaign.id)
    };
    let measured = &lattice.measured.campaign.name;
    // A single `worker film` command covers all campaigns that stored actions.
    let can_be_filmed =
        |source: &&&Source| source.campaign.record == "transitions" || explains(source);
    let to_film = missing.iter().find(can_be_filmed);
    let pack = to_film.and_then(|source| source.campaign.pin.as_ref());
    let pack = pack.map_or("PACK", |pin| pin.asset_pack.as_str());
    html! {
        @for source in &missing {
            @let campaign = &source.campaign;
            p.muted {
                "Not all of these rollouts of " (campaign.name) " are filmed. "
                @match campaign.record.as_str() {
                    "transitions" => "The campaign stored the actions from which they can be filmed.",
                    "all" => "The campaign films its rollouts; the missing films were lost, or are \
                              not uploaded yet.",
                    _ if explains(source) => {
                        "The campaign stores no actions to film from. This command runs the subsets \
                        again and stores them: "
                        code {
                            "coordinator explain " (measured) " --name " (measured)
                            "-filmed --create --record transitions"
                        }
                        "."
                    }
                    _ => {
                        "The campaign stores no actions to film from: it was created without "
                        code { "--record transitions" } "."
                    }
                }
            }
        }
        @if to_film.is_some() {
            p.muted {
                "This command makes the films from the stored actions: "
                // `page.js` replaces this address with the address that the browser uses.
                code { "worker film --connect " span data-origin { "http://127.0.0.1:7411" } " --assets " (pack) }
            }
        }
    }
}

/// Returns the verb for the outcome that a transition changes to, and the verb for the outcome that
/// it changes from.
const fn verbs(transition: Transition) -> (&'static str, &'static str) {
    match transition {
        Transition::Compensated => ("succeeds", "fails"),
        _ => ("fails", "succeeds"),
    }
}

/// Names a subset: `camera and robot together`, `camera alone`, `no perturbation`.
fn subset_name(set: AxisSet) -> String {
    let names: Vec<&str> = set.axes().map(benchmark::Axis::name).collect();
    match names.as_slice() {
        [] => "no perturbation".to_owned(),
        [axis] => format!("{axis} alone"),
        [first @ .., last] => format!("{} and {last} together", first.join(", ")),
    }
}

/// Joins several subsets: `camera alone; under robot alone`.
fn subset_names(sets: &[AxisSet]) -> String {
    let names: Vec<String> = sets.iter().map(|set| subset_name(*set)).collect();
    names.join("; under ")
}
