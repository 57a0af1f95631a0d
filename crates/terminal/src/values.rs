//! Parsers of option values, whose errors name the valid range and unit.

use std::fmt::Display;
use std::net::SocketAddr;
use std::ops::RangeInclusive;
use std::str::FromStr;

/// Returns a parser of whole numbers in a range: `number(1..=3600, "seconds")`. The unit may be
/// empty.
pub fn number<T>(
    range: RangeInclusive<T>,
    unit: &'static str,
) -> impl Fn(&str) -> Result<T, String> + Clone
where
    T: FromStr + PartialOrd + Display + Clone,
{
    move |text| match text.parse() {
        Ok(number) if range.contains(&number) => Ok(number),
        _ => Err(format!("write {}, {} to {}", whole(unit), range.start(), range.end())),
    }
}

/// Returns a parser of whole numbers from `first` on.
pub fn number_from<T>(first: T, unit: &'static str) -> impl Fn(&str) -> Result<T, String> + Clone
where
    T: FromStr + PartialOrd + Display + Clone,
{
    move |text| match text.parse() {
        Ok(number) if number >= first => Ok(number),
        Ok(_) => Err(format!("write {}, {first} or more", whole(unit))),
        // Too large for the type, or not a number.
        Err(_) if is_whole(text) => Err(format!("write a smaller number, {first} or more")),
        Err(_) => Err(format!("write {}, {first} or more", whole(unit))),
    }
}

/// Returns a parser of seconds in a range, which may have a decimal point.
pub fn seconds(range: RangeInclusive<f64>) -> impl Fn(&str) -> Result<f64, String> + Clone {
    decimal(range, "seconds")
}

/// Returns a parser of numbers in a range with a unit, which may have a decimal point.
pub fn decimal(
    range: RangeInclusive<f64>,
    unit: &'static str,
) -> impl Fn(&str) -> Result<f64, String> + Clone {
    move |text| match text.parse() {
        Ok(number) if range.contains(&number) => Ok(number),
        _ => Err(format!("write a number of {unit}, {} to {}", range.start(), range.end())),
    }
}

pub fn address(text: &str) -> Result<SocketAddr, &'static str> {
    text.parse().map_err(|_| {
        "write an IP address and a port, such as 127.0.0.1:7411, or 0.0.0.0:7411 for all of this \
         machine's addresses"
    })
}

fn whole(unit: &str) -> String {
    match unit {
        "" => "a whole number".to_owned(),
        unit => format!("a whole number of {unit}"),
    }
}

fn is_whole(text: &str) -> bool {
    !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_outside_its_range_is_refused_with_range_and_unit() {
        let read = number(1..=3600_u32, "seconds");
        assert_eq!(read("3600"), Ok(3600));
        let words = "write a whole number of seconds, 1 to 3600";
        for invalid in ["0", "3601", "-1", "1.5", "", "many", "99999999999"] {
            assert_eq!(read(invalid), Err(words.to_owned()), "{invalid}");
        }
        let read = number_from(1_u32, "rollouts");
        assert_eq!(read("7"), Ok(7));
        let words = "write a whole number of rollouts, 1 or more";
        assert_eq!(read("0"), Err(words.to_owned()));
        assert_eq!(read("x"), Err(words.to_owned()));
        let words = "write a smaller number, 1 or more";
        assert_eq!(read("99999999999"), Err(words.to_owned()));
    }

    #[test]
    fn seconds_may_have_a_decimal_point_and_must_be_finite() {
        let read = seconds(0.1..=3600.0);
        assert_eq!(read("0.5"), Ok(0.5));
        for invalid in ["0", "inf", "NaN", "soon"] {
            let words = "write a number of seconds, 0.1 to 3600";
            assert_eq!(read(invalid), Err(words.to_owned()), "{invalid}");
        }
    }

    #[test]
    fn an_address_without_a_port_is_refused_with_an_example() {
        assert!(address("[::1]:0").is_ok());
        for invalid in ["", "7411", "127.0.0.1", "localhost:7411", "nowhere"] {
            assert!(address(invalid).is_err_and(|words| words.contains("127.0.0.1:7411")));
        }
    }
}
