//! Choice of the next campaign for a worker, and of a task within it.

use crate::ids::CampaignId;

/// A campaign with waiting jobs that the claiming worker can run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WaitingCampaign {
    pub id: CampaignId,
    /// Priority: campaigns with a higher priority are leased first.
    pub priority: i32,
    pub leased: u32,
    /// Turn in which the campaign last received leases. Each turn grants leases to one campaign;
    /// turns are counted from 1. 0 if unknown.
    pub last_turn: u64,
}

/// Returns the campaign to lease from next, and how many of `claims` it gets before campaigns are
/// compared again; at least one.
///
/// The highest priority goes first. Campaigns of equal priority share the workers: the one with the
/// fewest leases is next; ties go to the longest wait since its last turn, then to the oldest
/// campaign. Claims that arrive together are assigned as if they had arrived one by one.
pub fn choose_campaign(waiting: &[WaitingCampaign], claims: usize) -> Option<(CampaignId, usize)> {
    let priority = waiting.iter().map(|campaign| campaign.priority).max()?;
    let peers = waiting.iter().filter(|campaign| campaign.priority == priority);
    let mut peers: Vec<&WaitingCampaign> = peers.collect();
    peers.sort_by_key(|campaign| (campaign.leased, campaign.last_turn, campaign.id));
    let first = peers.first()?;
    // The target is the number of leases that the campaign and its peers each reach once all claims
    // are served; peers that already have more leases get none of the claims.
    let mut target = usize::MAX;
    let mut leases = claims;
    for (preceding, peer) in peers.iter().enumerate() {
        leases += peer.leased as usize;
        target = target.min(leases.div_ceil(preceding + 1));
    }
    let share = target.saturating_sub(first.leased as usize);
    Some((first.id, share.max(1)))
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WaitingTask {
    pub task: String,
    /// Place of the task's next job in the campaign's order of jobs.
    pub first_unit: i64,
    pub leased: u32,
}

/// Chooses the task that a worker starts on: the one with the fewest leases; ties go to the task
/// whose next job comes first in the campaign's order of jobs.
pub fn choose_task(waiting: &[WaitingTask]) -> Option<&WaitingTask> {
    waiting.iter().min_by_key(|candidate| (candidate.leased, candidate.first_unit))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn campaign(id: i64, priority: i32, leased: u32, last_turn: u64) -> WaitingCampaign {
        WaitingCampaign { id: CampaignId(id), priority, leased, last_turn }
    }

    #[test]
    fn the_highest_priority_is_served_first_regardless_of_its_leases() {
        let waiting = [campaign(1, 0, 0, 0), campaign(2, 5, 90, 7), campaign(3, -5, 0, 0)];
        assert_eq!(choose_campaign(&waiting, 4), Some((CampaignId(2), 4)));
        assert_eq!(choose_campaign(&[], 4), None);
    }

    #[test]
    fn equal_priorities_are_ordered_by_leases_then_wait_then_age() {
        let first =
            |waiting: &[WaitingCampaign]| choose_campaign(waiting, 1).map(|choice| choice.0.0);
        assert_eq!(first(&[campaign(1, 0, 2, 1), campaign(2, 0, 1, 2)]), Some(2));
        assert_eq!(first(&[campaign(1, 0, 1, 9), campaign(2, 0, 1, 8)]), Some(2));
        assert_eq!(first(&[campaign(2, 0, 1, 8), campaign(1, 0, 1, 8)]), Some(1));
    }

    /// Asserts that campaigns end with the same numbers of leases whether `claims` claims arrive
    /// together or one by one.
    fn check(leased: &[u32], claims: usize) {
        let leases = |at_a_time: usize| {
            let mut waiting: Vec<WaitingCampaign> =
                (1..).zip(leased).map(|(id, leased)| campaign(id, 0, *leased, 0)).collect();
            let mut remaining = claims;
            for turn in 1.. {
                if remaining == 0 {
                    break;
                }
                let (id, share) =
                    choose_campaign(&waiting, remaining.min(at_a_time)).expect("a choice");
                assert!((1..=remaining).contains(&share), "{share} of {remaining}");
                let chosen = waiting.iter_mut().find(|campaign| campaign.id == id);
                let chosen = chosen.expect("the chosen campaign");
                chosen.leased += share as u32;
                chosen.last_turn = turn;
                remaining -= share;
            }
            waiting.iter().map(|campaign| campaign.leased).collect::<Vec<_>>()
        };
        let (mut together, mut alone) = (leases(usize::MAX), leases(1));
        together.sort_unstable();
        alone.sort_unstable();
        assert_eq!(together, alone, "{leased:?} and {claims} claims");
    }

    #[test]
    fn simultaneous_claims_are_assigned_as_if_sequential() {
        check(&[0, 0], 10);
        check(&[0, 0, 0], 10);
        check(&[7, 0], 4);
        check(&[7, 0], 9);
        check(&[3, 1, 5, 1], 6);
        check(&[3, 1, 5, 1], 1);
        check(&[2], 5);
    }

    #[test]
    fn the_task_with_the_fewest_leases_is_chosen_then_the_one_whose_job_comes_first() {
        let waiting = |task: &str, first_unit, leased| WaitingTask {
            task: task.to_owned(),
            first_unit,
            leased,
        };
        let tasks = [waiting("goal/0", 0, 2), waiting("goal/1", 9, 1), waiting("goal/2", 5, 1)];
        let chosen = |tasks| choose_task(tasks).map(|task| task.task.as_str());
        assert_eq!(chosen(&tasks), Some("goal/2"));
        assert_eq!(chosen(&tasks[..1]), Some("goal/0"));
        assert_eq!(chosen(&[]), None);
    }
}
