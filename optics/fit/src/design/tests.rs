//! Tests the bounds of designs on a dictionary that is computed from a formula.

use optics_model::fit::{
    Bounds, DesignQuestion, DesignSettings, Ends, FitOptions, FitSettings, HalfWidths, Limitation, Objective,
    PixelRow, SlabSet, Z,
};
use optics_model::grid::Axes;
use optics_model::{Invalid, MeasuredProfile, Measurement, Medium};

use super::design;
use crate::testing::{
    centres, dense, dense_axes, exact_set_up, noisy_dictionary, profile_value, uncertain_dictionary,
};
use crate::{FitDictionary, fit};

const PIXELS: u32 = 360;
/// Noise of a pixel as a share of its value; pixels of these tests have no other noise.
const NOISE: f64 = 0.01;

fn guess() -> Medium {
    Medium::new(3.1, 0.62, 0.3).unwrap()
}

fn dictionary(axes: Axes) -> FitDictionary {
    noisy_dictionary(axes, PIXELS, 0.0)
}

fn all_dense() -> &'static FitDictionary {
    dense(PIXELS, 0.0)
}

fn wide_set_up() -> FitSettings {
    FitSettings {
        objective: Some(Objective::Likelihood),
        refine: true,
        g: Bounds::fixed(0.3),
        ..FitSettings::default()
    }
}

fn settings(medium: Medium, set_up: FitSettings, sets: &[&[f64]], shots: &[u32]) -> DesignSettings {
    DesignSettings {
        channel: Some("G".to_owned()),
        slab_sets: sets.iter().map(|s| s.to_vec()).collect(),
        shots: shots.to_vec(),
        noise: NOISE,
        noise_floor: 0.0,
        set_up: FitOptions::new(set_up).unwrap(),
        ..DesignSettings::of(medium)
    }
}

fn sets(dictionary: &FitDictionary, settings: DesignSettings) -> Vec<SlabSet> {
    design(dictionary, &DesignQuestion::new(settings).unwrap()).unwrap().sets
}

fn close(found: f64, expected: f64, share: f64) {
    assert!((found / expected - 1.0).abs() < share, "{found}, expected {expected}");
}

/// The half-widths with g held.
fn determined(set: &SlabSet) -> [f64; 4] {
    let w = set.g_held;
    [w.sigma_t_per_mm, w.albedo, w.reduced_scattering_per_mm, w.absorption_per_mm]
}

/// With σ_t alone unknown the variance is 1/Σ (∂f/∂ln σ_t)²/σ². Between the nodes the derivative comes from a local
/// polynomial, which is accurate to 2 %.
#[test]
fn one_unknown_has_the_textbook_variance() {
    let dictionary = dictionary(Axes { albedo: vec![0.62], g: vec![0.3], ..dense_axes() });
    let found = sets(&dictionary, settings(guess(), exact_set_up(), &[&[0.5], &[1.0], &[0.5, 1.0]], &[1]));
    let information = |thickness: f64| -> f64 {
        let value = |x: f64, sigma_t: f64| profile_value(x, sigma_t, 0.62, 0.3, thickness, 1.0);
        let pixel_information = |x: f64| {
            let step: f64 = 1e-4;
            let slope = (value(x, 3.1 * libm::exp(step)) - value(x, 3.1 * libm::exp(-step))) / (2.0 * step);
            (slope / (NOISE * value(x, 3.1))).powi(2)
        };
        centres(PIXELS as usize).into_iter().map(pixel_information).sum()
    };
    let half_width = |information: f64| 3.1 * Z / information.sqrt();
    let [thin, thick] = [0.5, 1.0].map(information);
    for (set, information) in found.iter().zip([thin, thick, thin + thick]) {
        close(set.g_held.sigma_t_per_mm, half_width(information), 0.02);
        assert_eq!((set.g_held.albedo, set.g_held.g, set.g_free), (0.0, 0.0, None));
    }
}

