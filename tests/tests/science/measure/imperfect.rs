//! Accuracy of fits to imperfect measurements.
//!
//! Media between the grid points are traced, modified by typical imperfections of laboratories, each alone and all
//! together, and fitted. With `FARM_TEST_EFFORT=8`, 200 media with 4 million walks are fitted with the paper's whole
//! dictionary, and the results are printed as tables. Then these may be set:
//!
//! | variable | meaning |
//! |---|---|
//! | `FARM_TEST_TRUTHS=DIR` | keeps the traced profiles, so that another fit takes minutes, and a row of it seconds |
//! | `FARM_TEST_ROWS=none,all x3` | only these imperfections |
//! | `FARM_TEST_MEDIA=50` | number of media |
//! | `FARM_TEST_WALKS=16000000` | number of walks |
//! | `FARM_TEST_CSV=FILE` | a line for each medium, row and fit |

mod flaws;
mod media;
mod outcome;
mod rows;
mod table;
pub(super) mod truths;

use std::sync::OnceLock;

use farm_tests::statistics::{Share, effort, quantile};
use optics_fit::{DictionaryBuilder, FitDictionary};
use optics_model::job::JobSpec;
use optics_model::{Grid, Measurement, Walks};
use rayon::prelude::*;

use media::{SLABS_MM, Subject};
use outcome::{COVERED, Outcome, QUANTITIES, Way};
use rows::{Kind, Row};
use truths::Truth;

/// Largest median errors of σ_t and of 1 − α that the likelihood may have, g held, by row.
const MEDIAN_ERRORS: [(&str, [f64; 2]); 2] = [("none", [0.012, 0.03]), ("all", [0.015, 0.04])];
/// Accepted coverage of 95 % intervals, within two standard errors for their number.
const HELD: (f64, f64) = (0.93, 0.97);

/// Media, rows and fits of the test.
struct Trial {
    media: u64,
    rows: Vec<Row>,
    /// Walks of the slabs with nominal thickness, and of the others.
    walks: (u64, u64),
}

impl Trial {
    fn normal() -> Self {
        let rows = ["none", "all"].map(Row::named).to_vec();
        Self { media: 6, rows, walks: (2_000_000, 1_000_000) }
    }

    fn long() -> Self {
        let list = |name: &str| std::env::var(name).ok().map(|v| v.split(',').map(str::to_owned).collect());
        let names: Option<Vec<String>> = list("FARM_TEST_ROWS");
        let number = |name: &str, usual| std::env::var(name).map_or(usual, |v| v.parse().unwrap());
        let walks = number("FARM_TEST_WALKS", 4_000_000);
        Self {
            media: number("FARM_TEST_MEDIA", 200),
            rows: names.map_or_else(Row::all, |names| names.iter().map(|name| Row::named(name)).collect()),
            walks: (walks, walks),
        }
    }

    fn outcomes(&self, dictionary: &FitDictionary) -> Vec<Outcome> {
        let g = dictionary.grid().g();
        let range = (g[0], g[g.len() - 1]);
        let subjects = (0..self.media).into_par_iter().map(|number| Subject::draw(number, range));
        subjects.flat_map_iter(|subject| self.outcomes_of(&subject, dictionary)).collect()
    }

    fn outcomes_of(&self, subject: &Subject, dictionary: &FitDictionary) -> Vec<Outcome> {
        let mut traced: Vec<(f64, [Truth; 2])> = Vec::new();
        let mut outcomes = Vec::new();
        for (number, row) in self.rows.iter().enumerate() {
            let size = row.size(Kind::Thickness);
            if !traced.iter().any(|(s, _)| *s == size) {
                let walks = Walks::new(if size == 0.0 { self.walks.0 } else { self.walks.1 }).unwrap();
                traced.push((size, [0, 1].map(|slab| Truth::of(subject, slab, size, walks))));
            }
            let truths = &traced.iter().find(|(s, _)| *s == size).unwrap().1;
            let profile = |slab: usize| flaws::photographed(&truths[slab], row, subject.number, slab);
            let profiles = (0..SLABS_MM.len()).map(profile).collect();
            let measurement = Measurement::new(format!("m{}", subject.number), profiles).unwrap();
            let fitted = |way| Outcome::of(dictionary, subject, &measurement, (number, row), way);
            outcomes.extend(Way::ALL.map(fitted));
        }
        outcomes
    }
}

