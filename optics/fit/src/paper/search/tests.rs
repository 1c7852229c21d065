use optics_model::fit::{Bounds, Candidate, FitOptions, FitSettings, MuRange, Objective, Outside, Wavelet};
use optics_model::{MeasuredProfile, Measurement, Medium};

use crate::testing::{
    coarse_axes, dictionary, dictionary_of, exact_record, measured, noisy_records, profile_value,
    rounded_dictionary_of,
};
use crate::{FitDictionary, derivative, fit, scale};

fn options(change: impl FnOnce(&mut FitSettings)) -> FitOptions {
    let mut settings = FitSettings { objective: Some(Objective::Paper), ..FitSettings::default() };
    change(&mut settings);
    FitOptions::new(settings).unwrap()
}

fn best(dictionary: &FitDictionary, m: &Measurement, options: &FitOptions) -> Vec<Candidate> {
    fit(dictionary, m, options).unwrap().channels.remove(0).candidates
}

#[test]
fn medium_that_was_measured_is_found() {
    let dictionary = dictionary(360);
    for (sigma_t, albedo, g) in [(1.0, 0.3, 0.4), (4.0, 0.9, 0.0), (8.0, 0.6, 0.4)] {
        for (pixels, width) in [(360, 10.0), (720, 10.0), (90, 10.0), (200, 6.0)] {
            let m = measured(sigma_t, albedo, g, pixels, width);
            let found = &best(&dictionary, &m, &options(|_| {}))[0];
            let expected = Medium::new(sigma_t, albedo, g).unwrap();
            assert_eq!(found.medium, expected, "{pixels} pixels over {width} mm");
        }
    }
}

/// Eqs. 1 and 2, evaluated directly for every medium.
fn brute_force(dictionary: &FitDictionary, m: &Measurement, options: &FitOptions) -> Vec<(f64, Medium)> {
    let grid = dictionary.grid();
    let mut all = Vec::new();
    for (s, &sigma_t) in grid.sigma_t_per_mm().iter().enumerate() {
        for (g, &anisotropy) in grid.g().iter().enumerate() {
            for (a, &albedo) in grid.albedo().iter().enumerate() {
                let mut error = 0.0;
                for (t, profile) in m.profiles().iter().enumerate() {
                    let record = grid.record_at(0, s, g, t, a);
                    let simulated: Vec<f64> =
                        dictionary.values(record, 1).iter().map(|v| f64::from(*v)).collect();
                    let f: Vec<f64> = profile.values().iter().map(|v| options.settings().mu * v).collect();
                    let slope = |f: &[f64]| derivative(f, Wavelet::QuadraticSpline, 4);
                    let rms = |a: &[f64], b: &[f64]| {
                        (a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f64>() / a.len() as f64).sqrt()
                    };
                    // Per sample of 10 mm / 360, whatever the pitch of the profile.
                    let scale = simulated.len() as f64 / 360.0;
                    let abs = |f: Vec<f64>| f.into_iter().map(|v| v.abs() * scale).collect::<Vec<_>>();
                    error += rms(&f, &simulated);
                    error += options.settings().lambda * rms(&abs(slope(&f)), &abs(slope(&simulated)));
                }
                all.push((error, Medium::new(sigma_t, albedo, anisotropy).unwrap()));
            }
        }
    }
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    all
}

