//! The coordinator's table of access: whether a path is a call's or a page's, and the roles that
//! may have it. A call that is not named here takes an operator's token, so that a new one is
//! closed until it is named.

use transport::{Allowed, Resource, Role};

/// The roles that may read everything.
pub(crate) const READERS: [Role; 2] = [Role::Viewer, Role::Operator];
/// Address of the log-in page.
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

/// Paths that a browser loads before its person has logged in, or to log out: they reveal nothing
/// of any campaign.
const OPEN: [&str; 5] = [LOG_IN, "/logout", "/style.css", "/page.js", "/icon.svg"];

/// Returns the kind of resource at a path, with the roles that may have it.
pub(crate) fn resource(path: &str) -> Resource {
    if path.starts_with(WORKER_SERVICE) {
        Resource::Call(Allowed::OneOf(&[Role::Worker]))
    } else if READING.contains(&path) {
        Resource::Call(Allowed::OneOf(&READERS))
    } else if is_call(path) {
        Resource::Call(Allowed::OneOf(&[Role::Operator]))
    } else if OPEN.contains(&path) {
        Resource::Page(Allowed::Everybody)
    } else {
        Resource::Page(Allowed::OneOf(&READERS))
    }
}

/// Returns true if a path is a call's: its first segment is a service, whose name has a dot, as
/// in `/rollout.coordinator.v1.OperatorService/Report`.
pub(crate) fn is_call(path: &str) -> bool {
    let service = path.strip_prefix('/').and_then(|path| path.split_once('/'));
    service.is_some_and(|(service, _)| service.contains('.'))
}

#[cfg(test)]
mod tests;
