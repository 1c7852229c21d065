//! Media from charts of printed stacks and from a spectrophotometer: simulated ones, whose truth is known, and public ones.
//!
//! Values are those of `Print`, stack by stack over all directions, which `optics/layers` compares with the tracer and with
//! other programs.

use std::fmt::Write as _;
use std::path::Path;

use farm_tests::cli::{folder, json, write};
use farm_tests::process::run;
use farm_tests::statistics::{Normal, Share, effort, median};
use optics_chart::lab;
use optics_layers::{Print, PrintLayer};
use optics_model::Medium;
use optics_model::phase::PhaseShape;
use optics_model::scene::{Channel, Layer, RingLight, Scene, Sensor};
use serde_json::Value;

/// White, cyan and magenta: σ_s(1 − g) and σ_a in 1/mm of R, G and B.
const INKS: [(&str, [[f64; 2]; 3]); 3] = [
    ("white", [[7.0, 0.02], [8.5, 0.02], [10.0, 0.04]]),
    ("cyan", [[3.0, 2.8], [5.0, 0.7], [7.0, 0.06]]),
    ("magenta", [[7.0, 0.3], [4.0, 4.0], [6.5, 1.0]]),
];
/// Noise of a colour in L*, a* and b*.
const NOISE: f64 = 0.4;
const LAYER_MM: f64 = 0.08;

fn scene(ring: [f64; 2], polar_deg: f64) -> Scene {
    let layers = vec![Layer::sample("print", 0.0).unwrap(), Layer::clear("air", 1.0, 0.0, 0.0).unwrap()];
    let channels = vec![Channel::new("R", 0.5, 0.1).unwrap()];
    let ring = RingLight::new(ring[0], ring[1]).unwrap();
    Scene::new(layers, channels, ring, Sensor::new(10.0, 1, polar_deg).unwrap(), true).unwrap()
}

/// A slab of a material in a channel; all thicknesses are off by a factor.
fn layer(coefficients: [f64; 2], g: f64, thickness_mm: f64) -> PrintLayer {
    let scattering = coefficients[0] / (1.0 - g);
    let sigma_t = scattering + coefficients[1];
    let medium = Medium::new(sigma_t, scattering / sigma_t, g).unwrap();
    PrintLayer { medium, phase: PhaseShape::default(), thickness_mm }
}

/// A laboratory with what its chart does not know.
struct Laboratory {
    random: Normal,
    print: Print,
    g: f64,
    /// Factor on all thicknesses.
    thickness: f64,
    sheen: f64,
    /// Reflectance of the base by channel.
    base: [f64; 3],
    matrix: [[f64; 3]; 3],
    inks: Vec<[[f64; 2]; 3]>,
    index: f64,
}

impl Laboratory {
    fn new(seed: u64) -> Self {
        let mut random = Normal::new(seed);
        let mut about = |mean: f64, spread: f64| mean + spread * random.normal();
        let index = about(1.5, 0.03).clamp(1.4, 1.6);
        let print = Print::new(&scene([40.0, 50.0], 0.0), index, 0.5);
        let g = 1.0 - 0.6 * libm::exp(about(0.0, 0.2).clamp(-0.4, 0.4));
        let (thickness, sheen) = (about(1.0, 0.03), about(0.01, 0.005).max(0.0));
        let base = [0; 3].map(|_| about(0.5, 0.2).clamp(0.05, 0.95));
        let mut matrix = [[0.0; 3]; 3];
        for (i, row) in matrix.iter_mut().enumerate() {
            *row = [0; 3].map(|_| about(0.0, 0.1));
            row[i] = 0.0;
            row[i] = 1.0 - row.iter().sum::<f64>();
        }
        let mut scaled = |v: f64| v * libm::exp(about(0.0, 0.2));
        let inks = INKS.map(|(_, ink)| ink.map(|channel| channel.map(&mut scaled))).to_vec();
        Self { random, print, g, thickness, sheen, base, matrix, inks, index }
    }

    /// Another laboratory that has the same resins.
    fn with_same_resins(&self, seed: u64) -> Self {
        let print = Print::new(&scene([40.0, 50.0], 0.0), self.index, 0.5);
        Self { print, g: self.g, inks: self.inks.clone(), index: self.index, ..Self::new(seed) }
    }

    /// A chart of that many stacks.
    fn chart(&mut self, count: usize) -> String {
        let mut text = "slabs,L,a,b\n".to_owned();
        for stack in self.stacks(count) {
            let [l, a, b] = self.colour(&stack);
            writeln!(text, "{},{l:.3},{a:.3},{b:.3}", words(&stack)).unwrap();
        }
        text
    }