/// The search finds the same candidates as a comparison with every record.
#[test]
fn search_equals_brute_force() {
    let rounded = || {
        let (grid, record) = noisy_records(coarse_axes(), 90, 0.0);
        rounded_dictionary_of(&grid, record)
    };
    for (pixels, dictionary) in [(360, dictionary(360)), (90, dictionary(90)), (90, rounded())] {
        let m = measured(3.0, 0.7, 0.2, pixels as usize, 10.0);
        let all = options(|s| {
            s.lambda = 5.0;
            s.mu = 0.9;
            s.top = 24;
        });
        let one = options(|s| s.top = 1);
        for options in [options(|_| {}), all, one] {
            let found = best(&dictionary, &m, &options);
            let expected = brute_force(&dictionary, &m, &options);
            assert_eq!(found.len(), options.settings().top as usize);
            for (candidate, (error, medium)) in found.iter().zip(&expected) {
                assert_eq!(candidate.medium, *medium);
                assert!((candidate.error - error).abs() < 1e-6, "{} {error}", candidate.error);
                let lambda = options.settings().lambda;
                let sum: f64 =
                    candidate.thicknesses.iter().map(|t| t.value_rms + lambda * t.gradient_rms).sum();
                assert!((sum - candidate.error).abs() < 1e-12, "it is the sum of its terms");
                let record = candidate.thicknesses[1].record.unwrap();
                let (point, medium) = dictionary.grid().parameters(record);
                assert_eq!((point.thickness_mm(), medium), (1.0, candidate.medium));
            }
        }
    }
}

/// A dictionary whose profiles depend on the extinction alone: all media with the same one are equally good.
#[test]
fn equal_errors_keep_the_record_order() {
    let grid = dictionary(360).grid().clone();
    let value = |x: f64, medium: &Medium, _, _| profile_value(x, medium.sigma_t_per_mm(), 0.5, 0.0, 1.0, 1.0);
    let equal = dictionary_of(&grid, |index| exact_record(&grid, index, 3, value));
    let found = best(&equal, &measured(4.0, 0.5, 0.0, 360, 10.0), &options(|_| {}));
    let records: Vec<usize> = found.iter().map(|c| c.thicknesses[0].record.unwrap()).collect();
    let [first, next_g] = [0, 1].map(|g| grid.record_at(0, 2, g, 0, 0));
    assert_eq!(records, [first, first + 1, first + 2, next_g, next_g + 1]);
    assert!(found.iter().all(|c| c.error == found[0].error));
}

/// Candidates keep the bounds, and bounds outside the dictionary are refused.
#[test]
fn bounds_are_kept_or_refused() {
    type Change = fn(&mut FitSettings);
    type Kept = fn(&Medium) -> bool;
    let dictionary = dictionary(360);
    let m = measured(4.0, 0.9, 0.0, 360, 10.0);
    let within: [(Change, usize, Kept); 3] = [
        (|s| s.g = Bounds::fixed(0.4), 12, |m| m.g() == 0.4),
        (
            |s| {
                s.sigma_t_per_mm = Bounds::new("sigma_t_per_mm", Some(1.5), Some(4.0)).unwrap();
                s.albedo = Bounds::new("albedo", None, Some(0.6)).unwrap();
            },
            2 * 2 * 2,
            |m| (1.5..=4.0).contains(&m.sigma_t_per_mm()) && m.albedo() <= 0.6,
        ),
        // A value between two nodes admits both.
        (|s| s.sigma_t_per_mm = Bounds::fixed(3.0), 2 * 6, |m| [2.0, 4.0].contains(&m.sigma_t_per_mm())),
    ];
    for (change, count, is_kept) in within {
        let options = FitOptions::new(FitSettings { top: 24, ..*options(change).settings() }).unwrap();
        let found = best(&dictionary, &m, &options);
        assert!(found.len() == count && found.iter().all(|c| is_kept(&c.medium)), "{found:?}");
    }
    let refuse =
        |change: fn(&mut FitSettings)| fit(&dictionary, &m, &options(change)).unwrap_err().to_string();
    assert_eq!(refuse(|s| s.g = Bounds::fixed(0.5)), "g = 0.5 is not valid: the dictionary has 0 to 0.4");
    let above = refuse(|s| s.sigma_t_per_mm = Bounds::new("sigma_t_per_mm", Some(9.0), None).unwrap());
    assert_eq!(above, "sigma_t_per_mm = 9 to inf is not valid: the dictionary has 1 to 8");
}

