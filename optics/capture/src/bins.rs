//! Binning along the edge (ISO 12233): each raw sample of one colour goes into the bin of its distance from the edge.
//!
//! In each bin a robust line is fitted to the samples, and its value at the bin's middle is the profile's. With evenly
//! spread samples that is the average over the bin, whatever the profile's slope.

use rayon::prelude::*;

use crate::blemishes::{Blemish, BlemishMask, Residual};
use crate::calibration::Radiance;
use crate::estimate::Estimate;
use crate::frame::{Colour, Site};
use crate::lattice::{EdgeFrame, HALF_CROP_MM};
use crate::least_squares::{TUKEY_VARIANCE, median, spread, tukey};

/// Bins of a profile, and their width: 10 mm / 360.
pub const BINS: usize = 360;
pub const BIN_MM: f64 = 2.0 * HALF_CROP_MM / BINS as f64;

/// Profile of one channel over bins of equal width; x rises from the dark side to the light side, the edge at 0.
#[derive(Debug, Clone, PartialEq)]
pub struct EdgeProfile {
    pub colour: Colour,
    pub x_mm: Vec<f64>,
    /// Averages over bins, as radiance factors.
    pub values: Vec<f64>,
    /// Standard errors due to noise, independent in each bin.
    pub std_errors: Vec<f64>,
    /// Samples in each bin.
    pub counts: Vec<u32>,
    /// Share of samples that were rejected.
    pub rejected: Vec<f64>,
}

/// One sample in a bin.
#[derive(Debug, Clone, Copy)]
struct Binned {
    /// Place from the bin's middle, and along the edge, in mm.
    offset: f32,
    along: f32,
    value: f32,
    variance: f32,
    x: u32,
    y: u32,
}

/// Bins of a profile: the usual ones, or finer ones for the blur, since pixels much wider than a bin resolve it only
/// where the edge crosses them at many phases.
#[derive(Debug, Clone, Copy)]
struct BinGrid {
    bins: usize,
}

impl BinGrid {
    fn width_mm(self) -> f64 {
        2.0 * HALF_CROP_MM / self.bins as f64
    }
}

/// One channel of one shot in bins.
#[derive(Debug, Clone)]
pub(crate) struct Binning {
    pub profile: EdgeProfile,
    pub rejected_px: Vec<[u32; 2]>,
    /// Number of samples that lie in blemishes.
    pub masked: usize,
    pub thirds: Vec<Third>,
    pub clipped_share: f64,
    /// Ratio of the scatter in bins to the sensor's noise.
    pub scatter: f64,
}

/// Deviation of a third of the crop from the whole, within some bins.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Third {
    pub x_mm: f64,
    pub departure: f64,
    pub std_error: f64,
}

/// Bins of a zone in which thirds are compared.
const ZONE: usize = 20;

/// The bare edge for the blur fit, in bins of a quarter of the usual width, or as fine as the samples can fill.
pub(crate) fn fine(radiance: &Radiance<'_>, edge: &EdgeFrame, colour: Colour) -> EdgeProfile {
    let sites = radiance.frame.sites_of(colour);
    let per_pixel: f64 = sites.iter().map(|s| ((s.step * s.step) as f64).recip()).sum();
    let samples = per_pixel * (2.0 * HALF_CROP_MM / edge.mm_per_px()).powi(2);
    let parts = (samples / (BINS as f64 * FILLED)).clamp(1.0, 4.0) as usize;
    bin_on(BinGrid { bins: parts * BINS }, radiance, edge, colour, 0.0).profile
}

/// Average number of samples that a fine bin should hold: with fewer, many bins would be below the minimum.
const FILLED: f64 = 15.0;

/// Bins one channel; `origin_mm` is the place of its edge in the frame's coordinates.
pub(crate) fn bin(radiance: &Radiance<'_>, edge: &EdgeFrame, colour: Colour, origin_mm: f64) -> Binning {
    bin_on(BinGrid { bins: BINS }, radiance, edge, colour, origin_mm)
}

