//! Page listing the rollouts of a campaign, filtered by state or outcome.

use benchmark::RolloutId;
use maud::{Markup, html};
use queue::QueueError;
use queue::ids::{JobId, JobName};
use queue::read::{JobFilter, JobLine};

use super::campaign::rollout;
use super::layout::{self, Sheet, Tab, crumbs};
use super::problem::Problem;
use super::state::Page;

/// Most rollouts on one page.
const PAGE_JOBS: u32 = 200;

/// Filters of the page: query parameter and label.
const CHOICES: [(&str, &str); 6] = [
    ("state=leased", "running"),
    ("state=queued", "waiting"),
    ("state=committed", "with a result"),
    ("outcome=success", "succeeded"),
    ("outcome=failure", "failed"),
    ("state=quarantined", "quarantined"),
];

/// Filter and position parsed from a query.
#[derive(Default)]
struct Selection {
    /// Query of one of [`CHOICES`]; `None` lists all rollouts.
    choice: Option<&'static str>,
    /// Job id after which the list begins.
    after: i64,
    /// Id of a single rollout to list, in its first replicate; `None` lists all rollouts that match `choice`.
    id: Option<String>,
}

pub(super) async fn sheet(page: &Page, name: &str, query: &str) -> Result<Sheet, Problem> {
    let selection = Selection::read(query)?;
    let (campaign, mut view) = page.campaign(name).await?;
    let (lines, next) = match &selection.id {
        Some(id) => {
            let job = JobName { rollout_id: id.clone(), replicate: 0 };
            match view.job(&campaign, &job).await {
                Ok(line) => (vec![line], None),
                Err(QueueError::UnknownRollout { .. }) => (Vec::new(), None),
                Err(error) => return Err(error.into()),
            }
        }
        None => {
            let (name, value) = selection.choice.unwrap_or_default().split_once('=').unzip();
            let filter = JobFilter {
                state: value.filter(|_| name == Some("state")),
                success: value
                    .filter(|_| name == Some("outcome"))
                    .map(|outcome| outcome == "success"),
                task: None,
                condition: None,
                level: None,
                after: JobId(selection.after),
                limit: PAGE_JOBS + 1,
            };
            let mut lines = view.jobs(&campaign, filter).await?;
            let has_more = lines.len() > PAGE_JOBS as usize;
            lines.truncate(PAGE_JOBS as usize);
            let next = lines.last().filter(|_| has_more).map(|line| line.job_id.0);
            (lines, next)
        }
    };
    let campaign = campaign.name.as_str();
    let main = html! {
        (crumbs(campaign))
        h1 { "Rollouts of " (campaign) }
        (filters(campaign, &selection))
        @if lines.is_empty() { p { "No rollout matches." } } @else { (table(campaign, &lines)) }
        @if let Some(next) = next {
            @let choice = selection.choice.map(|choice| format!("{choice}&"));
            p { a rel="next" href={ "?" (choice.unwrap_or_default()) "after=" (next) } {
                "Next rollouts"
            } }
        }
    };
    let title = format!("Rollouts of {campaign}");
    Ok(Sheet::new(Tab::Campaigns, title, main))
}

impl Selection {
    fn read(query: &str) -> Result<Selection, Problem> {
        let mut selection = Selection::default();
        for (name, value) in form_urlencoded::parse(query.as_bytes()) {
            match name.as_ref() {
                "state" | "outcome" if value.is_empty() => {}
                "state" | "outcome" => {
                    let requested = format!("{name}={value}");
                    let filter = CHOICES.iter().find(|(choice, _)| *choice == requested);
                    let (choice, _) = filter.ok_or(Problem::Query(
                        "A state is one of queued, leased, committed and quarantined, an outcome \
                         success or failure.",
                    ))?;
                    selection.choice = Some(choice);
                }
                "after" => {
                    let after = value.parse();
                    selection.after =
                        after.map_err(|_| Problem::Query("`after` takes a number."))?;
                }
                "id" if !value.trim().is_empty() => selection.id = Some(canonical_id(value.trim())),
                _ => {}
            }
        }
        Ok(selection)
    }
}

/// Returns the spelling under which rollouts are stored; the reference's names and long names of
/// suites are accepted. Any other text is returned unchanged.
fn canonical_id(id: &str) -> String {
    let parsed: Result<RolloutId, _> = id.parse();
    parsed.map_or_else(|_| id.to_owned(), |id| id.to_string())
}

fn filters(campaign: &str, selection: &Selection) -> Markup {
    let base = format!("/campaigns/{campaign}/rollouts");
    html! {
        nav.ways aria-label="States and outcomes" {
            a href=(base) aria-current=[selection.choice.is_none().then_some("true")] { "all" }
            @for (choice, label) in CHOICES {
                @let current = (selection.choice == Some(choice)).then_some("true");
                a href={ (base) "?" (choice) } aria-current=[current] { (label) }
            }
        }
        form.find action=(base) {
            label for="id" { "Rollout id" }
            input #id name="id" placeholder="object/t0/simultaneous/L2/c00" size="32"
                value=[selection.id.as_deref()];
            button { "Find" }
        }
    }
}

fn table(campaign: &str, lines: &[JobLine]) -> Markup {
    let rows = html! {
        @for line in lines {
            tr {
                th scope="row" { (rollout(campaign, &line.rollout_id, line.replicate)) }
                td.words { (describe_state(line)) }
                td { (line.attempts) }
                td.words { (line.last_error.as_deref().unwrap_or_default()) }
            }
        }
    };
    let columns = ["rollout", ".state", "attempts", ".last error"];
    layout::table("Rollouts", &columns, &rows)
}

fn describe_state(line: &JobLine) -> String {
    match (line.state.as_str(), line.outcome.as_deref(), line.steps) {
        (_, Some("success"), Some(steps)) => format!("success after {steps} steps"),
        (_, Some(outcome), Some(steps)) => format!("{outcome} in {steps} steps"),
        ("leased", ..) => format!("running, control step {}", line.control_steps.unwrap_or(0)),
        ("quarantined", ..) => "quarantined".to_owned(),
        _ => "waiting".to_owned(),
    }
}
