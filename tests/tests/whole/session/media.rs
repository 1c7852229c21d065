//! From sessions of photographs to media, by the two commands of a laboratory.
//!
//! Media between the grid points are traced with the board's true ρ and the slabs' true thicknesses. The simulated
//! photographs have flicker, drift, blur, vignetting, glare and dust; the white reference, squares and thicknesses are off
//! by their stated errors, and so are the uncertain quantities of the scene `lab`. The normal run is one session, with a
//! dictionary of three anisotropies. With `FARM_TEST_EFFORT=10` there are seven sessions of three media, with the
//! dictionary of the plain command. Then these may be set:
//!
//! | variable | meaning |
//! |---|---|
//! | `FARM_TEST_SESSIONS=0..20` | these sessions |
//! | `FARM_TEST_KEEP=DIR` | keeps their folders |
//! | `FARM_TEST_AXES='g = [0.3, 0.4, 0.5]'` | axes of the dictionary; g is then drawn between these |
//!
//! Fewer nodes than the paper's leave more noise in the responses, and intervals hold less often.

mod laboratory;

use std::ops::Range;
use std::path::Path;

use farm_tests::coverage::{Answer, Coverage, QUANTITIES, media_table, table};
use farm_tests::statistics::effort;
use serde_json::Value;

use super::{captured, measured};
use farm_tests::cli::{folder, set_axes};
use laboratory::{Laboratory, STATED_MM};

/// Largest median error of σ_t in several sessions. In a single one the errors of the channels are nearly the same, so the
/// median is one error of a material whose second lobe is unknown: errors over their intervals are checked instead.
const MEDIAN_ERROR: f64 = 0.01;
/// Smallest share of intervals that contain the truth, in several sessions.
const HELD: f64 = 0.9;
/// Largest error in a single session, in half-widths of its interval: three standard errors. How many of its six intervals
/// hold is no test of one session: its errors are correlated, and with other seeds of the dictionary 3 to 5 hold.
const FARTHEST: f64 = 1.53;

/// Walks of a truth. Their noise is common to all pixels, like an error of the profile's gain, which the session states
/// as 0.04 to 0.12 %. A million walks leave about 0.11 %, these 0.03 %.
const TRUTH_WALKS: u64 = 16_000_000;

/// The size of the test.
struct Trial {
    sessions: Range<u64>,
    /// Lines that are added to the dictionary's grid.
    axes: String,
    g: (f64, f64),
    /// Walks of the truth.
    walks: u64,
}

impl Trial {
    fn normal() -> Self {
        Self {
            sessions: 0..1,
            axes: "g = [0.3, 0.4, 0.5]\nwalks = 20000\n".to_owned(),
            g: (0.3, 0.5),
            walks: 4_000_000,
        }
    }

    fn long() -> Self {
        let given = |name: &str| std::env::var(name).ok();
        let axes = given("FARM_TEST_AXES").map_or(String::new(), |axes| axes + "\n");
        let g = if axes.is_empty() { (0.0, 0.8) } else { (0.3, 0.5) };
        let sessions = given("FARM_TEST_SESSIONS").map_or(0..7, |v| {
            let (from, to) = v.split_once("..").expect("FARM_TEST_SESSIONS is a range such as 0..20");
            from.parse().unwrap()..to.parse().unwrap()
        });
        Self { sessions, axes, g, walks: TRUTH_WALKS }
    }

    /// Runs one session from photographs to media.
    fn session(&self, number: u64, data: &Path) -> Vec<Answer> {
        let laboratory = Laboratory::draw(number, self.g);
        let folder = folder();
        laboratory.photograph(folder.path(), self.walks);
        let report = captured(folder.path(), &[]).stdout;
        set_axes(&folder.path().join("out/grid.toml"), &self.axes);
        let g = laboratory.media[0].g();
        let data = data.to_str().unwrap();
        let found = measured(folder.path(), &["--g", &g.to_string(), "--data", data]);
        println!("session {number}: g {g:.3}, white reference off by {:+.2} %", 100.0 * laboratory.white);
        let is_set_up = |line: &&str| line.starts_with("board") || line.starts_with("errors");
        report.lines().filter(is_set_up).for_each(|line| println!("{line}"));
        if let Some(kept) = std::env::var_os("FARM_TEST_KEEP") {
            std::fs::rename(folder.path(), Path::new(&kept).join(number.to_string())).unwrap();
        }
        let truth = |name: &str, slab_mm: Option<f64>, _| {
            let slab = usize::from(slab_mm == Some(STATED_MM[1]));
            laboratory.scene.iter().find(|quantity| quantity.0 == name).and_then(|(_, values)| values[slab])
        };
        let answer = |(medium, channel): (_, &Value)| {
            let name = format!("{number} {}", channel["channel"].as_str().unwrap());
            Answer::new(name, medium, channel["refined"].clone()).with_scene(truth)
        };
        let channels = found["materials"][0]["channels"].as_array().unwrap();
        let answers: Vec<Answer> = laboratory.media.iter().zip(channels).map(answer).collect();
        print_scene(&answers[0]);
        println!("{}", media_table(&answers, &[0, 1]));
        answers
    }
}

/// Prints the uncertain quantities of the scene, with the error of each in its standard errors.
fn print_scene(answer: &Answer) {
    let row = |q: &farm_tests::coverage::SceneQuantity| {
        let is_known = !q.estimate.truth.is_nan();
        let known = |text: String| if is_known { text } else { String::new() };
        let slab_mm = q.slab_mm.map_or(String::new(), |mm| mm.to_string());
        let found = format!("{:.4} ± {:.4}", q.estimate.found, q.std_error);
        vec![
            q.name.clone(),
            slab_mm,
            known(format!("{:.4}", q.estimate.truth)),
            found,
            known(format!("{:+.2}", q.z())),
        ]
    };
    println!("{}", table("quantity | slab | truth | found | off", answer.scene.iter().map(row)));
}

/// The media from photographs have intervals that hold the truth.
#[test]
fn photographs_become_media() {
    let trial = if effort() >= 10 { Trial::long() } else { Trial::normal() };
    // Sessions of one set-up share its dictionary.
    let data = folder();
    let sessions: Vec<_> = trial.sessions.clone().map(|number| trial.session(number, data.path())).collect();
    let estimates = |q: &[usize]| Coverage::of_media(sessions.iter().map(Vec::as_slice), q);
    let row = |q: usize| {
        let (found, name) = (estimates(&[q]), QUANTITIES[q].to_owned());
        let [median, most] = [0.5, 0.9].map(|share| format!("{:.2}", 100.0 * found.error(share)));
        vec![name, median, most, found.hold().to_string()]
    };
    println!("{}", table("quantity | median error % | 90 % | hold %", (0..4).map(row)));
    let (found, median) = (estimates(&[0, 1]), estimates(&[0]).error(0.5));
    if sessions.len() == 1 {
        let farthest = found.all().map(|e| e.off().abs()).fold(0.0, f64::max);
        assert!(farthest <= FARTHEST, "an estimate is off by {farthest} half-widths of its interval");
    } else {
        assert!(median <= MEDIAN_ERROR, "the median error of σ_t is {median}");
        assert!(found.hold().share >= HELD, "{} % of the intervals of σ_t and α hold", found.hold());
    }
}
