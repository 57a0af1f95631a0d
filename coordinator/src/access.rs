//! Which call and which page takes which role. What is not named here takes an
//! operator's token, so that a new call is closed until it is named.

use transport::{Demand, Role};

/// The roles that may read everything.
pub(crate) const READERS: [Role; 2] = [Role::Viewer, Role::Operator];
/// Where browsers log in.
pub(crate) const LOG_IN: &str = "/login";

/// Everything that a worker calls.
const WORKER_SERVICE: &str = "/rollout.coordinator.v1.WorkerService/";
/// The calls of the operator service that change nothing.
const READING: [&str; 8] = [
    "/rollout.coordinator.v1.OperatorService/ListCampaigns",
    "/rollout.coordinator.v1.OperatorService/GetCampaign",
    "/rollout.coordinator.v1.OperatorService/ListJobs",
    "/rollout.coordinator.v1.OperatorService/GetJob",
    "/rollout.coordinator.v1.OperatorService/ListWorkers",
    "/rollout.coordinator.v1.OperatorService/Report",
    "/rollout.coordinator.v1.OperatorService/Export",
    "/rollout.coordinator.v1.OperatorService/Forecast",
];

/// What a browser loads before its person has logged in, or to log out: it
/// reveals nothing of any campaign.
const OPEN: [&str; 5] = [LOG_IN, "/logout", "/style.css", "/page.js", "/icon.svg"];

/// What the call or page at a path requires of its caller.
pub(crate) fn demands(path: &str) -> Demand {
    if path.starts_with(WORKER_SERVICE) {
        Demand::OneOf(&[Role::Worker])
    } else if READING.contains(&path) || is_page(path) {
        Demand::OneOf(&READERS)
    } else if OPEN.contains(&path) {
        Demand::Nothing
    } else {
        Demand::OneOf(&[Role::Operator])
    }
}

/// Whether a path can be a page's: a call's begins with its service, whose name
/// has a dot, as `rollout.coordinator.v1.OperatorService`.
fn is_page(path: &str) -> bool {
    let first = path
        .strip_prefix('/')
        .and_then(|path| path.split('/').next());
    first.is_some_and(|first| !first.contains('.')) && !OPEN.contains(&path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_nobody_thought_of_takes_an_operator() {
        let service = "/rollout.coordinator.v1.OperatorService";
        let only = |role: &'static [Role]| Demand::OneOf(role);
        let check = |path: &str, expected| assert_eq!(demands(path), expected, "{path}");
        check(&format!("{WORKER_SERVICE}Commit"), only(&[Role::Worker]));
        check(
            &format!("{service}/CreateCampaign"),
            only(&[Role::Operator]),
        );
        check(&format!("{service}/Added"), only(&[Role::Operator]));
        check("/added.v1.Service/Call", only(&[Role::Operator]));
        let reading = only(&READERS);
        for page in [
            "/",
            "/campaigns/a.b",
            "/compare",
            "/metrics",
            "/events",
            "/nowhere",
        ] {
            check(page, reading);
        }
        for open in OPEN {
            check(open, Demand::Nothing);
        }
        check(&format!("{service}/Report"), reading);
    }
}
