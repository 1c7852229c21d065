//! Accuracy of fits to imperfect measurements.
//!
//! Media between the grid points are traced, modified by typical imperfections of laboratories, each alone and all
//! together, and fitted. With `FARM_TEST_EFFORT=8`, 200 media with 4 million walks are fitted with the paper's whole
//! dictionary, and the results are printed as tables. Then these may be set:
//!
//! | variable | meaning |
//! |---|---|
//! | `FARM_TEST_ROWS=none,all x3` | only these imperfections |
//! | `FARM_TEST_MEDIA=50` | number of media |
//! | `FARM_TEST_WALKS=16000000` | number of walks |

mod flaws;
mod rows;

use farm_tests::coverage::{Answer, Coverage, QUANTITIES, table};
use farm_tests::statistics::{Normal, Share, effort, quantile};
use optics_fit::fit;
use optics_model::fit::{FitOptions, MISFIT};
use optics_model::scene::{Scene, Sensor};
use optics_model::{Grid, Measurement, Medium};
use rayon::prelude::*;

use super::{SLABS_MM, dictionary, traced, values};
use flaws::photographed;
use rows::{Kind, Row};

/// Largest median errors of σ_t and of 1 − α that the likelihood may have, g held, by row.
const MEDIAN_ERRORS: [(&str, [f64; 2]); 2] = [("none", [0.012, 0.03]), ("all", [0.015, 0.04])];
/// Fine pixels per pixel of the dictionary: enough for shifts and blurs.
const FINE: usize = 4;
/// Additional pixels at either end, so that the truth can be shifted and blurred.
const MARGIN: usize = 20;
/// Standard deviation of a slab's thickness about the nominal one, at the typical size.
const THICKNESS_MM: f64 = 0.005;

/// The paper's scene with only its first channel.
fn scene() -> Scene {
    let paper = Grid::paper().scene().clone();
    let first = paper.channels()[..1].to_vec();
    paper.with_channels(first).unwrap()
}

/// The scene with fine pixels about the edge.
fn fine() -> Scene {
    let coarse = scene().sensor();
    let pixels = coarse.pixels() + 2 * MARGIN;
    let width_mm = pixels as f64 * coarse.pitch_mm();
    scene().with_sensor(Sensor::new(width_mm, (pixels * FINE) as u32, coarse.polar_deg()).unwrap())
}

/// Media, rows and fits of the test.
struct Trial {
    media: u64,
    rows: Vec<Row>,
    /// Walks of the slabs with nominal thickness, and of the others.
    walks: [u64; 2],
}

/// The answers for one medium: row, whether g was held, and the answer.
type Found = (usize, bool, Answer);

impl Trial {
    fn normal() -> Self {
        Self { media: 6, rows: ["none", "all"].map(Row::named).to_vec(), walks: [2_000_000, 1_000_000] }
    }

    fn long() -> Self {
        let given = |name: &str| std::env::var(name).ok();
        let number = |name: &str, usual| given(name).map_or(usual, |v| v.parse().unwrap());
        let rows = given("FARM_TEST_ROWS").map(|names| names.split(',').map(Row::named).collect());
        let walks = [number("FARM_TEST_WALKS", 4_000_000); 2];
        Self { media: number("FARM_TEST_MEDIA", 200), rows: rows.unwrap_or_else(Row::all), walks }
    }

    fn found(&self) -> Vec<Found> {
        dictionary();
        (0..self.media).into_par_iter().flat_map_iter(|number| self.found_of(number)).collect()
    }

    /// A medium with g uniform between those of the dictionary, and slabs with random thicknesses: all off the grid.
    fn found_of(&self, number: u64) -> Vec<Found> {
        let g = dictionary().grid().g();
        let mut random = Normal::new(410_000 + number);
        let m = random.medium(g[0]);
        let g = g[0] + (g[g.len() - 1] - g[0]) * random.uniform();
        let medium = Medium::new(m.sigma_t_per_mm(), m.albedo(), g).unwrap();
        let off = [random.normal(), random.normal()];
        let mut found = Vec::new();
        for (row_number, row) in self.rows.iter().enumerate() {
            let size = row.size(Kind::Thickness);
            let profile = |slab: usize| {
                let thickness_mm = SLABS_MM[slab] + size * THICKNESS_MM * off[slab];
                let walks = self.walks[usize::from(size != 0.0)];
                let exact = values(&traced(&fine(), &medium, thickness_mm, walks, 420_000 + number), 0);
                photographed(&exact, row, number, slab)
            };
            let measurement = Measurement::new(format!("m{number}"), vec![profile(0), profile(1)]).unwrap();
            for is_held in [true, false] {
                let options = FitOptions::new(row.settings(is_held.then_some(g))).unwrap();
                let fitted = fit(dictionary(), &measurement, &options).unwrap();
                let refined = fitted.channels[0].refined.as_ref().unwrap();
                found.push((row_number, is_held, Answer::of_fit(measurement.material(), &medium, refined)));
            }
        }
        found
    }

