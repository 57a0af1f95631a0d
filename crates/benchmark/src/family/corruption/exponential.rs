//! Correctly rounded eˣ, for filters whose output depends on the last bit. The libraries that
//! LIBERO-Plus' code calls round these values correctly; libm's `exp` is wrong by one unit in the
//! last place for some.

/// Number of halvings of the argument, which are exact; the result is squared as many times.
const HALVINGS: i32 = 10;
/// Number of terms of the Taylor series of the reduced argument, whose magnitude is below 0.02.
const TERMS: u32 = 9;

/// Double-double number: the sum of two numbers, of which the second is at most half a unit in the
/// last place of the first.
#[derive(Clone, Copy)]
struct Double(f64, f64);

impl Double {
    /// Returns the exact sum of two numbers with |`large`| ≥ |`small`| (Fast2Sum).
    fn sum(large: f64, small: f64) -> Self {
        let sum = large + small;
        Self(sum, small - (sum - large))
    }

    fn times(self, other: Self) -> Self {
        let product = self.0 * other.0;
        let error = self.0.mul_add(other.0, -product);
        Self::sum(product, error + (self.0 * other.1 + self.1 * other.0))
    }

    fn over(self, divisor: f64) -> Self {
        let quotient = self.0 / divisor;
        let rest = (-quotient).mul_add(divisor, self.0) + self.1;
        Self::sum(quotient, rest / divisor)
    }

    fn plus_one(self) -> Self {
        let Self(large, small) = Self::sum(1.0, self.0);
        Self::sum(large, small + self.1)
    }
}

/// Returns eˣ for x from −20 to 0, correctly rounded.
pub(super) fn exp(x: f64) -> f64 {
    debug_assert!((-20.0..=0.0).contains(&x));
    let reduced = Double(x / f64::from(1 << HALVINGS), 0.0);
    // 1 + x (1 + x/2 (1 + x/3 (…)))
    let one = Double(1.0, 0.0);
    let series = (1..=TERMS)
        .rev()
        .fold(one, |sum, term| reduced.times(sum).over(f64::from(term)).plus_one());
    let result = (0..HALVINGS).fold(series, |power, _| power.times(power));
    result.0 + result.1
}

#[cfg(test)]
mod tests {
    use super::exp;

    /// Values of Python's `decimal` with fifty digits, rounded once.
    #[test]
    fn values_are_rounded_correctly() {
        for (x, expected) in [
            (0.0, 1.0),
            (-0.5, 0.606_530_659_712_633_4),
            (-0.031_25, 0.969_233_234_476_344_1),
            (-8.0, 0.000_335_462_627_902_511_84),
            (-1.722_222_222_222_222_3, 0.178_668_664_949_665_13),
        ] {
            assert_eq!(exp(x), expected, "{x}");
        }
    }
}
