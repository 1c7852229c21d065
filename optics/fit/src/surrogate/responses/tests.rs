//! Compares responses between their nodes with profiles that were traced in the changed scene with the same random walks.

use std::sync::atomic::AtomicBool;

use optics_layers::records;
use optics_model::grid::{Axes, Responses};
use optics_model::job::JobSpec;
use optics_model::scene::{Prior, PriorKind, Scene};
use optics_model::{Grid, Medium, PackedRecords, Walks};
use optics_tracer::SeenBase;

use crate::surrogate::{Surrogate, coordinates};
use crate::testing::traced_profile;
use crate::{DictionaryBuilder, FitDictionary};

const SLABS_MM: [f64; 2] = [0.5, 1.0];
const IOR: f64 = 1.53;

fn lab() -> Scene {
    let lab = Scene::lab();
    let first = lab.channels()[..1].to_vec();
    lab.with_channels(first).unwrap()
}

fn dictionary() -> FitDictionary {
    traced(lab(), dictionary_axes(), Walks::PAPER, 1)
}

fn dictionary_axes() -> Axes {
    Axes {
        sigma_t_per_mm: (0..12).map(|i| libm::pow(10_f64, f64::from(i) / 11.0)).collect(),
        albedo: (0..20).map(|i| 1.0 - (0.9 - f64::from(i) * 0.88 / 19.0).powi(2)).collect(),
        g: vec![0.0, 0.2, 0.4, 0.6, 0.8],
        thickness_mm: SLABS_MM.to_vec(),
        sample_ior: vec![IOR],
    }
}

/// The traced dictionary of a scene, with its responses.
fn traced(scene: Scene, axes: Axes, walks: Walks, seed: u64) -> FitDictionary {
    let base = SeenBase::of(&scene);
    let responses = Responses::of(&scene, &axes, |varied| base.through(varied)).unwrap().unwrap();
    let grid = Grid::new(scene, axes, walks, seed, false).unwrap().with_responses(responses).unwrap();
    let mut builder = DictionaryBuilder::new(grid.clone());
    for job in 0..grid.job_count() {
        let job = JobSpec::of(&grid, job);
        builder.add(&PackedRecords::pack(&job, &records(&job, &AtomicBool::new(false)).unwrap()));
    }
    builder.build()
}

/// The sample's roughness as the only uncertain quantity, in a dictionary of one slab of 1 mm.
fn of_roughness(seed: u64) -> FitDictionary {
    let roughness = lab().priors()[0].clone();
    let scene = lab().with_priors(vec![roughness]).unwrap();
    let axes = Axes {
        sigma_t_per_mm: vec![1.0, 2.0, 4.0, 8.0, 16.0, 32.0],
        albedo: vec![0.7, 0.8, 0.85, 0.9, 0.94, 0.97],
        g: vec![0.0, 0.4, 0.7],
        thickness_mm: vec![1.0],
        sample_ior: vec![IOR],
    };
    traced(scene, axes, Walks::new(2500).unwrap(), seed)
}

/// The model's error is a tenth of the change of a profile, alike at neighbouring pixels and different farther away.
#[test]
fn model_errors_are_shares_of_the_change() {
    let dictionary = of_roughness(1);
    let surrogate = Surrogate::new(&dictionary, 0, 0);
    let x = coordinates(&Medium::new(4.0, 0.9, 0.4).unwrap());
    let responses = surrogate.responses(1.0, x).unwrap();
    let change = responses.change(&[], &[], 1.0, x, &[1.5]).values;
    let errors = responses.model_errors(&[1.5], 10.0);
    let covariance = |i: usize, k: usize| -> f64 { errors.iter().map(|f| f[i] * f[k]).sum() };
    let n = change.len();
    for i in (n / 4..3 * n / 4).step_by(9) {
        let [own, far] = [i, i + n / 4].map(|k| covariance(i, k) / (change[i] * change[k]).abs());
        assert!((own.sqrt() - 0.1).abs() < 0.01, "pixel {i}: {}", own.sqrt());
        assert!(far.abs() < 0.05 * own, "pixel {i}: {far} {own}");
    }
    let none = responses.model_errors(&[0.0], 10.0);
    assert!(none.iter().flatten().all(|v| *v == 0.0));
}

