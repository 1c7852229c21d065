//! Reads and writes `media.json`: measured media with their covariance and the scene in which they were measured, for
//! predictions, comparisons and other programs.

#[cfg(test)]
mod tests;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use optics_model::fit::{ChannelFit, Interval, MaterialFit, Refined, SetUpDifference, SharedErrors, Z};
use optics_model::medium::check_ior;
use optics_model::phase::SecondLobe;
use optics_model::scene::Scene;
use optics_model::{Digest, Medium, SceneFile};
use serde::{Deserialize, Serialize};

use crate::bounded_file;
use crate::file_kind::or_other_kind;

/// Name of the file in the folder of a session or of media.
pub const MEDIA_FILE: &str = "media.json";
const FORMAT: &str = "farmctl-media/1";
/// Largest file that is read, in bytes.
const LARGEST: u64 = 64 << 20;
const MOST_MATERIALS: usize = 2000;

/// Materials that were measured together.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MediaFile {
    format: String,
    /// The program that wrote it, with its version.
    program: String,
    pub dictionary: String,
    /// Digest of the dictionary's grid and physics.
    pub dictionary_digest: String,
    /// Scale factor of the measured values.
    pub mu: f64,
    pub mu_std_error: f64,
    /// The set-up, with its uncertain numbers.
    pub scene: SceneFile,
    /// Estimates of these numbers.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub set_up: Vec<MediaSetUp>,
    pub materials: Vec<MediaMaterial>,
    /// Only of media from a chart.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub chart: Option<MediaChart>,
}

/// The camera, the sheen and the error of predictions of a chart.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MediaChart {
    /// Linear sRGB of the chart's camera from the radiance factors of R, G and B; none if it had no camera.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub matrix: Option<[[f64; 3]; 3]>,
    /// Light that faces return besides their mirrored image, of white.
    pub sheen: f64,
    /// Covariance of the errors of predictions: of (ΔL, ΔC, ΔH) over their weights in CIEDE2000, for a camera; else of
    /// logarithms by channel. Empty where the chart has too few patches to show it.
    pub model_error: Vec<Vec<f64>>,
    /// CIEDE2000 that 95 % of stacks like those of the chart stay below.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub delta_e_2000_below: Option<f64>,
    /// Thicknesses of layers in mm, without bases.
    pub layers_mm: Vec<f64>,
}

/// A material.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MediaMaterial {
    pub material: String,
    pub channels: Vec<MediaChannel>,
}

/// The estimate of an uncertain number of the scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MediaSetUp {
    /// Its name, such as `gel index`.
    pub quantity: String,
    /// None for one value in the whole session.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub material: Option<String>,
    /// None for one value in all channels.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub channel: Option<String>,
    /// Difference from the scene's value.
    pub difference: f64,
    /// Its changes by one standard deviation of each source of errors that it shares with media.
    pub shared: Vec<f64>,
}

/// The medium of a material in one channel, with 95 % intervals.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MediaChannel {
    pub channel: String,
    pub sigma_t_per_mm: f64,
    pub albedo: f64,
    pub g: f64,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub second_lobe: Option<MediaLobe>,
    pub sample_ior: f64,
    /// Covariance of (ln σ_t, √(1 − α), ln(1 − g)).
    pub covariance: [[f64; 3]; 3],
    /// Changes of (ln σ_t, √(1 − α), ln(1 − g)), and of weight and anisotropy of the second lobe, by one standard
    /// deviation of each independent source of errors that it shares with other media and the set-up.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub shared: Vec<[f64; SharedErrors::OF_MEDIUM]>,
    /// Whether the data determine σ_t and the albedo.
    pub resolved: bool,
    /// Root mean square of the residuals over that of the noise.
    pub misfit: f64,
    pub sigma_t_interval: MediaInterval,
    pub albedo_interval: MediaInterval,
    pub g_interval: MediaInterval,
    pub reduced_scattering_interval: MediaInterval,
    pub absorption_interval: MediaInterval,
}

/// The second lobe of a phase function.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct MediaLobe {
    pub weight: f64,
    pub g: f64,
}

/// An interval; null where it is open.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct MediaInterval {
    pub low: Option<f64>,
    pub high: Option<f64>,
}

impl From<Interval> for MediaInterval {
    fn from(i: Interval) -> Self {
        Self { low: (!i.open_low).then_some(i.low), high: (!i.open_high).then_some(i.high) }
    }
}

/// The dictionary, scene and scale factor of a measurement.
#[derive(Debug, Clone, Copy)]
pub struct MeasuredWith<'a> {
    pub dictionary: &'a str,
    pub digest: Digest,
    pub scene: &'a Scene,
    /// Scale factor and its standard error.
    pub mu: [f64; 2],
}

