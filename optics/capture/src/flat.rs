//! Determines the flat-field correction, the unevenness of light and lens, from shots of an even sheet.
//!
//! ln L = c_j + P(x, y), P a polynomial of the fourth order without constant, common to all shots, c_j the brightness
//! of shot j. The paper's own structure moves with the sheet, so differences between shots estimate how much of it
//! remains.

use rayon::prelude::*;

use crate::black::Black;
use crate::camera_settings::CameraSettings;
use crate::frame::{Colour, Frame, Photo};
use crate::least_squares::{median, robust_fit, robust_mean, scatter_of_mean, spread};
use crate::noise::Pairs;
use crate::refusal::{Refusal, TURNED, UNLIKE, Warning};
use crate::saturation::{CLIPPED, Saturation, saturation};

/// Cells of the grid on which a flat is fitted.
const ACROSS: usize = 36;
const DOWN: usize = 24;

const ORDER: usize = 4;

/// Standard error of the relative slope over the frame if there are fewer than two flat shots.
const UNKNOWN_SLOPE: f64 = 0.01;

/// Accumulates flat shots.
#[derive(Debug)]
pub struct Flats {
    black: Black,
    last: Option<Photo>,
    /// ln of the light of each cell, by shot and column.
    cells: Vec<Vec<Vec<f64>>>,
    labels: Vec<String>,
    pairs: Pairs,
}

/// Light over the frame, relative to its mean.
#[derive(Debug, Clone)]
pub struct Flat {
    size: [f64; 2],
    /// Coefficients of [`terms`] after a constant, of each column; none of even light.
    coefficients: Vec<Vec<f64>>,
    slope_std_error: Vec<f64>,
    pub(crate) pairs: Pairs,
    pub(crate) warnings: Vec<Warning>,
}

impl Flats {
    pub fn new(black: &Black) -> Self {
        let (cells, labels) = (Vec::new(), Vec::new());
        Self { black: black.clone(), last: None, cells, labels, pairs: Pairs::default() }
    }

    pub fn add(&mut self, photo: Photo) -> Result<(), Refusal> {
        let full = saturation(&photo);
        if let Some(last) = &self.last {
            CameraSettings::of(last).check(&photo)?;
            self.pairs.add(&last.frame, &photo.frame, self.black.levels(), full);
        }
        let cells = photo.frame.each(|colour| grid(&photo, &self.black, colour, full));
        self.cells.push(cells.into_iter().collect::<Result<_, _>>()?);
        self.labels.push(photo.label.clone());
        self.last = Some(photo);
        Ok(())
    }

    /// Without shots: even light, with a warning.
    pub fn finish(mut self) -> Result<Flat, Refusal> {
        let warnings = self.leave_out()?;
        let Some(last) = self.last else { return Ok(Flat::even()) };
        let size = [last.frame.width() as f64, last.frame.height() as f64];
        let (mut coefficients, mut slope_std_error) = (Vec::new(), Vec::new());
        for c in 0..last.frame.columns().len() {
            let cells: Vec<&[f64]> = self.cells.iter().map(|shot| shot[c].as_slice()).collect();
            coefficients.push(fit(&cells).ok_or(Refusal::Missing { what: "even flat shots" })?);
            slope_std_error.push(if cells.len() > 1 { slope_error(&cells) } else { UNKNOWN_SLOPE });
        }
        Ok(Flat { size, coefficients, slope_std_error, pairs: self.pairs, warnings })
    }
}

impl Flats {
    /// Leaves out shots that deviate from the others. Refuses them if too few shots would remain.
    fn leave_out(&mut self) -> Result<Vec<Warning>, Refusal> {
        let mut warnings = Vec::new();
        while self.cells.len() > 1 {
            let [apart, turned] = [false, true].map(|turn| -> Vec<f64> {
                (0..self.cells.len()).map(|j| apart(&self.cells, j, turn)).collect()
            });
            let worst = (0..apart.len()).max_by(|a, b| apart[*a].total_cmp(&apart[*b])).unwrap_or(0);
            let is_turned = apart[worst] > TURNED_APART && turned[worst] < 0.5 * apart[worst];
            if apart[worst] < APART && !is_turned {
                break;
            }
            let seen = format!(
                "light over the frame differs from the other flat shots' by {:.1} %",
                100.0 * apart[worst]
            );
            let cause = if is_turned { TURNED } else { UNLIKE };
            let refusal = Refusal::Unlike { label: self.labels[worst].clone(), seen, cause };
            if self.cells.len() < 3 {
                return Err(refusal);
            }
            self.cells.remove(worst);
            self.labels.remove(worst);
            warnings.push(Warning::LeftOut { why: Box::new(refusal) });
        }
        Ok(warnings)
    }
}

