//! Tests the checks of measurements with traced media: they accept every medium, and detect each mistake where it is
//! visible.

use std::sync::OnceLock;
use std::sync::atomic::AtomicBool;

use farm_tests::statistics::{Normal, effort};
use optics_layers::records;
use optics_model::job::JobSpec;
use optics_model::measurement::checks::{Finding, Kind, check};
use optics_model::scene::{Scene, Sensor};
use optics_model::{MeasuredProfile, Measurement, TransportPoint, Walks};

const SIGMA_T_PER_MM: [f64; 5] = [0.5, 1.5, 5.0, 14.0, 40.0];
const G: [f64; 3] = [0.0, 0.4, 0.8];
const ALBEDO: [f64; 8] = [0.05, 0.35, 0.7, 0.9, 0.98, 0.997, 0.9995, 0.99999];
const THICKNESS_MM: [f64; 2] = [0.5, 1.0];
/// Width in mm and pixels: the paper's, a narrow one, coarse pixels.
const SENSORS: [(f64, u32); 3] = [(10.0, 360), (4.0, 144), (10.0, 40)];

/// A traced profile.
#[derive(Clone)]
struct Traced {
    channel: String,
    thickness_mm: f64,
    x_mm: Vec<f64>,
    values: Vec<f64>,
    std_errors: Vec<f64>,
}

impl Traced {
    /// The profile with relative noise on every pixel, with or without standard errors.
    fn photograph(&self, noise: f64, has_errors: bool, random: &mut Normal) -> MeasuredProfile {
        let values = self.values.iter().map(|v| v * (1.0 + noise * random.normal())).collect();
        let errors =
            self.std_errors.iter().zip(&self.values).map(|(e, v)| libm::hypot(*e, noise * v)).collect();
        Self { values, std_errors: errors, ..self.clone() }.measured(has_errors)
    }

    fn map(&self, f: impl Fn(f64) -> f64) -> Self {
        Self { values: self.values.iter().copied().map(f).collect(), ..self.clone() }
    }

    fn at(&self, f: impl Fn(f64) -> f64) -> Self {
        Self { x_mm: self.x_mm.iter().copied().map(f).collect(), ..self.clone() }
    }

    fn slab(&self, thickness_mm: f64) -> Self {
        Self { thickness_mm, ..self.clone() }
    }

    fn measured(self, has_errors: bool) -> MeasuredProfile {
        let errors = has_errors.then_some(self.std_errors);
        MeasuredProfile::new(self.channel, self.thickness_mm, self.x_mm, self.values, errors).unwrap()
    }
}

/// A medium, through one sensor, at all thicknesses in all channels.
struct Sample {
    name: String,
    sensor: usize,
    profiles: Vec<Traced>,
}

impl Sample {
    fn find(&self, channel: &str, thickness_mm: f64) -> &Traced {
        self.profiles.iter().find(|p| p.channel == channel && p.thickness_mm == thickness_mm).unwrap()
    }
}

/// 120 media through three sensors, traced once.
fn samples() -> &'static [Sample] {
    static SAMPLES: OnceLock<Vec<Sample>> = OnceLock::new();
    SAMPLES.get_or_init(|| {
        let media = || SIGMA_T_PER_MM.into_iter().flat_map(|sigma_t| G.map(|g| (sigma_t, g)));
        let all = (0..SENSORS.len()).flat_map(|sensor| media().map(move |(sigma_t, g)| (sensor, sigma_t, g)));
        all.flat_map(|(sensor, sigma_t, g)| traced(sensor, sigma_t, g)).collect()
    })
}

