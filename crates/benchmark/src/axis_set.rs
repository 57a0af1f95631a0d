use std::fmt;
use std::str::FromStr;
use std::sync::LazyLock;

use crate::axis::{AXES, Axis};
use crate::names::{UnknownName, serde_as_text};

/// A set of axes, written in the order of [`AXES`]: `camera+robot`. The empty set
/// is written `none`.
///
/// Sets are ordered by size, then by their axes in the order of [`AXES`], so that
/// every set follows its subsets.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct AxisSet(u16);

impl AxisSet {
    pub const EMPTY: Self = Self(0);
    /// The protocol's axes, [`Axis::ALL`].
    pub const ALL: Self = Self((1 << Axis::ALL.len()) - 1);

    pub const fn of(axis: Axis) -> Self {
        Self(1 << axis as u8)
    }

    pub const fn len(self) -> usize {
        self.0.count_ones() as usize
    }

    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    pub const fn contains(self, axis: Axis) -> bool {
        self.0 & (1 << axis as u8) != 0
    }

    pub const fn is_subset(self, other: Self) -> bool {
        self.0 & other.0 == self.0
    }

    pub const fn is_proper_subset(self, other: Self) -> bool {
        self.is_subset(other) && self.0 != other.0
    }

    pub const fn union(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    pub const fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }

    /// Returns the axes of the set that *simultaneous* perturbs.
    pub const fn combined(self) -> Self {
        Self(self.0 & Self::ALL.0)
    }

    /// Returns the axes' names with `+` between, or `none`.
    pub fn name(self) -> &'static str {
        &NAMES[usize::from(self.0)]
    }

    /// Returns the axes in the order of [`AXES`].
    pub fn axes(self) -> impl Iterator<Item = Axis> + Clone {
        Axis::every().filter(move |&axis| self.contains(axis))
    }

    /// Returns all subsets, sorted, from the empty set to this set.
    pub fn subsets(self) -> Vec<Self> {
        let mut subsets: Vec<Self> =
            (0..=self.0).map(Self).filter(|set| set.is_subset(self)).collect();
        subsets.sort();
        subsets
    }
}

impl FromIterator<Axis> for AxisSet {
    fn from_iter<I: IntoIterator<Item = Axis>>(axes: I) -> Self {
        axes.into_iter().fold(Self::EMPTY, |set, axis| set.union(Self::of(axis)))
    }
}

impl Ord for AxisSet {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        // The smaller set comes first. Between sets of equal size, the earliest axis that only one
        // of them contains decides: the set with this axis comes first.
        let by_axes = || other.0.reverse_bits().cmp(&self.0.reverse_bits());
        self.len().cmp(&other.len()).then_with(by_axes)
    }
}

impl PartialOrd for AxisSet {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

const EMPTY: &str = "none";

/// Names of all sets; the index of a name is the set's bits.
static NAMES: LazyLock<Vec<String>> = LazyLock::new(|| {
    let name = |bits| {
        let names: Vec<&str> = AxisSet(bits).axes().map(Axis::name).collect();
        if names.is_empty() { EMPTY.to_owned() } else { names.join("+") }
    };
    (0..1 << AXES.len()).map(name).collect()
});

impl fmt::Display for AxisSet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for AxisSet {
    type Err = UnknownName;

    /// Parses axes in any order, each at most once.
    fn from_str(text: &str) -> Result<Self, UnknownName> {
        if text == EMPTY {
            return Ok(Self::EMPTY);
        }
        let mut set = Self::EMPTY;
        for name in text.split('+') {
            let axis: Axis = name.parse()?;
            if !axis.def().is_combined {
                return Err(UnknownName::new("axis", name, &Axis::ALL.map(Axis::name)));
            }
            if set.contains(axis) {
                let valid = ["axes with + between, each once, such as camera+robot"];
                return Err(UnknownName::new("set of axes", text, &valid));
            }
            set = set.union(Self::of(axis));
        }
        Ok(set)
    }
}

serde_as_text!(AxisSet);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_64_sets_are_parsed_from_their_text_and_sorted_after_their_subsets() {
        assert_eq!(AxisSet::from_iter(Axis::ALL), AxisSet::ALL);
        let sets = AxisSet::ALL.subsets();
        assert_eq!(sets.len(), 64);
        for (i, &set) in sets.iter().enumerate() {
            assert_eq!(set.to_string().parse(), Ok(set));
            assert_eq!(set.axes().collect::<AxisSet>(), set);
            assert!(sets[..i].iter().all(|earlier| !set.is_subset(*earlier)));
            assert!(set.is_subset(set) && !set.is_proper_subset(set));
        }
        let names: Vec<String> = sets[7..10].iter().map(AxisSet::to_string).collect();
        assert_eq!(
            names,
            ["camera+lighting", "camera+robot", "camera+sensor"],
            "pairs in the protocol's order"
        );
    }

    #[test]
    fn axes_may_be_in_any_order_and_occur_only_once() {
        let set: AxisSet = "robot+camera".parse().expect("a set");
        assert_eq!(set.to_string(), "camera+robot");
        for text in ["camera+camera", "camera+", "camera robot", ""] {
            assert!(text.parse::<AxisSet>().is_err(), "{text}");
        }
    }
}
