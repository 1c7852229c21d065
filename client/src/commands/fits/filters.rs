//! Notes that an absorption changes much within the band of a filter, where one medium cannot describe the profiles, and
//! that a filter probably passes light of other wavelengths.
//!
//! The profile of a band is the mean over its wavelengths. A fit takes it for that of one medium, whose σ_a is off by
//! about s² (½ (ln σ_a)″ − 0.3 (ln σ_a)′²), where s is the standard deviation of the filter: simulated for magenta at the
//! top and on the slope of its line, to a fifth for filters of up to 40 nm. The derivatives are those of the parabola
//! through three neighbouring bands.

use farm_figures::numbers::significant;
use farm_lab::measurement_file::Note;
use optics_model::fit::{ChannelFit, MaterialFit};
use optics_model::measurement::wavelength_nm;

/// Smallest bias that is noted.
const LEAST: f64 = 0.01;
/// Smallest share of the half-width of σ_a's interval that is noted.
const LEAST_OF_INTERVAL: f64 = 0.5;
/// Most bands that a note names.
const MOST_NAMED: usize = 4;

/// A band whose σ_a may be off.
#[derive(Debug)]
struct WideBand {
    name: String,
    /// Relative.
    bias: f64,
}

/// σ_a of a band over the least of its material from which on 1 % of light of other wavelengths shows.
const DARK: f64 = 3.0;
/// Probability below which data are not explained.
const UNEXPLAINED: f64 = 1e-3;

/// Notes materials that are unexplained in bands in which they absorb, and only there: with 1 % of light of another
/// wavelength in all bands p was 1e-55 at the top of magenta's line, 1e-9 on its slopes, and above 0.1 elsewhere.
pub(super) fn leaks(fits: &[MaterialFit]) -> Option<Note> {
    let named = fits.iter().flat_map(unexplained_where_dark).collect::<Vec<_>>().join(", ");
    (!named.is_empty()).then(|| Note {
        code: "LEAKING_FILTER",
        text: format!(
            "unexplained where the material absorbs, and only there: {named}; a filter that passes 1 % of light of other \
             wavelengths does this, and makes σ_a too small: block them by a second filter"
        ),
    })
}

fn unexplained_where_dark(fit: &MaterialFit) -> Vec<String> {
    let band = |channel: &ChannelFit| {
        let (nm, refined) = (wavelength_nm(&channel.channel)?, channel.refined.as_ref()?);
        let is_explained = refined.likelihood.probability >= UNEXPLAINED;
        Some((nm, refined.best.medium.absorption_per_mm(), is_explained))
    };
    let bands: Vec<(f64, f64, bool)> = fit.channels.iter().filter_map(band).collect();
    let least = bands.iter().map(|(_, sigma_a, _)| *sigma_a).fold(f64::INFINITY, f64::min);
    let unexplained = || bands.iter().filter(|(.., is_explained)| !is_explained);
    if unexplained().all(|(_, sigma_a, _)| *sigma_a >= DARK * least) {
        unexplained().map(|(nm, ..)| format!("{} {nm} nm", fit.material)).collect()
    } else {
        Vec::new()
    }
}

/// `widths` are wavelength and standard deviation of each filter in nm. None if the bands are narrow enough.
pub(super) fn wide(fits: &[MaterialFit], widths: &[(f64, f64)]) -> Option<Note> {
    let mut wide: Vec<WideBand> = fits.iter().flat_map(|fit| of_material(fit, widths)).collect();
    wide.sort_by(|a, b| b.bias.total_cmp(&a.bias));
    let count = wide.len();
    let named = wide.iter().take(MOST_NAMED);
    let named = named.map(|band| format!("{} (by {} %)", band.name, significant(100.0 * band.bias, 1)));
    let named = named.collect::<Vec<_>>().join(", ");
    let more = if count > MOST_NAMED { format!(" and {} more", count - MOST_NAMED) } else { String::new() };
    (count > 0).then(|| Note {
        code: "WIDE_BANDS",
        text: format!(
            "the absorption changes so much within the band that σ_a may be off: {named}{more}; take narrower filters there"
        ),
    })
}

