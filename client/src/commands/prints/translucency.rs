//! Implements `farmctl translucency`: lengths and coefficients that describe how translucent measured media are.

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Args;
use farm_figures::numbers::{minus, short, with_error};
use farm_lab::document::{Block, ValueTable};
use farm_lab::media_file::{MediaChannel, MediaFile};
use optics_layers::{Print, Uncertain};
use optics_model::Scene;
use optics_model::scene::{Layer, RingLight, Sensor};
use rayon::prelude::*;
use serde::Serialize;

use crate::output::Output;
use crate::prints::set_up::FoundSetUp;
use crate::prints::view::{narrowest_peak, uncertain};
use farm_lab::slabs::NamedSlab;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  farmctl translucency media
  farmctl translucency media --thickness 2 --json

mean free path: 1/(σ_s(1−g) + σ_a), after which the direction of light is forgotten
depth: 1/√(3 σ_a (σ_a + σ_s(1−g))), over which light fades in a thick block
K, S: of Kubelka and Munk, from the reflectance of a slab of --thickness in even light over bases
    of 0 and 0.8, without its surfaces
transmission distance: thickness of a polished slab that passes 5 % of even light")]
pub(crate) struct TranslucencyArgs {
    /// Measured media: media.json, or the folder that contains it.
    media: PathBuf,
    /// Thickness in mm at which K and S hold.
    #[arg(long, value_name = "MM", default_value_t = 1.0)]
    thickness: f64,
}

/// Values with their standard errors.
#[derive(Debug, Serialize)]
struct TranslucencyRow {
    material: String,
    channel: String,
    mean_free_path_mm: [f64; 2],
    /// Null where nothing absorbs.
    depth_mm: Option<[f64; 2]>,
    /// Null where a slab of the thickness does not determine them: it is too clear, or too dense.
    kubelka_munk_k_per_mm: Option<[f64; 2]>,
    kubelka_munk_s_per_mm: Option<[f64; 2]>,
    /// Null below 1 µm and above 1 m.
    transmission_distance_mm: Option<[f64; 2]>,
}

#[derive(Debug, Serialize)]
pub(crate) struct TranslucencyJson {
    thickness_mm: f64,
    channels: Vec<TranslucencyRow>,
}

/// Transmittance at the transmission distance.
const PASSED: f64 = 0.05;
/// Range of transmission distances in mm.
const DISTANCES_MM: (f64, f64) = (1e-3, 1e3);
/// Reflectances of the bases over which K and S are determined.
const BASES: [f64; 2] = [0.0, 0.8];

pub(crate) fn run(args: &TranslucencyArgs, output: &Output) -> Result<()> {
    optics_model::medium::check_thickness(args.thickness)?;
    let file = MediaFile::read(&args.media)?;
    let all: Vec<(&str, &MediaChannel)> =
        file.materials.iter().flat_map(|m| m.channels.iter().map(|c| (m.material.as_str(), c))).collect();
    let row = |(material, channel): &(&str, &MediaChannel)| {
        let slab = NamedSlab { shares: vec![((*material).to_owned(), 1.0)], thickness_mm: args.thickness };
        let set_up = FoundSetUp::new(&file, &[slab])?;
        of_channel(material, channel, &set_up, args.thickness)
            .with_context(|| format!("{material} {}", channel.channel))
    };
    let channels = all.par_iter().map(row).collect::<Result<_>>()?;
    let data = TranslucencyJson { thickness_mm: args.thickness, channels };
    output.answer("translucency", &data, || vec![table(&data)])
}

/// A slab with polished faces, in air; with an index of 1 it has none.
fn print(ior: f64, peak: f64) -> Result<Print> {
    let layers = vec![Layer::sample("slab", 0.0)?, Layer::clear("air", 1.0, 0.0, 0.0)?];
    let channels = Scene::smooth().channels().to_vec();
    let scene = Scene::new(layers, channels, RingLight::new(0.0, 90.0)?, Sensor::new(10.0, 1, 8.0)?, true)?;
    Ok(Print::new(&scene, ior, peak))
}

