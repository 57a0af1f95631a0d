//! Page of one campaign: progress, progress by condition, and the report so far.

use std::collections::{BTreeMap, BTreeSet};

use ::report::Document;
use benchmark::{Condition, Level, RolloutId};
use maud::{Markup, html};
use paired::{Outcome, Record};
use queue::read::Counts;

use super::bar::bar;
use super::campaigns::progress;
use super::layout::{Sheet, Tab, breakable, table};
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

/// Renders the progress by condition, and the report.
fn statistics(document: &Document, name: &str) -> Markup {
    let records = document.analyses.iter().flat_map(|analysis| &analysis.subject.records);
    // Links of an explaining campaign lead to the campaign that measured the transitions.
    let explained = document.analyses.iter().find_map(|analysis| analysis.findings.as_ref());
    let measuring_campaign = explained.map_or(name, |findings| findings.campaign.as_str());
    let link = |id: RolloutId, replicate: u32| address(measuring_campaign, id, replicate);
    let is_paired = document.analyses.iter().all(|analysis| analysis.is_paired());
    // A campaign of LIBERO's family has a table by dimension instead.
    let progress_by_condition = match &document.family {
        Some(_) => Markup::default(),
        None => by_condition(records, name),
    };
    html! {
        (::report::page_warnings(document))
        @if is_paired { (progress_by_condition) }
        (::report::sections(document, Some(&link)))
        @if !is_paired { (progress_by_condition) }
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
    let name = ::report::rollout_name(id, replicate);
    html! {
        @match id.parse() {
            Ok(id) => a href=(address(campaign, id, replicate)) { code { (name) } },
            Err(_) => code { (name) },
        }
    }
}

/// Renders a table of conditions × levels with the progress in each cell.
fn by_condition<'a>(records: impl Iterator<Item = &'a Record>, campaign: &str) -> Markup {
    let mut tallies: BTreeMap<(Condition, Level), Counts> = BTreeMap::new();
    for record in records {
        let key = (record.id.condition(), record.id.level());
        let tally = tallies.entry(key).or_default();
        match record.outcome {
            Outcome::Success | Outcome::Failure => tally.committed += 1,
            Outcome::Quarantined => tally.quarantined += 1,
            Outcome::Missing => tally.queued += 1,
        }
        tally.succeeded += u64::from(record.outcome == Outcome::Success);
    }
    let is_perturbed = |(condition, _): &&(Condition, Level)| *condition != Condition::Nominal;
    let perturbed = tallies.keys().filter(is_perturbed);
    let levels: BTreeSet<Level> = perturbed.clone().map(|key| key.1).collect();
    let conditions: BTreeSet<Condition> = perturbed.map(|key| key.0).collect();
    let is_subset = |condition: &Condition| matches!(condition, Condition::Subset(_));
    let (subsets, others): (Vec<Condition>, Vec<Condition>) =
        conditions.into_iter().partition(is_subset);
    let nominal = tallies.get(&(Condition::Nominal, Level::L0));
    let rows_of = |conditions: &[Condition]| {
        html! {
            @for condition in conditions {
                tr {
                    th scope="row" { (breakable(condition.name())) }
                    @for level in &levels {
                        td.tally {
                            @match tallies.get(&(*condition, *level)) {
                                Some(counts) => (tally(counts)),
                                None => span.muted { "–" },
                            }
                        }
                    }
                }
            }
        }
    };
    let rows = html! {
        @if let Some(nominal) = nominal {
            tr {
                th scope="row" { (Condition::Nominal.name()) }
                td.tally colspan=(levels.len().max(1)) { (tally(nominal)) }
            }
        }
        (rows_of(&others))
    };
    let mut columns = vec!["condition".to_owned()];
    columns.extend(levels.iter().map(|level| match *level {
        Level::L0 => "L0 (placebo)".to_owned(),
        level => level.to_string(),
    }));
    if levels.is_empty() {
        columns.push("unperturbed".to_owned());
    }
    html! {
        section {
            h2 { "Progress by condition" }
            (table("Progress by condition", &columns, &rows))
            @if !subsets.is_empty() {
                details {
                    summary { "Under several axes but not all: " (subsets.len()) " subsets" }
                    (table("Progress by subset", &columns, &rows_of(&subsets)))
                }
            }
            p { a href={ "/campaigns/" (campaign) "/rollouts" } { "All rollouts, one by one" } }
        }
    }
}

/// Renders a cell of the table: a progress bar and its counts.
fn tally(counts: &Counts) -> Markup {
    let Counts { committed: done, succeeded, quarantined, .. } = *counts;
    let total = counts.total();
    let description = format!(
        "{done} of {total} have a result, {succeeded} succeeded, {quarantined} quarantined"
    );
    html! {
        (bar(counts, &description))
        small {
            (done) "/" (total)
            @if done > 0 { ", " (succeeded) " succeeded" }
            @if quarantined > 0 { ", " (quarantined) " quarantined" }
        }
    }
}
