//! Builds answers for tests.

use optics_model::Medium;
use optics_model::descent::DescentEnd;
use optics_model::fit::{
    Agreement, Bound, Candidate, Cause, ChannelFit, Common, Design, Ends, ErrorSource, HalfWidths,
    Improvement, InkChannel, InkFit, Interval, Likelihood, Limitation, MixtureFit, MixturePart, Nuisance,
    NuisanceEstimate, OutlierPixel, PixelRow, Refined, ScaleCurve, ScalePoint, SceneEstimate, SlabSet,
    SourceShare, Stretch, Suspicion, Unmixed,
};
use optics_model::scene::Scope;

/// Two sets at σ_t = 6 / mm and 1 − α = 0.001: 0.5 mm, photographed once, and 0.5 and 1 mm, photographed twice.
pub fn design() -> Design {
    let medium = Medium::new(6.0, 0.999, 0.4).unwrap();
    // Half-widths in per cent of σ_t, 1 − α, σ_s(1 − g), σ_a.
    let widths = |[s, a, r, b]: [f64; 4], g: f64| HalfWidths {
        sigma_t_per_mm: 0.01 * s * medium.sigma_t_per_mm(),
        albedo: 0.01 * a * (1.0 - medium.albedo()),
        g,
        reduced_scattering_per_mm: 0.01 * r * medium.reduced_scattering_per_mm(),
        absorption_per_mm: 0.01 * b * medium.absorption_per_mm(),
    };
    let improvement = |limitation, std_error, halved, removed: Option<[f64; 4]>| Improvement {
        quantity: None,
        unit: None,
        limitation,
        std_error: Some(std_error),
        halved: Some(widths(halved, 0.0)),
        removed: removed.map(|w| widths(w, 0.0)),
        estimated: None,
        estimated_g_free: None,
    };
    let one = SlabSet {
        slabs_mm: vec![0.5],
        shots: 1,
        g_held: widths([4.0, 20.0, 4.0, f64::INFINITY], 0.0),
        g_free: Some(widths([40.0, 50.0, 7.0, f64::INFINITY], 2.0)),
        best_of_its_effort: true,
        best: false,
        improvements: vec![improvement(Limitation::Noise, 0.01, [3.0, 12.0, 3.0, 30.0], None)],
    };
    let two = SlabSet {
        slabs_mm: vec![0.5, 1.0],
        shots: 2,
        g_held: widths([2.0, 10.0, 2.0, 12.0], 0.0),
        g_free: Some(widths([15.0, 19.0, 2.0, 12.0], 0.3)),
        best_of_its_effort: true,
        best: true,
        improvements: vec![
            improvement(Limitation::Noise, 0.01, [1.6, 5.0, 1.6, 6.0], None),
            improvement(Limitation::Thickness, 0.005, [1.5, 10.0, 1.5, 12.0], Some([1.0, 9.0, 1.0, 11.0])),
        ],
    };
    let pixels = PixelRow::new(-5.0, 5.0, 0.05).unwrap();
    Design { channel: "R".to_owned(), medium, sample_ior: 1.53, pixels, sets: vec![one, two] }
}

/// An interval that is open below if it begins at 0, and open above if it ends beyond 1.
pub fn interval(low: f64, high: f64) -> Interval {
    Interval { low, high, open_low: low == 0.0, open_high: high > 1.0 }
}

/// A chosen scale factor and anisotropy with their intervals.
pub fn common() -> Common {
    Common {
        mu: 0.9,
        mu_std_error: 0.01,
        mu_interval: interval(0.88, 0.92),
        mu_chosen: true,
        g: Some(0.4),
        g_spread: None,
        g_equal_probability: None,
        g_change: None,
        g_interval: Some(interval(0.3, 0.5)),
        by_g: Vec::new(),
    }
}

/// A curve over the scale factor, without its points.
pub fn scale_curve() -> ScaleCurve {
    ScaleCurve {
        points: Vec::new(),
        best: ScalePoint { mu: 0.913, error: 0.28 },
        std_error: Some(0.0042),
        curvature: None,
        at_end: false,
        by_g: Vec::new(),
        best_g: 0.4,
    }
}

pub fn candidate(sigma_t_per_mm: f64) -> Candidate {
    let medium = Medium::new(sigma_t_per_mm, 0.999_827, 0.534_7).unwrap();
    Candidate { medium, sample_ior: 1.53, error: 0.0626, thicknesses: Vec::new() }
}

/// A channel with this σ_t; that of its best record is a whole number. If the misfit is above 2, it has a suspicion and
/// an unlikely χ².
pub fn channel(name: &str, sigma_t_per_mm: f64, misfit: f64) -> ChannelFit {
    let closed = |low, high| Interval { low, high, open_low: false, open_high: false };
    let suspicion =
        Suspicion { cause: Cause::EdgeOffset, thickness_mm: Some(0.5), amount: 0.0712, misfit_left: 1.04 };
    let refined = Refined {
        best: candidate(sigma_t_per_mm),
        resolved: true,
        resolved_at_g: true,
        valley: true,
        sigma_t_per_mm: closed(0.9 * sigma_t_per_mm, 1.1 * sigma_t_per_mm),
        albedo: closed(0.999_494, 0.999_986),
        g: closed(0.4123, 0.6312),
        reduced_scattering_per_mm: closed(13.46, 14.52),
        absorption_per_mm: closed(0.000_174, 0.005_93),
        covariance: [[0.0; 3]; 3],
        correlation: 0.0,
        measurement_noise: 0.01,
        dictionary_share: 0.1,
        misfit,
        suspicion: (misfit > 2.0).then_some(suspicion),
        likelihood: if misfit > 2.0 { likelihood(1130.2, 2e-9) } else { likelihood(712.4, 0.53) },
        from_mixtures: false,
        descent: DescentEnd::Converged,
        second_lobe: None,
    };
    ChannelFit {
        channel: name.to_owned(),
        candidates: vec![candidate(sigma_t_per_mm.ceil())],
        refined: Some(refined),
        outside: None,
        curves: Vec::new(),
    }
}

