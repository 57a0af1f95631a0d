//! Which variants: filters of the command line.

use clap::Args;
use libero_ctrl::Suite;
use libero_family::plus::{Dimension, Entry, Variant, entry, inventory};

use super::error::VariantsError;

/// Which variants of LIBERO-Plus; those that are of everything that is given.
#[derive(Clone, Debug, Default, Args)]
pub struct Choice {
    /// Variants by the benchmark's names, separated by commas [default: all 10,030]
    #[arg(long = "variant", value_name = "NAME,...", value_delimiter = ',')]
    pub variants: Vec<Variant>,
    /// Those of suites: libero_spatial, libero_object, libero_goal, libero_10
    #[arg(long = "suite", value_name = "SUITE,...", value_delimiter = ',')]
    pub suites: Vec<Suite>,
    /// Those of dimensions: background, robot, camera, language, noise, layout,
    /// light
    #[arg(long = "dimension", value_name = "NAME,...", value_delimiter = ',')]
    pub dimensions: Vec<Dimension>,
    /// Those of difficulties, 1 to 5; 0: those that have none
    #[arg(long = "difficulty", value_name = "N,...", value_delimiter = ',', value_parser = clap::value_parser!(u8).range(0..=5))]
    pub difficulties: Vec<u8>,
}

impl Choice {
    /// The chosen variants in the benchmark's order.
    ///
    /// # Errors
    /// If there is none, or the benchmark does not have one that is named.
    pub fn entries(&self) -> Result<Vec<&'static Entry>, VariantsError> {
        if let Some(unused) = self.variants.iter().find(|it| entry(it).is_none()) {
            return Err(VariantsError::Unused {
                name: unused.to_string(),
            });
        }
        let chosen = inventory().iter().filter(|entry| {
            is_of(&self.variants, &entry.variant)
                && is_of(&self.suites, &entry.variant.task.suite())
                && is_of(&self.dimensions, &entry.dimension())
                && is_of(&self.difficulties, &entry.difficulty.unwrap_or(0))
        });
        let chosen: Vec<_> = chosen.collect();
        match chosen.is_empty() {
            true => Err(VariantsError::Nothing),
            false => Ok(chosen),
        }
    }
}

/// True if nothing was asked for, or this was.
fn is_of<T: PartialEq>(asked: &[T], found: &T) -> bool {
    asked.is_empty() || asked.contains(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn filters_are_met_all_at_once() {
        let all = Choice::default();
        assert_eq!(all.entries().unwrap().len(), 10_030);
        let some = Choice {
            suites: vec![Suite::Goal],
            dimensions: vec![Dimension::Light],
            difficulties: vec![0],
            ..Choice::default()
        };
        assert_eq!(some.entries().unwrap().len(), 121);
        let none = Choice {
            suites: vec![Suite::Spatial],
            ..some
        };
        assert!(matches!(none.entries(), Err(VariantsError::Nothing)));
        let unused = "turn_on_the_stove_table_19".parse().unwrap();
        let unused = Choice {
            variants: vec![unused],
            ..Choice::default()
        };
        assert!(matches!(
            unused.entries(),
            Err(VariantsError::Unused { .. })
        ));
    }
}
