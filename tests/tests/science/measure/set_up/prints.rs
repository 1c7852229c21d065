//! Prints of media that were measured in random set-ups: whether the intervals of `farmctl predict` hold.

use farm_lab::colour::{Colorimetry, Illuminant, StandardObserver, Viewing, delta_e_2000};
use farm_lab::media_file::{MEDIA_FILE, MeasuredWith, MediaFile};
use farm_tests::cli::json;
use farm_tests::coverage::{Coverage, Estimate};
use farm_tests::process::run;
use farm_tests::statistics::{Normal, effort, quantile};
use optics_fit::FitDictionary;
use optics_layers::{Print, PrintedSlab, Uncertain, radiance_factors};
use optics_model::Digest;
use optics_model::fit::PhaseModel;
use optics_model::phase::SecondLobe;
use optics_model::scene::{Channel, Layer, Scene};
use serde_json::Value;

use super::scenes::{LOBE_WEIGHT, SAMPLE_INDEX, lab};
use super::session::{Nodes, SetUpSession, dictionary, dictionary_of};
use crate::measure::IOR;

/// Wavelengths that are enough for colours.
const NM: [f64; 6] = [460.0, 500.0, 540.0, 580.0, 620.0, 640.0];

/// A polished print in air, lit by a ring of 45° ± 5°.
fn bare() -> Scene {
    let lab = lab();
    let layers = vec![Layer::sample("print", 0.0).unwrap(), Layer::clear("air", 1.0, 0.0, 0.0).unwrap()];
    Scene::new(layers, lab.channels().to_vec(), lab.light(), lab.sensor(), true).unwrap()
}

/// A session with its media file in a folder.
struct MeasuredSession {
    session: SetUpSession,
    folder: tempfile::TempDir,
}

impl MeasuredSession {
    fn new(session: SetUpSession, dictionary: &FitDictionary) -> Self {
        let found = session.fitted(dictionary, PhaseModel::TwoLobes);
        let grid = dictionary.grid();
        let mu = [found.common.mu, found.common.mu_std_error];
        let with = MeasuredWith { dictionary: "lab", digest: Digest::of_grid(grid), scene: grid.scene(), mu };
        let folder = tempfile::tempdir().unwrap();
        let text = MediaFile::new(&found.materials, &found.shared_errors, &with).text().unwrap();
        std::fs::write(folder.path().join(MEDIA_FILE), text).unwrap();
        Self { session, folder }
    }

    /// The answer of `farmctl predict` for a slab.
    fn predicted(&self, slab: &str, over: &str, args: &[&str]) -> Value {
        let ran =
            run(self.folder.path(), &[&["predict", ".", slab, "--over", over, "--json"], args].concat());
        assert_eq!(ran.code, 0, "{}", ran.stderr);
        json(&ran, "predict")
    }

    /// True radiance factors of a slab in a channel, for shares of materials.
    fn exact(
        &self,
        scene: &Scene,
        shares: &[(usize, f64)],
        thickness_mm: f64,
        channel: usize,
        rho: &[f64],
    ) -> Vec<f64> {
        let difference: f64 =
            shares.iter().map(|(m, share)| share * self.session.difference(*m, SAMPLE_INDEX)).sum();
        let print = Print::new(scene, IOR + difference, 0.2);
        let media: Vec<Uncertain> = (0..self.session.materials())
            .map(|m| {
                let weight = 0.05 + self.session.difference(m, LOBE_WEIGHT);
                Uncertain::exact(self.session.media(m)[channel], SecondLobe::new(weight, -0.5).unwrap())
            })
            .collect();
        let slab = PrintedSlab { shares: shares.to_vec(), thickness_mm };
        radiance_factors(&print, &media, &[slab], rho).unwrap()
    }
}