    /// Slabs of each ink over black and white at 45:0 and d:8, and what passes them.
    fn spectrophotometry(&mut self) -> String {
        const ERROR: f64 = 0.003;
        let views = [([40.0, 50.0], 0.0), ([0.0, 90.0], 8.0), ([0.0, 90.0], 0.0)];
        let prints = views.map(|(ring, polar)| Print::new(&scene(ring, polar), self.index, 0.5));
        let mut text = "slabs,channel,value,std_error,base,geometry\n".to_owned();
        for (ink, (name, _)) in INKS.iter().enumerate() {
            for (c, channel) in ["460", "540", "620"].iter().enumerate() {
                for mm in [0.3, 1.0] {
                    let slab = [layer(self.inks[ink][c], self.g, mm * self.thickness)];
                    let mut row = |value: f64, base: &str, geometry: &str| {
                        let value = value + ERROR * self.random.normal();
                        writeln!(text, "{name}:{mm},{channel},{value:.5},{ERROR},{base},{geometry}").unwrap();
                    };
                    for (base, rho) in [("black", 0.03), ("white", 0.9)] {
                        let seen = prints[0].radiance_factors(&slab, &[rho])[0];
                        row(seen + self.sheen, base, "45:0");
                        row(prints[1].radiance_factors(&slab, &[rho])[0], base, "d:8");
                    }
                    row(prints[2].transmittance(&slab), "", "transmission");
                }
            }
        }
        text
    }

    /// Whether the intervals of both coefficients hold, of all media of an answer.
    fn held(&self, answer: &Value) -> Vec<bool> {
        let mut held = Vec::new();
        for material in answer["materials"].as_array().unwrap() {
            let ink = INKS.iter().position(|(name, _)| material["material"] == *name).unwrap();
            for (c, channel) in material["channels"].as_array().unwrap().iter().enumerate() {
                let [scattering, absorption] = self.inks[ink][c];
                held.push(interval_holds(channel, "reduced_scattering_interval", scattering));
                held.push(interval_holds(channel, "absorption_interval", absorption));
            }
        }
        held
    }

    /// Radiance factors of a stack.
    fn values(&self, stack: &[(usize, f64)]) -> [f64; 3] {
        std::array::from_fn(|c| {
            let slab = |(ink, mm): &(usize, f64)| layer(self.inks[*ink][c], self.g, mm * self.thickness);
            let slabs: Vec<PrintLayer> = stack.iter().map(slab).collect();
            self.print.radiance_factors(&slabs, &[self.base[c]])[0]
        })
    }

    /// CIELAB of a stack as the camera sees it.
    fn colour(&mut self, stack: &[(usize, f64)]) -> [f64; 3] {
        let v = self.values(stack);
        let seen = self.matrix.map(|row| row.iter().zip(v).map(|(m, v)| m * v).sum::<f64>() + self.sheen);
        lab(seen).map(|v| v + NOISE * self.random.normal())
    }

    /// Stacks of five layers on 0.8 mm of white, and wedges of each ink.
    fn stacks(&mut self, count: usize) -> Vec<Vec<(usize, f64)>> {
        let on_white = |mut stack: Vec<(usize, f64)>| {
            stack.push((0, 0.8));
            stack
        };
        let wedge = |ink: usize| [1, 2, 4, 8, 16].map(|layers| vec![(ink, LAYER_MM); layers]);
        let mut all: Vec<_> = (0..INKS.len()).flat_map(wedge).map(on_white).collect();
        while all.len() < count {
            let five = (0..5).map(|_| ((self.random.uniform() * INKS.len() as f64) as usize, LAYER_MM));
            all.push(on_white(five.collect()));
        }
        all
    }
}

fn words(stack: &[(usize, f64)]) -> String {
    stack.iter().map(|(ink, mm)| format!("{}:{mm}", INKS[*ink].0)).collect::<Vec<_>>().join(" ")
}

fn answer(folder: &Path, args: &[&str], kind: &str) -> Value {
    let ran = run(folder, &[args, &["--json"]].concat());
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    json(&ran, kind)
}

fn interval_holds(channel: &Value, name: &str, truth: f64) -> bool {
    let ends = &channel["refined"][name];
    let [low, high] = ["low", "high"].map(|end| ends[end].as_f64().unwrap());
    (ends["open_low"] == true || low <= truth) && (ends["open_high"] == true || truth <= high)
}

/// Whether σ_s(1 − g) and σ_a of two measurements differ by less than their uncertainties, for all media.
fn agreement(folder: &Path, a: &str, b: &str) -> Vec<bool> {
    let compared = answer(folder, &["compare", a, b], "compare");
    let channels = compared["channels"].as_array().unwrap().iter();
    let quantities = channels.flat_map(|c| c["quantities"].as_array().unwrap().iter().take(2));
    quantities.filter_map(|q| Some(q["e_n"].as_f64()?.abs() < 1.0)).collect()
}

/// That intervals of 95 % hold, as often as groups of them show it.
fn assert_held(what: &str, groups: &[Vec<bool>]) {
    let share = Share::of_groups(groups).unwrap();
    println!("{what} {share} %");
    assert!(share.share > 0.95 - 3.0 * share.std_error.max(0.02), "{what} {share}");
}