/// The likelihood of a fit to 716 pixels, where the data determine μ, blur and one origin, and a gain keeps its prior.
pub fn likelihood(chi2: f64, probability: f64) -> Likelihood {
    let estimate = |nuisance, profile_mm, value, std_error, (prior, prior_std_error)| NuisanceEstimate {
        nuisance,
        profile_mm,
        value,
        std_error,
        prior,
        prior_std_error,
    };
    let ends = |low, high| Ends { low, high };
    let share = |source, sigma_t| SourceShare {
        quantity: None,
        source,
        sigma_t,
        albedo: sigma_t,
        reduced_scattering: sigma_t,
        absorption: sigma_t,
    };
    Likelihood {
        chi2,
        degrees_of_freedom: 716.0,
        probability,
        nuisances: vec![
            estimate(Nuisance::Scale, None, 1.032, 0.004, (1.0, 0.05)),
            estimate(Nuisance::BlurVariance, None, 1.9e-4, 1e-4, (0.0, 9e-4)),
            estimate(Nuisance::Origin, Some(0.5), -0.0701, 0.0038, (0.0, 0.05)),
            estimate(Nuisance::Gain, Some(1.0), 0.0012, 0.0029, (0.0, 0.003)),
        ],
        outliers: vec![
            OutlierPixel { profile_mm: 0.5, x_mm: -1.23, deviation: -8.5 },
            OutlierPixel { profile_mm: 1.0, x_mm: 0.48, deviation: 6.25 },
        ],
        stretches: vec![
            Stretch { profile_mm: 0.5, from_mm: 1.2, to_mm: 1.6, deviation: 4.1 },
            Stretch { profile_mm: 1.0, from_mm: -2.0, to_mm: -1.5, deviation: -5.0 },
        ],
        bound: Bound {
            sigma_t_per_mm: ends(5.46, 6.54),
            albedo: ends(0.9996, 0.9999),
            g: ends(f64::NEG_INFINITY, f64::INFINITY),
            reduced_scattering_per_mm: ends(13.5, 14.5),
            absorption_per_mm: ends(0.000_25, 0.0055),
        },
        scene: Vec::new(),
        budget: vec![
            share(ErrorSource::Noise, 0.08),
            share(ErrorSource::Thickness, 0.116),
            share(ErrorSource::Zero, 0.004),
            share(ErrorSource::G, 0.8),
        ],
    }
}

/// A gel that contradicts its prior, a roughness at the end of its responses, and a ring as expected.
pub fn scene_estimates() -> Vec<SceneEstimate> {
    let estimate = |quantity: &str,
                    unit: &str,
                    scope,
                    [value, std_error]: [f64; 2],
                    [prior, sd]: [f64; 2]| {
        let slab_mm = (scope == Scope::Slab).then_some(0.5);
        let (quantity, unit) = (quantity.to_owned(), unit.to_owned());
        let at_end = scope == Scope::Material;
        SceneEstimate { quantity, unit, scope, slab_mm, value, std_error, prior, prior_std_error: sd, at_end }
    };
    vec![
        estimate("gel thickness", "mm", Scope::Slab, [0.0972, 0.0031], [0.02, 0.02]),
        estimate("sample roughness", "", Scope::Material, [0.12, 0.004], [0.05, 0.03]),
        estimate("ring angle", "°", Scope::Session, [45.2, 0.9], [45.0, 1.0]),
    ]
}

/// A strong absorber in white, with a mixture that contradicts it and one beyond the dictionary.
pub fn unmixed() -> Unmixed {
    let closed = |low, high| Interval { low, high, open_low: false, open_high: false };
    let medium = Medium::new(9.16, 0.0758, 0.46).unwrap();
    let channel = InkChannel {
        channel: "R".into(),
        medium,
        sigma_t_per_mm: closed(8.69, 9.64),
        albedo: closed(0.023, 0.126),
        g: Interval { open_high: true, ..closed(0.398, 0.5) },
        reduced_scattering_per_mm: closed(0.115, 0.618),
        absorption_per_mm: closed(8.17, 8.77),
        resolved: true,
        from_mixtures: true,
        descent: DescentEnd::Converged,
    };
    let mixture = |material: &str, pull: Option<f64>, left_out: Option<&str>| MixtureFit {
        material: material.into(),
        channel: "R".into(),
        parts: vec![MixturePart::new("white", 0.5), MixturePart::new("cyan", 0.5)],
        medium,
        agreement: pull.map(|pull| Agreement { chi2: 700.0, pixels: 720.0, misfit: 0.98, pull }),
        left_out: left_out.map(str::to_owned),
    };
    Unmixed {
        common: Common {
            mu: 0.91,
            mu_interval: closed(0.89, 0.93),
            g: Some(0.46),
            g_interval: Some(closed(0.398, 0.5)),
            ..common()
        },
        inks: vec![InkFit { material: "cyan".into(), channels: vec![channel] }],
        mixtures: vec![
            mixture("pale", Some(1.2), None),
            mixture("paler", Some(7.31), None),
            mixture("deep", None, Some("sigma_t_per_mm = 35")),
        ],
    }
}