/// Root mean square deviation from the other flat shots above which a shot is left out: paper is more even than that.
const APART: f64 = 0.03;

/// Deviation above which a shot is left out if, turned by 180°, it deviates by less than half.
const TURNED_APART: f64 = 0.008;

/// Deviation of a shot's light, in green or the only column, from the median of the others, as it is or turned by 180°.
fn apart(shots: &[Vec<Vec<f64>>], j: usize, turn: bool) -> f64 {
    let green = shots[j].len() / 2;
    let levelled = |cells: &[f64]| {
        let level = robust_mean(cells).0;
        cells.iter().map(|v| v - level).collect::<Vec<_>>()
    };
    let others: Vec<Vec<f64>> =
        shots.iter().enumerate().filter(|(i, _)| *i != j).map(|(_, s)| levelled(&s[green])).collect();
    let mut own = levelled(&shots[j][green]);
    if turn {
        own.reverse();
    }
    let off = |(k, v): (usize, &f64)| v - median(&mut others.iter().map(|o| o[k]).collect::<Vec<_>>());
    spread(&own.iter().enumerate().map(off).collect::<Vec<_>>())
}

impl Flat {
    pub(crate) fn even() -> Self {
        Self {
            size: [1.0, 1.0],
            coefficients: Vec::new(),
            slope_std_error: Vec::new(),
            pairs: Pairs::default(),
            warnings: vec![Warning::NoFlat { slope_percent: 100.0 * UNKNOWN_SLOPE }],
        }
    }

    /// Whether no shots of a flat were given.
    pub(crate) fn is_missing(&self) -> bool {
        self.coefficients.is_empty()
    }

    /// Light at a place of the frame, relative to its mean.
    pub fn at(&self, colour: Colour, x_px: f64, y_px: f64) -> f64 {
        let Some(coefficients) = self.coefficients.get(colour.index()) else { return 1.0 };
        let terms = terms(2.0 * x_px / self.size[0] - 1.0, 2.0 * y_px / self.size[1] - 1.0);
        libm::exp(coefficients.iter().zip(terms).map(|(c, t)| c * t).sum())
    }

    /// Standard error of the relative slope of a column across the frame's whole width.
    pub fn slope_std_error(&self, c: usize) -> f64 {
        self.slope_std_error.get(c).copied().unwrap_or(UNKNOWN_SLOPE)
    }
}

const TERMS: usize = (ORDER + 1) * (ORDER + 2) / 2;

/// x^i y^j, i + j ≤ [`ORDER`], the constant first; minus their means over the square, so that exp of their sum is 1 on
/// average to first order.
fn terms(x: f64, y: f64) -> [f64; TERMS] {
    let mean = |n: usize| if n.is_multiple_of(2) { 1.0 / (n as f64 + 1.0) } else { 0.0 };
    let powers = |v: f64| [1.0, v, v * v, v * v * v, v * v * v * v];
    let (of_x, of_y) = (powers(x), powers(y));
    let mut terms = [1.0; TERMS];
    let mut k = 1;
    for order in 1..=ORDER {
        for j in 0..=order {
            terms[k] = of_x[order - j] * of_y[j] - mean(order - j) * mean(j);
            k += 1;
        }
    }
    terms
}

/// Centres of cells on the square.
fn places() -> impl Iterator<Item = (f64, f64)> {
    let centre = |i: usize, n: usize| (2.0 * i as f64 + 1.0) / n as f64 - 1.0;
    (0..ACROSS * DOWN).map(move |k| (centre(k % ACROSS, ACROSS), centre(k / ACROSS, DOWN)))
}

/// ln of the mean light of each cell.
fn grid(photo: &Photo, black: &Black, colour: Colour, full: Saturation) -> Result<Vec<f64>, Refusal> {
    let frame = &photo.frame;
    let cells: Vec<FlatCell> =
        (0..ACROSS * DOWN).into_par_iter().map(|k| FlatCell::new(frame, black, colour, full, k)).collect();
    let sum = |count: fn(&FlatCell) -> usize| cells.iter().map(count).sum::<usize>() as f64;
    let share = sum(|cell| cell.clipped) / sum(|cell| cell.samples);
    if share > CLIPPED {
        let place = "the sheet".to_owned();
        let level = full.of_colour(frame, colour);
        return Err(Refusal::Clipped {
            label: photo.label.clone(),
            colour,
            place,
            share: 100.0 * share,
            level,
        });
    }
    Ok(cells.iter().map(|cell| cell.log_light).collect())
}

