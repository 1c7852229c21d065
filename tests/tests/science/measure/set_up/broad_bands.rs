//! Bands so wide that the medium changes within them: what a fit with one medium makes of their profiles.

use farm_tests::photograph::SpectralMaterial;
use optics_fit::{MeasurePlan, measure};
use optics_model::fit::{Bounds, FitOptions, FitSettings};
use optics_model::{MeasuredProfile, Measurement, Medium};

use super::scenes::lab;
use super::session::{NOISE, Nodes, SLABS_MM, WALKS, dictionary, traced};

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
    let mut values = vec![0.0; scene.sensor().pixels()];
    for (u, weight) in NODES {
        let medium = with_g(&material.at(nm + u * fwhm_nm / FWHM));
        let of_node = traced(scene.clone(), &medium, slab_mm, WALKS, 7);
        values.iter_mut().zip(of_node).for_each(|(sum, v)| *sum += weight * v);
    }
    let x = (0..values.len()).map(|i| scene.sensor().centre_mm(i)).collect();
    let std_errors = values.iter().map(|v| NOISE * v).collect();
    MeasuredProfile::new("R", slab_mm, x, values, Some(std_errors)).unwrap()
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
            let found =
                measure(dictionary(Nodes::Paper, true), &[material], &options, &MeasurePlan::default());
            found.unwrap().materials[0].channels[0].refined.clone().unwrap()
        };
        let truth = with_g(&magenta.at(nm));
        let of = |m: &Medium| [m.sigma_t_per_mm(), m.absorption_per_mm()];
        let both = fitted(&SLABS_MM);
        let off = |of_fit: f64, of_truth: f64| 100.0 * (of_fit / of_truth - 1.0);
        let found = of(&both.best.medium);
        let ends = [both.absorption_per_mm.low, both.absorption_per_mm.high].map(|v| off(v, of(&truth)[1]));
        let single = SLABS_MM.map(|mm| off(of(&fitted(&[mm]).best.medium)[1], of(&truth)[1]));
        println!(
            "| {nm} | {fwhm_nm} | {:+.1} % | {:+.1} %, {:+.1} to {:+.1} | {:+.1}, {:+.1} % | {:.3} |",
            off(found[0], of(&truth)[0]),
            off(found[1], of(&truth)[1]),
            ends[0],
            ends[1],
            single[0],
            single[1],
            both.likelihood.probability
        );
        let holds = ends[0] <= 0.0 && ends[1] >= 0.0;
        assert!(holds || fwhm_nm > 20.0, "{nm} nm, {fwhm_nm} nm wide");
    }
}
