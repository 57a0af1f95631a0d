//! The rollouts of a campaign, one by one, by state.

use maud::{Markup, html};
use queue::QueueError;
use queue::ids::{JobId, JobName};
use queue::read::{JobFilter, JobLine};

use super::campaign::rollout;
use super::layout::{self, Place, Sheet, crumbs};
use super::problem::Problem;
use super::state::Page;

/// Rollouts on a page.
const PAGE_JOBS: u32 = 200;

/// The states that one can ask for, and how they are called.
const STATES: [(&str, &str); 4] = [
    ("leased", "running"),
    ("queued", "waiting"),
    ("committed", "with a result"),
    ("quarantined", "quarantined"),
];

/// What a query asks for.
#[derive(Default)]
struct Wanted {
    state: Option<String>,
    after: i64,
    /// One rollout by its id, if any.
    id: Option<String>,
}

/// The page.
pub(super) async fn sheet(page: &Page, name: &str, query: &str) -> Result<Sheet, Problem> {
    let wanted = Wanted::read(query)?;
    let (of, mut view) = page.campaign(name).await?;
    let state = wanted.state.as_deref();
    let (lines, next) = match &wanted.id {
        Some(id) => {
            let job = JobName {
                rollout_id: id.clone(),
                replicate: 0,
            };
            match view.job(&of, &job).await {
                Ok(line) => (vec![line], None),
                Err(QueueError::UnknownRollout { .. }) => (Vec::new(), None),
                Err(error) => return Err(error.into()),
            }
        }
        None => {
            let filter = JobFilter {
                state,
                after: JobId(wanted.after),
                limit: PAGE_JOBS + 1,
            };
            let mut lines = view.jobs(&of, filter).await?;
            let is_more = lines.len() > PAGE_JOBS as usize;
            lines.truncate(PAGE_JOBS as usize);
            let next = lines.last().filter(|_| is_more).map(|line| line.id.0);
            (lines, next)
        }
    };
    let campaign = of.name.as_str();
    let main = html! {
        (crumbs(campaign))
        h1 { "Rollouts of " (campaign) }
        (filters(campaign, &wanted))
        @if lines.is_empty() { p { "There are none." } } @else { (table(campaign, &lines)) }
        @if let Some(next) = next {
            @let state = state.unwrap_or_default();
            p { a rel="next" href={ "?state=" (state) "&after=" (next) } { "The next ones" } }
        }
    };
    let title = format!("Rollouts of {campaign}");
    Ok(Sheet::new(Place::Campaigns, title, main))
}

impl Wanted {
    fn read(query: &str) -> Result<Wanted, Problem> {
        let mut wanted = Wanted::default();
        for (name, value) in form_urlencoded::parse(query.as_bytes()) {
            match name.as_ref() {
                "state" if value.is_empty() => {}
                "state" if STATES.iter().any(|(state, _)| *state == value) => {
                    wanted.state = Some(value.into_owned());
                }
                "state" => {
                    return Err(Problem::Query(
                        "A state is one of queued, leased, committed and quarantined.",
                    ));
                }
                "after" => {
                    let after = value.parse();
                    wanted.after = after.map_err(|_| Problem::Query("`after` takes a number."))?;
                }
                "id" if !value.trim().is_empty() => wanted.id = Some(value.trim().to_owned()),
                _ => {}
            }
        }
        Ok(wanted)
    }
}

fn filters(campaign: &str, wanted: &Wanted) -> Markup {
    let state = wanted.state.as_deref();
    let base = format!("/campaigns/{campaign}/rollouts");
    html! {
        nav.ways aria-label="States" {
            a href=(base) aria-current=[state.is_none().then_some("true")] { "all" }
            @for (name, words) in STATES {
                @let current = (state == Some(name)).then_some("true");
                a href={ (base) "?state=" (name) } aria-current=[current] { (words) }
            }
        }
        form.find action=(base) {
            label for="id" { "Rollout id" }
            input #id name="id" placeholder="object/t0/combination/L2/c00" size="32"
                value=[wanted.id.as_deref()];
            button { "Find" }
        }
    }
}

fn table(campaign: &str, lines: &[JobLine]) -> Markup {
    let rows = html! {
        @for line in lines {
            tr {
                th scope="row" { (rollout(campaign, &line.rollout_id, line.replicate)) }
                td.words { (standing(line)) }
                td { (line.attempt) }
                td.words { (line.last_error.as_deref().unwrap_or_default()) }
            }
        }
    };
    let columns = ["rollout", ".state", "attempts", ".last error"];
    layout::table("Rollouts", &columns, &rows)
}

fn standing(line: &JobLine) -> String {
    match (line.state.as_str(), line.success, line.steps) {
        (_, Some(true), Some(steps)) => format!("success after {steps} steps"),
        (_, Some(false), Some(steps)) => format!("failure in {steps} steps"),
        ("leased", ..) => format!("running, control step {}", line.control_steps.unwrap_or(0)),
        ("quarantined", ..) => "quarantined".to_owned(),
        _ => "waiting".to_owned(),
    }
}
