//! Compares the wavelengths of a chart with those of the media: values between two wavelengths are interpolated.

use optics_model::measurement::wavelength_nm;

/// Widest gap between two wavelengths of a chart within which values are interpolated.
const WIDEST_GAP_NM: f64 = 20.0;
/// Wavelengths this near to those that are compared take part in the interpolation.
const SPACING_NM: f64 = 10.0;

/// Value and standard error in a channel of the media: that of the same channel, or between two wavelengths. None if the
/// chart has neither.
pub(super) fn measured_at(name: &str, measured: &[(&str, f64, f64)]) -> Option<(f64, f64)> {
    if let Some((_, value, error)) = measured.iter().find(|(channel, ..)| *channel == name) {
        return Some((*value, *error));
    }
    let nm = wavelength_nm(name)?;
    let places = || measured.iter().filter_map(|m| Some((wavelength_nm(m.0)?, m.1, m.2)));
    let below = places().filter(|(at, ..)| *at <= nm).max_by(|a, b| a.0.total_cmp(&b.0))?;
    let above = places().filter(|(at, ..)| *at >= nm).min_by(|a, b| a.0.total_cmp(&b.0))?;
    let gap = above.0 - below.0;
    if gap > WIDEST_GAP_NM {
        return None;
    }
    let share = if gap > 0.0 { (nm - below.0) / gap } else { 0.0 };
    let mean = |a: f64, b: f64| a + share * (b - a);
    Some((mean(below.1, above.1), libm::hypot((1.0 - share) * below.2, share * above.2)))
}

/// Channels of the chart beyond those that are compared.
pub(super) fn left_out<'a>(measured: impl Iterator<Item = &'a str>, compared: &[String]) -> Vec<String> {
    let nm: Vec<f64> = compared.iter().filter_map(|name| wavelength_nm(name)).collect();
    let (first, last) =
        (nm.iter().copied().fold(f64::INFINITY, f64::min), nm.iter().copied().fold(0.0, f64::max));
    let is_used = |channel: &str| {
        let is_between =
            wavelength_nm(channel).is_some_and(|nm| nm > first - SPACING_NM && nm < last + SPACING_NM);
        is_between || compared.iter().any(|name| name == channel)
    };
    let mut names: Vec<String> = Vec::new();
    for channel in measured {
        if !is_used(channel) && !names.iter().any(|name| name == channel) {
            names.push(channel.to_owned());
        }
    }
    names
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Between two wavelengths of a chart values are interpolated, with their errors, but not over a wide gap.
    #[test]
    fn wavelengths_of_charts_are_interpolated() {
        let chart = [("385", 0.2, 0.01), ("395", 0.3, 0.01), ("450", 0.5, 0.01), ("R", 0.7, 0.02)];
        let (value, error) = measured_at("390", &chart).unwrap();
        assert!(
            (value - 0.25).abs() < 1e-12 && (error - 0.01 / 2_f64.sqrt()).abs() < 1e-12,
            "{value} {error}"
        );
        assert_eq!(measured_at("385", &chart), Some((0.2, 0.01)));
        assert_eq!(measured_at("R", &chart), Some((0.7, 0.02)));
        for outside in ["380", "420", "460", "G"] {
            assert_eq!(measured_at(outside, &chart), None, "{outside}");
        }
        let channels = chart.iter().map(|(channel, ..)| *channel);
        assert_eq!(left_out(channels, &["390".to_owned()]), ["450", "R"]);
    }
}