/// The effect of a spread within the base is smaller where thicker gel blurs the edge: more than half of the joint effect
/// that is traced follows to first order.
#[test]
fn spread_follows_other_quantities() {
    let chosen = [PriorKind::Thickness, PriorKind::BaseSpread];
    let gel_or_spread = |prior: &&Prior| chosen.contains(&prior.kind()) && prior.layers() != [0];
    let priors: Vec<Prior> = lab().priors().iter().filter(gel_or_spread).cloned().collect();
    let axes = Axes {
        sigma_t_per_mm: vec![1.5, 3.0, 5.0, 8.0, 12.0],
        albedo: vec![0.7, 0.85, 0.94, 0.98, 0.995],
        g: vec![0.2, 0.4, 0.6],
        thickness_mm: vec![0.5],
        sample_ior: vec![IOR],
    };
    let scene = lab().with_priors(priors.clone()).unwrap();
    let dictionary = traced(scene.clone(), axes, Walks::new(50_000).unwrap(), 1);
    let medium = Medium::new(4.0, 0.97, 0.4).unwrap();
    let profile = |[gel, spread]: [f64; 2]| {
        let mut varied = scene.clone();
        for (prior, u) in priors.iter().zip([gel, spread]).filter(|(_, u)| *u > 0.0) {
            let channels = varied.channels().to_vec();
            varied = varied.varied(prior, u * prior.std_error(), channels).unwrap();
        }
        traced_profile(varied, &medium, 0.5, Walks::new(2_000_000).unwrap(), 3)
    };
    let plain = profile([0.0, 0.0]);
    let x = coordinates(&medium);
    let responses = Surrogate::new(&dictionary, 0, 0).responses(0.5, x).unwrap();
    let change = |quantities: [f64; 2]| responses.change(&plain, &[], 0.5, x, &quantities).values;
    // A gel of 0.05 mm, and 0.3 mm of spread.
    let [of_gel, of_spread, of_both] = [[1.5, 0.0], [0.0, 3.0], [1.5, 3.0]].map(|q| (profile(q), change(q)));
    let near_edge = plain.len() / 2..plain.len() / 2 + 12;
    let traced = |i: usize| of_both.0[i] - of_gel.0[i] - of_spread.0[i] + plain[i];
    let predicted = |i: usize| of_both.1[i] - of_gel.1[i] - of_spread.1[i];
    let joint = root_mean_square(near_edge.clone().map(|i| traced(i) / plain[i]));
    let error = root_mean_square(near_edge.map(|i| (predicted(i) - traced(i)) / plain[i]));
    assert!(joint > 0.003 && error < 0.5 * joint, "{joint} {error}");
}

/// The stated noise is the scatter of values and slopes between dictionaries of different seeds.
#[test]
fn noise_is_the_scatter_between_seeds() {
    const SEEDS: u64 = 24;
    let (mm, x) = (1.0, coordinates(&Medium::new(3.0, 0.93, 0.3).unwrap()));
    let dictionaries: Vec<FitDictionary> = (1..=SEEDS).map(of_roughness).collect();
    let surrogates = dictionaries.iter().map(|dictionary| Surrogate::new(dictionary, 0, 0));
    let (mut found, mut stated) = ([Vec::new(), Vec::new()], 0.0);
    for surrogate in surrogates {
        let mut change = surrogate.responses(mm, x).unwrap().change(&[], &[], mm, x, &[1.5]);
        let [values, slopes] = &mut found;
        values.push(change.values);
        slopes.push(change.by_quantity.remove(0));
        let factors = surrogate.response_noise(mm, x).unwrap().factors(0, 1.5);
        stated += factors.iter().flatten().map(|f| f * f).sum::<f64>() / SEEDS as f64;
    }
    let variance = |values: &[Vec<f64>], p: usize| {
        let mean = values.iter().map(|v| v[p]).sum::<f64>() / SEEDS as f64;
        values.iter().map(|v| (v[p] - mean).powi(2)).sum::<f64>() / (SEEDS - 1) as f64
    };
    let pixels = found[0][0].len();
    let found: f64 = found.iter().flat_map(|of| (0..pixels).map(|p| variance(of, p))).sum();
    assert!((0.7..1.4).contains(&(stated / found)), "{}", stated / found);
}

/// Media off the nodes: a sequence of low discrepancy over ln σ_t, ln(1 − α) and g.
fn media(count: u32) -> Vec<Medium> {
    let at = |i: u32, step: f64| (0.5 + f64::from(i) * step).fract();
    let log = |low: f64, high: f64, u: f64| low * libm::pow(high / low, u);
    let medium = |i: u32| {
        let co_albedo = log(1e-3, 0.7, at(i, 0.671_043_606_7));
        let sigma_t = log(1.1, 9.0, at(i, 0.819_172_513_4));
        Medium::new(sigma_t, 1.0 - co_albedo, 0.75 * at(i, 0.549_700_477_9)).unwrap()
    };
    (0..count).map(medium).collect()
}

