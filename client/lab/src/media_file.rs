//! Reads and writes `media.json`: measured media with their covariance and the scene in which they were measured, for
//! predictions, comparisons and other programs.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use optics_model::fit::{Interval, MaterialFit, Refined, Z};
use optics_model::medium::check_ior;
use optics_model::phase::SecondLobe;
use optics_model::scene::Scene;
use optics_model::{Digest, Medium, SceneFile};
use serde::{Deserialize, Serialize};

use crate::bounded_file;

/// Name of the file in the folder of a session or of media.
pub const MEDIA_FILE: &str = "media.json";
const FORMAT: &str = "farmctl-media/1";
/// Largest file that is read, in bytes.
const LARGEST: u64 = 64 << 20;

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
    pub materials: Vec<MediaMaterial>,
}

/// A material.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MediaMaterial {
    pub material: String,
    pub channels: Vec<MediaChannel>,
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
    pub fn new(fits: &[MaterialFit], with: &MeasuredWith) -> Self {
        let channels = |fit: &MaterialFit| -> Vec<MediaChannel> {
            let channels = fit.channels.iter();
            channels.filter_map(|c| Some(MediaChannel::of(&c.channel, c.refined.as_ref()?))).collect()
        };
        let material =
            |fit: &MaterialFit| MediaMaterial { material: fit.material.clone(), channels: channels(fit) };
        Self {
            format: FORMAT.to_owned(),
            program: concat!("farmctl ", env!("CARGO_PKG_VERSION")).to_owned(),
            dictionary: with.dictionary.to_owned(),
            dictionary_digest: with.digest.to_string(),
            mu: with.mu[0],
            mu_std_error: with.mu[1],
            scene: SceneFile::from(with.scene),
            materials: fits.iter().map(material).collect(),
        }
    }

    /// The file of this path, or that in the folder of this path.
    pub fn read(path: &Path) -> Result<Self> {
        let path = if path.is_dir() { path.join(MEDIA_FILE) } else { PathBuf::from(path) };
        let place = || format!("media file {}", path.display());
        let bytes = bounded_file::read(&path, LARGEST).with_context(|| {
            format!("{}: `farmctl measure` writes it into the session's folder, or that of -o", place())
        })?;
        let json: serde_json::Value = serde_json::from_slice(&bytes).with_context(place)?;
        if json["format"] != FORMAT {
            bail!("{}: its format is {}, not {FORMAT:?}", place(), json["format"]);
        }
        let file: Self = serde_json::from_value(json).with_context(place)?;
        for (i, material) in file.materials.iter().enumerate() {
            if file.materials[..i].iter().any(|other| other.material == material.material) {
                bail!("{}: material {:?} occurs twice", place(), material.material);
            }
            for channel in &material.channels {
                channel
                    .check()
                    .with_context(|| format!("{}: {} {}", place(), material.material, channel.channel))?;
            }
        }
        Ok(file)
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

impl MediaMaterial {
    pub fn channel(&self, name: &str) -> Option<&MediaChannel> {
        self.channels.iter().find(|c| c.channel == name)
    }
}

impl MediaChannel {
    fn of(channel: &str, refined: &Refined) -> Self {
        let medium = refined.best.medium;
        Self {
            channel: channel.to_owned(),
            sigma_t_per_mm: medium.sigma_t_per_mm(),
            albedo: medium.albedo(),
            g: medium.g(),
            second_lobe: refined.second_lobe.map(|lobe| MediaLobe { weight: lobe.weight(), g: lobe.g() }),
            sample_ior: refined.best.sample_ior,
            covariance: covariance(refined),
            resolved: refined.resolved,
            misfit: refined.misfit,
            sigma_t_interval: refined.sigma_t_per_mm.into(),
            albedo_interval: refined.albedo.into(),
            g_interval: refined.g.into(),
            reduced_scattering_interval: refined.reduced_scattering_per_mm.into(),
            absorption_interval: refined.absorption_per_mm.into(),
        }
    }

    fn check(&self) -> Result<(), optics_model::Invalid> {
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
        if (0..3).all(|i| c[i][i] >= 0.0 && (0..3).all(|j| is_bounded(i, j))) {
            return Ok(());
        }
        let allowed = "a symmetric matrix of finite variances and covariances is needed";
        Err(optics_model::Invalid::new("covariance", format!("{c:?}"), allowed))
    }

    pub fn medium(&self) -> Result<Medium, optics_model::Invalid> {
        Medium::new(self.sigma_t_per_mm, self.albedo, self.g)
    }

    /// The second lobe; one without weight if the file has none.
    pub fn second_lobe(&self) -> Result<SecondLobe, optics_model::Invalid> {
        self.second_lobe.map_or(Ok(SecondLobe::default()), |lobe| SecondLobe::new(lobe.weight, lobe.g))
    }
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
    let of = [
        variance(&refined.sigma_t_per_mm, f64::ln),
        variance(&refined.albedo, |a| (1.0 - a).max(0.0).sqrt()),
        variance(&refined.g, |g| (1.0 - g).ln()),
    ];
    std::array::from_fn(|i| std::array::from_fn(|j| if i == j { of[i] } else { 0.0 }))
}

#[cfg(test)]
mod tests {
    use farm_figures::testing;

    use super::*;

    fn media() -> MediaFile {
        let channels = ["R", "G"].map(|name| testing::channel(name, 6.0, 1.0)).into();
        let fits = [MaterialFit { material: "white".into(), channels }];
        let scene = Scene::lab();
        let digest = Digest::of_bytes(b"grid");
        MediaFile::new(&fits, &MeasuredWith { dictionary: "lab", digest, scene: &scene, mu: [1.0, 0.01] })
    }

    /// A file is read as it was written, from its folder, too; the scene keeps its uncertain numbers.
    #[test]
    fn media_files_survive() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(MEDIA_FILE);
        std::fs::write(&path, media().text().unwrap()).unwrap();
        for path in [folder.path(), &path] {
            let read = MediaFile::read(path).unwrap();
            assert_eq!(read, media());
            assert_eq!(Scene::try_from(read.scene).unwrap(), Scene::lab());
        }
    }

    /// Refusals name the file, and the material where it is a number.
    #[test]
    fn wrong_media_files_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let refused = |text: &str| {
            std::fs::write(folder.path().join(MEDIA_FILE), text).unwrap();
            format!("{:#}", MediaFile::read(folder.path()).unwrap_err())
        };
        let text = media().text().unwrap();
        assert!(refused("{}").ends_with("its format is null, not \"farmctl-media/1\""));
        let wrong = refused(&text.replacen("\"sigma_t_per_mm\": 6.0", "\"sigma_t_per_mm\": -6.0", 1));
        assert!(wrong.contains("media.json: white R: sigma_t_per_mm = -6 is not valid"), "{wrong}");
        for (from, to, message) in [
            ("\"sample_ior\": 1.53", "\"sample_ior\": 0.5", "sample_ior = 0.5 is not valid"),
            (
                "\"material\": \"white\"",
                "\"material\": \"white\", \"channels\": []}, {\"material\": \"white\"",
                "occurs twice",
            ),
        ] {
            assert!(text.contains(from), "{text}");
            let wrong = refused(&text.replacen(from, to, 1));
            assert!(wrong.contains(message), "{wrong}");
        }
        let mut wrong = media();
        wrong.materials[0].channels[0].covariance[0][0] = -1.0;
        let wrong = refused(&wrong.text().unwrap());
        assert!(wrong.contains("a symmetric matrix of finite variances"), "{wrong}");
        std::fs::remove_file(folder.path().join(MEDIA_FILE)).unwrap();
        let missing = format!("{:#}", MediaFile::read(folder.path()).unwrap_err());
        assert!(missing.contains("`farmctl measure` writes it into the session's folder"), "{missing}");
        let named = media().material("cyan").unwrap_err().to_string();
        assert_eq!(named, "material \"cyan\" is not in the file: it has white");
    }
}