/// Intervals of media hold where index, layer height, sheen, base, camera and g are other than the chart knows; so does the
/// bound of colours for stacks that were not measured. Two laboratories agree about the same resins.
#[test]
fn media_of_charts_hold() {
    let [mut media, mut agree] = [Vec::new(), Vec::new()];
    let [mut within, mut medians] = [Vec::new(), Vec::new()];
    for seed in 0..4 * effort() {
        let mut laboratory = Laboratory::new(seed);
        let folder = folder();
        write(folder.path(), "chart.csv", &laboratory.chart(80));
        write(folder.path(), "others.csv", &laboratory.chart(120));
        write(folder.path(), "again.csv", &laboratory.with_same_resins(2000 + seed).chart(80));
        let found = answer(folder.path(), &["measure", "chart.csv", "-o", "media"], "chart");
        media.push(laboratory.held(&found));
        answer(folder.path(), &["measure", "again.csv", "-o", "again"], "chart");
        agree.push(agreement(folder.path(), "media", "again"));
        let others = answer(folder.path(), &["validate", "media", "others.csv"], "validate_stacks");
        within.push(others["bound"][1].as_f64().unwrap());
        medians.push(others["median"].as_f64().unwrap());
    }
    let bound = within.iter().sum::<f64>() / within.len() as f64;
    println!("colours {:.1} %, median {:.2}", 100.0 * bound, median(medians.clone()));
    assert_held("media hold", &media);
    assert_held("two laboratories agree", &agree);
    assert!(bound > 0.9 && median(medians) < 2.0 * NOISE, "{bound}");
}

/// Slabs over black and white at 45:0 and d:8, and what passes them, determine σ_s(1 − g) and σ_a: their intervals hold,
/// and two instruments agree about the same resins.
#[test]
fn media_of_spectrophotometers_hold() {
    let [mut media, mut agree] = [Vec::new(), Vec::new()];
    for seed in 0..6 * effort() {
        let mut laboratory = Laboratory::new(1000 + seed);
        let folder = folder();
        write(folder.path(), "slabs.csv", &laboratory.spectrophotometry());
        write(folder.path(), "again.csv", &laboratory.with_same_resins(3000 + seed).spectrophotometry());
        media.push(laboratory.held(&answer(
            folder.path(),
            &["measure", "slabs.csv", "-o", "media"],
            "chart",
        )));
        answer(folder.path(), &["measure", "again.csv", "-o", "again"], "chart");
        agree.push(agreement(folder.path(), "media", "again"));
    }
    assert_held("media hold", &media);
    assert_held("two instruments agree", &agree);
}

/// Public charts of printed stacks, whose folder `FARM_TEST_CHARTS` names: 200 or 60 patches predict the other ones. See
/// `docs/prints.md`.
#[test]
#[ignore = "needs the folder of public charts: FARM_TEST_CHARTS"]
fn public_charts_are_predicted() {
    let charts = std::env::var("FARM_TEST_CHARTS").expect("FARM_TEST_CHARTS names the folder of the charts");
    for (name, most) in [("RYBW_008_5L", [1.55, 1.70]), ("CMYB_008_5L", [1.30, 1.40])] {
        let text = std::fs::read_to_string(Path::new(&charts).join(name).with_extension("json")).unwrap();
        let chart: Value = serde_json::from_str(&text).unwrap();
        for (count, most) in [200, 60].into_iter().zip(most) {
            let (mut medians, mut within) = (Vec::new(), Vec::new());
            for seed in 0..3 * effort() {
                let mut random = Normal::new(seed);
                let mut entries = chart["entries"].as_array().unwrap().clone();
                for i in (1..entries.len()).rev() {
                    entries.swap(i, (random.uniform() * (i + 1) as f64) as usize);
                }
                let part = |entries: &[Value]| {
                    let mut part = chart.clone();
                    part["entries"] = entries.into();
                    part.to_string()
                };
                let folder = folder();
                write(folder.path(), "known.json", &part(&entries[..count]));
                write(folder.path(), "others.json", &part(&entries[count..]));
                // The index of polylactide.
                write(folder.path(), "chart.toml", "values = \"known.json\"\nsample_ior = 1.46\n");
                answer(folder.path(), &["measure", "chart.toml", "-o", "media"], "chart");
                let found = answer(folder.path(), &["validate", "media", "others.json"], "validate_stacks");
                medians.push(found["median"].as_f64().unwrap());
                within.push(found["bound"][1].as_f64().unwrap());
            }
            let mean = within.iter().sum::<f64>() / within.len() as f64;
            println!(
                "{name}, {count} patches: medians {medians:.2?}, within the bound {within:.3?}, mean {mean:.3}"
            );
            assert!(median(medians.clone()) <= most && mean > 0.9, "{name} {count}: {medians:?} {mean}");
        }
    }
}
