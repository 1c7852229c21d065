//! Errors of the levels that the media's parameters absorb, so that χ² does not show them: a camera's curve, a wrong
//! factor.

use std::sync::OnceLock;

use optics_fit::{MeasurePlan, measure};
use optics_model::fit::{Cause, FitOptions, FitSettings};
use optics_model::{MeasuredProfile, Measurement, Medium};

use super::{dictionary, materials, unknown_factor};

/// A white, a cyan and a black at g = 0.4, all off the grid, in channels R, G and B.
fn clean() -> &'static [Measurement] {
    static CLEAN: OnceLock<Vec<Measurement>> = OnceLock::new();
    CLEAN.get_or_init(|| {
        let media = [
            [(6.2, 0.9992), (9.3, 0.9996), (22.0, 0.999)],
            [(3.3, 0.62), (4.4, 0.966), (7.4, 0.988)],
            [(5.6, 0.33), (5.3, 0.36), (5.1, 0.41)],
        ];
        let medium = |(sigma_t, albedo)| Medium::new(sigma_t, albedo, 0.4).unwrap();
        let media = media.map(|channels| channels.map(medium));
        materials(["m0", "m1", "m2"].into_iter().zip(media), 70_000, 1_000_000, 1.0)
    })
}

/// The suspected cause of every channel with changed values; None if no channel has one.
fn suspected(change: fn(f64) -> f64, mu: Option<f64>) -> Option<(Cause, f64)> {
    let profile = |p: &MeasuredProfile| {
        let values = p.values().iter().map(|v| change(*v)).collect();
        let slope = |v: f64| (change(v * 1.001) - change(v * 0.999)) / (0.002 * v);
        let pixels = p.values().iter().zip(p.std_errors().unwrap());
        let std_errors = pixels.map(|(v, e)| e * slope(*v)).collect();
        let (channel, x_mm) = (p.channel(), p.x_mm().to_vec());
        MeasuredProfile::new(channel, p.thickness_mm(), x_mm, values, Some(std_errors)).unwrap()
    };
    let material =
        |m: &Measurement| Measurement::new(m.material(), m.profiles().iter().map(profile).collect());
    let changed: Vec<Measurement> = clean().iter().map(|m| material(m).unwrap()).collect();
    let options = FitOptions::new(FitSettings { mu: mu.unwrap_or(1.0), ..FitSettings::default() }).unwrap();
    let plan = if mu.is_none() { unknown_factor() } else { MeasurePlan::default() };
    let found = measure(dictionary(), &changed, &options, &plan).unwrap();
    let channels = found.materials.iter().flat_map(|m| &m.channels);
    let all: Vec<_> = channels.map(|c| c.refined.as_ref().unwrap().suspicion).collect();
    println!("{:?}: μ {:.3}", all[0], found.common.mu);
    let all: Vec<_> = all.into_iter().map(|s| s.map(|s| (s.cause, s.amount))).collect();
    assert!(all.windows(2).all(|pair| pair[0] == pair[1]), "{all:?}");
    all[0]
}

fn is(found: Option<(Cause, f64)>, cause: Cause, amount: f64, within: f64) -> bool {
    found.is_some_and(|f| f.0 == cause && (f.1 - amount).abs() <= within)
}

/// 0.9 is a mild camera curve. sRGB is no power: between 0.45 and 0.57 from bright to dark values, and found as less, near
/// the end of the range of exponents (e⁻¹), since media absorb a part.
#[test]
fn camera_curve_is_named_with_its_exponent() {
    assert_eq!(suspected(|v| v, None), None);
    assert_eq!(suspected(|v| 0.95 * v, None), None, "a factor is estimated");
    let curved = suspected(|v| libm::pow(v, 0.9), None);
    assert!(is(curved, Cause::Exponent, 0.9, 0.02), "{curved:?}");
    let steep = suspected(|v| libm::pow(v, 1.1), None);
    assert!(is(steep, Cause::Exponent, 1.1, 0.03), "{steep:?}");
    let srgb = suspected(
        |v| if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * libm::pow(v, 1.0 / 2.4) - 0.055 },
        None,
    );
    assert!(is(srgb, Cause::Exponent, 0.42, 0.08), "{srgb:?}");
}

/// The given factor is wrong by a typical error of the white reference.
#[test]
fn contradicted_scale_factor_is_named() {
    assert_eq!(suspected(|v| v, Some(1.0)), None);
    let bright = suspected(|v| 1.1 * v, Some(1.0));
    assert!(is(bright, Cause::Gain, 0.1, 0.02), "{bright:?}");
    let dark = suspected(|v| 0.71 * v, Some(1.0));
    assert!(is(dark, Cause::Gain, -0.29, 0.03), "{dark:?}");
}