/// Traces all albedos with the same walks.
fn traced(sensor: usize, sigma_t: f64, g: f64) -> Vec<Sample> {
    let (width, pixels) = SENSORS[sensor];
    let scene = Scene::paper().with_sensor(Sensor::new(width, pixels, 0.0).unwrap());
    let x_mm: Vec<f64> = (0..pixels as usize).map(|i| scene.sensor().centre_mm(i)).collect();
    let name = |albedo: &f64| format!("σ_t {sigma_t}, α {albedo}, g {g}, sensor {sensor}");
    let sample = |albedo| Sample { name: name(albedo), sensor, profiles: Vec::new() };
    let mut samples: Vec<Sample> = ALBEDO.iter().map(sample).collect();
    for thickness_mm in THICKNESS_MM {
        let point = TransportPoint::new(sigma_t, g, thickness_mm, 1.53).unwrap();
        let walks = Walks::new(50_000 * effort()).unwrap();
        let job = JobSpec::new(scene.clone(), point, ALBEDO.to_vec(), walks, 7, false).unwrap();
        for (sample, record) in samples.iter_mut().zip(records(&job, &AtomicBool::new(false)).unwrap()) {
            sample.profiles.extend(scene.channels().iter().zip(&record.profiles).map(
                |(channel, profile)| {
                    let wide = |v: &[f32]| v.iter().copied().map(f64::from).collect();
                    let (values, std_errors) =
                        (wide(profile.radiance_factor.values()), wide(profile.radiance_factor.std_errors()));
                    let channel = channel.name().to_owned();
                    Traced { channel, thickness_mm, x_mm: x_mm.clone(), values, std_errors }
                },
            ));
        }
    }
    samples
}

fn measured(profiles: Vec<MeasuredProfile>) -> Vec<Finding> {
    check(&[Measurement::new("m", profiles).unwrap()])
}

/// Measurements of valid media are neither refused nor noted.
#[test]
fn valid_media_cause_no_finding() {
    let mut random = Normal::new(12);
    let mut checked = 0;
    for sample in samples() {
        for noise in [0.0, 0.004, 0.013, 0.03].repeat(effort() as usize) {
            for has_errors in [true, false] {
                let photograph = |p: &Traced| p.photograph(noise, has_errors, &mut random);
                // Media that scatter no light back have constant profiles, whose refusal is tested elsewhere.
                let seen = |p: &&Traced| p.values.iter().any(|v| *v != p.values[0]);
                let profiles: Vec<_> = sample.profiles.iter().filter(seen).map(photograph).collect();
                if profiles.is_empty() {
                    continue;
                }
                let findings = measured(profiles);
                assert!(
                    findings.is_empty(),
                    "{}, noise {noise}, errors {has_errors}: {findings:#?}",
                    sample.name
                );
                checked += 1;
            }
        }
    }
    assert!(checked >= 2000, "{checked}");
}

/// White, dark and clear media with well visible edges, on the paper's sensor.
fn plain() -> impl Iterator<Item = &'static Sample> {
    let seen = |s: &&Sample| {
        let profile = s.find("R", 1.0);
        profile.values[330] - profile.values[30] > 0.1 * profile.values[330].max(0.3)
    };
    samples().iter().filter(|s| s.sensor == 0).filter(seen)
}

fn refused(profiles: Vec<MeasuredProfile>, kind: Kind) -> bool {
    measured(profiles).iter().any(|f| f.certain && f.kind == kind)
}

fn share(hits: impl Iterator<Item = bool>) -> f64 {
    let hits: Vec<bool> = hits.collect();
    assert!(hits.len() >= 30, "{} media are too few", hits.len());
    hits.iter().filter(|h| **h).count() as f64 / hits.len() as f64
}

/// For every medium with a visible edge: units, pixel numbers, encoded values, falling profiles, and a misplaced edge.
/// Positions in centimetres get a note.
#[test]
fn wrong_units_and_sides_are_detected() {
    type Mistake = fn(&Traced) -> Traced;
    let mistakes: [(Kind, Mistake); 11] = [
        (Kind::ValuesTooLarge, |p| p.map(|v| 255.0 * v + 2.0)),
        (Kind::ValuesTooLarge, |p| p.map(|v| (65_535.0 * v).round() + 100.0)),
        (Kind::ValuesTooLarge, |p| p.map(|v| 100.0 * v + 2.0)),
        (Kind::PixelNumbers, |p| p.at(|x| ((x + 5.0) * 36.0).floor())),
        (Kind::PixelNumbers, |p| p.at(|x| (x * 36.0).floor())),
        (Kind::UnitOfX, |p| p.at(|x| 1000.0 * x)),
        (Kind::UnitOfX, |p| p.at(|x| 0.001 * x)),
        (Kind::UnitOfThickness, |p| p.slab(500.0)),
        (Kind::Falling, |p| Traced { values: p.values.iter().rev().copied().collect(), ..p.clone() }),
        // From 0 to 10 mm, and two thirds of a millimetre off an edge that is narrower than this.
        (Kind::EdgeElsewhere, |p| p.at(|x| x + 5.0)),
        (Kind::EdgeElsewhere, |p| p.at(|x| x - 2.5)),
    ];
    for (kind, mistake) in mistakes {
        for sample in plain() {
            let profile = mistake(sample.find("R", 0.5)).measured(true);
            assert!(refused(vec![profile], kind), "{kind:?} in {}", sample.name);
        }
    }
    let findings = measured(vec![samples()[3].find("R", 0.5).at(|x| 0.1 * x).measured(true)]);
    assert!(findings.iter().any(|f| f.kind == Kind::UnitOfX && !f.certain), "{findings:#?}");
}

