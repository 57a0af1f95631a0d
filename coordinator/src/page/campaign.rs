//! One campaign: how far it is, condition by condition, and its report filling
//! in.

use std::collections::{BTreeMap, BTreeSet};

use maud::{Markup, html};
use paired::{Matched, Outcome, Record};
use protocol::{Axis, Condition, Level, RolloutId};

use super::bar::pieces;
use super::campaigns::progress;
use super::layout::{Place, Sheet};
use super::problem::Problem;
use super::state::Page;

/// The page.
pub(super) async fn sheet(page: &Page, name: &str) -> Result<Sheet, Problem> {
    let (campaign, mut view) = page.campaign(name).await?;
    let document = page.document(&campaign, &mut view).await?;
    let status = view.status(campaign).await?;
    let name = &status.campaign.name;
    let records = document.analyses.iter().flat_map(|a| &a.subject.records);
    let link = |matched: &Matched| address(name.as_str(), shown_first(matched), matched.replicate);
    let main = html! {
        p.crumbs { a href="/" { "Campaigns" } }
        h1 { (name) }
        (progress(&status))
        (::report::page_warnings(&document))
        (by_condition(records, name.as_str()))
        (::report::sections(&document, Some(&link)))
    };
    Ok(Sheet {
        title: name.to_string(),
        place: Place::Campaigns,
        main,
    })
}

/// Where a rollout's configuration is shown.
pub(super) fn address(campaign: &str, rollout: RolloutId, replicate: u32) -> String {
    match replicate {
        0 => format!("/campaigns/{campaign}/configurations/{rollout}"),
        k => format!("/campaigns/{campaign}/configurations/{rollout}?replicate={k}"),
    }
}

/// How a condition is called beside its peers.
pub(super) fn condition_name(condition: Condition) -> &'static str {
    match condition {
        Condition::Clean => "nominal",
        Condition::Combination => "all at once",
        single => single.name(),
    }
}

/// The rollout that a configuration is called by: all axes at once.
fn shown_first(matched: &Matched) -> RolloutId {
    RolloutId::perturbed(
        matched.task,
        Condition::Combination,
        matched.level,
        matched.config,
    )
    .unwrap_or_else(|_| RolloutId::clean(matched.task, matched.init_id))
}

/// Outcomes of a condition at a level.
#[derive(Clone, Copy, Default)]
struct Tally {
    succeeded: u64,
    failed: u64,
    aside: u64,
    missing: u64,
}

impl Tally {
    fn add(&mut self, outcome: Outcome) {
        match outcome {
            Outcome::Success => self.succeeded += 1,
            Outcome::Failure => self.failed += 1,
            Outcome::Quarantined => self.aside += 1,
            Outcome::Missing => self.missing += 1,
        }
    }
}

/// A table of conditions × levels with what is there of each.
fn by_condition<'a>(records: impl Iterator<Item = &'a Record>, campaign: &str) -> Markup {
    let mut tallies: BTreeMap<(Condition, Level), Tally> = BTreeMap::new();
    for record in records {
        let key = (record.id.condition(), record.id.level());
        tallies.entry(key).or_default().add(record.outcome);
    }
    let levels: BTreeSet<Level> = tallies.keys().map(|(_, level)| *level).collect();
    let perturbed: Vec<Level> = levels
        .into_iter()
        .filter(|level| *level != Level::L0)
        .collect();
    let singles = Axis::ALL.into_iter().map(Condition::Single);
    let rows: Vec<Condition> = singles
        .chain([Condition::Combination])
        .filter(|row| tallies.keys().any(|(condition, _)| condition == row))
        .collect();
    let nominal = tallies.get(&(Condition::Clean, Level::L0));
    html! {
        section {
            h2 { "Progress by condition" }
            div.scroll tabindex="0" role="region" aria-label="Progress by condition" {
                table.progress {
                    thead {
                        tr {
                            th scope="col" { "condition" }
                            @for level in &perturbed { th scope="col" { (level) } }
                            @if perturbed.is_empty() { th scope="col" { "unperturbed" } }
                        }
                    }
                    tbody {
                        @if let Some(nominal) = nominal {
                            tr {
                                th scope="row" { "nominal" }
                                td colspan=(perturbed.len().max(1)) { (tally(nominal)) }
                            }
                        }
                        @for row in rows {
                            tr {
                                th scope="row" { (condition_name(row)) }
                                @for level in &perturbed {
                                    td {
                                        @match tallies.get(&(row, *level)) {
                                            Some(found) => (tally(found)),
                                            None => span.muted { "–" },
                                        }
                                    }
                                }
                            }
                        }
                    }
                }
            }
            p { a href={ "/campaigns/" (campaign) "/rollouts" } { "All rollouts, one by one" } }
        }
    }
}

fn tally(tally: &Tally) -> Markup {
    let done = tally.succeeded + tally.failed;
    let total = done + tally.aside + tally.missing;
    let words = format!(
        "{done} of {total} have a result, {} succeeded, {} quarantined",
        tally.succeeded, tally.aside
    );
    let bar = [
        ("succeeded", tally.succeeded),
        ("failed", tally.failed),
        ("aside", tally.aside),
    ];
    html! {
        (pieces(total, &bar, &words))
        small {
            (done) "/" (total)
            @if done > 0 { ", " (tally.succeeded) " succeeded" }
            @if tally.aside > 0 { ", " (tally.aside) " quarantined" }
        }
    }
}
