//! Section on a configuration under every subset of the axes: the lattice figure, the minimal
//! subsets that change its outcome, and their films.

use benchmark::RolloutId;
use maud::{Markup, html};
use paired::adaptive::subsets::Explained;
use queue::read::{Campaign, View};
use report::figures;

use super::campaign::address;
use super::films;
use super::lattice_view::{LatticeView, read};
use super::problem::Problem;

/// Rendered section of a configuration's page.
#[derive(Default)]
pub(super) struct Section {
    pub(super) markup: Markup,
    pub(super) films: usize,
}

impl Section {
    pub(super) fn is_empty(&self) -> bool {
        self.markup.0.is_empty()
    }
}

/// Renders the section. If no subset of the configuration was run, the section is empty or, for a
/// transition of a campaign that is not derived itself, suggests `coordinator explain`.
pub(super) async fn section(
    view: &mut View,
    campaign: &Campaign,
    requested: RolloutId,
) -> Result<Section, Problem> {
    let Some(lattice) = read(view, campaign, requested).await? else {
        return Ok(Section::default());
    };
    let explained = Explained::of(lattice.configuration, &lattice.outcomes).ok();
    if !lattice.has_subsets() {
        let measured = &lattice.measured.campaign;
        // A derived campaign cannot be explained.
        if explained.is_none() || view.source(measured.id).await?.is_some() {
            return Ok(Section::default());
        }
        let markup = html! {
            p {
                "The axes that cause this transition are unknown. This command finds them: "
                code { "coordinator explain " (measured.name) " --create" }
            }
        };
        return Ok(Section { markup, films: 0 });
    }
    let outcomes = paired::adaptive::subsets::outcomes(&lattice.outcomes);
    let explanation = explained.as_ref().map(|explained| &explained.explanation);
    let link = |set| lattice.link(set);
    let picture = figures::lattice(
        lattice.configuration,
        lattice.outcomes.full(),
        &outcomes,
        explanation,
        &link,
    );
    let films = explanation.map(|explanation| films::films(&lattice, explanation));
    let films = films.unwrap_or_default();
    let markup = html! {
        section {
            h2 { @if explanation.is_some() { "Minimal subsets of the axes" } @else { "Under every subset of the axes" } }
            (sources(&lattice, campaign))
            @if let Some(explanation) = explanation {
                ul { @for answer in &explanation.answers { (films::describe_answer(answer, explanation.transition)) } }
            }
            figure {
                div.scroll.centred tabindex="0" role="region" aria-label="Every subset of the axes" {
                    (picture.inline())
                }
                figcaption {
                    "This configuration under every subset of the axes: none on top, all at the \
                    bottom, a line wherever one axis is added. Initial state and every perturbation \
                    are the same throughout. A node opens its rollout; a ring marks a subset that \
                    changes the outcome, while no smaller subset that was run changes it."
                }
            }
            (films.markup)
        }
    };
    Ok(Section { markup, films: films.count })
}

/// Renders a link from the shown campaign, which measures or explains the configuration, to the
/// other one; nothing without an explaining campaign.
fn sources(lattice: &LatticeView, shown: &Campaign) -> Markup {
    let link = |campaign: &Campaign| {
        let name = campaign.name.as_str();
        html! { a href={ "/campaigns/" (name) } { (name) } }
    };
    html! {
        @if let Some(explaining) = &lattice.explaining {
            p.muted {
                @if explaining.campaign.id == shown.id {
                    "Explains "
                    a href=(address(lattice.measured.campaign.name.as_str(), lattice.configuration, 0)) {
                        "this configuration of " (lattice.measured.campaign.name)
                    }
                    "."
                } @else {
                    "Explained by " (link(&explaining.campaign)) "."
                }
            }
        }
    }
}
