//! What is wrong with photographs is told by the misfit, with its likeliest reason.

use std::sync::OnceLock;

use optics_fit::fit;
use optics_model::fit::{Bounds, Cause, FitOptions, FitSettings, MISFIT, Refined};
use optics_model::{MeasuredProfile, Measurement, Medium};

use crate::{dictionary, photograph};

/// x in mm and value, of a profile of a thickness, to the value that is photographed.
type Spoil = fn(f64, f64, f64, &dyn Fn(f64) -> f64) -> f64;

/// The photographs before anything went wrong, traced once.
fn clean(thickness_mm: f64) -> &'static MeasuredProfile {
    static CLEAN: OnceLock<[MeasuredProfile; 2]> = OnceLock::new();
    let clean = CLEAN.get_or_init(|| {
        let truth = Medium::new(4.3, 0.965, 0.4).unwrap();
        [0.5, 1.0].map(|t| photograph(&truth, 1, t, 9_500, 4_000_000, 1.0, 0.004).0)
    });
    &clean[usize::from(thickness_mm > 0.75)]
}

fn found(spoil: Spoil, swap: bool) -> Refined {
    let profile = |thickness_mm: f64| {
        let clean = clean(thickness_mm);
        let (x, values) = (clean.x_mm().to_vec(), clean.values());
        let pitch = clean.pitch_mm();
        let at = |x_mm: f64| {
            let place = ((x_mm - x[0]) / pitch).clamp(0.0, (x.len() - 1) as f64);
            let below = (place as usize).min(x.len() - 2);
            values[below] + (place - below as f64) * (values[below + 1] - values[below])
        };
        let spoilt = x.iter().zip(values).map(|(x, v)| spoil(*x, *v, thickness_mm, &at)).collect();
        let errors = clean.std_errors().unwrap().to_vec();
        let told = if swap { 1.5 - thickness_mm } else { thickness_mm };
        MeasuredProfile::new("G", told, x.clone(), spoilt, Some(errors)).unwrap()
    };
    let measurement = Measurement::new("m", vec![profile(0.5), profile(1.0)]).unwrap();
    let settings = FitSettings { g: Bounds::fixed(0.4), refine: true, ..FitSettings::default() };
    let fit = fit(dictionary(), &measurement, &FitOptions::new(settings).unwrap()).unwrap();
    fit.channels[0].refined.clone().unwrap()
}

#[test]
fn clean_photographs_have_no_misfit() {
    let r = found(|_, v, _, _| v, false);
    assert!(r.misfit < 1.5 && r.suspicion.is_none(), "{r:?}");
}

#[test]
fn spoilt_photographs_are_told_with_the_likeliest_reason() {
    let cases: [(&str, Spoil, bool, Cause); 6] = [
        ("edge 0.1 mm off", |x, _, _, at| at(x - 0.1), false, Cause::EdgeOffset),
        ("light rises by 5 % to the edge", |x, v, _, _| v * (1.0 + 0.05 * x / 5.0), false, Cause::Slope),
        ("5 % too dark at 0.5 mm", |_, v, t, _| if t < 0.75 { 0.95 * v } else { v }, false, Cause::Gain),
        (
            "dust",
            |x, v, _, _| if (x * 36.0).floor().rem_euclid(23.0) < 1.0 { 0.7 * v } else { v },
            false,
            Cause::Outliers,
        ),
        ("sRGB", |_, v, _, _| 1.055 * v.powf(1.0 / 2.4) - 0.055, false, Cause::GammaCoded),
        ("thicknesses exchanged", |_, v, _, _| v, true, Cause::ThicknessesSwapped),
    ];
    for (what, spoil, swap, cause) in cases {
        let r = found(spoil, swap);
        println!("{what}: misfit {:.2}, {:?}", r.misfit, r.suspicion);
        assert!(r.misfit > MISFIT, "{what}: {}", r.misfit);
        assert_eq!(r.suspicion.map(|s| s.cause), Some(cause), "{what}");
    }
}
