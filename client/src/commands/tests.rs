//! Tests the JSON of `farmctl/1`, byte by byte.

mod examples;

use farm_figures::testing::{self, interval, likelihood, scene_estimates};
use farm_lab::measurement_file::Note;
use farm_lab::set_up::SetUp;
use farm_proto::ids::WorkerId;
use farm_proto::status::{MachineFacts, WorkerState, WorkerStatus};
use farm_proto::wire::{MeasurementSummary, StatusResponse};
use optics_model::fit::{
    Bounds, Candidate, Cause, ChannelFit, Common, Curve, DesignQuestion, DesignSettings, DistanceMap,
    ErrorSource, FitCurves, FitOptions, FitSettings, GError, MapLayer, MaterialFit, Objective, Outside,
    PixelRow, PredictedChannel, PredictedProfiles, Refined, ScaleCurve, ScalePoint, SharedErrors,
    SourceShare, Suspicion, ThicknessError, Wavelet,
};
use optics_model::job::JobSpec;
use optics_model::phase::SecondLobe;
use optics_model::{Derivatives, Estimate, Medium, Profile, Record, Scene, TransportPoint, Walks};
use serde::Serialize;

use super::dictionaries::{list, show};
use super::farm::{status, workers};
use super::fits::similar::{self, SimilarArgs};
use super::fits::{design, fit, map, profile, scale};
use super::measurements::{kept, simulate};
use crate::answers::{MeasureAnswer, MeasurementAnswer, UsedOptions};
use crate::output::envelope;
use crate::testing::{dictionary, is_stable};

/// The JSON output is unchanged: one answer per line, as `--json` prints it. Fields may be added to a version, never changed
/// or removed: a line may only grow.
#[test]
fn machine_readable_output_is_stable() {
    is_stable("commands/tests/farmctl-1.jsonl", &(answers().join("\n") + "\n"));
}

fn answers() -> Vec<String> {
    let (fits, common, scale_curve) = (materials(), [common(Some(0.4)), common(None)], scale_curve());
    let [free, bound, likely] = options();
    let found = |g: usize, scale| MeasureAnswer {
        scale,
        common: common[g].clone(),
        materials: fits.clone(),
        unmixed: None,
        shared_errors: SharedErrors::default(),
        kept: None,
        not_kept: None,
    };
    let job = job();
    let assumed = SetUp::default().assumed(&[]);
    let used = |options| UsedOptions::new("paper", options, &assumed);
    let simulated = |several| {
        let style = simulate::JsonStyle { several, walks: 5000, seed: 7 };
        line("simulate", &simulate::SimulateJson::new(&style, &job, 0.9, &record()))
    };
    let dictionaries = [dictionary(true), dictionary(false)];
    let scaled = scale::ScaleJson { scale: &scale_curve, common: &common[0], materials: &fits[1..] };
    vec![
        line("fit", &about(used(&free), fit::FitJson { materials: &fits }, &notes())),
        line("fit", &about(used(&bound), fit::FitJson { materials: &fits[..1] }, &[])),
        line("scale", &about(used(&bound), scaled, &notes())),
        line("measure", &crate::measured::data(used(&free), &found(0, Some(scale_curve.clone())), &notes())),
        line(
            "profile",
            &profile::ProfileJson { dictionary: "paper", x_mm: vec![-1.0, 1.0], profiles: &predicted() },
        ),
        line("measure", &crate::measured::data(used(&bound), &found(1, None), &[])),
        line("map", &about(used(&free), map::MapJson { maps: &[material_map()] }, &notes())),
        line("similar", &similar::data(&similar_args()).unwrap()),
        simulated(false),
        simulated(true),
        line("status", &status::data(Some("http://farm:7700"), &farm(""), &[worker()], &dictionaries)),
        line("status", &status::data(None, &farm("the disk is full"), &[], &[])),
        line("show", &show::data(&dictionaries[0])),
        line("show", &show::data(&dictionaries[1])),
        line("list", &list::data(&dictionaries)),
        line("workers", &workers::data(&[worker()])),
        line("fit", &about(used(&likely), fit::FitJson { materials: &[with_likelihood()] }, &[])),
        line("design", &design::data("paper", &design_question(likely), &assumed, &testing::design())),
        line("measure", &crate::measured::data(used(&likely), &with_inks(fits[..1].to_vec()), &[])),
        line("measurements", &kept::KeptListJson { measurements: vec![kept_measurement().into()] }),
    ]
}

