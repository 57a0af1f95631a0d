//! What a campaign that explains another runs next. Which subsets explain a
//! configuration is `lattice`'s business; here what it asks for becomes rollouts.

use std::ops::Range;

use lattice::{Sample, configurations, plan};
use paired::Record;
use protocol::{AxisSet, Explanation, RolloutId};

/// Rollouts that follow from what is known.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Wanted {
    /// The simultaneous rollout of their configuration, in the campaign that is
    /// explained.
    pub(crate) simultaneous: RolloutId,
    /// The axes to perturb.
    pub(crate) axes: AxisSet,
    /// The replicates to run: those that neither campaign has.
    pub(crate) replicates: Range<u32>,
}

/// The rollouts that follow from the records of the explained campaign and the
/// explaining one's `own`; none where everything is explained, or asked for.
pub(crate) fn wanted(
    explained: &[Record],
    own: &[Record],
    explanation: &Explanation,
) -> Vec<Wanted> {
    // Of a single axis there is nothing to explain.
    let Ok(known) = configurations(explained, own, explanation) else {
        return Vec::new();
    };
    let mut all = Vec::new();
    for (&simultaneous, requests) in plan(&known, &Sample::of(explanation, explained)) {
        for request in requests {
            let asked = known[&simultaneous].tally(request.set).asked();
            all.push(Wanted {
                simultaneous,
                axes: request.set,
                replicates: asked..asked + request.rollouts,
            });
        }
    }
    all
}