/// The formula is proportional to the albedo, and so is every profile to its own gain: the two variances add up for one
/// slab, and the mean of two slabs has half of each.
#[test]
fn set_up_errors_add_to_the_noise() {
    let dictionary = dictionary(Axes { sigma_t_per_mm: vec![3.1], g: vec![0.3], ..dense_axes() });
    let set_up = FitSettings { gain_std_error: 0.004, ..exact_set_up() };
    let found = sets(&dictionary, settings(guess(), set_up, &[&[0.5], &[0.5, 0.5]], &[1]));
    let of_one = (NOISE * NOISE / f64::from(PIXELS) + 0.004 * 0.004).sqrt();
    close(found[0].g_held.albedo, 0.62 * Z * of_one, 1e-3);
    close(found[1].g_held.albedo, 0.62 * Z * of_one / 2.0_f64.sqrt(), 1e-3);
    // A common factor does not average out.
    let set_up = FitSettings { mu_std_error: 0.004, ..exact_set_up() };
    let found = sets(&dictionary, settings(guess(), set_up, &[&[0.5, 0.5]], &[1]));
    let of_two = (NOISE * NOISE / f64::from(2 * PIXELS) + 0.004 * 0.004).sqrt();
    close(found[0].g_held.albedo, 0.62 * Z * of_two, 1e-3);
    // With an unknown factor the albedo is undetermined, however many slabs there are.
    let unknown = DesignSettings { mu_free: true, ..settings(guess(), exact_set_up(), &[&[0.5, 0.5]], &[1]) };
    let found = sets(&dictionary, unknown);
    assert!(found[0].g_held.albedo.is_infinite(), "{:?}", found[0].g_held);
    let scale = found[0].improvements.iter().find(|i| i.limitation == Limitation::Scale).unwrap();
    assert_eq!((scale.std_error, scale.halved), (None, None));
    close(scale.removed.unwrap().albedo, 0.62 * Z * NOISE / f64::from(2 * PIXELS).sqrt(), 1e-3);
}

/// Twice the shots reduce the standard error by √2 only as far as it comes from noise.
#[test]
fn two_shots_halve_only_the_noise_variance() {
    let dictionary = all_dense();
    let found = sets(dictionary, settings(guess(), exact_set_up(), &[&[0.5, 1.0]], &[1, 2]));
    for (one, two) in determined(&found[0]).into_iter().zip(determined(&found[1])) {
        close(one / two, 2.0_f64.sqrt(), 1e-3);
    }
    // More photographs of the same slab with the same lamp do not determine its thickness or the lamp's evenness.
    let real = sets(dictionary, settings(guess(), FitSettings::default(), &[&[0.5, 1.0]], &[1, 2]));
    for (one, two) in determined(&real[0]).into_iter().zip(determined(&real[1])) {
        assert!((1.0..1.35).contains(&(one / two)), "{one} {two}");
    }
}

/// A set with more slabs determines a medium at least as well.
#[test]
fn more_slabs_never_hurt() {
    let dictionary = all_dense();
    let chains: [&[&[f64]]; 3] = [
        &[&[0.5], &[0.5, 0.5], &[0.5, 0.5, 1.0], &[0.5, 0.5, 1.0, 1.0]],
        &[&[1.0], &[0.5, 1.0], &[0.5, 0.7, 1.0]],
        &[&[0.7], &[0.7, 0.7], &[0.7, 0.7, 0.7]],
    ];
    for chain in chains {
        for mu_free in [false, true] {
            let asked = DesignSettings { mu_free, ..settings(guess(), FitSettings::default(), chain, &[1]) };
            let found = sets(dictionary, asked);
            for pair in found.windows(2) {
                let [fewer, more] = pair else { unreachable!("windows of two") };
                for (few, many) in determined(fewer).into_iter().zip(determined(more)) {
                    assert!(many <= few * (1.0 + 1e-9), "{fewer:?} {more:?}");
                }
                assert!(more.g_held.sigma_t_per_mm < fewer.g_held.sigma_t_per_mm, "{fewer:?} {more:?}");
            }
        }
    }
}

/// The measurement as it is planned, without the noise that its standard errors state, so that a fit finds the guess. The
/// bound of a noisy one is that at its optimum, a little away from the truth.
fn as_planned(medium: &Medium) -> Measurement {
    let (s, a, g) = (medium.sigma_t_per_mm(), medium.albedo(), medium.g());
    let profile = |thickness: f64| {
        let x = centres(120);
        let values: Vec<f64> = x.iter().map(|x| profile_value(*x, s, a, g, thickness, 1.0)).collect();
        let std_errors = values.iter().map(|v| NOISE * v).collect();
        MeasuredProfile::new("G", thickness, x, values, Some(std_errors)).unwrap()
    };
    Measurement::new("planned", vec![profile(0.5), profile(1.0)]).unwrap()
}

