//! Speed of the fit with a whole dictionary.
//!
//! `FARM_BENCH_DATA=DIR cargo bench -p farm-coordinator` takes the dictionary "paper" of a data directory, which
//! `farmctl submit --data DIR` makes. Without it the paper's grid is filled by a formula. That serves to compare
//! versions, but pruning differs from that of simulated profiles.

#![expect(clippy::unwrap_used, reason = "a benchmark may panic")]

use std::path::PathBuf;

use criterion::{Criterion, criterion_group, criterion_main};
use farm_coordinator::load_dictionary;
use farm_coordinator::store::{DataDir, Store};
use optics_fit as fit;
use optics_fit::{DictionaryBuilder, FitDictionary};
use optics_model::fit::{Bounds, FitOptions, FitSettings, MuRange};
use optics_model::job::JobSpec;
use optics_model::{Estimate, Grid, MeasuredProfile, Measurement, PackedRecords, Profile, Record};

fn runtime() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_multi_thread().enable_all().build().unwrap()
}

fn load(runtime: &tokio::runtime::Runtime) -> FitDictionary {
    let Some(data) = std::env::var_os("FARM_BENCH_DATA").map(PathBuf::from) else { return made_up() };
    runtime.block_on(async {
        let store = Store::open(DataDir::lock(&data).unwrap(), |_| {}).await.unwrap();
        let stored = store.dictionaries().await.unwrap();
        let paper = stored.into_iter().find(|d| d.name.as_str() == "paper").expect("a dictionary \"paper\"");
        let dictionary = load_dictionary(&store, &paper.name, paper.id, &paper.grid).await.unwrap();
        store.close().await;
        dictionary
    })
}

/// The paper's grid with profiles from a formula.
fn made_up() -> FitDictionary {
    let grid = Grid::paper();
    let mut builder = DictionaryBuilder::new(grid.clone());
    let record = |index: usize| {
        let (point, medium) = grid.parameters(index);
        let width = 0.3 + point.thickness_mm() / (medium.sigma_t_per_mm() * (1.0 - medium.g()));
        let value = |i: usize| {
            let x = grid.scene().sensor().centre_mm(i);
            (medium.albedo() * (0.3 + 0.2 * libm::tanh(x / width) / point.thickness_mm())) as f32
        };
        let values: Vec<f32> = (0..grid.scene().sensor().pixels()).map(value).collect();
        let estimate = Estimate::new(values.clone(), vec![0.0; values.len()]).unwrap();
        let profile = Profile { radiance_factor: estimate, derivatives: None };
        Record { index, profiles: vec![profile; 3] }
    };
    for job in 0..grid.job_count() {
        let first = grid.first_record(job);
        let records: Vec<Record> = (first..first + grid.albedo().len()).map(record).collect();
        builder.add(&PackedRecords::pack(&JobSpec::of(&grid, job), &records));
    }
    builder.build()
}

/// A smooth random-looking sequence of numbers from −1 to 1.
fn noise(n: usize) -> f64 {
    (libm::sin(n as f64 * 12.9898) * 43_758.547).fract()
}

