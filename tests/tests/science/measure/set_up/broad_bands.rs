//! Bands so wide that the medium changes within them: what a fit with one medium makes of their profiles.

use farm_tests::coverage::Answer;
use farm_tests::photograph::SpectralMaterial;
use optics_fit::{MeasurePlan, measure};
use optics_model::fit::{Bounds, FitOptions, FitSettings, Interval};
use optics_model::{MeasuredProfile, Measurement, Medium};

use super::scenes::lab;
use super::session::{NOISE, Nodes, WALKS, dictionary};
use crate::measure::{SLABS_MM, centres_mm, traced, values};

/// Standard deviations of a Gaussian filter over its full width at half maximum.
const FWHM: f64 = 2.354_820_045;
/// Places of the filter that are traced: Gauss–Hermite quadrature, exact to the ninth order.
const NODES: [(f64, f64); 5] = [
    (-2.856_970_013_872_806, 0.011_257_411_327_720_69),
    (-1.355_626_179_974_266, 0.222_075_922_005_612_7),
    (0.0, 0.533_333_333_333_333_3),
    (1.355_626_179_974_266, 0.222_075_922_005_612_7),
    (2.856_970_013_872_806, 0.011_257_411_327_720_69),
];

/// The profile of a slab through a filter, without the error of a photograph but with its noise.
fn profile(material: &SpectralMaterial, nm: f64, fwhm_nm: f64, slab_mm: f64) -> MeasuredProfile {
    let scene = lab();
    let mut sum = vec![0.0; scene.sensor().pixels()];
    for (u, weight) in NODES {
        let medium = with_g(&material.at(nm + u * fwhm_nm / FWHM));
        let of_node = values(&traced(&scene, &medium, slab_mm, WALKS, 7), 0);
        sum.iter_mut().zip(of_node).for_each(|(sum, v)| *sum += weight * v);
    }
    let std_errors = sum.iter().map(|v| NOISE * v).collect();
    MeasuredProfile::new("R", slab_mm, centres_mm(&scene), sum, Some(std_errors)).unwrap()
}

/// g is given: the filter's effect on it is not the subject.
fn with_g(medium: &Medium) -> Medium {
    Medium::new(medium.sigma_t_per_mm(), medium.albedo(), 0.4).unwrap()
}

/// Prints what filters of several widths make of magenta, at the top and on the slope of its line.
#[test]
#[ignore = "long form"]
fn broad_bands_bias_absorption() {
    let magenta = &SpectralMaterial::ALL[1];
    println!("| nm | FWHM | σ_t off | σ_a off, 95 % | σ_a of 0.5 and 1 mm alone | p |");
    for (nm, fwhm_nm) in [550.0, 600.0].into_iter().flat_map(|nm| [1.0, 10.0, 40.0, 80.0].map(|f| (nm, f))) {
        let fitted = |slabs: &[f64]| {
            let profiles = slabs.iter().map(|mm| profile(magenta, nm, fwhm_nm, *mm)).collect();
            let material = Measurement::new("magenta", profiles).unwrap();
            let settings = FitSettings { refine: true, g: Bounds::fixed(0.4), ..FitSettings::default() };
            let options = FitOptions::new(settings).unwrap();
            let found = measure(dictionary(Nodes::Lab, true), &[material], &options, &MeasurePlan::default());
            Answer::all(&found.unwrap().materials, [&with_g(&magenta.at(nm))]).remove(0)
        };
        let both = fitted(&SLABS_MM);
        let [sigma_t, _, _, absorption, _] = both.medium;
        let Interval { low, high, .. } = absorption.interval;
        let ends = [low, high].map(|end| 100.0 * (end / absorption.truth - 1.0));
        let single = SLABS_MM.map(|mm| 100.0 * fitted(&[mm]).medium[3].error());
        println!(
            "| {nm} | {fwhm_nm} | {:+.1} % | {:+.1} %, {:+.1} to {:+.1} | {:+.1}, {:+.1} % | {:.3} |",
            100.0 * sigma_t.error(),
            100.0 * absorption.error(),
            ends[0],
            ends[1],
            single[0],
            single[1],
            both.probability()
        );
        let holds = ends[0] <= 0.0 && ends[1] >= 0.0;
        assert!(holds || fwhm_nm > 20.0, "{nm} nm, {fwhm_nm} nm wide");
    }
}