/// Searches in views of a part of the pixels, or with other wavelets and levels, find the medium, and the order of the
/// candidates does not depend on their number.
#[test]
fn parts_wavelets_and_levels_differ() {
    let dictionary = dictionary(360);
    let part = measured(8.0, 0.6, 0.4, 200, 6.0);
    for (wavelet, level) in [(Wavelet::QuadraticSpline, 2), (Wavelet::Haar, 4), (Wavelet::QuadraticSpline, 4)]
    {
        let options = options(|s| {
            s.wavelet = wavelet;
            s.level = level;
            s.top = 24;
        });
        let found = best(&dictionary, &part, &options);
        assert_eq!(found[0].medium, Medium::new(8.0, 0.6, 0.4).unwrap());
        assert!(found.windows(2).all(|w| w[0].error <= w[1].error));
        let few = FitOptions::new(FitSettings { top: 3, ..*options.settings() }).unwrap();
        assert_eq!(best(&dictionary, &part, &few), found[..3]);
    }
}

/// Profiles brighter or darker than all records are fitted and marked, by either objective.
#[test]
fn profiles_beyond_all_records_are_marked() {
    let dictionary = dictionary(360);
    for objective in [Objective::Paper, Objective::Likelihood] {
        let outside = |factor: f64| {
            let m = measured(4.0, 0.9, 0.0, 360, 10.0);
            let settings = FitSettings { mu: factor, objective: Some(objective), ..FitSettings::default() };
            let options = FitOptions::new(settings).unwrap();
            let channel = fit(&dictionary, &m, &options).unwrap().channels.remove(0);
            (channel.outside, channel.candidates.len())
        };
        assert_eq!(outside(1.0), (None, 5));
        assert_eq!(outside(10.0), (Some(Outside::Brighter), 5));
        assert_eq!(outside(0.01), (Some(Outside::Darker), 5));
    }
}

/// Unknown channels and thicknesses, and an x that hardly overlaps with the dictionary's, are refused.
#[test]
fn profiles_outside_the_dictionary_are_refused() {
    let dictionary = dictionary(360);
    let x: Vec<f64> = (0..50).map(|i| f64::from(i) * 0.1).collect();
    let refuse = |channel: &str, thickness: f64, shift: f64| {
        let x: Vec<f64> = x.iter().map(|x| x + shift).collect();
        let profile = MeasuredProfile::new(channel, thickness, x.clone(), x, None).unwrap();
        let m = Measurement::new("m", vec![profile]).unwrap();
        fit(&dictionary, &m, &options(|_| {})).unwrap_err().to_string()
    };
    assert_eq!(refuse("X", 0.5, 0.0), "channel = X is not valid: the dictionary has R, G, B");
    assert_eq!(
        refuse("R", 0.7, 0.0),
        "thickness_mm = 0.7 is not valid: the dictionary has 0.5, 1; `farmctl submit GRID.toml` computes one with all \
         of them if the grid file says thickness_mm = [0.5, 0.7, 1], and takes over what is there. With --objective likelihood, thicknesses near the \
         dictionary's need none"
    );
    let range = refuse("R", 0.5, 100.0);
    assert!(range.contains("it covers 0 pixels of the dictionary's -5 to 5 mm, 8 are needed"), "{range}");
}

/// Profiles with too many different ranges of x are refused.
#[test]
fn too_many_x_ranges_are_refused() {
    let dictionary = dictionary(360);
    let several: Vec<_> = [10.0, 9.5, 9.0, 8.5, 8.0].map(|width| measured(4.0, 0.9, 0.0, 180, width)).into();
    let (options, range) = (options(|_| {}), MuRange::new(1.0, 1.0, 1.0).unwrap());
    assert!(scale(&dictionary, &several[..4], &options, &range).is_ok());
    let error = scale(&dictionary, &several, &options, &range).unwrap_err().to_string();
    assert!(error.contains("x_mm = 5 different ranges"), "{error}");
}
