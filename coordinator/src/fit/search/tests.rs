use farm_proto::grid::Axes;
use farm_proto::scene::{Scene, Sensor};
use farm_proto::{Estimate, Grid, MeasuredProfile, Profile, Record, Walks};

use super::*;
use crate::fit::{DictionaryBuilder, Wavelet, derivative};

/// Edge profiles that stand for simulated ones: smooth, and different for every parameter combination.
fn profile_value(x: f64, sigma_t: f64, albedo: f64, g: f64, thickness: f64, channel: f64) -> f64 {
    let width = 0.3 + thickness / (sigma_t * (1.0 - g));
    let level = albedo * (0.2 + 0.1 * channel);
    level + 0.3 * albedo * (x / width).tanh() / (1.0 + thickness)
}

fn dictionary(pixels: u32) -> FitDictionary {
    let axes = Axes {
        sigma_t_per_mm: vec![1.0, 2.0, 4.0, 8.0],
        albedo: vec![0.3, 0.6, 0.9],
        g: vec![0.0, 0.4],
        thickness_mm: vec![0.5, 1.0],
        sample_ior: vec![1.5],
    };
    let scene = Scene::paper().with_sensor(Sensor::new(10.0, pixels, 0.0).unwrap());
    let grid = Grid::new(scene, axes, Walks::PAPER, 1, false).unwrap();
    let sensor = grid.scene().sensor();
    let mut builder = DictionaryBuilder::new(grid.clone());
    for index in (0..grid.record_count()).rev() {
        let (point, medium) = grid.parameters(index);
        let profile = |channel: usize| {
            let value = |i| {
                let (s, a, g) = (medium.sigma_t_per_mm(), medium.albedo(), medium.g());
                profile_value(sensor.centre_mm(i), s, a, g, point.thickness_mm(), channel as f64) as f32
            };
            let values: Vec<f32> = (0..sensor.pixels()).map(value).collect();
            let std_errors = vec![0.0; values.len()];
            Profile { radiance_factor: Estimate::new(values, std_errors).unwrap(), derivatives: None }
        };
        builder.add(&Record { index, profiles: (0..3).map(profile).collect() });
    }
    builder.build()
}

/// A measurement of a medium at both thicknesses, in channel G, over `width` mm.
fn measured(sigma_t: f64, albedo: f64, g: f64, pixels: usize, width: f64) -> Measurement {
    let profile = |thickness: f64| {
        let pitch = width / pixels as f64;
        let x: Vec<f64> = (0..pixels).map(|i| (i as f64 + 0.5) * pitch - width / 2.0).collect();
        let ripple = |i: usize| 0.003 * ((i * 7919) % 13) as f64 / 13.0;
        let value = |(i, x): (usize, &f64)| profile_value(*x, sigma_t, albedo, g, thickness, 1.0) + ripple(i);
        let values = x.iter().enumerate().map(value).collect();
        MeasuredProfile::new("G", thickness, x, values, None).unwrap()
    };
    Measurement::new("test", vec![profile(0.5), profile(1.0)]).unwrap()
}

fn best(dictionary: &FitDictionary, m: &Measurement, options: &FitOptions) -> Vec<Candidate> {
    fit(dictionary, m, options).unwrap().remove(0).candidates
}

#[test]
fn the_medium_that_was_measured_is_found() {
    let dictionary = dictionary(360);
    for (sigma_t, albedo, g) in [(1.0, 0.3, 0.4), (4.0, 0.9, 0.0), (8.0, 0.6, 0.4)] {
        for (pixels, width) in [(360, 10.0), (720, 10.0), (90, 10.0), (200, 6.0)] {
            let m = measured(sigma_t, albedo, g, pixels, width);
            let found = &best(&dictionary, &m, &FitOptions::default())[0];
            let expected = Medium::new(sigma_t, albedo, g).unwrap();
            assert_eq!(found.medium, expected, "{pixels} pixels over {width} mm");
        }
    }
}

/// Eqs. 1 and 2 written down once more, as plainly as can be.
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
                    let f: Vec<f64> = profile.values().iter().map(|v| options.mu() * v).collect();
                    let slope = |f: &[f64]| derivative(f, Wavelet::QuadraticSpline, 4);
                    let rms = |a: &[f64], b: &[f64]| {
                        (a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f64>() / a.len() as f64).sqrt()
                    };
                    // Per sample of 10 mm / 360, whatever the pitch of the profile.
                    let scale = simulated.len() as f64 / 360.0;
                    let abs = |f: Vec<f64>| f.into_iter().map(|v| v.abs() * scale).collect::<Vec<_>>();
                    error += rms(&f, &simulated);
                    error += options.lambda() * rms(&abs(slope(&f)), &abs(slope(&simulated)));
                }
                all.push((error, Medium::new(sigma_t, albedo, anisotropy).unwrap()));
            }
        }
    }
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    all
}

