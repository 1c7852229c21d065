//! Accumulates sums over batches of walks, and computes records from them, with exact levels where they are known.

use crate::controls::Controls;
use crate::grid::{BATCH_WALKS, CHUNK_BATCHES};
use crate::invalid::{Invalid, Result};
use crate::job::JobSpec;
use crate::packed::{PackedRecords, std_errors};
use crate::profile::{Derivatives, Estimate, Profile, Record};

/// Bytes of a job's result: the sums of its block if it is divided, else its records.
pub fn result_bytes(job: &JobSpec) -> usize {
    match job.block() {
        Some(_) => Sums::bytes(job),
        None => PackedRecords::bytes_of(job),
    }
}

/// Relative accuracy of exact levels.
const LEVEL_ERROR: f64 = 1e-4;

/// Sums over batches of a profile's numbers, and of the squares of the batches' deviations from the mean of their chunk:
/// `[pixel][channel][quantity][albedo]`.
///
/// With exact levels the deviations are those of the corrected radiance factor: see [`Self::into_records`].
///
/// Addition of floating-point numbers depends on the order, so sums are merged in the order of their batches,
/// wherever they were computed.
#[derive(Debug, Clone, PartialEq)]
pub struct Sums {
    pub sums: Vec<f64>,
    pub deviations: Vec<f64>,
    /// Scores of the walks over uniform bases of ρ_light and ρ_dark, at the job's albedos and then at those of its
    /// [`Controls`]: `[light, dark][channel][albedo]`; empty without controls.
    pub levels: Vec<f64>,
    /// Radiance factors over uniform bases, without noise: `[light, dark][channel][control]`. They are 0 until they are
    /// set.
    pub exact: Vec<f64>,
    batches: u64,
}

impl Sums {
    /// Largest number that sums may hold.
    const LARGEST: f64 = 1e30;

    /// Sums over no batch.
    pub fn new(job: &JobSpec) -> Self {
        let [len, levels, exact] = Self::lengths(job);
        let zeros = |len| vec![0.0; len];
        Self {
            sums: zeros(len),
            deviations: zeros(len),
            levels: zeros(levels),
            exact: zeros(exact),
            batches: 0,
        }
    }

    /// Sums over no batch, of which records are made without exact levels.
    pub fn of_walks_alone(job: &JobSpec) -> Self {
        Self { levels: Vec::new(), exact: Vec::new(), ..Self::new(job) }
    }

    /// Whether exact levels correct the records.
    pub fn is_controlled(&self) -> bool {
        !self.levels.is_empty()
    }

    /// Numbers of the sums, of the levels and of the exact levels.
    fn lengths(job: &JobSpec) -> [usize; 3] {
        let (scene, albedos) = (job.scene(), job.albedo().len());
        let channels = scene.channels().len();
        let len = scene.sensor().pixels() * channels * quantities(job) * albedos;
        let controls = Controls::of_job(job).albedos().len();
        let levels = if controls > 0 { albedos + controls } else { 0 };
        [len, 2 * channels * levels, 2 * channels * controls]
    }

    /// Bytes that a job's sums take, in memory and on the wire.
    pub fn bytes(job: &JobSpec) -> usize {
        let [len, levels, exact] = Self::lengths(job);
        (2 * len + levels + exact) * size_of::<f64>()
    }

    /// Counts batches whose numbers have been added: a chunk, or the remaining batches in the last one.
    pub fn add_batches(&mut self, batches: u64) {
        self.batches += batches;
    }

    /// Adds the batches that follow these.
    ///
    /// # Panics
    /// If they belong to a job of another shape.
    pub fn merge(&mut self, next: &Self) {
        assert_eq!(self.sums.len(), next.sums.len(), "sums of one shape are merged");
        let add = |own: &mut [f64], next: &[f64]| own.iter_mut().zip(next).for_each(|(a, b)| *a += b);
        add(&mut self.sums, &next.sums);
        add(&mut self.deviations, &next.deviations);
        add(&mut self.levels, &next.levels);
        self.exact.clone_from(&next.exact);
        self.batches += next.batches;
    }

    /// Sums, deviations, levels, exact levels: 64-bit floats, little endian.
    pub fn to_le_bytes(&self) -> Vec<u8> {
        let parts = [&self.sums, &self.deviations, &self.levels, &self.exact];
        parts.into_iter().flatten().flat_map(|v| v.to_le_bytes()).collect()
    }