fn kept_measurement() -> MeasurementSummary {
    MeasurementSummary {
        id: "3f2a9c0d11e08b47".to_owned(),
        kept_unix_ms: 1_763_000_000_000,
        owner: "alice".to_owned(),
        title: "white, second print".to_owned(),
        note: "slab 2 had a scratch\nagain".to_owned(),
        source: "white.csv".to_owned(),
        command: "farmctl measure white.csv --keep".to_owned(),
        dictionary: "lab".to_owned(),
        materials: vec!["white".to_owned()],
        channels: 3,
    }
}

fn predicted() -> PredictedProfiles {
    let channel = |name: &str, std_errors| PredictedChannel {
        channel: name.to_owned(),
        values: vec![0.25, 0.5],
        std_errors,
        gradient: vec![0.125, 0.0],
    };
    PredictedProfiles {
        medium: Medium::new(6.0, 0.999, 0.4).unwrap(),
        thickness_mm: 0.5,
        sample_ior: 1.5,
        recorded: false,
        pixels: PixelRow::new(-4.0, 4.0, 0.5).unwrap(),
        channels: vec![channel("R", Some(vec![0.001, 0.002])), channel("G", None)],
    }
}

fn with_inks(materials: Vec<MaterialFit>) -> MeasureAnswer {
    MeasureAnswer {
        scale: None,
        common: common(Some(0.4)),
        materials,
        unmixed: Some(testing::unmixed()),
        shared_errors: SharedErrors::default(),
        kept: None,
        not_kept: None,
    }
}

fn about<'a, T>(options: UsedOptions<'a>, answer: T, notes: &'a [Note]) -> MeasurementAnswer<'a, T> {
    MeasurementAnswer { options, answer, notes }
}

fn line(kind: &str, data: &impl Serialize) -> String {
    envelope(kind, data).unwrap()
}

fn notes() -> Vec<Note> {
    vec![Note { code: "x_in_cm", text: "x is in cm".to_owned() }]
}

fn options() -> [FitOptions; 3] {
    let bound = FitSettings {
        lambda: 12.5,
        mu: 0.913,
        mu_std_error: 0.004,
        wavelet: Wavelet::Haar,
        level: 3,
        sigma_t_per_mm: Bounds::new("sigma_t", Some(0.5), None).unwrap(),
        albedo: Bounds::new("albedo", None, Some(0.99)).unwrap(),
        g: Bounds::fixed(0.4),
        ..FitSettings::default()
    };
    let likely = FitSettings {
        objective: Some(Objective::Likelihood),
        thickness_std_error_mm: 0.002,
        origin_std_error_mm: 0.01,
        blur_mm: 0.025,
        blur_std_error_mm: 0.001,
        slope_std_error: 0.004,
        ..FitSettings::default()
    };
    [FitOptions::default(), FitOptions::new(bound).unwrap(), FitOptions::new(likely).unwrap()]
}

fn design_question(set_up: FitOptions) -> DesignQuestion {
    let settings = DesignSettings::of(Medium::new(6.0, 0.999, 0.4).unwrap());
    DesignQuestion::new(DesignSettings { set_up, mu_free: true, ..settings }).unwrap()
}