/// Bins all channels of a shot without specks and scratches, which are returned.
pub(crate) fn bin_clean(
    radiance: &Radiance<'_>,
    edge: &EdgeFrame,
    origins_mm: &[Estimate],
) -> (Vec<Binning>, Vec<Blemish>) {
    let grid = BinGrid { bins: BINS };
    let columns = radiance.frame.columns().iter().zip(origins_mm);
    let mut channels: Vec<ChannelBins> =
        columns.map(|(c, origin)| ChannelBins::new(grid, radiance, edge, *c, origin.value)).collect();
    let mut blemishes = Vec::new();
    // Masking a blemish may reveal the rim of another.
    for _ in 0..3 {
        let residuals: Vec<Vec<Residual>> = channels.iter().map(ChannelBins::residuals).collect();
        let mask = BlemishMask::find(&residuals, edge.mm_per_px());
        if mask.blemishes.is_empty() {
            break;
        }
        for channel in &mut channels {
            channel.mask(&mask);
        }
        blemishes.extend(mask.blemishes);
    }
    (channels.into_iter().map(ChannelBins::binning).collect(), blemishes)
}

fn bin_on(
    grid: BinGrid,
    radiance: &Radiance<'_>,
    edge: &EdgeFrame,
    colour: Colour,
    origin_mm: f64,
) -> Binning {
    ChannelBins::new(grid, radiance, edge, colour, origin_mm).binning()
}

/// Samples of one channel in their bins, with the lines through them.
struct ChannelBins {
    grid: BinGrid,
    colour: Colour,
    bins: Vec<Vec<Binned>>,
    fits: Vec<Option<BinFit>>,
    masked_px: Vec<[u32; 2]>,
    clipped: usize,
}

impl ChannelBins {
    fn new(grid: BinGrid, radiance: &Radiance<'_>, edge: &EdgeFrame, colour: Colour, origin_mm: f64) -> Self {
        let (bins, clipped) = collect(grid, radiance, edge, &radiance.frame.sites_of(colour), origin_mm);
        let fits = fits(&bins, grid);
        Self { grid, colour, bins, fits, masked_px: Vec::new(), clipped }
    }

    fn residuals(&self) -> Vec<Residual> {
        let bin_residuals = |(samples, fit): (&Vec<Binned>, &Option<BinFit>)| {
            let fit = fit.as_ref()?;
            let residual = |s: &Binned| {
                let off = s.residual(fit.value, fit.slope);
                Residual { x: s.x, y: s.y, z: off / fit.scale(), share: off / fit.value.max(1e-6) }
            };
            Some(samples.iter().map(residual).collect::<Vec<_>>())
        };
        self.bins.iter().zip(&self.fits).filter_map(bin_residuals).flatten().collect()
    }

    fn mask(&mut self, mask: &BlemishMask) {
        for samples in &mut self.bins {
            let masked = samples.extract_if(.., |s| mask.holds(s.x, s.y));
            self.masked_px.extend(masked.map(|s| [s.x, s.y]));
        }
        self.fits = fits(&self.bins, self.grid);
    }

    fn binning(self) -> Binning {
        let Self { grid, colour, bins, fits, masked_px, clipped } = self;
        let ratios = |f: &BinFit| f.scatter / f.sigma;
        let mut finite: Vec<f64> = fits.iter().flatten().map(ratios).collect();
        let scatter = if finite.is_empty() { 1.0 } else { median(&mut finite) };
        let total = bins.iter().map(Vec::len).sum::<usize>() + masked_px.len();
        let masked = masked_px.len();
        let rejected = bins.iter().zip(&fits).flat_map(|(samples, fit)| rejected(samples, fit.as_ref()));
        Binning {
            profile: profile(grid, colour, &bins, &fits, scatter.max(1.0)),
            rejected_px: masked_px.into_iter().chain(rejected).collect(),
            masked,
            thirds: thirds(&bins, &fits),
            clipped_share: clipped as f64 / (total + clipped).max(1) as f64,
            scatter,
        }
    }
}

