//! Sequential comparison of two campaigns that run their configurations in the same drawn
//! order.

use std::collections::{BTreeMap, BTreeSet};

use libero_ctrl::{Condition, Level, RolloutId, Stop, StopRule};

use crate::outcomes::{Outcome, Record};
use crate::sequential::campaign::{SEQUENTIAL_ALPHA, drawn_order};
use crate::sequential::difference::SequentialDifference;
use crate::sequential::look::Look;
use crate::sequential::order::Unit;

/// Look at the difference A − B under one condition at one level.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ComparedLook {
    /// The level.
    pub level: Level,
    /// The condition.
    pub condition: Condition,
    /// The interval over the configurations that both campaigns have completed.
    pub look: Look,
    /// Number of configurations after which the rule was first met; `None` if it was not met, or
    /// without a rule.
    pub met_after: Option<usize>,
}

/// Error: the campaigns have different configurations, so that their orders differ.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NotInOneOrder;

/// Returns the looks at the difference under every condition that perturbs, at every level
/// including the placebo, in the first replicate. The seed and strata of `order` define the drawn
/// order of both campaigns; its rule is not used. `rule` is the rule of
/// [`ComparedLook::met_after`]. A condition is skipped at a level if either campaign lacks it there
/// in any configuration or if any of its rollouts is `unpaired`.
///
/// # Errors
/// If one campaign has a configuration that the other lacks.
pub fn compared_looks(
    [a, b]: [&[Record]; 2],
    unpaired: &BTreeSet<RolloutId>,
    order: &Stop,
    rule: Option<&StopRule>,
) -> Result<Vec<ComparedLook>, NotInOneOrder> {
    let [a, b] = [outcomes(a), outcomes(b)];
    let units = units(&a);
    if units != self::units(&b) {
        return Err(NotInOneOrder);
    }
    let order = drawn_order(order, units.iter().copied());
    let mut looks = Vec::new();
    for (&(level, condition), outcomes_a) in &a {
        let outcomes_b = b.get(&(level, condition));
        let Some(outcomes_b) = outcomes_b
            .filter(|outcomes_b| [outcomes_a.len(), outcomes_b.len()] == [units.len(); 2])
        else {
            continue;
        };
        let is_unpaired = |&(task, config): &Unit| {
            let id = RolloutId::perturbed(task, condition, level, config);
            id.is_ok_and(|id| unpaired.contains(&id))
        };
        if units.iter().any(is_unpaired) {
            continue;
        }
        let mut difference = SequentialDifference::new(&order, SEQUENTIAL_ALPHA);
        let mut met_after = None;
        for unit in order.units() {
            let result = difference.complete(unit, outcomes_a[unit], outcomes_b[unit]);
            result.expect("a configuration of the order");
            let look = difference.look();
            if met_after.is_none() && rule.is_some_and(|rule| look.meets(rule)) {
                met_after = Some(look.used);
            }
        }
        looks.push(ComparedLook { level, condition, look: difference.look(), met_after });
    }
    Ok(looks)
}

type Outcomes = BTreeMap<(Level, Condition), BTreeMap<Unit, Outcome>>;

/// Groups the outcomes of the perturbed rollouts of replicate 0 by level and condition.
fn outcomes(records: &[Record]) -> Outcomes {
    let mut outcomes = Outcomes::new();
    for record in records.iter().filter(|record| record.replicate == 0) {
        let id = record.id;
        if let Some(config) = id.config() {
            let cell = outcomes.entry((id.level(), id.condition())).or_default();
            cell.insert((id.task(), config), record.outcome);
        }
    }
    outcomes
}

fn units(outcomes: &Outcomes) -> BTreeSet<Unit> {
    let units = outcomes.values().flat_map(BTreeMap::keys);
    units.copied().collect()
}
