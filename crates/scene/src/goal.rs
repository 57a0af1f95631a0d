//! Check of a goal before its scene is composed, so that a task that cannot succeed is refused
//! before anything runs.

use benchmark::Predicate;

use crate::bddl::{Declaration, Problem};
use crate::catalog::{Articulation, category};
use crate::error::SceneError;

const KNOWN: &str = "(on OBJECT OBJECT-OR-REGION), (in OBJECT REGION), (open X), (close X), \
                     (turnon X), (turnoff X)";

/// Checks each predicate's name, and the number, kind and category of its arguments.
pub fn check_goal(problem: &Problem) -> Result<(), SceneError> {
    problem.goal.iter().try_for_each(|predicate| {
        let fault =
            |text: String| SceneError::Inconsistent(format!("the goal {predicate}: {text}"));
        check(problem, predicate).map_err(fault)
    })
}

fn check(problem: &Problem, predicate: &Predicate) -> Result<(), String> {
    let declared = |name: &str| {
        let mut all = problem.objects.iter().chain(&problem.fixtures);
        all.find(|declaration| declaration.name == name)
    };
    let is_region = |name: &str| declared(name).is_none() && problem.region(name).is_some();
    for name in &predicate.arguments {
        if declared(name).is_none() && !is_region(name) {
            return Err(format!("the file declares no object, fixture or region `{name}`"));
        }
    }
    match (predicate.name.as_str(), predicate.arguments.as_slice()) {
        ("on" | "in", [moved, _]) if is_region(moved) => {
            Err(format!("`{moved}` is a region, not an object"))
        }
        ("in", [_, outer]) if !is_region(outer) => {
            Err(format!("`{outer}` is an object or a fixture, and `in` needs a region"))
        }
        ("on" | "in", [_, _]) => Ok(()),
        ("open" | "close" | "turnon" | "turnoff", [name]) => {
            let owner = match problem.region(name) {
                Some(region) if is_region(name) => declared(&region.target),
                _ => declared(name),
            };
            let owner = owner.ok_or_else(|| format!("`{name}` belongs to no object or fixture"))?;
            match supports(owner, &predicate.name) {
                true => Ok(()),
                false => Err(format!(
                    "category `{}` does not support `{}`",
                    owner.category, predicate.name
                )),
            }
        }
        _ => Err(format!("no predicate has this name and number of arguments; there are {KNOWN}")),
    }
}

/// The composition reports an unknown category.
fn supports(instance: &Declaration, predicate: &str) -> bool {
    let Some(category) = category(&instance.category) else {
        return true;
    };
    match category.articulation {
        Articulation::None => false,
        Articulation::OpenClose { .. } => matches!(predicate, "open" | "close"),
        Articulation::OnOff { .. } => matches!(predicate, "turnon" | "turnoff"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(goal: &str) -> Option<String> {
        let text = format!(
            "(define (problem p) (:domain robosuite) (:language put it)
             (:regions (top_side (:target wooden_cabinet_1)) (spot (:target main_table)))
             (:fixtures main_table - table wooden_cabinet_1 - wooden_cabinet)
             (:objects plate_1 - plate)
             (:goal (And {goal})))"
        );
        let problem = Problem::parse(&text).expect("a problem");
        check_goal(&problem).err().map(|error| error.to_string())
    }

    #[test]
    fn goals_that_cannot_be_evaluated_are_named_with_the_reason() {
        for (goal, expected) in [
            ("(Grasp plate_1)", "there are (on OBJECT"),
            ("(On plate_1)", "there are (on OBJECT"),
            ("(On plate_1 plate_9)", "no object, fixture or region `plate_9`"),
            ("(Open plate_1)", "category `plate` does not support `open`"),
            ("(TurnOn wooden_cabinet_1)", "does not support `turnon`"),
            ("(In plate_1 wooden_cabinet_1)", "`in` needs a region"),
            ("(On main_table_spot plate_1)", "is a region, not an object"),
        ] {
            let found = message(goal);
            assert!(
                found.as_ref().is_some_and(|text| text.contains(expected)),
                "{goal}: {found:?}"
            );
        }
        for goal in [
            "(On plate_1 main_table_spot)",
            "(In plate_1 wooden_cabinet_1_top_side)",
            "(Open wooden_cabinet_1_top_side)",
            "(Close wooden_cabinet_1)",
        ] {
            assert_eq!(message(goal), None, "{goal}");
        }
    }
}