fn candidate(sigma_t: f64, record: Option<usize>) -> Candidate {
    let thickness = |thickness_mm, record| ThicknessError {
        thickness_mm,
        value_rms: 0.1 + 0.2,
        gradient_rms: 1.25e-7,
        record,
    };
    Candidate {
        medium: Medium::new(sigma_t, 0.999_827, 0.4).unwrap(),
        thicknesses: vec![thickness(0.5, record), thickness(1.0, record.map(|r| r + 41))],
        ..testing::candidate(sigma_t)
    }
}

fn curve(values: [f64; 3]) -> Curve {
    Curve { values: values.into(), gradient: values.map(|v| 0.5 * v).into() }
}

fn channel(name: &str, suspicion: Option<(Cause, Option<f64>)>) -> ChannelFit {
    let suspicion = suspicion.map(|(cause, thickness_mm)| Suspicion {
        cause,
        thickness_mm,
        amount: -0.0712,
        misfit_left: 1.04,
    });
    let plain = testing::channel(name, 6.21, 1.0);
    let refined = Refined {
        best: candidate(6.21, None),
        sigma_t_per_mm: interval(5.9, 6.5),
        albedo: interval(0.9, 0.95),
        g: interval(0.0, 0.6),
        reduced_scattering_per_mm: interval(0.25, 0.75),
        absorption_per_mm: interval(1e-9, 0.005),
        covariance: [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.5]],
        correlation: 0.98,
        resolved: false,
        resolved_at_g: false,
        misfit: 3.42,
        suspicion,
        likelihood: likelihood(712.4, 0.5312),
        second_lobe: SecondLobe::new(0.07, -0.5).ok(),
        ..plain.refined.unwrap()
    };
    ChannelFit {
        candidates: vec![candidate(6.0, Some(16_234)), candidate(6.5, Some(17_000))],
        refined: Some(refined),
        ..testing::channel(name, 6.21, 1.0)
    }
}

fn materials() -> Vec<MaterialFit> {
    let curves = |refined| FitCurves {
        thickness_mm: 0.5,
        x_mm: vec![-1.0, 0.0, 1.0],
        measured: curve([0.1, 0.5, f64::NAN]),
        candidates: vec![curve([0.1, 0.4, 0.8]), curve([0.2, 0.5, 1e-12])],
        refined,
        residuals: vec![-0.5, 1.25, 0.0],
        left_out: vec![2],
    };
    let with_curves = ChannelFit {
        curves: vec![curves(Some(curve([0.125, 0.25, 0.5]))), curves(None)],
        ..channel("R", Some((Cause::EdgeOffset, Some(0.5))))
    };
    let outside = |outside| ChannelFit { refined: None, outside: Some(outside), ..channel("outside", None) };
    let causes = [
        Cause::Unknown,
        Cause::Gain,
        Cause::Zero,
        Cause::Slope,
        Cause::Blur,
        Cause::GammaCoded,
        Cause::Exponent,
        Cause::ThicknessesSwapped,
        Cause::Thickness,
    ];
    let suspected = causes.map(|cause| channel(&format!("{cause:?}"), Some((cause, None))));
    let empty = ChannelFit { candidates: Vec::new(), ..outside(Outside::Darker) };
    vec![
        MaterialFit {
            material: "Vero \"White\" µ".to_owned(),
            channels: vec![with_curves, channel("G", None), outside(Outside::Brighter), empty],
        },
        MaterialFit { material: "resin".to_owned(), channels: suspected.into() },
    ]
}

/// A channel in a scene with uncertain quantities.
fn with_likelihood() -> MaterialFit {
    let mut channel = channel("R", None);
    let likelihood = &mut channel.refined.as_mut().unwrap().likelihood;
    likelihood.scene = scene_estimates();
    likelihood.budget.push(SourceShare {
        source: ErrorSource::Scene,
        quantity: Some("gel thickness".to_owned()),
        sigma_t: 0.25,
        albedo: 0.125,
        reduced_scattering: 0.5,
        absorption: 0.0,
    });
    MaterialFit { material: "resin".to_owned(), channels: vec![channel] }
}