/// The paper's whole dictionary in one channel.
fn whole_dictionary() -> &'static FitDictionary {
    static DICTIONARY: OnceLock<FitDictionary> = OnceLock::new();
    DICTIONARY.get_or_init(|| {
        let paper = Grid::paper();
        let grid = Grid::new(truths::scene(), paper.axes().clone(), Walks::PAPER, 1, false).unwrap();
        let mut builder = DictionaryBuilder::new(grid.clone());
        for job in 0..grid.job_count() {
            builder.add(&truths::records(&JobSpec::of(&grid, job)));
        }
        builder.build()
    })
}

/// The outcomes of a row, with g held or free.
fn of_row(outcomes: &[Outcome], row: usize, g_held: bool) -> Vec<&Outcome> {
    let way = Way { g_held };
    outcomes.iter().filter(|o| o.row == row && o.way == way).collect()
}

fn check_errors(rows: &[Row], outcomes: &[Outcome]) {
    for (name, most) in MEDIAN_ERRORS {
        let Some(row) = rows.iter().position(|row| row.name == name) else { continue };
        let these = of_row(outcomes, row, true);
        for (which, most) in most.into_iter().enumerate().filter(|_| !these.is_empty()) {
            let median = quantile(these.iter().map(|o| o.errors()[which].abs()).collect(), 0.5);
            assert!(median < most, "{name}: the median error of {} is {median}", ["σ_t", "1 − α"][which]);
        }
    }
}

/// Intervals have their stated coverage if the priors match the imperfections.
fn check_intervals(rows: &[Row], outcomes: &[Outcome]) {
    for (number, row) in rows.iter().enumerate().filter(|(_, row)| row.has_matching_prior()) {
        for g_held in [true, false] {
            let these = of_row(outcomes, number, g_held);
            let slack = 2.0 * (0.95 * 0.05 / these.len() as f64).sqrt();
            for (q, name) in COVERED.map(|q| (q, QUANTITIES[q])) {
                let Some(held) = Share::of(these.iter().map(|o| o.holds(q))) else { continue };
                let within = (HELD.0 - slack..=HELD.1 + slack).contains(&held.share);
                assert!(within, "{}: {held} % of the intervals of {name} hold, g held: {g_held}", row.name);
            }
        }
    }
}

/// The intervals of a measurement are correlated, so the standard error is that of the number of measurements.
fn check_few_intervals(outcomes: &[Outcome], measurements: f64) {
    let least = 0.95 - 2.0 * (0.95 * 0.05 / measurements).sqrt();
    let held = Share::of(outcomes.iter().flat_map(|o| COVERED.map(|q| o.holds(q)))).unwrap();
    assert!(held.share >= least, "{held} % of the intervals hold");
}

#[test]
fn intervals_of_imperfect_measurements_hold_the_media() {
    let long = effort() >= 8;
    let trial = if long { Trial::long() } else { Trial::normal() };
    let dictionary = if long { whole_dictionary() } else { super::dictionary() };
    let outcomes = trial.outcomes(dictionary);
    for way in Way::ALL {
        println!("{}", table::imperfections(&trial.rows, &outcomes, way));
    }
    if let Some(text) = table::efficiency(&trial.rows, &outcomes) {
        println!("{text}");
    }
    if let Some(file) = std::env::var_os("FARM_TEST_CSV") {
        table::write_csv(file.as_ref(), &trial.rows, &outcomes);
    }
    check_errors(&trial.rows, &outcomes);
    if long {
        check_intervals(&trial.rows, &outcomes);
    } else {
        check_few_intervals(&outcomes, (trial.media * trial.rows.len() as u64) as f64);
    }
}
