//! Levels: the severity of a perturbation. The units of a radius on each axis are in
//! `presets`.

use std::fmt;
use std::str::FromStr;

use crate::names::{UnknownName, serde_as_text};

/// Severity: the radius of a perturbation in normalised coordinates, in which
/// every parameter of an axis is divided by its unit.
///
/// LIBERO-CTRL names four radii; radius 4, for example, is written `L2`. Any other radius
/// is written as a number with up to six decimals, such as `r2.5`. Levels are ordered by
/// radius. `L0` is the level of nominal rollouts and, for perturbed rollouts, the placebo
/// level, whose radius is stored in the rows ([`crate::Placebo`]).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Level {
    // An integer, so that a level equals the level parsed from its text.
    radius_micros: u32,
    /// True for a level of a benchmark whose radii LIBERO-CTRL does not name; see
    /// [`Self::without_name`].
    is_nameless: bool,
}

impl Level {
    /// Radius 0 for nominal rollouts; the placebo level for perturbed rollouts.
    pub const L0: Self = Self::of_whole_radius(0);
    pub const L1: Self = Self::of_whole_radius(2);
    pub const L2: Self = Self::of_whole_radius(4);
    pub const L3: Self = Self::of_whole_radius(8);

    pub const PERTURBED: [Self; 3] = [Self::L1, Self::L2, Self::L3];

    /// Returns the level of a radius, rounded to six decimals; `None` if the rounded radius is
    /// not from 0.001 to 100.
    pub fn of_radius(radius: f64) -> Option<Self> {
        let radius_micros = (radius * f64::from(MICROS)).round();
        let valid = f64::from(MIN_MICROS)..=f64::from(MAX_MICROS);
        valid.contains(&radius_micros).then_some(Self::of_radius_micros(radius_micros as u32))
    }

    pub fn radius(self) -> f64 {
        f64::from(self.radius_micros) / f64::from(MICROS)
    }

    pub fn is_named(self) -> bool {
        Self::PERTURBED.contains(&self)
    }

    /// Returns the level of the same radius that is written as a number: the names stand for the
    /// units of LIBERO's calibration, which another benchmark does not have. L0 keeps its name.
    pub(crate) fn without_name(self) -> Self {
        Self { is_nameless: self != Self::L0, ..self }
    }

    const fn of_whole_radius(radius: u32) -> Self {
        Self::of_radius_micros(radius * MICROS)
    }

    pub(crate) const fn of_radius_micros(radius_micros: u32) -> Self {
        Self { radius_micros, is_nameless: false }
    }
}

impl fmt::Display for Level {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some((name, _)) = NAMES.iter().find(|(_, level)| level == self) {
            return f.pad(name);
        }
        let (whole, micros) = (self.radius_micros / MICROS, self.radius_micros % MICROS);
        let decimals = format!("{micros:06}");
        let decimals = decimals.trim_end_matches('0');
        let point = if decimals.is_empty() { "" } else { "." };
        f.pad(&format!("r{whole}{point}{decimals}"))
    }
}

impl FromStr for Level {
    type Err = UnknownName;

    fn from_str(text: &str) -> Result<Self, UnknownName> {
        if let Some((_, level)) = NAMES.iter().find(|(name, _)| *name == text) {
            return Ok(*level);
        }
        let radius = text.strip_prefix('r').and_then(micros);
        radius
            .filter(|radius| (MIN_MICROS..=MAX_MICROS).contains(radius))
            .map(Self::of_radius_micros)
            .ok_or_else(|| UnknownName::new("level", text, &VALID))
    }
}

serde_as_text!(Level);

const NAMES: [(&str, Level); 4] =
    [("L0", Level::L0), ("L1", Level::L1), ("L2", Level::L2), ("L3", Level::L3)];

const VALID: [&str; 5] = ["L0", "L1", "L2", "L3", "or a radius from r0.001 to r100"];

const MICROS: u32 = 1_000_000;
const DECIMALS: usize = 6;
/// Smallest radius, micros; below it, some parameters would be rounded to zero.
const MIN_MICROS: u32 = MICROS / 1_000;
/// Largest radius, micros: well below the radius, about 500, at which a light's brightness
/// overflows single precision.
const MAX_MICROS: u32 = 100 * MICROS;

fn micros(text: &str) -> Option<u32> {
    let (whole, decimals) = text.split_once('.').unwrap_or((text, "0"));
    let has_only_digits = |text: &str| !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit());
    if !has_only_digits(whole) || !has_only_digits(decimals) || decimals.len() > DECIMALS {
        return None;
    }
    let whole = whole.parse::<u32>().ok()?.checked_mul(MICROS)?;
    let micros: u32 = format!("{decimals:0<DECIMALS$}").parse().ok()?;
    whole.checked_add(micros)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_level_is_parsed_from_its_text() {
        let check = |text: &str, radius: f64| {
            let level: Level = text.parse().expect("a level");
            assert_eq!(level.to_string(), text);
            assert_eq!(level.radius(), radius, "{text}");
        };
        check("r2.5", 2.5);
        check("r1.632993", 1.632993);
        check("r0.001", 0.001);
        check("r16", 16.0);
        check("r100", 100.0);
        check("L0", 0.0);
        check("L3", 8.0);
    }

    #[test]
    fn a_radius_is_rounded_to_six_decimals() {
        for text in ["r0.001", "r0.1", "r2.675", "L2", "r99.999999", "r100"] {
            let level: Level = text.parse().expect("a level");
            assert_eq!(Level::of_radius(level.radius()), Some(level), "{text}");
        }
        assert_eq!(Level::of_radius(1.0 / 3.0), "r0.333333".parse().ok());
        for radius in [0.0, 0.0004, -2.0, 100.1, f64::NAN, f64::INFINITY] {
            assert_eq!(Level::of_radius(radius), None, "{radius}");
        }
    }

    #[test]
    fn texts_of_equal_radii_are_the_same_level() {
        assert_eq!("r4".parse(), Ok(Level::L2));
        assert_eq!("r2.000".parse(), Ok(Level::L1));
        assert_eq!("r2.50".parse::<Level>(), "r2.5".parse());
    }

    #[test]
    fn levels_are_ordered_by_radius() {
        let mut levels: Vec<Level> =
            ["L3", "r2.5", "L1", "r10", "L2"].map(|text| text.parse().expect("a level")).to_vec();
        levels.sort();
        let texts: Vec<String> = levels.iter().map(Level::to_string).collect();
        assert_eq!(texts, ["L1", "r2.5", "L2", "L3", "r10"]);
    }

    #[test]
    fn an_invalid_radius_is_refused() {
        for text in [
            "",
            "r",
            "r0",
            "r-1",
            "r+1",
            "r.5",
            "r1.",
            "r1.2345678",
            "r1e3",
            "rnan",
            "r0.0009",
            "r100.000001",
            "r99999999999",
            "L4",
            "2.5",
        ] {
            let error = text.parse::<Level>().expect_err(text).to_string();
            assert!(error.contains("r0.001 to r100"), "{error}");
        }
    }
}
