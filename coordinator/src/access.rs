//! Access table of the coordinator: maps each path to a gRPC call or a page, and to the roles that
//! may access it. A call that is not listed here requires the operator role, so that a new call is
//! closed to viewers and workers by default.

use transport::{Allowed, Resource, Role};

/// Roles that may read all pages and make the calls in [`READ_ONLY_CALLS`].
pub(crate) const READERS: [Role; 2] = [Role::Viewer, Role::Operator];
pub(crate) const LOG_IN: &str = "/login";

/// Path prefix of the worker service's calls.
const WORKER_SERVICE: &str = "/rollout.coordinator.v1.WorkerService/";
/// Calls of the operator service that viewers may make, too. They change nothing.
const READ_ONLY_CALLS: [&str; 9] = [
    "/rollout.coordinator.v1.OperatorService/ListCampaigns",
    "/rollout.coordinator.v1.OperatorService/GetCampaign",
    "/rollout.coordinator.v1.OperatorService/GetSpecification",
    "/rollout.coordinator.v1.OperatorService/ListJobs",
    "/rollout.coordinator.v1.OperatorService/GetJob",
    "/rollout.coordinator.v1.OperatorService/ListWorkers",
    "/rollout.coordinator.v1.OperatorService/Report",
    "/rollout.coordinator.v1.OperatorService/Export",
    "/rollout.coordinator.v1.OperatorService/Forecast",
];

/// Pages and files that need no login. They reveal nothing about campaigns.
const PUBLIC_PATHS: [&str; 5] = [LOG_IN, "/logout", "/style.css", "/page.js", "/icon.svg"];

/// Returns the kind of resource at a path and the roles that may access it.
pub(crate) fn resource(path: &str) -> Resource {
    if path.starts_with(WORKER_SERVICE) {
        Resource::Call(Allowed::OneOf(&[Role::Worker]))
    } else if READ_ONLY_CALLS.contains(&path) {
        Resource::Call(Allowed::OneOf(&READERS))
    } else if is_call(path) {
        Resource::Call(Allowed::OneOf(&[Role::Operator]))
    } else if PUBLIC_PATHS.contains(&path) {
        Resource::Page(Allowed::Everybody)
    } else {
        Resource::Page(Allowed::OneOf(&READERS))
    }
}

/// Returns true if a path is that of a gRPC call, whose first segment is a dotted service name as
/// in `/rollout.coordinator.v1.OperatorService/Report`.
pub(crate) fn is_call(path: &str) -> bool {
    let service = path.strip_prefix('/').and_then(|path| path.split_once('/'));
    service.is_some_and(|(service, _)| service.contains('.'))
}

#[cfg(test)]
mod tests;