/// A fit of the planned measurement gives the bound that the design predicts, and an interval of its width. Uncertain
/// quantities of the scene are unknowns of both bounds, with their priors; if they are known exactly, the bounds are those
/// of the exact scene.
#[test]
fn fit_has_the_bound_of_its_design() {
    let [narrow, wide] = [0, 1].map(|uncertain| {
        let dictionary = &uncertain_dictionary(uncertain);
        let set_up = FitSettings { mu_std_error: 0.01, wedge_std_error: 0.0, ..wide_set_up() };
        let options = FitOptions::new(set_up).unwrap();
        let found = fit(dictionary, &as_planned(&guess()), &options).unwrap().channels.remove(0);
        let refined = found.refined.unwrap();
        let bound = refined.likelihood.bound;
        let planned = sets(dictionary, settings(guess(), set_up, &[&[0.5, 1.0]], &[1])).remove(0);
        let half = |ends: Ends| 0.5 * (ends.high - ends.low);
        let widths = planned.g_held;
        close(widths.sigma_t_per_mm, half(bound.sigma_t_per_mm), 0.01);
        close(widths.albedo, half(bound.albedo), 0.01);
        close(widths.reduced_scattering_per_mm, half(bound.reduced_scattering_per_mm), 0.01);
        close(widths.absorption_per_mm, half(bound.absorption_per_mm), 0.01);
        assert_eq!((widths.g, half(bound.g)), (0.0, 0.0));
        let interval = refined.sigma_t_per_mm;
        close(0.5 * (interval.high - interval.low), widths.sigma_t_per_mm, 0.1);
        planned
    });
    let [few, many] = [&narrow, &wide].map(|set| set.g_held.sigma_t_per_mm);
    assert!(many > 1.1 * few, "{many} {few}");
    let of_gel = wide.improvements.iter().find(|i| i.limitation == Limitation::Scene).unwrap();
    assert_eq!(of_gel.quantity.as_deref(), Some("gel thickness"));
    close(of_gel.removed.unwrap().sigma_t_per_mm, few, 1e-3);
    assert!(narrow.improvements.iter().all(|i| i.limitation != Limitation::Scene));
}

/// The formula depends on σ_t and g through σ_t (1 − g) alone.
#[test]
fn undetermined_parameters_are_reported_so() {
    let dictionary = all_dense();
    let set = &sets(dictionary, settings(guess(), FitSettings::default(), &[&[0.5, 1.0]], &[1]))[0];
    let free = set.g_free.unwrap();
    assert!(free.sigma_t_per_mm.is_infinite() && free.g.is_infinite(), "{free:?}");
    // Their combination is determined nevertheless.
    assert!(free.of_reduced_scattering(&guess()) < 0.1, "{free:?}");
    assert!(set.g_held.of_sigma_t(&guess()) < 0.05, "{:?}", set.g_held);
}

/// A predicted improvement equals the bound of the better set-up, which is smaller; parts that are exact already are not
/// listed.
#[test]
fn improvements_match_a_better_set_up() {
    let as_is = FitSettings { mu_std_error: 0.01, blur_mm: 0.02, ..FitSettings::default() };
    let plan = |set_up: FitSettings, shots: u32| {
        sets(all_dense(), settings(guess(), set_up, &[&[0.5, 1.0]], &[shots])).remove(0)
    };
    let listed = |set: &SlabSet| set.improvements.iter().map(|i| i.limitation).collect::<Vec<_>>();
    let set = plan(as_is, 1);
    let mut all = listed(&set);
    assert_eq!(
        all.iter().map(|l| format!("{l:?}")).collect::<Vec<_>>().join(" "),
        "Noise Thickness Origin Blur Gain Zero Slope Wedge Scale"
    );
    all.retain(|limitation| *limitation != Limitation::Slope);
    assert_eq!(listed(&plan(FitSettings { slope_std_error: 0.0, ..as_is }, 1)), all);
    for improvement in &set.improvements {
        let with = |factor: f64| {
            let mut set_up = as_is;
            match improvement.limitation {
                Limitation::Noise => return plan(as_is, (1.0 / (factor * factor)) as u32).g_held,
                Limitation::Thickness => set_up.thickness_std_error_mm *= factor,
                Limitation::Origin => set_up.origin_std_error_mm *= factor,
                Limitation::Blur => set_up.blur_std_error_mm *= factor,
                Limitation::Gain => set_up.gain_std_error *= factor,
                Limitation::Zero => set_up.offset_std_error *= factor,
                Limitation::Slope => set_up.slope_std_error *= factor,
                Limitation::Wedge => set_up.wedge_std_error *= factor,
                Limitation::Scale => set_up.mu_std_error *= factor,
                Limitation::Scene => unreachable!("the scene is exact"),
            }
            plan(set_up, 1).g_held
        };
        let same = |a: HalfWidths, b: HalfWidths, most: f64| {
            close(a.sigma_t_per_mm, b.sigma_t_per_mm, 1e-9);
            close(a.albedo, b.albedo, 1e-9);
            assert!(a.sigma_t_per_mm <= most * (1.0 + 1e-9), "{improvement:?}");
        };
        let halved = improvement.halved.unwrap();
        same(halved, with(0.5), set.g_held.sigma_t_per_mm);
        improvement.removed.into_iter().for_each(|removed| same(removed, with(0.0), halved.sigma_t_per_mm));
    }
}

