//! Finds the simplest map from one server's actions to another's. Each of the seven components is
//! unchanged or affine; the gripper may have another convention, and the chunk may be shifted.
//! Pure functions.

use benchmark::Action;

use crate::doctor::answers::Answers;

pub(crate) const GRIPPER: usize = 6;
/// Smallest scale of an affine map; a smaller scale means that the answers are unrelated.
const LEAST_SCALE: f64 = 1e-3;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Map {
    Same,
    Gripper(Convention),
    Affine { scale: f64, offset: f64 },
}

/// Convention of the second server's gripper, as a function of the first server's value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Convention {
    Inverted,
    /// From −1..1 to 0..1.
    ZeroToOne,
    /// From −1..1 to 1..0.
    OneToZero,
    /// From 0..1 to −1..1.
    FromZeroToOne,
    /// From 0..1 to 1..−1.
    FromOneToZero,
    /// Rounded to −1 or 1.
    Sign,
}

impl Convention {
    const ALL: [Self; 6] = [
        Self::Inverted,
        Self::ZeroToOne,
        Self::OneToZero,
        Self::FromZeroToOne,
        Self::FromOneToZero,
        Self::Sign,
    ];

    fn apply(self, number: f64) -> f64 {
        match self {
            Self::Inverted => -number,
            Self::ZeroToOne => (number + 1.0) / 2.0,
            Self::OneToZero => (1.0 - number) / 2.0,
            Self::FromZeroToOne => 2.0 * number - 1.0,
            Self::FromOneToZero => 1.0 - 2.0 * number,
            Self::Sign => number.signum(),
        }
    }
}

impl Map {
    fn apply(self, number: f64) -> f64 {
        match self {
            Self::Same => number,
            Self::Gripper(convention) => convention.apply(number),
            Self::Affine { scale, offset } => scale * number + offset,
        }
    }

    /// Returns the number of assumptions of the map: an affine map has two parameters.
    fn cost(self) -> u32 {
        match self {
            Self::Same => 0,
            Self::Gripper(_) => 1,
            Self::Affine { .. } => 2,
        }
    }
}

/// Largest root-mean-square difference within which values count as equal, by component of an
/// action.
pub(crate) type Limit = Action;

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Fit {
    /// k if the first server's action k corresponds to the second server's action 0, and −k if the
    /// second server's action k corresponds to the first server's action 0.
    pub shift: i32,
    pub maps: [Map; 7],
    /// Remaining root-mean-square difference of each component.
    pub remaining: Action,
    /// True if the remaining difference is within the limit.
    pub explains: bool,
}

impl Fit {
    pub(crate) fn cost(&self) -> u32 {
        let maps: u32 = self.maps.iter().map(|map| map.cost()).sum();
        maps + u32::from(self.shift != 0)
    }

    pub(crate) fn is_identity(&self) -> bool {
        self.cost() == 0
    }

    /// Returns true if the remaining difference is within `limit`, which may differ from the limit
    /// with which the fit was made.
    pub(crate) fn is_within(&self, limit: &Limit) -> bool {
        self.remaining.iter().zip(limit).all(|(remaining, limit)| remaining <= limit)
    }

    /// Returns the norm of the remaining difference, in units of the limit.
    pub(crate) fn remainder(&self, limit: &Limit) -> f64 {
        let shares = self.remaining.iter().zip(limit);
        shares.map(|(remaining, limit)| (remaining / limit).powi(2)).sum::<f64>().sqrt()
    }
}

/// Returns the simplest map from `first` to `second` whose remaining difference is within `limit`;
/// if there is none, the best map without a shift.
pub(crate) fn fit(first: &Answers, second: &Answers, limit: &Limit) -> Fit {
    let aligned = fit_at_shift(first, second, 0, limit);
    if aligned.explains && aligned.is_identity() {
        return aligned;
    }
    let pairs = first.chunks.iter().zip(&second.chunks);
    let shortest = pairs.map(|(a, b)| a.len().min(b.len())).min().unwrap_or(0);
    // At least half of the chunk must remain to be compared.
    let furthest = (shortest / 2) as i32;
    let shifts = (1..=furthest).flat_map(|by| [by, -by]);
    let shifted = shifts.map(|shift| fit_at_shift(first, second, shift, limit));
    let explaining = shifted.filter(|fit| fit.explains);
    let simplest = explaining.min_by(|a, b| {
        let by_remainder = || a.remainder(limit).total_cmp(&b.remainder(limit));
        a.cost().cmp(&b.cost()).then_with(by_remainder)
    });
    match simplest {
        Some(fit) if !aligned.explains || fit.cost() < aligned.cost() => fit,
        _ => aligned,
    }
}

