//! Accumulates sums over batches of walks, and computes records from them.

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

/// Sums of a profile's numbers over batches, and of the squares of the batches' deviations from the mean of their chunk:
/// `[pixel][channel][quantity][albedo]`.
///
/// Addition of floating-point numbers depends on the order, so sums are merged in the order of their batches,
/// wherever they were computed.
#[derive(Debug, Clone, PartialEq)]
pub struct Sums {
    pub sums: Vec<f64>,
    pub deviations: Vec<f64>,
    batches: u64,
}

impl Sums {
    /// Largest number that sums may hold.
    const LARGEST: f64 = 1e30;

    /// Sums over no batch.
    pub fn new(job: &JobSpec) -> Self {
        let len = Self::len(job);
        Self { sums: vec![0.0; len], deviations: vec![0.0; len], batches: 0 }
    }

    fn len(job: &JobSpec) -> usize {
        let scene = job.scene();
        scene.sensor().pixels() * scene.channels().len() * quantities(job) * job.albedo().len()
    }

    /// Bytes that a job's sums take, in memory and on the wire.
    pub fn bytes(job: &JobSpec) -> usize {
        2 * Self::len(job) * size_of::<f64>()
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
        for (a, b) in self.sums.iter_mut().zip(&next.sums) {
            *a += b;
        }
        for (a, b) in self.deviations.iter_mut().zip(&next.deviations) {
            *a += b;
        }
        self.batches += next.batches;
    }

    /// Sums, then deviations: 64-bit floats, little endian.
    pub fn to_le_bytes(&self) -> Vec<u8> {
        self.sums.iter().chain(&self.deviations).flat_map(|v| v.to_le_bytes()).collect()
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
        let deviations = sums.split_off(sums.len() / 2);
        Ok(Self { sums, deviations, batches })
    }

    /// Mean and standard error per pixel, one record per albedo.
    ///
    /// The mean over n batches in c chunks is Σb / n; its standard error √(Σ(b − mean of its chunk)² / (n (n − c))).
    pub fn into_records(self, job: &JobSpec) -> Vec<Record> {
        let scene = job.scene();
        let (pixels, channels, albedos) =
            (scene.sensor().pixels(), scene.channels().len(), job.albedo().len());
        let quantities = quantities(job);
        let row = channels * quantities * albedos;
        let batches = self.batches as f64;
        let degrees = batches - self.batches.div_ceil(CHUNK_BATCHES) as f64;
        let scale = 1.0 / (BATCH_WALKS as f64 * scene.light().measure());
        let estimate = |channel: usize, quantity: usize, albedo: usize| {
            let column = (channel * quantities + quantity) * albedos + albedo;
            let (values, mut std_errors): (_, Vec<f32>) = (0..pixels)
                .map(|pixel| {
                    let at = pixel * row + column;
                    let variance = self.deviations[at] / degrees;
                    let mean = self.sums[at] / batches;
                    ((mean * scale) as f32, ((variance / batches).sqrt() * scale) as f32)
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
}

/// Quantities estimated per albedo: the radiance factor, and ∂/∂α and ∂/∂σ_t if requested.
pub fn quantities(job: &JobSpec) -> usize {
    if job.derivatives() { 3 } else { 1 }
}