    /// Names and answers of the rows, with g held or free.
    fn by_row(&self, found: &[Found], is_held: bool) -> Vec<(&Row, Vec<Answer>)> {
        let row_entries = |number| found.iter().filter(move |f| (f.0, f.1) == (number, is_held));
        let rows = self.rows.iter().enumerate();
        rows.map(|(number, row)| (row, row_entries(number).map(|f| f.2.clone()).collect())).collect()
    }
}

fn coverage(answers: &[Answer], quantity: usize) -> Coverage {
    Coverage::of_media(answers.chunks(1), &[quantity])
}

/// Prints errors and coverage of every row.
fn print_rows(rows: &[(&Row, Vec<Answer>)]) {
    let row = |(row, answers): &(&Row, Vec<Answer>)| {
        let spread =
            |q| [0.5, 0.9].map(|s| format!("{:.2}", 100.0 * coverage(answers, q).error(s))).join(" / ");
        let share = |is: &dyn Fn(&Answer) -> bool| {
            format!("{:.1}", 100.0 * Share::of(answers.iter().map(is)).unwrap().share)
        };
        let mut cells = vec![row.name.clone(), answers.len().to_string(), spread(0), spread(1)];
        cells.extend((0..4).map(|q| coverage(answers, q).hold().to_string()));
        cells.extend([
            share(&|a| a.json["resolved_at_g"] != true),
            share(&|a| a.json["misfit"].as_f64().unwrap() > MISFIT),
            share(&|a| a.probability() < 0.01),
        ]);
        cells
    };
    let head = "imperfection | media | σ_t %, median / 90 % | 1 − α %, median / 90 % | hold σ_t | α | σ_s(1−g) | σ_a \
                | unresolved % | misfit > 2 % | p(χ²) < 1 % %";
    println!("{}", table(head, rows.iter().map(row)));
}

/// Prints ratios of the widths of intervals to the Cramér–Rao bound without imperfections.
fn print_efficiency(answers: &[Answer]) {
    let row = |q: usize| {
        let found = coverage(answers, q);
        let ratios: Vec<f64> = found.all().filter_map(farm_tests::coverage::Estimate::over_bound).collect();
        let at = |share| quantile(ratios.clone(), share);
        let name = QUANTITIES[q].to_owned();
        (!ratios.is_empty()).then(|| {
            vec![
                name,
                format!("{:.2} / {:.2}", at(0.5), at(0.9)),
                ratios.len().to_string(),
                found.hold().to_string(),
            ]
        })
    };
    println!(
        "{}",
        table("quantity | width over the bound, median / 90 % | closed | hold", (0..5).filter_map(row))
    );
}

/// In the long form, intervals of each quantity have their stated coverage if the priors match the imperfections. In the
/// normal run all are counted together: those of a measurement are correlated, so the standard error is that of the
/// number of measurements.
#[test]
fn intervals_of_imperfect_measurements_hold_the_media() {
    let is_long = effort() >= 8;
    let trial = if is_long { Trial::long() } else { Trial::normal() };
    let found = trial.found();
    for is_held in [true, false] {
        let rows = trial.by_row(&found, is_held);
        println!("\ng {}\n", if is_held { "held" } else { "free" });
        print_rows(&rows);
        rows.iter().filter(|(row, _)| row.name == "none").for_each(|(_, answers)| print_efficiency(answers));
        for (row, answers) in &rows {
            let name = &row.name;
            for (_, most) in MEDIAN_ERRORS.iter().filter(|(row, _)| is_held && row == name) {
                let medians = [0, 1].map(|q| coverage(answers, q).error(0.5));
                assert!(medians[0] < most[0] && medians[1] < most[1], "{name}: median errors {medians:?}");
            }
            let slack = 2.0 * (0.95 * 0.05 / answers.len() as f64).sqrt();
            for q in (0..4).filter(|_| is_long && row.has_matching_prior()) {
                let hold = coverage(answers, q).hold();
                let within = (0.93 - slack..=0.97 + slack).contains(&hold.share);
                assert!(
                    within,
                    "{name}: {hold} % of the intervals of {} hold, g held: {is_held}",
                    QUANTITIES[q]
                );
            }
        }
    }
    let all: Vec<Answer> = found.into_iter().map(|f| f.2).collect();
    let measurements = (trial.media * trial.rows.len() as u64) as f64;
    let hold = Coverage::of_media([&all[..]], &[0, 1, 2, 3]).hold();
    let least = 0.95 - 2.0 * (0.95 * 0.05 / measurements).sqrt();
    assert!(is_long || hold.share >= least, "{hold} % of the intervals hold");
}