/// Two slabs are better than two photographs of one, since each has its own error.
#[test]
fn slab_sets_combine_with_best_marked() {
    let found = sets(all_dense(), settings(guess(), FitSettings::default(), &[], &[1, 2]));
    let tried: Vec<String> = found.iter().map(|s| format!("{:?} {}", s.slabs_mm, s.shots)).collect();
    assert_eq!(tried, ["[0.5] 1", "[0.5] 2", "[1.0] 1", "[1.0] 2", "[0.5, 1.0] 1", "[0.5, 1.0] 2"]);
    let best: Vec<usize> = (0..found.len()).filter(|i| found[*i].best).collect();
    assert_eq!(best, [5]);
    let of_one = found.iter().filter(|s| s.best_of_its_effort && s.photographs() == 1).count();
    assert_eq!(of_one, 1);
    // Two slabs determine more than two photographs of one: their errors are independent.
    assert!(found[4].best_of_its_effort && !found[1].best_of_its_effort && !found[3].best_of_its_effort);
    assert_eq!(super::choices(&[1.0, 2.0, 3.0], 2), [[1.0, 2.0], [1.0, 3.0], [2.0, 3.0]]);
}

/// Designs that the dictionary does not cover are refused with the field; in a dictionary of one medium nothing can be
/// determined.
#[test]
fn designs_beyond_the_dictionary_are_refused() {
    let dictionary = all_dense();
    let refused = |settings: DesignSettings| -> Invalid {
        design(dictionary, &DesignQuestion::new(settings).unwrap()).unwrap_err()
    };
    let plain = || settings(guess(), FitSettings::default(), &[&[0.5]], &[1]);
    let slab = refused(DesignSettings { slab_sets: vec![vec![0.5], vec![0.5, 0.25]], ..plain() });
    assert_eq!((slab.field(), slab.given()), ("slab_sets[1][1]", "0.25"));
    assert!(slab.allowed().contains("thickness_mm = [0.25, 0.5, 1]"), "{slab}");
    assert!(slab.allowed().contains("farmctl submit GRID.toml"), "{slab}");
    let medium_outside = |sigma_t, albedo, g| Medium::new(sigma_t, albedo, g).unwrap();
    for (medium, field, given) in [
        (medium_outside(40.0, 0.62, 0.3), "sigma_t_per_mm", "40"),
        (medium_outside(3.1, 0.999, 0.3), "albedo", "0.999"),
        (medium_outside(3.1, 0.62, 0.9), "g", "0.9"),
    ] {
        let error = refused(DesignSettings { medium, ..plain() });
        assert_eq!((error.field(), error.given()), (field, given));
    }
    let wide = PixelRow::new(-6.0, 6.0, 0.1).unwrap();
    assert_eq!(refused(DesignSettings { pixels: Some(wide), ..plain() }).field(), "pixels");
    assert_eq!(refused(DesignSettings { channel: Some("X".to_owned()), ..plain() }).field(), "channel");
    assert_eq!(refused(DesignSettings { sample_ior: Some(1.7), ..plain() }).field(), "sample_ior");
    let axes = Axes { sigma_t_per_mm: vec![3.1], albedo: vec![0.62], g: vec![0.3], ..dense_axes() };
    let question = DesignQuestion::new(plain()).unwrap();
    assert_eq!(design(&self::dictionary(axes), &question).unwrap_err().field(), "dictionary");
}

/// Pixels that cover only a part of the profile determine less.
#[test]
fn fewer_pixels_widen_the_errors() {
    let dictionary = all_dense();
    let with = |pixels: Option<PixelRow>| {
        let asked = settings(guess(), FitSettings::default(), &[&[0.5, 1.0]], &[1]);
        sets(dictionary, DesignSettings { pixels, ..asked })[0].g_held.sigma_t_per_mm
    };
    let own = with(None);
    close(with(PixelRow::new(-5.0, 5.0, 10.0 / 360.0).ok()), own, 1e-9);
    let coarse = with(PixelRow::new(-5.0, 5.0, 10.0 / 90.0).ok());
    let half = with(PixelRow::new(-5.0, 0.0, 10.0 / 360.0).ok());
    assert!(coarse > 1.1 * own && half > 1.1 * own, "{own} {coarse} {half}");
}