impl MediaFile {
    /// The refined channels of fits.
    pub fn new(fits: &[MaterialFit], errors: &SharedErrors, with: &MeasuredWith) -> Self {
        let mut number = 0;
        let mut channels = |fit: &MaterialFit| -> Vec<MediaChannel> {
            let mut channel = |c: &ChannelFit| {
                number += 1;
                Some(MediaChannel::of(&c.channel, c.refined.as_ref()?, errors.of_channel(number - 1)))
            };
            fit.channels.iter().filter_map(&mut channel).collect()
        };
        let material =
            |fit: &MaterialFit| MediaMaterial { material: fit.material.clone(), channels: channels(fit) };
        let names = quantity_names(with.scene);
        let set_up = |d: &SetUpDifference| {
            let material = d.material.map(|i| fits.get(i).map(|fit| fit.material.clone()));
            let channel = d.channel.map(|i| with.scene.channels().get(i).map(|c| c.name().to_owned()));
            // An estimate of an unknown material is not one of the session.
            if material == Some(None) || channel == Some(None) {
                return None;
            }
            Some(MediaSetUp {
                quantity: names.get(d.prior)?.clone(),
                material: material.flatten(),
                channel: channel.flatten(),
                difference: d.difference,
                shared: d.changes.iter().copied().map(rounded).collect(),
            })
        };
        Self {
            format: FORMAT.to_owned(),
            program: concat!("farmctl ", env!("CARGO_PKG_VERSION")).to_owned(),
            dictionary: with.dictionary.to_owned(),
            dictionary_digest: with.digest.to_string(),
            mu: with.mu[0],
            mu_std_error: with.mu[1],
            scene: SceneFile::from(with.scene),
            set_up: errors.scene.iter().filter_map(set_up).collect(),
            materials: fits.iter().map(material).collect(),
            chart: None,
        }
    }

    /// The file of this path, or that in the folder of this path.
    pub fn read(path: &Path) -> Result<Self> {
        let path = if path.is_dir() { path.join(MEDIA_FILE) } else { PathBuf::from(path) };
        let place = || format!("media file {}", path.display());
        let bytes = bounded_file::read(&path, LARGEST).with_context(|| {
            format!("{}: `farmctl measure` writes it into the session's folder, or that of -o", place())
        })?;
        or_other_kind(Self::parsed(&bytes), &bytes, "media file").with_context(place)
    }

    fn parsed(bytes: &[u8]) -> Result<Self> {
        Self::from_json(serde_json::from_slice(bytes)?)
    }

    /// The checked contents of a file.
    pub fn from_json(json: serde_json::Value) -> Result<Self> {
        if json["format"] != FORMAT {
            bail!("its format is {}, not {FORMAT:?}", json["format"]);
        }
        let file: Self = serde_json::from_value(json)?;
        let sources = file.sources();
        file.chart.as_ref().map_or(Ok(()), MediaChart::check).context("chart")?;
        if let Some(other) = file.set_up.iter().find(|s| s.shared.len() != sources) {
            let found = other.shared.len();
            bail!("set_up {}: it has {found} shared errors, others {sources}", other.quantity);
        }
        if file.materials.len() > MOST_MATERIALS {
            let found = file.materials.len();
            bail!("it has {found} materials, {MOST_MATERIALS} are allowed");
        }
        for (i, material) in file.materials.iter().enumerate() {
            if file.materials[..i].iter().any(|other| other.material == material.material) {
                bail!("material {:?} occurs twice", material.material);
            }
            for channel in &material.channels {
                channel
                    .check(sources)
                    .with_context(|| format!("{} {}", material.material, channel.channel))?;
            }
        }
        Ok(file)
    }

    /// Number of sources of errors that media and set-up share.
    fn sources(&self) -> usize {
        let all = self.materials.iter().flat_map(|m| &m.channels).map(|c| c.shared.len());
        all.chain(self.set_up.iter().map(|s| s.shared.len())).max().unwrap_or(0)
    }

    /// The text of the file.
    pub fn text(&self) -> Result<String> {
        Ok(serde_json::to_string_pretty(self)? + "\n")
    }

    /// The material of a name.
    pub fn material(&self, name: &str) -> Result<&MediaMaterial> {
        self.materials.iter().find(|m| m.material == name).with_context(|| {
            let names: Vec<&str> = self.materials.iter().map(|m| m.material.as_str()).collect();
            format!("material {name:?} is not in the file: it has {}", names.join(", "))
        })
    }
}

impl MediaChart {
    fn check(&self) -> Result<()> {
        let numbers = self.model_error.iter().flatten().chain(&self.layers_mm);
        let all = numbers.chain(self.matrix.iter().flatten().flatten()).chain([&self.sheen]);
        let is_square = self.model_error.iter().all(|row| row.len() == self.model_error.len());
        if !is_square || !all.into_iter().all(|v| v.is_finite()) {
            bail!("finite numbers and a square model_error are needed");
        }
        Ok(())
    }
}