#[test]
fn swapped_thicknesses_are_found_where_they_matter() {
    let swapped = |s: &Sample| [0.5, 1.0].map(|mm| s.find("R", mm).slab(1.5 - mm).measured(true)).to_vec();
    let refused = share(plain().map(|s| refused(swapped(s), Kind::ThicknessOrder)));
    let warned = share(plain().map(|s| measured(swapped(s)).iter().any(|f| f.kind == Kind::ThicknessOrder)));
    println!("swapped thicknesses: refused {refused:.2}, warned {warned:.2}");
    assert!(refused > 0.6 && warned > 0.8, "refused {refused:.2}, warned {warned:.2}");
}

/// The data of one profile under the names of two channels or slabs are refused.
#[test]
fn equal_data_under_two_names_are_refused() {
    for sample in plain().step_by(8) {
        let red = sample.find("R", 0.5);
        for other in [Traced { channel: "G".to_owned(), ..red.clone() }, red.slab(1.0)] {
            let profiles = vec![red.clone().measured(true), other.measured(true)];
            assert!(refused(profiles, Kind::SameValues), "{}", sample.name);
        }
    }
}

fn srgb(v: f64) -> f64 {
    if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * libm::pow(v, 1.0 / 2.4) - 0.055 }
}

/// Values of one decimal are refused as such, and those of two are not.
#[test]
fn values_of_one_decimal_are_refused() {
    let mut refused_count = 0;
    for sample in samples().iter().filter(|s| s.sensor != 2) {
        let is_refused = |digits: f64| {
            let traced = sample.find("R", 0.5).map(|v| (digits * v).round() / digits);
            let varies = traced.values.iter().any(|v| *v != traced.values[0]);
            let is_found =
                |findings: Vec<Finding>| findings.iter().any(|f| f.kind == Kind::FewDigits && f.certain);
            varies.then(|| is_found(measured(vec![traced.measured(false)])))
        };
        assert_ne!(is_refused(10.0), Some(false), "{}", sample.name);
        assert_ne!(is_refused(100.0), Some(true), "{}", sample.name);
        refused_count += usize::from(is_refused(10.0).is_some());
    }
    assert!(refused_count > 20, "{refused_count}");
}

/// Values of 8 bits are noted, and refused only where a gamma curve shows.
#[test]
fn eight_bit_values_are_noted() {
    let in_steps = |v: f64| (255.0 * v.clamp(0.0, 1.0)).round() / 255.0;
    let eight_bit = |p: Traced| measured(vec![p.measured(false)]);
    let found = |findings: &[Finding], certain: bool| {
        findings.iter().any(|f| f.kind == Kind::EightBit && (f.certain || !certain))
    };
    let mut warned_count = 0;
    for sample in samples().iter().filter(|s| s.sensor != 2) {
        let linear = sample.find("R", 0.5).map(in_steps);
        let varies = linear.values.iter().any(|v| *v != linear.values[0]);
        if varies {
            let findings = eight_bit(linear);
            assert!(!findings.iter().any(|f| f.certain), "{}: {findings:#?}", sample.name);
            warned_count += usize::from(found(&findings, false));
        }
    }
    assert!(warned_count > 50, "{warned_count}");
    let encoded = |s: &Sample| eight_bit(s.find("R", 0.5).map(|v| in_steps(srgb(v))));
    let (warned, refused) =
        (share(plain().map(|s| found(&encoded(s), false))), share(plain().map(|s| found(&encoded(s), true))));
    println!("sRGB of 8 bits: warned {warned:.2}, refused {refused:.2}");
    assert!(warned > 0.95 && refused > 0.02, "warned {warned:.2}, refused {refused:.2}");
}