#[test]
fn the_answer_is_that_of_brute_force() {
    for pixels in [360, 90] {
        let dictionary = dictionary(pixels);
        let m = measured(3.0, 0.7, 0.2, pixels as usize, 10.0);
        for options in [FitOptions::default(), FitOptions::new(5.0, 0.9, None, 24).unwrap()] {
            let found = best(&dictionary, &m, &options);
            let expected = brute_force(&dictionary, &m, &options);
            assert_eq!(found.len(), options.top());
            for (candidate, (error, medium)) in found.iter().zip(&expected) {
                assert_eq!(candidate.medium, *medium);
                assert!((candidate.error - error).abs() < 1e-6, "{} {error}", candidate.error);
            }
        }
    }
}

/// A dictionary whose profiles depend on the extinction alone: all media with the same one are equally good.
#[test]
fn equal_errors_come_in_the_order_of_the_records() {
    let grid = dictionary(360).grid().clone();
    let mut builder = DictionaryBuilder::new(grid.clone());
    for index in 0..grid.record_count() {
        let (point, _) = grid.parameters(index);
        let value = |i: usize| {
            profile_value(grid.scene().sensor().centre_mm(i), point.sigma_t_per_mm(), 0.5, 0.0, 1.0, 1.0)
        };
        let values: Vec<f32> = (0..360).map(|i| value(i) as f32).collect();
        let radiance_factor = Estimate::new(values, vec![0.0; 360]).unwrap();
        builder.add(&Record { index, profiles: vec![Profile { radiance_factor, derivatives: None }; 3] });
    }
    let options = FitOptions::new(20.0, 1.0, None, 5).unwrap();
    let found = best(&builder.build(), &measured(4.0, 0.5, 0.0, 360, 10.0), &options);
    let records: Vec<usize> = found.iter().map(|c| c.thicknesses[0].record).collect();
    let first = grid.record_at(0, 2, 0, 0, 0);
    let next_g = grid.record_at(0, 2, 1, 0, 0);
    assert_eq!(records, [first, first + 1, first + 2, next_g, next_g + 1]);
    assert!(found.iter().all(|c| c.error == found[0].error));
}

#[test]
fn an_error_is_the_sum_of_its_terms() {
    let dictionary = dictionary(360);
    for candidate in best(&dictionary, &measured(3.0, 0.7, 0.2, 360, 10.0), &FitOptions::default()) {
        let sum: f64 = candidate.thicknesses.iter().map(|t| t.value_rms + 20.0 * t.gradient_rms).sum();
        assert!((sum - candidate.error).abs() < 1e-12);
        let (point, medium) = dictionary.grid().parameters(candidate.thicknesses[1].record);
        assert_eq!((point.thickness_mm(), medium), (1.0, candidate.medium));
    }
}

#[test]
fn a_fixed_anisotropy_is_kept_and_an_unknown_one_refused() {
    let dictionary = dictionary(360);
    let m = measured(4.0, 0.9, 0.0, 360, 10.0);
    let fixed = FitOptions::new(20.0, 1.0, Some(0.4), 24).unwrap();
    let found = best(&dictionary, &m, &fixed);
    assert_eq!(found.len(), 12);
    assert!(found.iter().all(|c| c.medium.g() == 0.4));
    let unknown = FitOptions::new(20.0, 1.0, Some(0.3), 5).unwrap();
    let error = fit(&dictionary, &m, &unknown).unwrap_err().to_string();
    assert_eq!(error, "g = 0.3 is not valid: the dictionary has 0, 0.4");
}

#[test]
fn unknown_channels_and_thicknesses_and_foreign_ranges_are_refused() {
    let dictionary = dictionary(360);
    let x: Vec<f64> = (0..50).map(|i| f64::from(i) * 0.1).collect();
    let refuse = |channel: &str, thickness: f64, shift: f64| {
        let x: Vec<f64> = x.iter().map(|x| x + shift).collect();
        let profile = MeasuredProfile::new(channel, thickness, x.clone(), x, None).unwrap();
        let m = Measurement::new("m", vec![profile]).unwrap();
        fit(&dictionary, &m, &FitOptions::default()).unwrap_err().to_string()
    };
    assert_eq!(refuse("X", 0.5, 0.0), "channel = X is not valid: the dictionary has R, G, B");
    assert_eq!(refuse("R", 0.7, 0.0), "thickness_mm = 0.7 is not valid: the dictionary has 0.5, 1");
    let range = refuse("R", 0.5, 100.0);
    assert!(range.contains("it covers 0 pixels of the dictionary's -5 to 5 mm, 8 are needed"), "{range}");
}
