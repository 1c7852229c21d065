//! Measurement of strong absorbers by dilution: the inks of the paper's Table 1 from slabs of their mixtures.
//!
//! In the normal run two inks are measured in one channel. With `FARM_TEST_EFFORT=8` it is the chart of all 31 equal
//! mixtures of the five inks, in three channels, with the paper's whole dictionary. The exposure is off by an unknown
//! factor.

use farm_tests::coverage::{Answer, Coverage, Estimate, media_table};
use farm_tests::statistics::{Normal, effort};
use farm_tests::stored;
use optics_fit::{FitDictionary, measure, unmix};
use optics_model::fit::{FitOptions, Mixture, Mixtures, Unmixed};
use optics_model::scene::Channel;
use optics_model::{Grid, MeasuredProfile, Measurement, Medium};
use rayon::prelude::*;

use super::table_1::TABLE_1;
use super::{NOISE, SLABS_MM, centres_mm, noisy, print_common, traced, unknown_factor, values};

const G: f64 = 0.4;

/// Indices of Table 1's inks that are mixed in equal parts.
type Subset = Vec<usize>;

fn name(subset: &[usize]) -> String {
    subset.iter().map(|i| TABLE_1[*i].0).collect::<Vec<_>>().join("+")
}

/// The medium of inks in these volume fractions.
fn mixed(parts: &[(usize, f64)], channel: usize) -> Medium {
    let sum = |of: &dyn Fn(f64, f64) -> f64| -> f64 {
        parts.iter().map(|(i, f)| f * of(TABLE_1[*i].1[channel].0, TABLE_1[*i].1[channel].1)).sum()
    };
    let (scattering, absorption) = (sum(&|s, a| s * a), sum(&|s, a| s * (1.0 - a)));
    Medium::new(scattering + absorption, scattering / (scattering + absorption), G).unwrap()
}

fn equal(subset: &[usize]) -> Vec<(usize, f64)> {
    subset.iter().map(|i| (*i, 1.0 / subset.len() as f64)).collect()
}

/// A traced slab of a medium, darker by a factor and with noise.
fn slab(
    medium: &Medium,
    channel: usize,
    thickness_mm: f64,
    seed: u64,
    walks: u64,
    mu: f64,
) -> MeasuredProfile {
    let scene = Grid::paper().scene().clone();
    let record = traced(&scene, medium, thickness_mm, walks, 770_000 + seed);
    let exact: Vec<f64> = values(&record, channel).iter().map(|v| v / mu).collect();
    let slab = (scene.channels()[channel].name(), thickness_mm);
    noisy(slab, centres_mm(&scene), &exact, |v| NOISE * v, &mut Normal::new(880_000 + seed))
}

/// Slabs of equal mixtures.
fn photographed(
    subsets: &[Subset],
    channels: std::ops::Range<usize>,
    walks: u64,
    mu: f64,
) -> Vec<Measurement> {
    let material = |(number, subset): (usize, &Subset)| {
        let mut profiles = Vec::new();
        for channel in channels.clone() {
            let medium = mixed(&equal(subset), channel);
            for (i, thickness_mm) in SLABS_MM.into_iter().enumerate() {
                let seed = ((number * 3 + channel) * 2 + i) as u64;
                profiles.push(slab(&medium, channel, thickness_mm, seed, walks, mu));
            }
        }
        Measurement::new(name(subset), profiles).unwrap()
    };
    subsets.par_iter().enumerate().map(material).collect()
}

fn mixtures(subsets: &[Subset]) -> Mixtures {
    let several = subsets.iter().filter(|s| s.len() > 1);
    let mixture = |s: &Subset| {
        let parts = equal(s).into_iter().map(|(i, f)| (TABLE_1[i].0.to_owned(), f));
        Mixture::new(name(s), parts).unwrap()
    };
    Mixtures::new(several.map(mixture).collect()).unwrap()
}

/// Measures inks and prints them, with their mixtures that deviate. Returns the inks' channels.
fn unmixed(dictionary: &FitDictionary, subsets: &[Subset], slabs: &[Measurement]) -> (Unmixed, Vec<Answer>) {
    let (plan, options) = (unknown_factor(), FitOptions::default());
    let measured = measure(dictionary, slabs, &options, &plan).unwrap();
    print_common(&measured.common);
    let found = unmix(dictionary, slabs, &mixtures(subsets), &measured, &options, &plan).unwrap();
    print_common(&found.common);
    for mixture in &found.mixtures {
        let name = format!("{} {}", mixture.material, mixture.channel);
        match (&mixture.agreement, &mixture.left_out) {
            (Some(a), _) if a.pull > 2.0 || a.misfit > 1.2 => {
                println!("{name}: misfit {:.2}, pull {:.1}", a.misfit, a.pull);
            }
            (None, Some(why)) => println!("{name}: {why}"),
            _ => {}
        }
    }
    let (paper, mut answers) = (Grid::paper(), Vec::new());
    for ink in &found.inks {
        let number = TABLE_1.iter().position(|row| row.0 == ink.material).unwrap();
        for of_channel in &ink.channels {
            let mut channels = paper.scene().channels().iter();
            let channel = channels.position(|c| c.name() == of_channel.channel).unwrap();
            let name = format!("{} {}", ink.material, of_channel.channel);
            let json = serde_json::to_value(of_channel).unwrap();
            answers.push(Answer::new(name, &mixed(&[(number, 1.0)], channel), json));
        }
    }
    println!("{}", media_table(&answers, &[0, 1, 2, 3]));
    (found, answers)
}