fn collect(
    grid: BinGrid,
    radiance: &Radiance<'_>,
    edge: &EdgeFrame,
    sites: &[Site],
    origin_mm: f64,
) -> (Vec<Vec<Binned>>, usize) {
    let width_mm = grid.width_mm();
    let corners = edge.crop_px();
    let end = |axis: usize, f: fn(f64, f64) -> f64| corners.iter().map(|c| c[axis]).reduce(f).unwrap_or(0.0);
    let (width, height) = (radiance.frame.width() as f64, radiance.frame.height() as f64);
    let columns = (end(0, f64::min) - 2.0).max(0.0) as usize..(end(0, f64::max) + 2.0).min(width) as usize;
    let rows = (end(1, f64::min) - 2.0).max(0.0) as usize..(end(1, f64::max) + 2.0).min(height) as usize;
    let empty = || (vec![Vec::new(); grid.bins], 0);
    let add_row = |(mut bins, mut clipped): (Vec<Vec<Binned>>, usize), y: usize| {
        for site in sites.iter().filter(|s| s.has_row(y)) {
            for x in (site.column_from(columns.start)..columns.end).step_by(site.step) {
                let [across, along] = edge.mm([x as f64 + 0.5, y as f64 + 0.5]);
                let at = (across - origin_mm) / width_mm + 0.5 * grid.bins as f64;
                if along.abs() > HALF_CROP_MM || !(0.0..grid.bins as f64).contains(&at) {
                    continue;
                }
                let sample = radiance.sample(*site, x, y);
                if sample.clipped {
                    clipped += 1;
                    continue;
                }
                bins[at as usize].push(Binned {
                    offset: ((at.fract() - 0.5) * width_mm) as f32,
                    along: along as f32,
                    value: sample.value as f32,
                    variance: sample.variance as f32,
                    x: x as u32,
                    y: y as u32,
                });
            }
        }
        (bins, clipped)
    };
    // Chunks of rows of a fixed size, joined in order, so that sums do not depend on the number of threads.
    let all: Vec<usize> = rows.collect();
    let parts: Vec<_> =
        all.par_chunks(64).map(|chunk| chunk.iter().fold(empty(), |sum, y| add_row(sum, *y))).collect();
    let mut whole = empty();
    for (bins, clipped) in parts {
        for (to, from) in whole.0.iter_mut().zip(bins) {
            to.extend(from);
        }
        whole.1 += clipped;
    }
    whole
}

/// A robust line in a bin.
#[derive(Debug, Clone, Copy)]
struct BinFit {
    value: f64,
    slope: f64,
    /// Variance of one sample: expected from the sensor, and observed.
    sigma: f64,
    scatter: f64,
    /// Residual above which samples are rejected.
    limit: f64,
    /// Ratio of the variance of the value to that of one sample.
    leverage: f64,
    kept: usize,
}

/// Largest step from each bin's median to a neighbour's. Printed and scanned edges waver by a fraction of a pixel, and
/// samples that would fit a neighbouring bin are not dust.
fn steps(bins: &[Vec<Binned>]) -> Vec<f64> {
    let medians: Vec<f64> = bins
        .par_iter()
        .map(|samples| median(&mut samples.iter().map(|s| f64::from(s.value)).collect::<Vec<_>>()))
        .collect();
    let step = |a: usize, b: usize| (medians[a] - medians[b]).abs();
    let last = bins.len() - 1;
    (0..bins.len()).map(|k| step(k, k.saturating_sub(1)).max(step(k, (k + 1).min(last)))).collect()
}

fn fits(bins: &[Vec<Binned>], grid: BinGrid) -> Vec<Option<BinFit>> {
    let steps = steps(bins);
    bins.par_iter().zip(&steps).map(|(samples, step)| BinFit::of(samples, *step, grid)).collect()
}

/// Residuals above which samples are rejected, in standard deviations: where Tukey's weights are 0.
const REJECTED: f64 = 4.685;

/// Fewest samples of a bin.
const SAMPLES: usize = 8;

impl BinFit {
    fn of(samples: &[Binned], step: f64, grid: BinGrid) -> Option<Self> {
        if samples.len() < SAMPLES {
            return None;
        }
        // The mean of noisy variances is unbiased; weights by single variances would favour dark samples.
        let variance = median(&mut samples.iter().map(|s| f64::from(s.variance)).collect::<Vec<_>>());
        let sigma = variance.sqrt().max(1e-12);
        let mut value = median(&mut samples.iter().map(|s| f64::from(s.value)).collect::<Vec<_>>());
        let mut slope = 0.0;
        let (mut scatter, mut scale) = (sigma, f64::INFINITY);
        let mut residuals = Vec::new();
        for round in 0..12 {
            residuals = samples.iter().map(|s| s.residual(value, slope)).collect::<Vec<_>>();
            scatter = spread(&residuals);
            // The first iteration only finds the level.
            scale = libm::hypot(sigma, step).max(if round == 0 { 3.0 * scatter } else { 0.0 });
            let [mut n, mut sx, mut sxx, mut sy, mut sxy] = [0.0; 5];
            for (s, r) in samples.iter().zip(&residuals) {
                let (w, x, y) = (tukey(r / scale), f64::from(s.offset), f64::from(s.value));
                n += w;
                sx += w * x;
                sxx += w * x * x;
                sy += w * y;
                sxy += w * x * y;
            }
            let determinant = n * sxx - sx * sx;
            if determinant <= 1e-6 * n * n * grid.width_mm().powi(2) {
                return None;
            }
            value = (sxx * sy - sx * sxy) / determinant;
            slope = (n * sxy - sx * sy) / determinant;
        }
        let limit = REJECTED * scale;
        let kept = samples.iter().zip(&residuals).filter(|(_, r)| r.abs() < limit);
        let (mut n, mut sx, mut sxx) = (0.0, 0.0, 0.0);
        for (s, _) in kept {
            let x = f64::from(s.offset);
            n += 1.0;
            sx += x;
            sxx += x * x;
        }
        let leverage = sxx / (n * sxx - sx * sx);
        // A weight function wider than the noise loses less efficiency, by the fourth power of the width.
        let lost = TUKEY_VARIANCE - 1.0;
        let leverage = leverage * (1.0 + lost * (sigma / scale).powi(4));
        Some(Self { value, slope, sigma, scatter, limit, leverage, kept: n as usize })
    }

