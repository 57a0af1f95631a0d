//! Which task a worker is given next.

/// A task of one campaign of which jobs wait, as a claim sees it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WaitingTask {
    /// "libero_goal/3".
    pub task: String,
    /// Place of its next job in paired-unit order.
    pub first_unit: i64,
    /// Leases on it now.
    pub leased: u32,
}

/// Picks the task of a campaign that a worker starts on: the one that the
/// fewest leases are on; among equals the one whose next job comes first in
/// paired-unit order.
pub fn choose_task(waiting: &[WaitingTask]) -> Option<&WaitingTask> {
    waiting
        .iter()
        .min_by_key(|candidate| (candidate.leased, candidate.first_unit))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_claim_prefers_solitude_then_paired_unit_order() {
        let waiting = |task: &str, first_unit, leased| WaitingTask {
            task: task.to_owned(),
            first_unit,
            leased,
        };
        let tasks = [
            waiting("libero_goal/0", 0, 2),
            waiting("libero_goal/1", 9, 1),
            waiting("libero_goal/2", 5, 1),
        ];
        let chosen = |tasks| choose_task(tasks).map(|task| task.task.as_str());
        assert_eq!(chosen(&tasks), Some("libero_goal/2"));
        assert_eq!(chosen(&tasks[..1]), Some("libero_goal/0"));
        assert_eq!(chosen(&[]), None);
    }
}
