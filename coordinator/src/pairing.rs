//! Whether a result may stand beside its configuration's others. Pure. A
//! matched comparison is worth nothing if the scene, the initial state, the
//! assets or the simulator moved between its conditions.

use crate::store::results::{Digests, Provenance, Sibling};
use crate::store::workers::Pin;

/// What a campaign demands of each of its results.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Demand<'a> {
    /// What it is pinned to.
    pub(crate) pin: Option<&'a Pin>,
    /// Its realisation mode.
    pub(crate) realisation: &'a str,
}

/// The first difference that keeps a result out, in words; none if it may
/// stand.
pub(crate) fn difference(
    demand: &Demand<'_>,
    sibling: Option<&Sibling>,
    provenance: &Provenance,
    digests: &Digests,
) -> Option<String> {
    let differs = |what: &str, here: &str, there: &str, whose: &str| {
        (here != there).then(|| format!("{what} is `{here}` here and `{there}` {whose}"))
    };
    let campaign = "in the campaign";
    let pinned = demand.pin.and_then(|pin| {
        let pack = (&provenance.asset_pack_digest, &pin.asset_pack_digest);
        let mujoco = (&provenance.mujoco_version, &pin.mujoco_version);
        differs("asset-pack digest", pack.0, pack.1, campaign)
            .or_else(|| differs("MuJoCo version", mujoco.0, mujoco.1, campaign))
    });
    let realised = || {
        let here = &provenance.realisation;
        differs("realisation mode", here, demand.realisation, campaign)
    };
    let paired = || {
        let sibling = sibling?;
        let whose = format!(
            "in its sibling `{}` (worker `{}`)",
            sibling.rollout_id, sibling.worker_id
        );
        let state = (&digests.init_state, &sibling.init_state_digest);
        differs(
            "scene digest",
            &digests.scene,
            &sibling.scene_digest,
            &whose,
        )
        .or_else(|| differs("initial-state digest", state.0, state.1, &whose))
    };
    pinned.or_else(realised).or_else(paired)
}