fn of_material(fit: &MaterialFit, widths: &[(f64, f64)]) -> Vec<WideBand> {
    let known = |channel: &ChannelFit| {
        let (nm, refined) = (wavelength_nm(&channel.channel)?, channel.refined.as_ref()?);
        let sigma_a = refined.best.medium.absorption_per_mm();
        let interval = refined.absorption_per_mm;
        (sigma_a > 0.0).then(|| (nm, libm::log(sigma_a), 0.5 * (interval.high - interval.low) / sigma_a))
    };
    let mut bands: Vec<(f64, f64, f64)> = fit.channels.iter().filter_map(known).collect();
    bands.sort_by(|a, b| a.0.total_cmp(&b.0));
    if bands.len() < 3 {
        return Vec::new();
    }
    let wide = |i: usize| {
        let first = i.saturating_sub(1).min(bands.len() - 3);
        let (nm, _, half_width) = bands[i];
        let (_, std_dev_nm) = widths.iter().find(|(of, _)| *of == nm)?;
        let (slope, curvature) = derivatives(&bands[first..first + 3], nm);
        let bias = std_dev_nm.powi(2) * (0.5 * curvature - 0.3 * slope * slope).abs();
        let is_large = bias > LEAST && bias > LEAST_OF_INTERVAL * half_width;
        is_large.then(|| WideBand { name: format!("{} {nm} nm", fit.material), bias })
    };
    (0..bands.len()).filter_map(wide).collect()
}

/// First and second derivative at `nm` of the parabola through three points.
fn derivatives(points: &[(f64, f64, f64)], nm: f64) -> (f64, f64) {
    let [(x0, y0, _), (x1, y1, _), (x2, y2, _)] = *points else { return (0.0, 0.0) };
    let (first, second) = ((y1 - y0) / (x1 - x0), (y2 - y1) / (x2 - x1));
    let half = (second - first) / (x2 - x0);
    (first + half * (2.0 * nm - x0 - x1), 2.0 * half)
}

#[cfg(test)]
mod tests {
    use farm_figures::testing;
    use optics_model::Medium;

    use super::*;

    /// Bands of a Gaussian line of 40 nm at 550 nm, whose σ_a is known to 1 %.
    fn line(wavelengths: &[f64]) -> MaterialFit {
        let channel = |nm: &f64| {
            let sigma_a = 1.2 * libm::exp(-0.5 * ((nm - 550.0) / 40.0).powi(2));
            let mut channel = testing::channel(&nm.to_string(), 5.0 + sigma_a, 1.0);
            let refined = channel.refined.as_mut().unwrap();
            refined.best.medium = Medium::new(5.0 + sigma_a, 5.0 / (5.0 + sigma_a), 0.4).unwrap();
            (refined.absorption_per_mm.low, refined.absorption_per_mm.high) =
                (0.99 * sigma_a, 1.01 * sigma_a);
            channel
        };
        MaterialFit { material: "magenta".into(), channels: wavelengths.iter().map(channel).collect() }
    }

    /// Misfits in dark bands alone are noted; those of a single band, or in bright ones, have other causes.
    #[test]
    fn misfits_where_dark_are_leaks() {
        let of = |unexplained: &[&str]| {
            let mut fit = line(&[430.0, 470.0, 550.0]);
            for channel in &mut fit.channels {
                let is_unexplained = unexplained.contains(&channel.channel.as_str());
                channel.refined.as_mut().unwrap().likelihood.probability =
                    if is_unexplained { 1e-9 } else { 0.4 };
            }
            leaks(&[fit]).map(|note| note.text)
        };
        assert!(of(&["550"]).unwrap().contains("only there: magenta 550 nm; a filter"), "{:?}", of(&["550"]));
        assert_eq!([of(&[]), of(&["430", "550"]), of(&["430"])], [None, None, None]);
    }

    /// Biases of simulated filters of 40 nm were 9 % at the top and 17 % on the slope, of 10 nm 0.5 and 1.4 %.
    #[test]
    fn wide_bands_are_noted() {
        let wavelengths = [500.0, 550.0, 600.0];
        let widths = |fwhm: f64| wavelengths.map(|nm| (nm, fwhm / 2.3548));
        let biases: Vec<f64> =
            of_material(&line(&wavelengths), &widths(40.0)).iter().map(|band| band.bias).collect();
        for (found, simulated) in biases.iter().zip([0.17, 0.09, 0.17]) {
            assert!((found / simulated - 1.0).abs() < 0.2, "{biases:?}");
        }
        let text = wide(&[line(&wavelengths)], &widths(40.0)).unwrap().text;
        assert!(text.contains("magenta 500 nm (by 17 %)"), "{text}");
        assert_eq!(of_material(&line(&wavelengths), &widths(10.0)).len(), 2, "the slopes");
        assert_eq!(wide(&[line(&wavelengths)], &widths(3.0)), None);
        assert_eq!(wide(&[line(&[500.0, 550.0])], &widths(40.0)), None, "two bands have no curvature");
    }
}