/// Returns the simplest map from `first` to `second` with the given [`Fit::shift`].
fn fit_at_shift(first: &Answers, second: &Answers, shift: i32, limit: &Limit) -> Fit {
    let (skip_first, skip_second) = (shift.max(0) as usize, (-shift).max(0) as usize);
    let chunks = first.chunks.iter().zip(&second.chunks);
    let rows: Vec<(&Action, &Action)> = chunks
        .flat_map(|(a, b)| a.iter().skip(skip_first).zip(b.iter().skip(skip_second)))
        .collect();
    let mut fit = Fit { shift, maps: [Map::Same; 7], remaining: [0.0; 7], explains: true };
    for component in 0..7 {
        let numbers: Vec<(f64, f64)> =
            rows.iter().map(|(a, b)| (a[component], b[component])).collect();
        let mut simplest = (Map::Same, remaining_difference(&numbers, Map::Same));
        if simplest.1 > limit[component] {
            let conventions = Convention::ALL.map(Map::Gripper);
            let conventions = conventions.into_iter().filter(|_| component == GRIPPER);
            for map in conventions.chain(affine(&numbers)) {
                let remaining = remaining_difference(&numbers, map);
                // Maps are ordered by cost, so the first map within the limit is the simplest.
                if simplest.1 > limit[component] && remaining < simplest.1 {
                    simplest = (map, remaining);
                }
            }
        }
        fit.explains &= simplest.1 <= limit[component];
        (fit.maps[component], fit.remaining[component]) = simplest;
    }
    fit
}

/// Returns the remaining root-mean-square difference after a map.
fn remaining_difference(numbers: &[(f64, f64)], map: Map) -> f64 {
    let squares = numbers.iter().map(|(a, b)| (map.apply(*a) - b).powi(2));
    (squares.sum::<f64>() / numbers.len().max(1) as f64).sqrt()
}

/// Fits scale and offset by least squares. `None` for too few pairs, or if the second value does
/// not depend on the first.
fn affine(numbers: &[(f64, f64)]) -> Option<Map> {
    let count = numbers.len() as f64;
    if numbers.len() < 4 {
        return None;
    }
    let mean = |value: fn(&(f64, f64)) -> f64| numbers.iter().map(value).sum::<f64>() / count;
    let (mean_a, mean_b) = (mean(|pair| pair.0), mean(|pair| pair.1));
    let variance: f64 = numbers.iter().map(|(a, _)| (a - mean_a).powi(2)).sum();
    let covariance: f64 = numbers.iter().map(|(a, b)| (a - mean_a) * (b - mean_b)).sum();
    let scale = match variance / count > 1e-12 {
        true => covariance / variance,
        // If the first server's value is constant, only an offset can be determined.
        false => 1.0,
    };
    (scale.abs() >= LEAST_SCALE).then_some(Map::Affine { scale, offset: mean_b - scale * mean_a })
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMIT: Limit = [1e-3; 7];

    /// Returns eight chunks of four actions without a pattern.
    fn answers() -> Answers {
        let number = |situation: usize, row: usize, component: usize| {
            ((situation * 37 + row * 11 + component * 5) as f64 * 1.7).sin() * 0.8
        };
        let chunk = |situation: usize| {
            (0..4)
                .map(move |row| std::array::from_fn(|component| number(situation, row, component)))
        };
        Answers {
            chunks: (0..8).map(|situation| chunk(situation).collect()).collect(),
            spread: [0.0; 7],
        }
    }

    fn changed(change: impl Fn(&mut Action)) -> Answers {
        let mut changed = answers();
        changed.chunks.iter_mut().flatten().for_each(change);
        changed
    }

    #[test]
    fn equal_actions_fit_without_a_map_and_unrelated_actions_do_not_fit() {
        let same = fit(&answers(), &changed(|action| action[2] += 1e-4), &LIMIT);
        assert!(same.explains && same.is_identity());
        let squared = changed(|action| action[2] = action[2] * action[2]);
        let other = fit(&answers(), &squared, &LIMIT);
        assert!(!other.explains);
        let constant = changed(|action| *action = [0.3; 7]);
        assert!(!fit(&answers(), &constant, &LIMIT).explains);
    }

    #[test]
    fn a_gripper_convention_is_preferred_to_a_scale() {
        for convention in Convention::ALL {
            let other = changed(|action| action[GRIPPER] = convention.apply(action[GRIPPER]));
            let found = fit(&answers(), &other, &LIMIT);
            assert_eq!(found.maps[GRIPPER], Map::Gripper(convention));
            assert!(found.explains && found.cost() == 1);
        }
        let scaled = fit(&answers(), &changed(|action| action[GRIPPER] *= 0.04), &LIMIT);
        let Map::Affine { scale, offset } = scaled.maps[GRIPPER] else {
            panic!("{scaled:?}");
        };
        assert!((scale - 0.04).abs() < 1e-9 && offset.abs() < 1e-9);
    }
}
