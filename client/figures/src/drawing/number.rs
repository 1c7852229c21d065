//! Formats numbers for labels.

/// A number with at most `digits` significant digits, no trailing zeros and a typographic minus sign.
pub(crate) fn number(value: f64, digits: i32) -> String {
    if value == 0.0 || !value.is_finite() {
        return if value == 0.0 { "0".to_owned() } else { value.to_string() };
    }
    let exponent = libm::log10(value.abs()).floor() as i32;
    if !(-5..=5).contains(&exponent) {
        let mantissa = number(value / 10_f64.powi(exponent), digits);
        return format!("{mantissa}·10^{{{}}}", signed(&exponent.to_string()));
    }
    let decimals = usize::try_from(digits - 1 - exponent).unwrap_or(0);
    let text = format!("{value:.decimals$}");
    let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    signed(text)
}

/// Text of a number with the typographic minus.
pub(crate) fn signed(text: &str) -> String {
    text.replace('-', "−")
}

/// The double nearest to mantissa · 10^exponent.
pub(crate) fn scientific(mantissa: i32, exponent: i32) -> f64 {
    // Parsing gives the nearest double to 2e-5, a product need not.
    format!("{mantissa}e{exponent}").parse().unwrap_or(f64::NAN)
}

/// The label of a multiple of a step of 1, 2 or 5 times a power of ten.
pub(crate) fn even_label(value: f64, step_exponent: i32) -> String {
    if value == 0.0 {
        return "0".to_owned();
    }
    if !(-5..=4).contains(&step_exponent) {
        return number(value, 4);
    }
    let decimals = usize::try_from(-step_exponent).unwrap_or(0);
    signed(&format!("{value:.decimals$}"))
}

/// The label of a tick on a logarithmic axis, as a power of ten if the axis is labelled so.
pub(crate) fn logarithmic_label(mantissa: i32, exponent: i32, powers: bool) -> String {
    match (powers, mantissa) {
        (false, _) => number(scientific(mantissa, exponent), 1),
        (true, 1) => format!("10^{{{}}}", signed(&exponent.to_string())),
        (true, _) => format!("{mantissa}·10^{{{}}}", signed(&exponent.to_string())),
    }
}

/// A length to a hundredth of a pixel, without trailing zeros.
pub(crate) fn short(length: f64) -> String {
    let text = format!("{length:.2}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers in labels have as few digits as possible.
    #[test]
    fn numbers_have_few_digits() {
        let message = [0.5, 0.9991, -2.25, 1e-7, 12.0, 0.0].map(|v| number(v, 6));
        assert_eq!(message, ["0.5", "0.9991", "−2.25", "1·10^{−7}", "12", "0"]);
    }
}