fn by_g() -> Vec<GError> {
    let best = |g, error| GError { g, error, best_mu: 0.912, best_mu_error: 0.28 };
    vec![best(0.0, 0.3), best(0.4, 0.281)]
}

fn common(g: Option<f64>) -> Common {
    Common {
        mu: 0.913,
        mu_std_error: 0.0042,
        mu_interval: interval(0.9, 0.93),
        mu_chosen: g.is_some(),
        g,
        g_interval: g.map(|_| interval(0.35, 0.47)),
        by_g: g.map(|_| by_g()).unwrap_or_default(),
        ..testing::common()
    }
}

fn scale_curve() -> ScaleCurve {
    let point = |mu, error| ScalePoint { mu, error };
    let points = vec![point(0.8, 0.4), point(0.913, 0.28), point(1.0, 0.5)];
    ScaleCurve { points, by_g: by_g(), ..testing::scale_curve() }
}

fn material_map() -> map::MaterialMap {
    map::MaterialMap { material: "resin".to_owned(), map: distance_map() }
}

fn distance_map() -> DistanceMap {
    let layer = |g, similar| MapLayer {
        g,
        errors: vec![vec![0.1, 0.2, 0.3], vec![0.4, f64::NAN, 0.6]],
        best: candidate(4.0, Some(12)),
        similar,
    };
    DistanceMap {
        channel: "R".to_owned(),
        sigma_t_per_mm: vec![1.0, 4.0],
        albedo: vec![0.5, 0.9, 0.999_9],
        sample_ior: 1.53,
        best_layer: 1,
        layers: vec![layer(0.0, Some(Medium::new(2.5, 0.875, 0.0).unwrap())), layer(0.4, None)],
    }
}

fn similar_args() -> SimilarArgs {
    SimilarArgs { sigma_t: 4.0, albedo: 0.75, g: 0.5, to: vec![0.0, 0.5] }
}

fn job() -> JobSpec {
    let point = TransportPoint::new(4.0, 0.4, 0.5, 1.53).unwrap();
    let scene = Scene::paper().with_sensor(optics_model::scene::Sensor::new(10.0, 2, 0.0).unwrap());
    JobSpec::new(scene, point, vec![0.9], Walks::new(5000).unwrap(), 7, false).unwrap()
}

fn record() -> Record {
    let profile = || {
        let estimate = |values: [f32; 2]| Estimate::new(values.into(), vec![0.001, 0.0]).unwrap();
        let derivatives = Derivatives { albedo: estimate([1.0, 2.0]), sigma_t: estimate([3.0, 4.0]) };
        Profile { radiance_factor: estimate([0.1, 0.8]), derivatives: Some(derivatives) }
    };
    Record { index: 3, profiles: vec![profile(), profile(), profile()] }
}

fn worker() -> WorkerStatus {
    WorkerStatus {
        id: WorkerId("0123456789".to_owned()),
        label: "node 1".to_owned(),
        threads: 16,
        leases: 32,
        jobs_done: 836,
        silent_ms: 1234,
        state: WorkerState::Working,
        suspended_ms: 0,
        version: "0.1.0".to_owned(),
        facts: MachineFacts {
            cores: 16,
            memory_bytes: 64 << 30,
            kernel: "avx2".to_owned(),
            log: "node1:/log".to_owned(),
        },
        machine: "node1@10.0.0.7".to_owned(),
    }
}

fn farm(store_fault: &str) -> StatusResponse {
    StatusResponse {
        version: "0.1.0".to_owned(),
        physics_version: 3,
        jobs_pending: 12,
        jobs_leased: 3,
        dictionaries: 2,
        workers: 1,
        threads: 16,
        jobs_done: 836,
        uptime_ms: 123_456,
        database_bytes: 1 << 33,
        checks_agreed: 8,
        checks_disputed: 0,
        checks_waiting: 1,
        store_fault: store_fault.to_owned(),
    }
}
