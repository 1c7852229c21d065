//! Formats goodness of fit, nuisances and left-out pixels of a likelihood fit as sentences.

use optics_model::fit::{Nuisance, NuisanceEstimate, OutlierPixel, Refined, Stretch};

use farm_figures::misfit::{goodness, is_unlikely};
use farm_figures::numbers::{minus, significant, with_error};

/// Largest number of pixels, and of stretches, that are listed individually.
const MOST: usize = 6;

/// χ² below this share of the degrees of freedom, if there are at least `QUIET_FROM`, shows that the given errors are no
/// noise of single pixels.
const QUIET: f64 = 0.5;
const QUIET_FROM: f64 = 100.0;

/// The warning about data that scatter far less than their errors allow: profiles that were smoothed or simulated have
/// errors that neighbouring pixels share, and averaging over pixels does not make those smaller.
pub(super) fn too_quiet(refined: &Refined) -> Option<String> {
    let l = &refined.likelihood;
    let quiet = l.degrees_of_freedom >= QUIET_FROM && l.chi2 < QUIET * l.degrees_of_freedom;
    let warning = "χ² is too small: pixels scatter less than their errors and the dictionary's noise would have them. If \
                   neighbouring pixels share their errors, as in smoothed or simulated profiles, the intervals are too \
                   narrow; if the errors are too large, they are too wide";
    quiet.then(|| warning.to_owned())
}

/// Findings on the set-up; χ² comes first unless a warning has reported it.
pub(super) fn findings(refined: &Refined) -> Vec<String> {
    let l = &refined.likelihood;
    let goodness = (!is_unlikely(l)).then(|| goodness(l));
    let moved = l.nuisances.iter().filter(|n| moved(n)).map(nuisance).collect::<Vec<_>>();
    let moved = (!moved.is_empty()).then(|| moved.join(", "));
    let first: Vec<String> = goodness.into_iter().chain(moved).collect();
    let first = (!first.is_empty()).then(|| first.join("; "));
    first.into_iter().chain(outliers(&l.outliers)).chain(stretches(&l.stretches)).collect()
}

/// Whether the data add information to the prior of a nuisance.
fn moved(n: &NuisanceEstimate) -> bool {
    (n.value - n.prior).abs() > n.prior_std_error || n.std_error < 0.5 * n.prior_std_error
}

/// `origin −0.070 ± 0.004 mm (0.5 mm)`.
fn nuisance(n: &NuisanceEstimate) -> String {
    let profile = n.profile_mm.map_or(String::new(), |t| format!(" ({t} mm)"));
    let percent = || with_error(100.0 * n.value, 100.0 * n.std_error);
    let plain = || with_error(n.value, n.std_error);
    let text = match n.nuisance {
        // The factor is 1/μ; μ is reported.
        Nuisance::Scale => format!("μ {}", with_error(1.0 / n.value, n.std_error / (n.value * n.value))),
        Nuisance::BlurVariance => format!("blur {}", blur(n.value, n.std_error)),
        Nuisance::Thickness => format!("thickness {} mm", plain()),
        Nuisance::Origin => format!("origin {} mm", plain()),
        Nuisance::Gain => format!("gain {} %", percent()),
        Nuisance::Zero => format!("zero {}", plain()),
        Nuisance::Slope => format!("slope {} % per 10 mm", percent()),
        Nuisance::Wedge => format!("wedge {} % per 10 mm", percent()),
    };
    text + &profile
}

/// A variance in mm² as a standard deviation in µm, d√v = dv / (2√v). Near 0 this is not valid: then only the upper end
/// of its 95 % interval is printed.
fn blur(variance: f64, std_error: f64) -> String {
    if variance > 2.0 * std_error {
        let deviation = variance.sqrt();
        format!("{} µm", with_error(1e3 * deviation, 1e3 * 0.5 * std_error / deviation))
    } else {
        format!("< {} µm", significant(1e3 * (variance.max(0.0) + 2.0 * std_error).sqrt(), 2))
    }
}

/// Deviation in σ below which a pixel was left out because of its neighbours: it may be the rim of a speck.
const RIM: f64 = 3.5;

/// `4 pixels left out: 0.5 mm at x = −1.23, 0.48, 0.51 mm; 1 mm at x = 2.1 mm; and 2 at their rims`.
fn outliers(all: &[OutlierPixel]) -> Option<String> {
    let (pixels, rims): (Vec<OutlierPixel>, Vec<_>) = all.iter().partition(|p| p.deviation.abs() >= RIM);
    let count = match pixels.len() {
        0 => return None,
        1 => "1 pixel".to_owned(),
        n => format!("{n} pixels"),
    };
    let rims = match (rims.len(), pixels.len()) {
        (0, _) => String::new(),
        (n, 1) => format!("; and {n} at its rim"),
        (n, _) => format!("; and {n} at their rims"),
    };
    let mut profiles: Vec<(f64, Vec<String>)> = Vec::new();
    for pixel in &pixels[..pixels.len().min(MOST)] {
        let x = position(pixel.x_mm);
        match profiles.iter_mut().find(|(t, _)| *t == pixel.profile_mm) {
            Some((_, all)) => all.push(x),
            None => profiles.push((pixel.profile_mm, vec![x])),
        }
    }
    let profiles: Vec<String> =
        profiles.iter().map(|(t, x)| format!("{t} mm at x = {} mm", x.join(", "))).collect();
    Some(format!("{count} left out: {}{}{rims}", profiles.join("; "), more(pixels.len())))
}

