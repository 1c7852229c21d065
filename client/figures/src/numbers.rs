//! Formats numbers with their meaningful digits only.

use optics_model::fit::{Interval, SlabSet};

/// Longest name of a material in a table of 80 columns.
const LONGEST_NAME: usize = 8;

/// A name with its end cut off where it would make a table too wide.
pub fn short(name: &str) -> String {
    if name.chars().count() <= LONGEST_NAME {
        return name.to_owned();
    }
    name.chars().take(LONGEST_NAME - 1).chain(['…']).collect()
}

/// A number with `digits` significant digits, without trailing zeros.
pub fn significant(value: f64, digits: i32) -> String {
    if value == 0.0 || !value.is_finite() {
        return value.to_string();
    }
    let decimals = (digits - 1 - libm::log10(value.abs()).floor() as i32).clamp(0, 12) as usize;
    let text = format!("{value:.decimals$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

/// `−0.070 ± 0.004`: the error with one digit, and the value with as many decimals.
pub fn with_error(value: f64, std_error: f64) -> String {
    to_error(value, std_error, 1).join(" ± ")
}

/// An error with these digits, and before it the value with as many decimals.
pub fn to_error(value: f64, std_error: f64, digits: i32) -> [String; 2] {
    if !(std_error > 0.0 && std_error.is_finite()) {
        return [minus(&significant(value, 4)), significant(std_error, 1)];
    }
    let decimals = |error: f64| (digits - 1 - libm::log10(error).floor() as i32).clamp(0, 12) as usize;
    // 0.0997 is 0.10.
    let rounded = format!("{std_error:.*}", decimals(std_error)).parse().unwrap_or(std_error);
    let decimals = decimals(rounded);
    [fixed(value, decimals), format!("{std_error:.decimals$}")]
}

/// A number with these decimals and the typographic minus sign, which zero does not have.
pub fn fixed(value: f64, decimals: usize) -> String {
    let value = format!("{value:.decimals$}");
    if value.contains(|c| ('1'..='9').contains(&c)) { minus(&value) } else { value.replace('-', "") }
}

/// A number with the typographic minus sign.
pub fn minus(number: &str) -> String {
    number.replace('-', "−")
}

/// An albedo with enough digits that 1 − α has three.
pub fn albedo(value: f64) -> String {
    let co_albedo = 1.0 - value;
    if co_albedo <= 0.0 {
        return "1".to_owned();
    }
    let decimals = (2 - libm::log10(co_albedo).floor() as i32).clamp(2, 9) as usize;
    let text = format!("{value:.decimals$}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// An albedo with enough digits that 1 − α has two, for the ends of intervals.
pub fn albedo_end(value: f64) -> String {
    let co_albedo = 1.0 - value;
    let decimals = if co_albedo <= 0.0 { 2 } else { (1 - libm::log10(co_albedo).floor() as i32).clamp(2, 6) };
    let text = format!("{value:.*}", decimals as usize);
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// `5.96…6.17`, with ≤ and ≥ where the data set no bound. Both ends have the decimals of half the width, two digits if it
/// begins with 1 to 4, else one, and more where an end would round to 0 or 1. `alone` formats an end that stands alone.
pub fn interval(i: &Interval, alone: impl Fn(f64) -> String) -> String {
    match (i.open_low, i.open_high) {
        (false, false) if i.low == i.high => "held".to_owned(),
        (false, false) => {
            let half = 0.5 * (i.high - i.low).abs();
            let enough = (-libm::log10(0.2 * half).floor()).clamp(0.0, 9.0) as usize;
            // No end is rounded to 0 or 1.
            let rounds_away = |end: f64, decimals: usize| {
                let shown: f64 = format!("{end:.decimals$}").parse().unwrap_or(end);
                shown != end && (shown == 0.0 || shown == 1.0)
            };
            let decimals = (enough..9).find(|d| ![i.low, i.high].iter().any(|end| rounds_away(*end, *d)));
            let decimals = decimals.unwrap_or(9);
            minus(&format!("{:.decimals$}…{:.decimals$}", i.low, i.high))
        }
        (true, false) => format!("≤ {}", alone(i.high)),
        (false, true) => format!("≥ {}", alone(i.low)),
        (true, true) => "any".to_owned(),
    }
}

/// The thicknesses of a set of slabs: `0.5 + 1`.
pub fn slabs(set: &SlabSet) -> String {
    set.slabs_mm.iter().map(f64::to_string).collect::<Vec<_>>().join(" + ")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers have as many digits as they need.
    #[test]
    fn numbers_have_only_needed_digits() {
        let message = [6.0, 5.994, 0.12345, 24.04, 123.4, 0.0].map(|v| significant(v, 3));
        assert_eq!(message, ["6", "5.99", "0.123", "24", "123", "0"]);
        assert_eq!(
            [0.05, 0.9991, 0.999_903, 0.35, 1.0].map(albedo),
            ["0.05", "0.9991", "0.999903", "0.35", "1"]
        );
    }

    /// A value has as many decimals as its standard error.
    #[test]
    fn value_has_the_decimals_of_its_error() {
        let message = |value, error| with_error(value, error);
        assert_eq!(message(-0.0701, 0.0038), "−0.070 ± 0.004");
        assert_eq!(message(0.5, 0.0096), "0.50 ± 0.01");
        assert_eq!(message(123.4, 20.0), "123 ± 20");
        assert_eq!(message(-0.0001, 0.004), "0.000 ± 0.004");
        assert_eq!(message(0.5, 0.0), "0.5 ± 0");
        assert_eq!([-0.004, -0.006, 1.25].map(|v| fixed(v, 2)), ["0.00", "−0.01", "1.25"]);
    }

    /// Intervals are marked where the data set no bound.
    #[test]
    fn intervals_mark_missing_bounds() {
        let text = |low, high, open_low, open_high| {
            interval(&Interval { low, high, open_low, open_high }, |v| significant(v, 2))
        };
        assert_eq!(text(1.0, 2.0, false, false), "1.0…2.0");
        assert_eq!(text(0.8954, 0.9006, false, false), "0.8954…0.9006");
        assert_eq!(text(0.9795, 0.98068, false, false), "0.9795…0.9807");
        assert_eq!(text(5.96, 6.171, false, false), "5.96…6.17");
        assert_eq!(text(5.16, 12.8, false, false), "5.2…12.8");
        assert_eq!(text(20.0, 190.0, false, false), "20…190");
        assert_eq!(text(0.3, 35.0, false, false), "0.3…35.0");
        assert_eq!(text(0.9902, 0.99996, false, false), "0.99020…0.99996");
        assert_eq!(text(-0.03, 0.98, false, false), "−0.03…0.98");
        assert_eq!(text(0.0, 0.5, false, false), "0.00…0.50");
        assert_eq!(text(1.0, 2.0, true, false), "≤ 2");
        assert_eq!(text(1.0, 2.0, false, true), "≥ 1");
        assert_eq!(text(1.0, 2.0, true, true), "any");
        assert_eq!(text(0.4, 0.4, false, false), "held");
    }
}