fn check(name: &str, found: &Coverage) {
    let [error, width] = [found.error(0.5), found.median_half_width()].map(|v| 100.0 * v);
    println!("{name}: hold {} %; median error {error:.2} %, half-width {width:.2} %", found.hold());
    found.check(name, 3.0);
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

fn radiance_factor(value: &Value, exact: f64) -> Estimate {
    Estimate::normal(number(&value["radiance_factor"]), number(&value["std_error"]), exact)
}

/// Inks with spectra, and mixtures of two of them, 0.2 to 3 mm thick, over black and white at 45:0.
#[test]
#[ignore = "long form"]
fn predicted_prints_keep_their_coverage() {
    const PRINTS: usize = 20;
    const RHO: [f64; 2] = [0.03, 0.9];
    let lab = lab();
    let side = &lab.channels()[0];
    let channel = |nm: &f64| Channel::new(nm.to_string(), side.rho_light(), side.rho_dark()).unwrap();
    let scene = lab.clone().with_channels(NM.iter().map(channel).collect()).unwrap();
    let dictionary = dictionary_of(&scene, Nodes::Lab);
    let viewing = Viewing { illuminant: Illuminant::D50, observer: StandardObserver::TwoDegrees };
    let colorimetry = Colorimetry::new(&NM, viewing).unwrap();
    let (mut factors, mut labs) = (Coverage::default(), [(); 3].map(|()| Coverage::default()));
    let mut differences = Vec::new();
    for number_of in 0..25 * effort() {
        // The truth lies between: flaws of each photograph, and of each slab in all bands.
        let common = number_of % 2 == 1;
        let session = MeasuredSession::new(SetUpSession::of_inks(number_of, 3, &NM, common), dictionary);
        let mut random = Normal::new(940_000 + number_of);
        let (mut of_factors, mut of_labs) = (Vec::new(), [const { Vec::new() }; 3]);
        for _ in 0..PRINTS {
            let (a, b) = ((3.0 * random.uniform()) as usize, (3.0 * random.uniform()) as usize);
            let share = (1e3 * random.uniform()).ceil() / 1e3;
            let thickness_mm = (1e3 * 0.2 * libm::pow(15_f64, random.uniform())).round() / 1e3;
            let is_one = a == b || share == 1.0;
            let shares = if is_one { vec![(a, 1.0)] } else { vec![(a, share), (b, 1.0 - share)] };
            let slab = if is_one {
                format!("m{a}:{thickness_mm}")
            } else {
                format!("m{a}={share},m{b}={:.3}:{thickness_mm}", 1.0 - share)
            };
            let found = session.predicted(&slab, "black,white", &["--geometry", "45:0", "--roughness", "0"]);
            let exact = |channel| session.exact(&bare(), &shares, thickness_mm, channel, &RHO);
            let exact: Vec<Vec<f64>> = (0..NM.len()).map(exact).collect();
            for (base, _) in RHO.iter().enumerate() {
                for (channel, exact) in exact.iter().enumerate() {
                    let value = &found["channels"][channel]["bases"][base];
                    of_factors.push(radiance_factor(value, exact[base]));
                }
                let spectrum: Vec<f64> = exact.iter().map(|of| of[base]).collect();
                let colour = &found["colours"]["bases"][base];
                let lab: [f64; 3] = std::array::from_fn(|k| number(&colour["lab"][k]));
                let truth = colorimetry.colour(&spectrum).lab;
                for k in 0..3 {
                    of_labs[k].push(Estimate::normal(lab[k], number(&colour["lab_std_errors"][k]), truth[k]));
                }
                differences.push(delta_e_2000(lab, truth));
            }
        }
        factors.0.push(of_factors);
        labs.iter_mut().zip(of_labs).for_each(|(lab, of_session)| lab.0.push(of_session));
    }
    let [median, worst] = [0.5, 1.0].map(|at| quantile(differences.clone(), at));
    println!("CIEDE2000: median {median:.2}, greatest {worst:.2}");
    check("radiance factors", &factors);
    ["L*", "a*", "b*"].iter().zip(&labs).for_each(|(name, lab)| check(name, lab));
}

/// Slabs of one medium in the measured set-up, over both sides of its board and a grey.
#[test]
#[ignore = "long form"]
fn predicted_photographs_keep_their_coverage() {
    let mut factors = Coverage::default();
    for number_of in 0..20 * effort() {
        let session = SetUpSession::random(number_of, 6, true);
        let session = MeasuredSession::new(session, dictionary(Nodes::Lab, true));
        let mut of_session = Vec::new();
        for (material, thickness_mm) in [0.3, 1.0, 2.0].into_iter().enumerate() {
            let found = session.predicted(&format!("m{material}:{thickness_mm}"), "light,dark,0.5", &[]);
            let scene = session.session.scene(material);
            let board = &scene.channels()[0];
            let rho = [board.rho_light(), board.rho_dark(), 0.5];
            let exact = session.exact(&scene, &[(material, 1.0)], thickness_mm, 0, &rho);
            for (base, exact) in exact.into_iter().enumerate() {
                of_session.push(radiance_factor(&found["channels"][0]["bases"][base], exact));
            }
        }
        factors.0.push(of_session);
    }
    check("radiance factors", &factors);
}