/// `0.5 mm: x = 1.2…1.6 mm is too bright by 4.1 σ together`.
fn stretches(stretches: &[Stretch]) -> Option<String> {
    let one = |s: &Stretch| {
        let (from, to) = (position(s.from_mm), position(s.to_mm));
        let how = if s.deviation > 0.0 { "bright" } else { "dark" };
        let deviation = significant(s.deviation.abs(), 2);
        format!("{} mm: x = {from}…{to} mm is too {how} by {deviation} σ together", s.profile_mm)
    };
    let text: Vec<String> = stretches.iter().take(MOST).map(one).collect();
    (!text.is_empty()).then(|| text.join("; ") + &more(stretches.len()))
}

fn more(count: usize) -> String {
    if count > MOST { format!("; and {} more", count - MOST) } else { String::new() }
}

/// A position along x, rounded to a micrometre.
fn position(x_mm: f64) -> String {
    // Adding 0 turns −0 into 0.
    let rounded = (1e3 * x_mm).round() / 1e3 + 0.0;
    minus(&rounded.to_string())
}

#[cfg(test)]
mod tests {
    use farm_figures::testing::likelihood;

    use super::*;

    fn estimate(nuisance: Nuisance, value: f64, std_error: f64, prior: (f64, f64)) -> NuisanceEstimate {
        let (prior, prior_std_error) = prior;
        NuisanceEstimate { nuisance, profile_mm: Some(0.5), value, std_error, prior, prior_std_error }
    }

    /// Each nuisance is given in its unit.
    #[test]
    fn each_nuisance_is_given_in_its_unit() {
        for (kind, value, std_error, expected) in [
            (Nuisance::Scale, 1.25, 0.005, "μ 0.800 ± 0.003"),
            (Nuisance::BlurVariance, 6.25e-4, 1e-5, "blur 25.0 ± 0.2 µm"),
            (Nuisance::Thickness, 0.5123, 0.0021, "thickness 0.512 ± 0.002 mm"),
            (Nuisance::Origin, -0.0701, 0.0038, "origin −0.070 ± 0.004 mm"),
            (Nuisance::Gain, 0.0042, 0.001, "gain 0.4 ± 0.1 %"),
            (Nuisance::Zero, -0.001_25, 0.000_31, "zero −0.0013 ± 0.0003"),
            (Nuisance::Slope, 0.0203, 0.0006, "slope 2.03 ± 0.06 % per 10 mm"),
        ] {
            let estimate = estimate(kind, value, std_error, (0.0, 1.0));
            assert_eq!(nuisance(&NuisanceEstimate { profile_mm: None, ..estimate }), expected);
        }
    }

    /// A blur that is compatible with zero has an upper end only.
    #[test]
    fn small_blur_has_only_an_upper_end() {
        assert_eq!(blur(0.0, 1e-4), "< 14 µm");
        assert_eq!(blur(-3e-4, 1e-4), "< 14 µm");
        assert_eq!(blur(1.9e-4, 1e-4), "< 20 µm");
        assert_eq!(blur(2.5e-4, 1e-4), "16 ± 3 µm");
    }

    /// Only nuisances about which the data add information are listed.
    #[test]
    fn only_informed_nuisances_are_listed() {
        let origin = |value, std_error| moved(&estimate(Nuisance::Origin, value, std_error, (0.01, 0.05)));
        assert!(!origin(0.03, 0.03));
        assert!(origin(0.03, 0.024), "much better known than before");
        assert!(origin(-0.041, 0.05), "beyond the prior");
        let held = |value| moved(&estimate(Nuisance::Thickness, value, 0.0, (0.5, 0.0)));
        assert!(!held(0.5) && held(0.51));
    }

    /// Data that scatter less than their standard errors cause a warning.
    #[test]
    fn too_small_scatter_causes_a_warning() {
        let mut refined = farm_figures::testing::channel("R", 6.21, 1.0).refined.unwrap();
        for (chi2, warns) in [(300.0, true), (400.0, false), (716.0, false), (1130.0, false)] {
            refined.likelihood = likelihood(chi2, 1.0);
            assert_eq!(too_quiet(&refined).is_some(), warns, "{chi2} of 716");
        }
    }

    /// Outliers are named by x; beyond the limit they are counted.
    #[test]
    fn outliers_are_named_by_x() {
        let pixel = |profile_mm, x_mm| OutlierPixel { profile_mm, x_mm, deviation: 9.0 };
        let few = [pixel(0.5, -1.23), pixel(0.5, 0.48), pixel(1.0, -0.0001), pixel(0.5, 0.51)];
        let message = "4 pixels left out: 0.5 mm at x = −1.23, 0.48, 0.51 mm; 1 mm at x = 0 mm";
        assert_eq!(outliers(&few).unwrap(), message);
        let many: Vec<_> = (1..=9).map(|i| pixel(0.5, f64::from(i))).collect();
        let message = "9 pixels left out: 0.5 mm at x = 1, 2, 3, 4, 5, 6 mm; and 3 more";
        assert_eq!(outliers(&many).unwrap(), message);
        assert_eq!(outliers(&many[..1]).unwrap(), "1 pixel left out: 0.5 mm at x = 1 mm");
        assert_eq!(outliers(&[]), None);
        let rim = |x_mm| OutlierPixel { deviation: -1.1, ..pixel(0.5, x_mm) };
        let message = "1 pixel left out: 0.5 mm at x = 1 mm; and 2 at its rim";
        assert_eq!(outliers(&[rim(0.9), pixel(0.5, 1.0), rim(1.1)]).unwrap(), message);
        assert!(outliers(&[rim(0.9), many[0], many[1]]).unwrap().ends_with("; and 1 at their rims"));
    }
}