/// A material and its σ_t and α in R, G, B.
type Row = (&'static str, [(f64, f64); 3]);

/// The paper's Table 1, at g = 0.4.
const TABLE_1: [Row; 5] = [
    ("cyan", [(9.0, 0.05), (4.5, 0.7), (7.5, 0.98)]),
    ("magenta", [(2.5, 0.98), (3.0, 0.1), (10.0, 0.9)]),
    ("yellow", [(2.25, 0.997), (3.75, 0.995), (19.0, 0.15)]),
    ("black", [(5.0, 0.35), (5.5, 0.35), (6.5, 0.35)]),
    ("white", [(6.0, 0.9991), (9.0, 0.9997), (24.0, 0.999)]),
];

/// A channel, and the σ_t and α of a medium in it.
type Medium = (usize, f64, f64);

/// The record nearest to a medium with 1 % of noise, as a measurement at both thicknesses.
fn measurement(dictionary: &FitDictionary, material: &str, media: &[Medium], seed: usize) -> Measurement {
    let grid = dictionary.grid();
    let nearest = |axis: &[f64], v: f64| {
        let distance = |i: &usize| (axis[*i] - v).abs();
        (0..axis.len()).min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap()
    };
    let mut profiles = Vec::new();
    for &(channel, sigma_t, albedo) in media {
        for (t, thickness) in grid.thickness_mm().iter().enumerate() {
            let (s, a) = (nearest(grid.sigma_t_per_mm(), sigma_t), nearest(grid.albedo(), albedo));
            let record = grid.record_at(0, s, nearest(grid.g(), 0.4), t, a);
            let exact = dictionary.values(record, channel);
            let noisy = |(i, v): (usize, &f32)| f64::from(*v) * (1.0 + 0.017 * noise(seed + i + 1000 * t));
            let values = exact.iter().enumerate().map(noisy).collect();
            let x = (0..exact.len()).map(|i| grid.scene().sensor().centre_mm(i)).collect();
            let name = grid.scene().channels()[channel].name();
            profiles.push(MeasuredProfile::new(name, *thickness, x, values, None).unwrap());
        }
    }
    Measurement::new(material, profiles).unwrap()
}

fn materials(dictionary: &FitDictionary) -> Vec<Measurement> {
    let material = |(i, (name, media)): (usize, &Row)| {
        let media: Vec<_> = media.iter().enumerate().map(|(c, (s, a))| (c, *s, *a)).collect();
        measurement(dictionary, name, &media, 7 * i)
    };
    TABLE_1.iter().enumerate().map(material).collect()
}

fn single(dictionary: &FitDictionary) -> Vec<Measurement> {
    let mut all = Vec::new();
    for (name, media) in &TABLE_1 {
        for (channel, (sigma_t, albedo)) in media.iter().enumerate() {
            all.push(measurement(dictionary, name, &[(channel, *sigma_t, *albedo)], 11 * all.len()));
        }
    }
    all
}

fn engine(c: &mut Criterion) {
    let runtime = runtime();
    let mut group = c.benchmark_group("load");
    group.sample_size(10);
    group.bench_function("dictionary", |b| b.iter_with_large_drop(|| load(&runtime)));
    group.finish();

    let dictionary = load(&runtime);
    let questions = single(&dictionary);
    let fitted = |question, options: &FitOptions| fit::fit(&dictionary, question, options).unwrap();
    let usual = FitOptions::default();
    let mut group = c.benchmark_group("one channel, two thicknesses");
    for (name, question) in [("white G", &questions[13]), ("cyan R", &questions[0])] {
        group.bench_function(format!("search, {name}"), |b| b.iter(|| fitted(question, &usual)));
    }
    let mut next = questions.iter().cycle();
    group.bench_function("search, all of Table 1 in turn", |b| {
        b.iter(|| fitted(next.next().unwrap(), &usual));
    });
    for (name, g) in [("g held", Bounds::fixed(0.4)), ("g free", Bounds::FREE)] {
        let options = FitOptions::new(FitSettings { g, refine: true, ..FitSettings::default() }).unwrap();
        group.bench_function(format!("search, refinement and certainty, {name}"), |b| {
            b.iter(|| fitted(&questions[13], &options));
        });
    }
    group.bench_function("distance map", |b| {
        b.iter(|| fit::distance_map(&dictionary, &questions[13], &usual).unwrap());
    });
    group.finish();

    let materials = materials(&dictionary);
    let mut group = c.benchmark_group("five materials, three channels");
    group.sample_size(10);
    group.bench_function("scale factor, 201 values", |b| {
        b.iter(|| fit::scale(&dictionary, &materials, &usual, &MuRange::default()).unwrap());
    });
    let plan = fit::MeasurePlan { search_mu: Some(MuRange::default()), ..fit::MeasurePlan::default() };
    group.bench_function("the whole measurement", |b| {
        b.iter(|| fit::measure(&dictionary, &materials, &usual, &plan).unwrap());
    });
}

criterion_group!(benches, engine);
criterion_main!(benches);
