//! Page of one campaign: progress, and the report so far.

use benchmark::RolloutId;
use maud::{Markup, html};
use report::Document;

use super::campaigns::progress;
use super::layout::{Sheet, Tab};
use super::problem::Problem;
use super::state::Page;

pub(super) async fn sheet(page: &Page, name: &str) -> Result<Sheet, Problem> {
    let (campaign, mut view) = page.campaign(name).await?;
    let document = page.document(&campaign, &mut view).await?;
    let status = view.status(campaign).await?;
    let name = status.name.as_str();
    let main = html! {
        p.crumbs { a href="/" { "Campaigns" } }
        h1 { (name) }
        (progress(&status))
        @match &document {
            Some(document) => (statistics(document, name)),
            None => (being_computed()),
        }
        p { a href={ "/campaigns/" (name) "/rollouts" } { "All rollouts, one by one" } }
    };
    Ok(Sheet::new(Tab::Campaigns, name, main))
}

/// Renders a note in place of statistics that are not computed yet.
pub(super) fn being_computed() -> Markup {
    html! {
        p.muted role="status" {
            "The figures are being computed from all results; this page shows them once they are \
            done."
        }
    }
}

/// Renders the report.
fn statistics(document: &Document, name: &str) -> Markup {
    // Links of an explaining campaign lead to the campaign that measured the transitions.
    let explained = document.analyses.iter().find_map(|analysis| analysis.findings.as_ref());
    let measuring_campaign = explained.map_or(name, |findings| findings.campaign.as_str());
    let link = |id: RolloutId, replicate: u32| address(measuring_campaign, id, replicate);
    html! {
        (report::page_warnings(document))
        (report::sections(document, Some(&link)))
    }
}

/// Returns the address of the page of a rollout's configuration.
pub(super) fn address(campaign: &str, rollout: RolloutId, replicate: u32) -> String {
    match replicate {
        0 => format!("/campaigns/{campaign}/configurations/{rollout}"),
        k => format!("/campaigns/{campaign}/configurations/{rollout}?replicate={k}"),
    }
}

/// Renders the name of a rollout, linked to the page of its configuration.
pub(super) fn rollout(campaign: &str, id: &str, replicate: u32) -> Markup {
    let name = report::rollout_name(id, replicate);
    html! {
        @match id.parse() {
            Ok(id) => a href=(address(campaign, id, replicate)) { code { (name) } },
            Err(_) => code { (name) },
        }
    }
}
