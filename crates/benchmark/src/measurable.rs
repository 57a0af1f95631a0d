use crate::campaign::Rollouts;
use crate::design::Nominal;
use crate::level::Level;
use crate::thresholds::Thresholds;

/// Reason why the thresholds of a campaign cannot be measured, with a remedy.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NotMeasurable {
    #[error(
        "its rows are not expanded from a design, so that their values at another radius are \
         unknown; create a campaign with `tasks`, `axes` and `levels`"
    )]
    NoDesign,
    #[error(
        "it has no nominal rollouts, from which thresholds are measured; create it with `nominal` \
         eval"
    )]
    NoNominal,
    #[error(
        "it perturbs nothing, or at the placebo level only; create a campaign with axes and levels"
    )]
    NoCondition,
    #[error("it does not run the condition {given}; its conditions are {valid}")]
    ConditionNotRun { given: &'static str, valid: String },
}

impl Thresholds {
    pub fn check_measurable(&self, rollouts: &Rollouts) -> Result<(), NotMeasurable> {
        let Rollouts::Design(design) = rollouts else {
            return Err(NotMeasurable::NoDesign);
        };
        if design.nominal == Nominal::None {
            return Err(NotMeasurable::NoNominal);
        }
        let valid = design.conditions();
        if valid.is_empty() || design.levels.iter().all(|level| *level == Level::L0) {
            return Err(NotMeasurable::NoCondition);
        }
        let not_run = self.conditions.iter().find(|condition| !valid.contains(condition));
        match not_run {
            None => Ok(()),
            Some(given) => Err(NotMeasurable::ConditionNotRun {
                given: given.name(),
                valid: valid
                    .iter()
                    .map(|condition| condition.name())
                    .collect::<Vec<_>>()
                    .join(", "),
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::axis::Axis;
    use crate::axis_set::AxisSet;
    use crate::condition::Condition;
    use crate::design::Design;

    fn thresholds(conditions: &[Condition]) -> Thresholds {
        Thresholds {
            campaign: "first".to_owned(),
            conditions: conditions.to_vec(),
            tolerance: Thresholds::DEFAULT_TOLERANCE,
            max_radius: Thresholds::DEFAULT_MAX_RADIUS,
            budget: None,
            seed: 0,
        }
    }

    #[test]
    fn conditions_that_cannot_be_measured_are_refused_with_the_valid_conditions() {
        let design = Design { axes: vec![Axis::Camera, Axis::Robot], ..Design::v0_1() };
        let check = |change: fn(&mut Design), conditions: &[Condition]| {
            let mut design = design.clone();
            change(&mut design);
            thresholds(conditions).check_measurable(&Rollouts::Design(design))
        };
        let run = [Condition::Single(Axis::Camera), Condition::Simultaneous];
        assert_eq!(check(|_| (), &run), Ok(()));
        assert_eq!(check(|_| (), &[]), Ok(()));
        let subset = Condition::of(AxisSet::from_iter([Axis::Camera, Axis::Sensor]));
        for not_run in [Condition::Single(Axis::Sensor), Condition::Nominal, subset] {
            let error =
                check(|_| (), &[not_run]).expect_err("a condition that the campaign does not run");
            let valid = "its conditions are camera, robot, simultaneous";
            assert!(error.to_string().contains(valid), "{error}");
        }
        let result = check(|design| design.nominal = Nominal::None, &[]);
        assert_eq!(result, Err(NotMeasurable::NoNominal));
        let result = check(|design| design.axes.clear(), &[]);
        assert_eq!(result, Err(NotMeasurable::NoCondition));
        let result = check(|design| design.levels = vec![Level::L0], &[]);
        assert_eq!(result, Err(NotMeasurable::NoCondition));
        let imported = thresholds(&[]).check_measurable(&Rollouts::Rows(Vec::new()));
        assert_eq!(imported, Err(NotMeasurable::NoDesign));
    }
}
