//! Measures the brightness of the crop in coarse cells, which shows where a slab covers it.

use super::edge::{EdgeFrame, HALF_CROP_MM};
use crate::calibration::Radiance;
use crate::estimate::Estimate;
use crate::frame::Site;
use crate::least_squares::robust_mean;
use crate::refusal::Refusal;

/// Cells along each side of the crop, each half a millimetre wide.
const CELLS: usize = 20;

/// Relative deviation from the bare board within which a cell counts as not covered.
const FREE: f64 = 0.015;

/// Mean radiance factor of each cell and channel, by distance from the edge within each row.
#[derive(Debug, Clone)]
pub(crate) struct CropCells(Vec<Vec<CellMean>>);

#[derive(Debug, Clone, Copy)]
struct CellMean {
    value: f64,
    std_error: f64,
}

impl CropCells {
    pub fn of(radiance: &Radiance<'_>, edge: &EdgeFrame) -> Self {
        Self(radiance.frame.each(|colour| {
            let sites = radiance.frame.sites_of(colour);
            (0..CELLS * CELLS).map(|k| cell(radiance, edge, &sites, k)).collect()
        }))
    }

    /// Mean over the crop, per channel; half of the difference between its sides counts as error.
    pub fn levels(&self) -> Vec<Estimate> {
        let level = |cells: &Vec<CellMean>| {
            let side = |light: bool| {
                let of_side = cells.iter().enumerate().filter(|(k, _)| is_light(*k) == light);
                robust_mean(&of_side.map(|(_, cell)| cell.value).collect::<Vec<_>>())
            };
            let ([a, noise_a], [b, noise_b]) = (<[f64; 2]>::from(side(false)), <[f64; 2]>::from(side(true)));
            let std_error = libm::hypot(0.5 * libm::hypot(noise_a, noise_b), 0.5 * (a - b));
            Estimate::new(f64::midpoint(a, b), std_error)
        };
        self.0.iter().map(level).collect()
    }

    pub fn mean(shots: &[Self]) -> Self {
        let n = shots.len() as f64;
        let cell_mean = |c: usize, k: usize| {
            let sum = |f: fn(&CellMean) -> f64| shots.iter().map(|s| f(&s.0[c][k])).sum::<f64>();
            CellMean { value: sum(|c| c.value) / n, std_error: sum(|c| c.std_error) / n / n.sqrt() }
        };
        let cells = |c: usize| (0..CELLS * CELLS).map(|k| cell_mean(c, k)).collect();
        Self((0..shots[0].0.len()).map(cells).collect())
    }

    /// Shares of the dark and the light side of the crop that look uncovered, `self` being the bare board.
    fn free_shares(&self, sample: &Self) -> [f64; 2] {
        let share = |side: bool| {
            let free = (0..CELLS * CELLS).filter(|k| is_light(*k) == side && self.is_free(sample, *k));
            free.count() as f64 / (CELLS * CELLS / 2) as f64
        };
        [share(false), share(true)]
    }

    /// Whether the whole crop looks uncovered.
    pub fn is_bare(&self, sample: &Self) -> bool {
        self.free_shares(sample).iter().all(|share| *share > 0.9)
    }

    /// Refuses a crop that a slab does not cover, `self` being the bare board.
    pub fn check_covered(&self, label: &str, sample: &Self) -> Result<(), Refusal> {
        if self.is_bare(sample) {
            return Err(Refusal::NoSlab { label: label.to_owned() });
        }
        // An opaque slab looks like the bare dark side.
        let dark_counts = self.free_shares(sample)[0] < 0.6;
        let counts = |k: &usize| self.is_free(sample, *k) && (is_light(*k) || dark_counts);
        let corner = |k: usize| [(k % CELLS) as f64, (k / CELLS) as f64];
        let border = |k: &usize| [k % CELLS, k / CELLS].iter().any(|i| *i == 0 || *i == CELLS - 1);
        let open: Vec<usize> = (0..CELLS * CELLS).filter(border).filter(counts).collect();
        // A single cell may be due to chance.
        if open.len() < 3 {
            return Ok(());
        }
        let inner = (0..CELLS * CELLS).filter(counts).map(corner);
        let mm = |i: f64| (i + 0.5) * 2.0 * HALF_CROP_MM / CELLS as f64 - HALF_CROP_MM;
        let nearest = inner.min_by(|a, b| {
            let far = |c: &[f64; 2]| libm::hypot(mm(c[0]), mm(c[1]));
            far(a).total_cmp(&far(b))
        });
        let [x, y] = nearest.unwrap_or([0.0; 2]);
        Err(Refusal::RimInCrop { label: label.to_owned(), x_mm: mm(x), y_mm: mm(y) })
    }

    fn is_free(&self, sample: &Self, k: usize) -> bool {
        self.0.iter().zip(&sample.0).all(|(bare, sample)| {
            let (bare, now) = (bare[k], sample[k]);
            let noise = libm::hypot(bare.std_error, now.std_error);
            (now.value - bare.value).abs() < (FREE * bare.value).max(3.0 * noise)
        })
    }
}

/// Whether a cell lies on the light side.
fn is_light(k: usize) -> bool {
    k % CELLS >= CELLS / 2
}

fn cell(radiance: &Radiance<'_>, edge: &EdgeFrame, sites: &[Site], k: usize) -> CellMean {
    const STEPS: usize = 8;
    let side = 2.0 * HALF_CROP_MM / CELLS as f64;
    let at = |i: usize, part: usize| (i as f64 + (part as f64 + 0.5) / STEPS as f64) * side - HALF_CROP_MM;
    let mut values = Vec::new();
    for part in 0..STEPS * STEPS {
        let px = edge.px([at(k % CELLS, part % STEPS), at(k / CELLS, part / STEPS)]);
        for site in sites {
            let (x, y) = site.nearest(px, radiance.frame);
            values.push(radiance.sample(*site, x, y).value);
        }
    }
    let (value, std_error) = robust_mean(&values);
    CellMean { value, std_error }
}