/// Samples of one cell: their number, those that are clipped, and ln of the mean of the others.
struct FlatCell {
    samples: usize,
    clipped: usize,
    log_light: f64,
}

impl FlatCell {
    fn new(frame: &Frame, black: &Black, colour: Colour, full: Saturation, k: usize) -> Self {
        let range = |i: usize, n: usize, side: usize| i * side / n..(i + 1) * side / n;
        let (columns, rows) =
            (range(k % ACROSS, ACROSS, frame.width()), range(k / ACROSS, DOWN, frame.height()));
        // A few thousand samples give a cell's mean to 0.01 %.
        let skip = (columns.len() * rows.len() / 16_000).isqrt().max(1);
        let (mut sums, mut counts) = ([0.0; 2], [0; 2]);
        for site in frame.sites_of(colour) {
            for (x, y) in site.pixels(columns.clone(), rows.clone(), skip) {
                let is_clipped = usize::from(full.is_at(frame, site, x, y));
                sums[is_clipped] += black.signal(frame, site, x, y);
                counts[is_clipped] += 1;
            }
        }
        let used = usize::from(counts[0] == 0);
        let mean = sums[used] / f64::max(counts[used] as f64, 1.0);
        Self { samples: counts[0] + counts[1], clipped: counts[1], log_light: libm::log(mean.max(1e-3)) }
    }
}

/// Coefficients common to all shots, the first one 0.
fn fit(shots: &[&[f64]]) -> Option<Vec<f64>> {
    let levels: Vec<f64> = shots.iter().map(|s| robust_mean(s).0).collect();
    let cells: Vec<f64> = (0..ACROSS * DOWN)
        .map(|k| shots.iter().zip(&levels).map(|(s, l)| s[k] - l).sum::<f64>() / shots.len() as f64)
        .collect();
    let points: Vec<_> = places().map(|(x, y)| terms(x, y)).zip(cells).collect();
    let (found, _) = robust_fit(&points, 6)?;
    let mut coefficients = found.x.as_slice().to_vec();
    coefficients[0] = 0.0;
    Some(coefficients)
}

/// Standard error of the mean slope, from slopes of single shots.
fn slope_error(shots: &[&[f64]]) -> f64 {
    let slope = |shot: &&[f64]| -> f64 {
        let (mut sum, mut squares) = (0.0, 0.0);
        for ((x, _), v) in places().zip(shot.iter()) {
            sum += x * v;
            squares += x * x;
        }
        2.0 * sum / squares
    };
    scatter_of_mean(&shots.iter().map(slope).collect::<Vec<f64>>())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// All terms but the constant have a mean of zero over the frame.
    #[test]
    fn terms_have_zero_mean() {
        let n = 200;
        let at = |i: usize| (2.0 * i as f64 + 1.0) / n as f64 - 1.0;
        let mut sums = [0.0; TERMS];
        for k in 0..n * n {
            for (sum, t) in sums.iter_mut().zip(terms(at(k % n), at(k / n))) {
                *sum += t / (n * n) as f64;
            }
        }
        assert!(sums[1..].iter().all(|s| s.abs() < 1e-4), "{sums:?}");
    }

    /// Vignetting and a slope, in three shots of which one has a speck.
    #[test]
    fn smooth_light_is_found_despite_a_speck() {
        let light = |x: f64, y: f64| libm::log((1.0 + 0.03 * x - 0.02 * y) * (1.0 - 0.06 * (x * x + y * y)));
        let even: Vec<f64> = places().map(|(x, y)| light(x, y)).collect();
        let mut spoiled = even.clone();
        spoiled[100] -= 0.3;
        let found = fit(&[&even, &spoiled, &even]).unwrap();
        let model = |x: f64, y: f64| terms(x, y).iter().zip(&found).map(|(t, c)| t * c).sum::<f64>();
        let offset = model(0.0, 0.0) - light(0.0, 0.0);
        for (x, y) in places() {
            assert!((model(x, y) - light(x, y) - offset).abs() < 3e-4, "{x} {y}");
        }
    }
}