/// Differences of a quantity at which responses are compared, in standard deviations: one up and down within the range,
/// and three quarters of the way to the farthest step.
fn places(prior: &Prior, scene: &Scene) -> Vec<f64> {
    let (low, high) = prior.range(scene);
    let sd = prior.std_error();
    let far = prior.steps(scene).iter().fold(0.0, |far: f64, step| far.max(step.abs())) / sd;
    vec![1.0, (-1.0_f64).max(low / sd), (0.75 * far).min(high / sd)]
}

/// Errors of the responses for one quantity and place, over media and slabs.
#[derive(Default)]
struct ResponseErrors {
    /// Root mean square of the traced difference, in per cent of the profile.
    effects: Vec<f64>,
    /// Root mean square of the response's error, over that of the records' noise.
    over_noise: Vec<f64>,
    /// Error of the mean level in per cent.
    levels: Vec<f64>,
}

fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted[((share * sorted.len() as f64) as usize).min(sorted.len() - 1)]
}

fn root_mean_square(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let n = values.len() as f64;
    (values.map(|v| v * v).sum::<f64>() / n).sqrt()
}

impl ResponseErrors {
    fn add(&mut self, plain: &[f64], changed: &[f64], found: &[f64], noise: &[Vec<f64>]) {
        let n = plain.len();
        let error = |i: usize| found[i] - (changed[i] - plain[i]);
        let noise_at = |i: usize| noise.iter().map(|f| (f[i] / plain[i]).powi(2)).sum::<f64>().sqrt();
        let off = root_mean_square((0..n).map(|i| error(i) / plain[i]));
        self.effects.push(100.0 * root_mean_square((0..n).map(|i| changed[i] / plain[i] - 1.0)));
        self.over_noise.push(off / root_mean_square((0..n).map(noise_at)));
        self.levels.push(100.0 * ((0..n).map(error).sum::<f64>() / plain.iter().sum::<f64>()).abs());
    }
}

#[test]
#[ignore = "long form"]
fn responses_agree_with_traced_differences() {
    check_responses(|prior| {
        prior.kind().is_traced() && !prior.kind().is_of_phase() && !prior.kind().is_of_base()
    });
}

#[test]
#[ignore = "long form"]
fn base_agrees_with_traced_differences() {
    check_responses(|prior| prior.kind().is_of_base());
}

#[test]
#[ignore = "long form"]
fn second_lobe_agrees_with_traced_differences() {
    check_responses(|prior| prior.kind().is_of_phase());
}

/// Prints the errors of quantities. In the median they are below the noise of the records.
fn check_responses(chosen: impl Fn(&Prior) -> bool) {
    let (media, walks) = (media(20), Walks::new(10_000_000).unwrap());
    let (scene, dictionary) = (lab(), dictionary());
    let (surrogate, base) = (Surrogate::new(&dictionary, 0, 0), SeenBase::of(&scene));
    let slab_mm = |m: usize| SLABS_MM[m % SLABS_MM.len()];
    let all = |scene: &Scene| -> Vec<Vec<f64>> {
        let profile = |(m, medium): (usize, &Medium)| {
            traced_profile(scene.clone(), medium, slab_mm(m), walks, m as u64)
        };
        media.iter().enumerate().map(profile).collect()
    };
    let plain = all(&scene);
    println!("| quantity | u | effect % | error over noise: median | 95 % | of the level %: median | 95 % |");
    for (p, prior) in scene.priors().iter().enumerate().filter(|(_, prior)| chosen(prior)) {
        for u in places(prior, &scene) {
            let varied = scene.varied(prior, u * prior.std_error(), scene.channels().to_vec()).unwrap();
            let channels = base.through(&varied).unwrap();
            let changed = all(&varied.with_channels(channels).unwrap());
            let mut quantities = vec![0.0; scene.priors().len()];
            quantities[p] = u;
            let mut compared = ResponseErrors::default();
            for (m, medium) in media.iter().enumerate() {
                let (mm, x) = (slab_mm(m), coordinates(medium));
                let found =
                    surrogate.responses(mm, x).unwrap().change(&plain[m], &[], mm, x, &quantities).values;
                let noise = surrogate.noise_factors_at(mm, x).factors;
                compared.add(&plain[m], &changed[m], &found, &noise);
            }
            let ResponseErrors { effects, over_noise, levels } = compared;
            let [median, most] = [0.5, 0.95].map(|share| quantile(&over_noise, share));
            let [level, worst] = [0.5, 0.95].map(|share| quantile(&levels, share));
            let (name, effect) = (scene.name_of(prior), quantile(&effects, 0.5));
            println!(
                "| {name} | {u:+.2} | {effect:.3} | {median:.2} | {most:.2} | {level:.3} | {worst:.3} |"
            );
            assert!(median < 1.0, "{name} at {u}: {median}");
        }
    }
}
