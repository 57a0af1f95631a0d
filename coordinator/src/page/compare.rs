//! Page of the paired comparison of two campaigns.

use maud::{Markup, html};
use queue::ids::{CampaignName, shortened};
use queue::read::{Campaign, View};

use super::campaign::being_computed;
use super::layout::{Sheet, Tab};
use super::problem::Problem;
use super::state::Page;

pub(super) const ADDRESS: &str = "/compare";

/// Renders the page, or the selection form alone if the query does not name two campaigns.
pub(super) async fn sheet(page: &Page, query: &str) -> Result<Sheet, Problem> {
    let parameter = |key: &str| {
        let mut pairs = form_urlencoded::parse(query.as_bytes());
        let value = pairs.find(|(name, _)| name == key);
        value.map(|(_, value)| value.into_owned())
    };
    let (a, b) = (parameter("a"), parameter("b"));
    let mut view = page.queue.view().await?;
    let names = names(&mut view).await?;
    let form = form(&names, [a.as_deref(), b.as_deref()]);
    let (Some(a), Some(b)) = (a, b) else {
        let main = html! { (crumbs()) h1 { "Compare two campaigns" } (form) };
        return Ok(Sheet::new(Tab::Campaigns, "Compare", main));
    };
    let (a, b) = (campaign(&mut view, &a).await?, campaign(&mut view, &b).await?);
    let comparison = page.comparison([&a, &b], &mut view).await?;
    let title = format!("{} against {}", a.name, b.name);
    let main = html! {
        (crumbs())
        h1 { (title) }
        p {
            "A is policy " strong { (a.policy) } " of "
            a href={ "/campaigns/" (a.name) } { (a.name) }
            ", B is policy " strong { (b.policy) } " of "
            a href={ "/campaigns/" (b.name) } { (b.name) } "."
        }
        (form)
        @match comparison.as_deref() {
            None => (being_computed()),
            Some(Ok(comparison)) => (::report::page_comparison(comparison)),
            Some(Err(refused)) => {
                h2 { "These campaigns cannot be compared" }
                ul { @for reason in &refused.reasons { li { (reason) } } }
            }
        }
    };
    Ok(Sheet::new(Tab::Campaigns, title, main))
}

/// Renders the selection form; empty if there are fewer than two campaigns.
pub(super) fn form(names: &[String], chosen: [Option<&str>; 2]) -> Markup {
    let select = |id: &str, chosen: Option<&str>, default_index: usize| {
        let chosen = chosen.or_else(|| names.get(default_index).map(String::as_str));
        html! {
            select #(id) name=(id) {
                @for name in names {
                    option value=(name) selected[Some(name.as_str()) == chosen] { (name) }
                }
            }
        }
    };
    html! {
        @if names.len() > 1 {
            form.find action=(ADDRESS) {
                label for="a" { "Compare" }
                (select("a", chosen[0], 0))
                label for="b" { "with" }
                (select("b", chosen[1], 1))
                button { "Show the difference" }
            }
        }
    }
}

fn crumbs() -> Markup {
    html! { p.crumbs { a href="/" { "Campaigns" } } }
}

/// Returns the campaigns' names, newest first.
async fn names(view: &mut View) -> Result<Vec<String>, Problem> {
    let statuses = view.statuses().await?;
    Ok(statuses.into_iter().rev().map(|status| status.name).collect())
}

async fn campaign(view: &mut View, name: &str) -> Result<Campaign, Problem> {
    let unknown = || Problem::Campaign(shortened(name, 80).to_owned());
    let name = CampaignName::parse(name).map_err(|_| unknown())?;
    Ok(view.campaign(&name).await?)
}