    /// Standard deviation of residuals: noise, and the waver of the edge.
    fn scale(&self) -> f64 {
        self.limit / REJECTED
    }
}

impl Binned {
    fn residual(&self, value: f64, slope: f64) -> f64 {
        f64::from(self.value) - value - slope * f64::from(self.offset)
    }
}

fn rejected(samples: &[Binned], fit: Option<&BinFit>) -> Vec<[u32; 2]> {
    let Some(fit) = fit else { return Vec::new() };
    let far = |s: &&Binned| s.residual(fit.value, fit.slope).abs() >= fit.limit;
    samples.iter().filter(far).map(|s| [s.x, s.y]).collect()
}

/// Bins without enough samples get NaN.
fn profile(
    grid: BinGrid,
    colour: Colour,
    bins: &[Vec<Binned>],
    fits: &[Option<BinFit>],
    scatter: f64,
) -> EdgeProfile {
    let centre = |k: usize| (k as f64 + 0.5) * grid.width_mm() - HALF_CROP_MM;
    let error = |f: &BinFit| f.sigma * scatter * f.leverage.sqrt();
    let share = |samples: &Vec<Binned>, f: &BinFit| 1.0 - f.kept as f64 / samples.len() as f64;
    let bin_values =
        |f: &dyn Fn(&BinFit) -> f64| fits.iter().map(|fit| fit.as_ref().map_or(f64::NAN, f)).collect();
    EdgeProfile {
        colour,
        x_mm: (0..grid.bins).map(centre).collect(),
        values: bin_values(&|f| f.value),
        std_errors: bin_values(&error),
        counts: bins.iter().map(|b| b.len() as u32).collect(),
        rejected: bins.iter().zip(fits).map(|(b, f)| f.as_ref().map_or(0.0, |f| share(b, f))).collect(),
    }
}

/// Deviation of each third along the edge from the bins' lines, by zones. The means are trimmed by a twelfth at either
/// end, so that specks of dust do not count, but a bubble that single bins would reject does.
fn thirds(bins: &[Vec<Binned>], fits: &[Option<BinFit>]) -> Vec<Third> {
    let mut found = Vec::new();
    for (zone, (bins, fits)) in bins.chunks(ZONE).zip(fits.chunks(ZONE)).enumerate() {
        let mut residuals = [const { Vec::new() }; 3];
        let mut variances = [0.0; 3];
        for (samples, fit) in bins.iter().zip(fits) {
            let Some(fit) = fit else { continue };
            for s in samples {
                let third = (f64::from(s.along) / HALF_CROP_MM * 1.5 + 1.5).clamp(0.0, 2.0) as usize;
                residuals[third].push(s.residual(fit.value, fit.slope));
                variances[third] += fit.sigma.powi(2);
            }
        }
        let x_mm = (zone as f64 + 0.5) * ZONE as f64 * BIN_MM - HALF_CROP_MM;
        for (mut residuals, variance) in residuals.into_iter().zip(variances) {
            let (n, cut) = (residuals.len(), residuals.len() / 12);
            if n > 30 {
                residuals.sort_by(f64::total_cmp);
                let kept = &residuals[cut..n - cut];
                let departure = kept.iter().sum::<f64>() / kept.len() as f64;
                found.push(Third { x_mm, departure, std_error: variance.sqrt() / n as f64 });
            }
        }
    }
    found
}