impl MediaMaterial {
    pub fn channel(&self, name: &str) -> Option<&MediaChannel> {
        self.channels.iter().find(|c| c.channel == name)
    }
}

impl MediaChannel {
    fn of(channel: &str, refined: &Refined, shared: &[[f64; SharedErrors::OF_MEDIUM]]) -> Self {
        let medium = refined.best.medium;
        // Media from mixtures are not those of the joint fit.
        let shared = if refined.from_mixtures { &[] } else { shared };
        Self {
            channel: channel.to_owned(),
            sigma_t_per_mm: medium.sigma_t_per_mm(),
            albedo: medium.albedo(),
            g: medium.g(),
            second_lobe: refined.second_lobe.map(|lobe| MediaLobe { weight: lobe.weight(), g: lobe.g() }),
            sample_ior: refined.best.sample_ior,
            covariance: covariance(refined),
            shared: shared.iter().map(|changes| changes.map(rounded)).collect(),
            resolved: refined.resolved,
            misfit: refined.misfit,
            sigma_t_interval: refined.sigma_t_per_mm.into(),
            albedo_interval: refined.albedo.into(),
            g_interval: refined.g.into(),
            reduced_scattering_interval: refined.reduced_scattering_per_mm.into(),
            absorption_interval: refined.absorption_per_mm.into(),
        }
    }

    fn check(&self, sources: usize) -> Result<(), optics_model::Invalid> {
        self.medium()?;
        self.second_lobe()?;
        check_ior("sample_ior", self.sample_ior)?;
        let c = &self.covariance;
        // The entries of a covariance are finite, and none exceeds those of the diagonal in its row and column.
        let is_bounded = |i: usize, j: usize| {
            c[i][j].is_finite()
                && (c[i][j] - c[j][i]).abs() <= 1e-9 * (c[i][i] * c[j][j]).abs().sqrt() + 1e-300
                && c[i][j].powi(2) <= (1.0 + 1e-6) * c[i][i] * c[j][j] + 1e-300
        };
        if !(0..3).all(|i| c[i][i] >= 0.0 && (0..3).all(|j| is_bounded(i, j))) {
            let allowed = "a symmetric matrix of finite variances and covariances is needed";
            return Err(optics_model::Invalid::new("covariance", format!("{c:?}"), allowed));
        }
        let variance = |i: usize| self.shared.iter().map(|changes| changes[i].powi(2)).sum::<f64>();
        if ![0, sources].contains(&self.shared.len())
            || !self.shared.iter().flatten().all(|change| change.is_finite())
            || !(0..3).all(|i| variance(i) <= 1.01 * c[i][i])
        {
            let allowed = format!("{sources} changes are needed, whose squares are part of the variances");
            return Err(optics_model::Invalid::new(
                "shared",
                format!("{} changes", self.shared.len()),
                allowed,
            ));
        }
        Ok(())
    }

    pub fn medium(&self) -> Result<Medium, optics_model::Invalid> {
        Medium::new(self.sigma_t_per_mm, self.albedo, self.g)
    }

    /// The second lobe; one without weight if the file has none.
    pub fn second_lobe(&self) -> Result<SecondLobe, optics_model::Invalid> {
        self.second_lobe.map_or(Ok(SecondLobe::default()), |lobe| SecondLobe::new(lobe.weight, lobe.g))
    }
}

/// Names of the uncertain quantities of a scene; the second of one name gets a number.
pub fn quantity_names(scene: &Scene) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    let plain: Vec<String> = scene.priors().iter().map(|prior| scene.name_of(prior)).collect();
    for (i, name) in plain.iter().enumerate() {
        let before = plain[..i].iter().filter(|other| *other == name).count();
        names.push(if before == 0 { name.clone() } else { format!("{name} ({})", before + 1) });
    }
    names
}

/// Five digits, which keep the file small.
fn rounded(change: f64) -> f64 {
    format!("{change:.4e}").parse().unwrap_or(change)
}

/// The covariance of a fit. That of an ink from mixtures is not known: the variances follow from its intervals.
fn covariance(refined: &Refined) -> [[f64; 3]; 3] {
    if !refined.from_mixtures {
        return refined.covariance;
    }
    let variance = |i: &Interval, coordinate: fn(f64) -> f64| {
        let half = 0.5 * (coordinate(i.high) - coordinate(i.low)).abs() / Z;
        // An end that is not known leaves a factor of e.
        if half.is_finite() { half * half } else { 1.0 }
    };
    let variances = [
        variance(&refined.sigma_t_per_mm, libm::log),
        variance(&refined.albedo, |a| (1.0 - a).max(0.0).sqrt()),
        variance(&refined.g, |g| libm::log(1.0 - g)),
    ];
    std::array::from_fn(|i| std::array::from_fn(|j| if i == j { variances[i] } else { 0.0 }))
}