fn of_channel(
    material: &str,
    channel: &MediaChannel,
    set_up: &FoundSetUp,
    thickness_mm: f64,
) -> Result<TranslucencyRow> {
    let uncertain = uncertain(channel, set_up.assumed())?;
    let medium = uncertain.medium;
    let sample_ior = channel.sample_ior + set_up.scene(&channel.channel)?.sample_ior_offset();
    let peak = narrowest_peak(material, channel)?;
    let (without, polished) = (print(1.0, peak)?, print(sample_ior, peak)?);
    let value = |f: &dyn Fn(&Uncertain) -> f64| {
        let (value, std_error) = uncertain.spread(f);
        [value, std_error]
    };
    let transport = |u: &Uncertain| u.medium.reduced_scattering_per_mm() + u.medium.absorption_per_mm();
    // The depth of a medium whose absorption may be 0 is not linear in it, but its inverse square is.
    let fading = |u: &Uncertain| 3.0 * u.medium.absorption_per_mm() * transport(u);
    let depth = |[x, error]: [f64; 2]| [1.0 / x.sqrt(), 0.5 * error / libm::pow(x, 1.5)];
    let coefficient = |i: usize| known(value(&|u| kubelka_munk(&without, u, thickness_mm)[i]));
    let passed = value(&|u| distance(&polished, u));
    let within = DISTANCES_MM.0 * 1.001..DISTANCES_MM.1 / 1.001;
    Ok(TranslucencyRow {
        material: material.to_owned(),
        channel: channel.channel.clone(),
        mean_free_path_mm: value(&|u| 1.0 / transport(u)),
        depth_mm: (medium.absorption_per_mm() > 0.0).then(|| depth(value(&fading))),
        kubelka_munk_k_per_mm: coefficient(0),
        kubelka_munk_s_per_mm: coefficient(1),
        transmission_distance_mm: known(passed).filter(|[distance, _]| within.contains(distance)),
    })
}

fn known(value: [f64; 2]) -> Option<[f64; 2]> {
    value.iter().all(|v| v.is_finite()).then_some(value)
}

/// K and S that give the reflectances R₀ over black and R over a base of ρ: with c = 1/R₀ − a = b coth(b S t),
/// 2a = (1 − R (1/R₀ − ρ))/ρ + 1/R₀, b² = a² − 1, K = S (a − 1).
fn kubelka_munk(print: &Print, medium: &Uncertain, thickness_mm: f64) -> [f64; 2] {
    let found = print.reflectances(&[medium.slab(thickness_mm)], &BASES);
    let (black, white) = (found[0], found[1]);
    let a = 0.5 * ((1.0 - white * (1.0 / black - BASES[1])) / BASES[1] + 1.0 / black);
    let a = a.max(1.0 + 1e-12);
    let b = (a * a - 1.0).sqrt();
    let ratio = (1.0 / black - a) / b;
    let s = 0.5 * libm::log((ratio + 1.0) / (ratio - 1.0)) / (b * thickness_mm);
    [s * (a - 1.0), s]
}

/// The thickness that passes [`PASSED`], by bisection of its logarithm.
fn distance(print: &Print, medium: &Uncertain) -> f64 {
    let passes = |mm: f64| print.transmittance(&[medium.slab(mm)]) > PASSED;
    let (mut low, mut high) = DISTANCES_MM;
    while high / low > 1.0 + 1e-6 {
        let middle = (low * high).sqrt();
        if passes(middle) { low = middle } else { high = middle }
    }
    (low * high).sqrt()
}

fn table(data: &TranslucencyJson) -> Block {
    let head =
        "material | ch | >mean free path\nmm | >depth\nmm | >K\n/mm | >S\n/mm | >transmission\ndistance mm";
    let cell = |[value, std_error]: [f64; 2]| minus(&with_error(value, std_error));
    let optional = |value: Option<[f64; 2]>| value.map_or_else(|| "–".to_owned(), cell);
    let row = |r: &TranslucencyRow| {
        vec![
            short(&r.material),
            r.channel.clone(),
            cell(r.mean_free_path_mm),
            r.depth_mm.map_or_else(|| "∞".to_owned(), cell),
            optional(r.kubelka_munk_k_per_mm),
            optional(r.kubelka_munk_s_per_mm),
            optional(r.transmission_distance_mm),
        ]
    };
    ValueTable::new(head, data.channels.iter().map(row)).block()
}

#[cfg(test)]
mod tests {
    use optics_model::Medium;
    use optics_model::phase::SecondLobe;

    use super::*;

    fn uncertain(sigma_t: f64, albedo: f64) -> Uncertain {
        let medium = Medium::new(sigma_t, albedo, 0.0).unwrap();
        Uncertain::exact(medium, SecondLobe::default())
    }

    /// In thick bright media S is ¾ σ_s and K 2 σ_a in the limit; so K/S is 8/3 of σ_a/σ_s.
    #[test]
    fn kubelka_munk_has_its_limits() {
        let [k, s] = kubelka_munk(&print(1.0, 0.5).unwrap(), &uncertain(10.0, 0.999), 2.0);
        assert!((s / 7.5 - 1.0).abs() < 0.05, "{s}");
        assert!((k / 0.02 - 1.0).abs() < 0.1, "{k}");
    }

    /// Without scattering and faces the distance is −ln 0.05/σ_a, at 8°.
    #[test]
    fn transmission_distance_follows_beer() {
        let found = distance(&print(1.0, 0.5).unwrap(), &uncertain(3.0, 0.0));
        let expected = libm::log(20_f64) / 3.0 * libm::cos(8_f64.to_radians());
        assert!((found / expected - 1.0).abs() < 1e-3, "{found} {expected}");
    }
}