/// Intervals of 95 % in correlated pairs: none may miss by more than half its width.
fn check_near(answers: &[Answer]) {
    for answer in answers {
        for e in &answer.medium[..4] {
            let slack = 0.5 * (e.interval.high - e.interval.low);
            let near = e.interval.low - slack <= e.truth && e.truth <= e.interval.high + slack;
            assert!(near, "{}: {e:?}", answer.name);
        }
    }
}

/// The ink in a channel, which its mixtures determine.
fn from_mixtures<'a>(answers: &'a [Answer], name: &str) -> &'a Answer {
    let answer = answers.iter().find(|a| a.name == name).unwrap();
    assert_eq!(answer.json["from_mixtures"], true, "{answer:?}");
    answer
}

fn ratio_of_ends(e: &Estimate) -> f64 {
    e.interval.high / e.interval.low
}

const CYAN: usize = 0;
const WHITE: usize = 4;

fn two_inks() -> Vec<Subset> {
    vec![vec![CYAN], vec![WHITE], vec![CYAN, WHITE]]
}

/// An absorber that slabs do not resolve is measured in mixtures with white.
#[test]
fn unresolved_absorber_is_measured_in_white() {
    let subsets = two_inks();
    let slabs = photographed(&subsets, 0..1, 1_000_000, 1.0);
    let (found, inks) = unmixed(super::dictionary(), &subsets, &slabs);
    check_near(&inks);
    let absorption = from_mixtures(&inks, "cyan R").medium[3];
    assert!(libm::log(ratio_of_ends(&absorption)) < 0.15, "{absorption:?}");
    assert!(found.mixtures.iter().all(|m| m.agreement.unwrap().pull < 3.0), "{:?}", found.mixtures);
}

/// A slab without an edge nearby, on the light side of the base.
fn patch(subset: &[usize], seed: u64, mu: f64) -> Measurement {
    let medium = mixed(&equal(subset), 0);
    let paper = Grid::paper().scene().clone();
    let light = paper.channels()[0].rho_light();
    let uniform = paper.with_channels(vec![Channel::new("R", light, light).unwrap()]).unwrap();
    let traced = values(&traced(&uniform, &medium, 1.0, 1_000_000, 990_000 + seed), 0);
    let exact = traced.iter().sum::<f64>() / traced.len() as f64 / mu;
    let std_error = 0.003 * exact;
    let value = exact + std_error * Normal::new(880_500 + seed).normal();
    let profile = MeasuredProfile::patch("R", 1.0, value, std_error).unwrap();
    Measurement::new(name(subset), vec![profile]).unwrap()
}

/// An absorber is measured from patches of a chart.
#[test]
fn absorber_is_measured_from_chart_patches() {
    let subsets = two_inks();
    let mu = 0.95;
    let mut measured = photographed(&subsets[1..2], 0..1, 1_000_000, mu);
    measured.extend([0, 2].map(|i| patch(&subsets[i], i as u64, mu)));
    let (_, inks) = unmixed(super::dictionary(), &subsets, &measured);
    let cyan = from_mixtures(&inks, "cyan R");
    check_near(std::slice::from_ref(cyan));
    assert!(ratio_of_ends(&cyan.medium[3]) < 1.55, "{cyan:?}");
}

/// The long form, with the whole Table 1.
#[test]
fn all_of_table_1_follows_from_mixtures() {
    if effort() < 8 {
        return;
    }
    let subsets: Vec<Subset> =
        (1_u32..32).map(|bits| (0..5).filter(|i| (bits >> i) & 1 == 1).collect()).collect();
    let slabs = photographed(&subsets, 0..3, 4_000_000, 0.913);
    let (found, inks) = unmixed(stored::dictionary(&Grid::paper()), &subsets, &slabs);
    // Sixty intervals of 95 % in correlated groups of four, all with one g: at least fifty-one.
    let all = Coverage::of_media([&inks[..]], &[0, 1, 2, 3]);
    let (held, count) = (all.count(), all.all().count());
    assert!(count == 60 && held >= 51, "{held} of {count} intervals hold");
    // With relative noise, magenta's green can be measured by itself, although it is dark.
    let magenta = inks.iter().find(|ink| ink.name == "magenta G").unwrap();
    for ink in [from_mixtures(&inks, "cyan R"), magenta, from_mixtures(&inks, "yellow B")] {
        assert!(ink.medium[..4].iter().all(Estimate::holds), "{ink:?}");
    }
    let furthest = found.mixtures.iter().filter_map(|m| m.agreement).map(|a| a.pull).fold(0.0, f64::max);
    assert!(furthest < 4.0, "a mixture deviates from its inks by {furthest} standard errors");
}
