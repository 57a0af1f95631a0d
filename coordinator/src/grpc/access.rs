//! Which call takes which role. What is not named here takes an operator's
//! token, so that a call that is added is closed until somebody opens it.

use transport::{Demand, Role};

/// Everything that a worker calls.
const WORKER_SERVICE: &str = "/rollout.coordinator.v1.WorkerService/";
/// The calls of the operator service that change nothing.
const READING: [&str; 7] = [
    "/rollout.coordinator.v1.OperatorService/ListCampaigns",
    "/rollout.coordinator.v1.OperatorService/GetCampaign",
    "/rollout.coordinator.v1.OperatorService/ListJobs",
    "/rollout.coordinator.v1.OperatorService/GetJob",
    "/rollout.coordinator.v1.OperatorService/ListWorkers",
    "/rollout.coordinator.v1.OperatorService/Report",
    "/rollout.coordinator.v1.OperatorService/Export",
];

/// Who may make the call at a path.
pub(crate) fn demands(path: &str) -> Demand {
    if path.starts_with(WORKER_SERVICE) {
        Demand::OneOf(&[Role::Worker])
    } else if READING.contains(&path) {
        Demand::OneOf(&[Role::Viewer, Role::Operator])
    } else {
        Demand::OneOf(&[Role::Operator])
    }
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
        check("/", only(&[Role::Operator]));
        let reading = only(&[Role::Viewer, Role::Operator]);
        check(&format!("{service}/Report"), reading);
    }
}