    /// The sums of a job over a number of batches, as [`Self::to_le_bytes`] wrote them.
    pub fn from_le_bytes(job: &JobSpec, batches: u64, bytes: &[u8]) -> Result<Self> {
        if bytes.len() != Self::bytes(job) {
            let allowed = format!("{} are needed", Self::bytes(job));
            return Err(Invalid::new("sums", format_args!("{} bytes", bytes.len()), allowed));
        }
        let number = |b: &[u8]| f64::from_le_bytes(b.try_into().expect("8 bytes"));
        let mut sums: Vec<f64> = bytes.chunks_exact(8).map(number).collect();
        // Sums of walks are far smaller; larger numbers do not fit 32-bit floats.
        if let Some(i) = sums.iter().position(|v| v.is_nan() || v.abs() > Self::LARGEST) {
            let allowed = format!("at most {:e} is allowed", Self::LARGEST);
            return Err(Invalid::new(format!("sums[{i}]"), sums[i], allowed));
        }
        let [len, levels, _] = Self::lengths(job);
        let exact = sums.split_off(2 * len + levels);
        let levels = sums.split_off(2 * len);
        let deviations = sums.split_off(len);
        Ok(Self { sums, deviations, levels, exact, batches })
    }

    /// Mean and standard error per pixel, one record per albedo.
    ///
    /// The mean over n batches in c chunks is Σb / n; its standard error √(Σ(b − mean of its chunk)² / (n (n − c))).
    ///
    /// With exact levels U and the walks' own, L, the radiance factor F becomes F + (1 − s) Δ_dark + s Δ_light, with the
    /// share s = (F − L_dark)/(L_light − L_dark) and Δ = Σ w (U − L) over the [`Controls`]. Far from the edge the exact
    /// levels are left. Their accuracy is part of the standard errors.
    pub fn into_records(self, job: &JobSpec) -> Vec<Record> {
        let scene = job.scene();
        let (pixels, channels, albedos) =
            (scene.sensor().pixels(), scene.channels().len(), job.albedo().len());
        let quantities = quantities(job);
        let row = channels * quantities * albedos;
        let batches = self.batches as f64;
        let degrees = batches - self.batches.div_ceil(CHUNK_BATCHES) as f64;
        let scale = 1.0 / (BATCH_WALKS as f64 * scene.light().measure());
        let controls = Controls::of_job(job);
        let estimate = |channel: usize, quantity: usize, albedo: usize| {
            let column = (channel * quantities + quantity) * albedos + albedo;
            let controlled = quantity == 0 && self.is_controlled();
            let level = controlled.then(|| {
                [0, 1].map(|side| self.level(&controls, channels, [side, channel, albedo], scale / batches))
            });
            let (values, mut std_errors): (_, Vec<f32>) = (0..pixels)
                .map(|pixel| {
                    let at = pixel * row + column;
                    let by_walks = (self.deviations[at] / degrees / batches).sqrt() * scale;
                    let mean = self.sums[at] / batches * scale;
                    let Some([light, dark]) = &level else { return (mean as f32, by_walks as f32) };
                    let contrast = light.own - dark.own;
                    let share = if contrast == 0.0 { 0.5 } else { (mean - dark.own) / contrast };
                    let value = mean + (1.0 - share) * dark.change + share * light.change;
                    let level_error = LEVEL_ERROR * value;
                    (value as f32, (by_walks * by_walks + level_error * level_error).sqrt() as f32)
                })
                .unzip();
            // A record is the same whether it was packed or not.
            std_errors::round(&mut std_errors);
            Estimate::new(values, std_errors).expect("sums of finite numbers are finite")
        };
        let profile = |channel: usize, albedo: usize| Profile {
            radiance_factor: estimate(channel, 0, albedo),
            derivatives: job.derivatives().then(|| Derivatives {
                albedo: estimate(channel, 1, albedo),
                sigma_t: estimate(channel, 2, albedo),
            }),
        };
        (0..albedos)
            .map(|albedo| Record {
                index: job.first_record() + albedo,
                profiles: (0..channels).map(|channel| profile(channel, albedo)).collect(),
            })
            .collect()
    }

    fn level(
        &self,
        controls: &Controls,
        channels: usize,
        [side, channel, albedo]: [usize; 3],
        scale: f64,
    ) -> WalkedLevel {
        let (row, count) = (side * channels + channel, controls.albedos().len());
        let len = self.levels.len() / (2 * channels);
        let (own, walked) = self.levels[row * len..][..len].split_at(len - count);
        let exact = &self.exact[row * count..][..count];
        let changes: Vec<f64> =
            exact.iter().zip(walked).map(|(exact, walked)| exact - walked * scale).collect();
        WalkedLevel { own: own[albedo] * scale, change: controls.at(albedo, &changes) }
    }
}

/// A level of one albedo: the walks' own, and Δ.
struct WalkedLevel {
    own: f64,
    change: f64,
}

/// Quantities estimated per albedo: the radiance factor, and ∂/∂α and ∂/∂σ_t if requested.
pub fn quantities(job: &JobSpec) -> usize {
    if job.derivatives() { 3 } else { 1 }
}
