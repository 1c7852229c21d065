//! Predicts profiles at any thickness near the dictionary's.
//!
//! A walk's decisions depend only on the sample's optical thickness τ = σ_t t. The walk hits the base at t·a + b, where a
//! is the part of the sample and b that of the clear layers; both depend on τ. So the profile over ξ = x/t is a function
//! of τ and of b/t: with given clear layers and at fixed τ it depends on 1/t alone, and smoothly. Between two thicknesses
//! of the dictionary, and a little beyond, it is interpolated linearly in 1/t. Records at one thickness alone are scaled,
//! x with t, as if the clear layers were scaled, too.

mod stretch;
#[cfg(test)]
mod tests;

use optics_model::scene::LayerMedium;
use optics_model::{Grid, Invalid};

use crate::dictionary::axes::list;
use crate::surrogate::{ALBEDO, Coordinates, G, Prediction, SIGMA_T, Surrogate, add_scaled};
use stretch::{Stretch, Tail};

/// Greatest distance from one of the dictionary's thicknesses at which profiles are predicted, as a share of it.
const REACH: f64 = 0.1;

/// Greatest distance at which records are only scaled, times the ratio of the clear layers' thickness to the sample's:
/// this product is the size of the neglected effect. 3.3 % at 0.5 mm in the paper's set-up, whose clear layers are 0.21 mm
/// thick.
const SCALED_REACH: f64 = 0.033 * 0.21 / 0.5;

/// Greatest ratio of two thicknesses between which profiles are interpolated.
const BETWEEN: f64 = 2.5;

/// Least and greatest ratio of two thicknesses from which profiles are extrapolated, and the best one: if they are
/// closer, the difference of their records is mostly noise; if they are further apart, it is not linear in 1/t.
const BEYOND: (f64, f64, f64) = (1.25, 4.0, 2.0);

/// Least range of ln τ over which two thicknesses must have records.
const OVERLAP: f64 = std::f64::consts::LN_2;

/// Thicknesses are the same if they differ by less than this share: decimals in files are rounded.
const SAME: f64 = 1e-6;

/// Length over which the slope of a profile decays beyond its ends, as a share of its width.
const LEVELS: f64 = 0.2;

/// Length over which the difference of two thicknesses vanishes beyond its ends, in units of the thicker.
const VANISHES: f64 = 4.0;

/// A contrast that is too small to be measured.
const INVISIBLE: f64 = 1e-6;

/// A profile at some thickness, its derivatives by the coordinates at that thickness, and by ln t at given coordinates.
#[derive(Debug, Clone)]
pub(crate) struct PredictionAt {
    pub values: Vec<f64>,
    pub slopes: [Vec<f64>; 3],
    pub by_ln_thickness: Vec<f64>,
}

/// Near one of the dictionary's thicknesses the contribution of the other to a prediction is small, and hardly depends on
/// the medium: it is taken from a medium near by, which saves half of the work.
#[derive(Debug, Clone)]
pub(crate) struct NearThickness {
    /// Index into the grid's thicknesses.
    base: usize,
    /// The thick slab's profile less the thin one's, stretched to the requested thickness; none if records are only
    /// scaled.
    difference: Option<NearDifference>,
}

#[derive(Debug, Clone)]
struct NearDifference {
    values: Vec<f64>,
    base_mm: f64,
    /// Derivative of the difference's weight by 1/t.
    per_inverse: f64,
}

/// Greatest weight of the difference for which it is taken from a medium near by.
const SMALL: f64 = 0.1;

/// The thicknesses from which a profile is predicted, as indices into the grid's thicknesses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ThicknessBasis {
    One(usize),
    Two { thin: usize, thick: usize },
}

impl Surrogate<'_> {
    /// Least and greatest ln σ_t that can be predicted at a thickness, or an error if it is too far from the
    /// dictionary's.
    pub(crate) fn supported(&self, thickness_mm: f64) -> Result<(f64, f64), Invalid> {
        let (grid, axis) = (self.grid(), self.grid().thickness_mm());
        if !predicts_thickness(grid, thickness_mm) {
            return Err(unsupported(axis, &ranges(grid), thickness_mm));
        }
        // Beyond the first and the last thickness the axis of σ_t moves with the optical thickness.
        let (low, high) = self.limits()[SIGMA_T];
        let thinner = (axis[0] / thickness_mm).max(1.0);
        let thicker = (axis[axis.len() - 1] / thickness_mm).min(1.0);
        Ok((low + libm::log(thinner), high + libm::log(thicker)))
    }

    /// The profile at any thickness, on the dictionary's pixels. It is continued beyond [`Surrogate::supported`], but is
    /// unreliable there.
    pub(crate) fn predict_at(&self, thickness_mm: f64, x: Coordinates) -> PredictionAt {
        match ThicknessBasis::of(self.grid(), thickness_mm) {
            ThicknessBasis::One(thickness) => self.scaled(thickness, thickness_mm, x),
            ThicknessBasis::Two { thin, thick } => self.interpolated(thin, thick, thickness_mm, x),
        }
    }

    /// Prepares predictions near this thickness and this medium; none if the thickness is not near one of the
    /// dictionary's.
    pub(crate) fn near(&self, thickness_mm: f64, x: Coordinates) -> Option<NearThickness> {
        let axis = self.grid().thickness_mm();
        let ThicknessBasis::Two { thin, thick } = ThicknessBasis::of(self.grid(), thickness_mm) else {
            let ThicknessBasis::One(base) = ThicknessBasis::of(self.grid(), thickness_mm) else {
                return None;
            };
            return Some(NearThickness { base, difference: None });
        };
        let (thin_mm, thick_mm) = (axis[thin], axis[thick]);
        let per_inverse = 1.0 / (1.0 / thick_mm - 1.0 / thin_mm);
        let weight = |base_mm: f64| (1.0 / thickness_mm - 1.0 / base_mm) * per_inverse;
        let base = if weight(thin_mm).abs() < weight(thick_mm).abs() { thin } else { thick };
        let optical = x[SIGMA_T] + libm::log(thickness_mm);
        let (low, high) = common(self.grid(), thin_mm, thick_mm);
        let lacks_base = if base == thin { optical > high } else { optical < low };
        if weight(axis[base]).abs() > SMALL || lacks_base {
            return None;
        }
        let nearest = optical.clamp(low, high);
        let (of_thin, of_thick) =
            (self.at_optical_thickness(thin, nearest, x), self.at_optical_thickness(thick, nearest, x));
        let mut difference = self.difference(&of_thin, &of_thick, thick_mm / thin_mm);
        if nearest != optical {
            let there = if base == thin { of_thin } else { of_thick };
            difference = with_contrast(difference, &there, &self.at_optical_thickness(base, optical, x));
        }
        let vanishes = Tail::Vanishes(VANISHES * thick_mm / self.grid().scene().sensor().pitch_mm());
        let stretch = Stretch::new(difference.values.len(), thickness_mm / thick_mm);
        let values = stretch.apply(&difference.values, vanishes);
        let difference = Some(NearDifference { values, base_mm: axis[base], per_inverse });
        Some(NearThickness { base, difference })
    }

    /// The profile at a thickness near that of `near`.
    pub(crate) fn predict_near(
        &self,
        near: &NearThickness,
        thickness_mm: f64,
        x: Coordinates,
    ) -> PredictionAt {
        let record = self.at_optical_thickness(near.base, x[SIGMA_T] + libm::log(thickness_mm), x);
        let mut sum = self.stretched(&record, near.base, thickness_mm, self.levels());
        if let Some(NearDifference { values, base_mm, per_inverse }) = &near.difference {
            let weight = (1.0 / thickness_mm - 1.0 / base_mm) * per_inverse;
            add_scaled(&mut sum.values, weight, values);
            add_scaled(&mut sum.by_ln_thickness, -per_inverse / thickness_mm, values);
        }
        sum
    }

    /// The profile predicted from records at one thickness, the clear layers being scaled with it.
    fn scaled(&self, thickness: usize, thickness_mm: f64, x: Coordinates) -> PredictionAt {
        let record = self.at_optical_thickness(thickness, x[SIGMA_T] + libm::log(thickness_mm), x);
        self.stretched(&record, thickness, thickness_mm, self.levels())
    }

    /// Thin + w·(thick − thin), with w linear in 1/t, at the same optical thickness.
    ///
    /// Where the dictionary lacks one of the two, their difference is taken at the nearest optical thickness at which it
    /// has both, scaled in proportion to the contrast of the other one, and added to or subtracted from it.
    fn interpolated(&self, thin: usize, thick: usize, thickness_mm: f64, x: Coordinates) -> PredictionAt {
        let axis = self.grid().thickness_mm();
        let (thin_mm, thick_mm) = (axis[thin], axis[thick]);
        let per_inverse = 1.0 / (1.0 / thick_mm - 1.0 / thin_mm);
        let weight = (1.0 / thickness_mm - 1.0 / thin_mm) * per_inverse;
        let weight_by_ln_thickness = -per_inverse / thickness_mm;

        let optical = x[SIGMA_T] + libm::log(thickness_mm);
        let (low, high) = common(self.grid(), thin_mm, thick_mm);
        let nearest = optical.clamp(low, high);
        let of_thin = self.at_optical_thickness(thin, nearest, x);
        let of_thick = self.at_optical_thickness(thick, nearest, x);
        let difference = self.difference(&of_thin, &of_thick, thick_mm / thin_mm);
        let (base, factor) = if optical > high { (thick, weight - 1.0) } else { (thin, weight) };
        let there = if base == thin { of_thin } else { of_thick };
        let (record, difference) = if nearest == optical {
            (there, difference)
        } else {
            let record = self.at_optical_thickness(base, optical, x);
            let difference = with_contrast(difference, &there, &record);
            (record, difference)
        };

        let vanishes = Tail::Vanishes(VANISHES * thick_mm / self.grid().scene().sensor().pitch_mm());
        let difference = self.stretched(&difference, thick, thickness_mm, vanishes);
        let mut sum = self.stretched(&record, base, thickness_mm, self.levels());
        add_scaled(&mut sum.by_ln_thickness, factor, &difference.by_ln_thickness);
        add_scaled(&mut sum.by_ln_thickness, weight_by_ln_thickness, &difference.values);
        add_scaled(&mut sum.values, factor, &difference.values);
        for (slope, by) in sum.slopes.iter_mut().zip(&difference.slopes) {
            add_scaled(slope, factor, by);
        }
        sum
    }

    /// The thick slab's profile less the thin one's, on the thick one's pixels.
    fn difference(&self, thin: &Prediction, thick: &Prediction, ratio: f64) -> Prediction {
        let stretch = Stretch::new(thin.values.len(), ratio);
        let difference = |thick: &[f64], thin: &[f64]| {
            let mut difference = thick.to_vec();
            add_scaled(&mut difference, -1.0, &stretch.apply(thin, self.levels()));
            difference
        };
        let slope = |c: usize| difference(&thick.slopes[c], &thin.slopes[c]);
        Prediction {
            values: difference(&thick.values, &thin.values),
            slopes: [slope(SIGMA_T), slope(ALBEDO), slope(G)],
        }
    }

    fn at_optical_thickness(&self, thickness: usize, ln_optical: f64, x: Coordinates) -> Prediction {
        let grid = self.grid();
        let ln_sigma_t = ln_optical - libm::log(grid.thickness_mm()[thickness]);
        self.predict(thickness, [ln_sigma_t, x[ALBEDO], x[G]])
    }

    fn stretched(
        &self,
        record: &Prediction,
        thickness: usize,
        thickness_mm: f64,
        tail: Tail,
    ) -> PredictionAt {
        let ratio = thickness_mm / self.grid().thickness_mm()[thickness];
        let stretch = Stretch::new(record.values.len(), ratio);
        let slopes = record.slopes.each_ref().map(|slope| stretch.apply(slope, tail));
        let (values, mut by_ln_thickness) = stretch.apply_with_slope(&record.values, tail);
        // At a given σ_t the optical thickness grows with the thickness.
        add_scaled(&mut by_ln_thickness, 1.0, &slopes[SIGMA_T]);
        PredictionAt { values, slopes, by_ln_thickness }
    }

    fn levels(&self) -> Tail {
        Tail::Levels(LEVELS * self.grid().scene().sensor().pixels() as f64)
    }
}

/// Converts a difference from the optical thickness of `there` to that of `record`. It is assumed to be proportional to
/// the contrast, which is the contribution of the base to a profile.
fn with_contrast(difference: Prediction, there: &Prediction, record: &Prediction) -> Prediction {
    let of_there = contrast(&there.values);
    if of_there < INVISIBLE {
        let mut constant = difference;
        constant.slopes[SIGMA_T].fill(0.0);
        return constant;
    }
    let ratio = contrast(&record.values) / of_there;
    let scaled = |v: &[f64], factor: f64| v.iter().map(|v| factor * v).collect::<Vec<f64>>();
    let slope = |c: usize| {
        // The optical thickness of the difference and of `there` stays when that of `record` changes.
        let fixed = if c == SIGMA_T { 0.0 } else { 1.0 };
        let by = (contrast(&record.slopes[c]) - fixed * ratio * contrast(&there.slopes[c])) / of_there;
        let mut slope = scaled(&difference.values, by);
        add_scaled(&mut slope, fixed * ratio, &difference.slopes[c]);
        slope
    };
    Prediction {
        values: scaled(&difference.values, ratio),
        slopes: [slope(SIGMA_T), slope(ALBEDO), slope(G)],
    }
}

/// Mean of the light end of a profile less that of the dark end, each over a fifteenth of the pixels.
fn contrast(profile: &[f64]) -> f64 {
    let count = (profile.len() / 15).max(1);
    let (dark, light) = (&profile[..count], &profile[profile.len() - count..]);
    (light.iter().sum::<f64>() - dark.iter().sum::<f64>()) / count as f64
}

/// The range of ln τ in which a grid has records at both thicknesses.
fn common(grid: &Grid, thin_mm: f64, thick_mm: f64) -> (f64, f64) {
    let sigma_t = grid.sigma_t_per_mm();
    // The ends of the axis are included in spite of rounding.
    (libm::log(sigma_t[0] * thick_mm) - SAME, libm::log(sigma_t[sigma_t.len() - 1] * thin_mm) + SAME)
}

impl ThicknessBasis {
    fn of(grid: &Grid, thickness_mm: f64) -> Self {
        let axis = grid.thickness_mm();
        let after = axis.partition_point(|t| *t < thickness_mm);
        if 0 < after && after < axis.len() && between(grid, after - 1) {
            return Self::Two { thin: after - 1, thick: after };
        }
        let distance = |t: f64| libm::log(thickness_mm / t).abs();
        let nearest = (0..axis.len()).min_by(|a, b| distance(axis[*a]).total_cmp(&distance(axis[*b])));
        Self::beyond(grid, nearest.expect("a grid has a thickness"))
    }

    /// The basis near a thickness but not between neighbours: this thickness and another one for extrapolation, or this
    /// one alone.
    fn beyond(grid: &Grid, nearest: usize) -> Self {
        let axis = grid.thickness_mm();
        let ratio = |i: usize| (axis[i] / axis[nearest]).max(axis[nearest] / axis[i]);
        let (least, greatest, best) = BEYOND;
        let usable =
            |i: &usize| (least..=greatest * (1.0 + SAME)).contains(&ratio(*i)) && overlap(grid, nearest, *i);
        let off = |i: usize| libm::log(ratio(i) / best).abs();
        let partner = (0..axis.len()).filter(usable).min_by(|a, b| off(*a).total_cmp(&off(*b)));
        match partner {
            Some(partner) => Self::Two { thin: nearest.min(partner), thick: nearest.max(partner) },
            None => Self::One(nearest),
        }
    }
}

/// Whether profiles between a thickness and the next are interpolated.
fn between(grid: &Grid, thin: usize) -> bool {
    let axis = grid.thickness_mm();
    axis[thin + 1] <= BETWEEN * (1.0 + SAME) * axis[thin] && overlap(grid, thin, thin + 1)
}

/// Whether there are enough optical thicknesses at which the grid has records of both.
fn overlap(grid: &Grid, a: usize, b: usize) -> bool {
    let axis = grid.thickness_mm();
    let (low, high) = common(grid, axis[a.min(b)], axis[a.max(b)]);
    high - low > OVERLAP
}

/// Whether a dictionary of this grid predicts slabs of a thickness.
pub fn predicts_thickness(grid: &Grid, thickness_mm: f64) -> bool {
    let within =
        |(low, high): &(f64, f64)| (low * (1.0 - SAME)..=high * (1.0 + SAME)).contains(&thickness_mm);
    ranges(grid).iter().any(within)
}

/// The thicknesses that are predicted, as disjoint ranges.
fn ranges(grid: &Grid) -> Vec<(f64, f64)> {
    let axis = grid.thickness_mm();
    let mut ranges: Vec<(f64, f64)> = Vec::new();
    for (i, t) in axis.iter().enumerate() {
        let reach = reach(grid, i);
        let (low, high) = (t * (1.0 - reach), t * (1.0 + reach));
        match ranges.last_mut() {
            Some(last) if low <= last.1 || between(grid, i - 1) => last.1 = high,
            _ => ranges.push((low, high)),
        }
    }
    ranges
}

/// Greatest distance from one of the grid's thicknesses at which profiles are predicted, as a share of it.
fn reach(grid: &Grid, thickness: usize) -> f64 {
    let layers = grid.scene().layers().iter();
    let clear_mm: f64 = layers
        .map(|layer| match layer.medium() {
            LayerMedium::Clear { thickness_mm, .. } => thickness_mm,
            LayerMedium::Sample => 0.0,
        })
        .sum();
    match ThicknessBasis::beyond(grid, thickness) {
        ThicknessBasis::One(_) if clear_mm > 0.0 => {
            REACH.min(SCALED_REACH * grid.thickness_mm()[thickness] / clear_mm)
        }
        _ => REACH,
    }
}

fn unsupported(axis: &[f64], ranges: &[(f64, f64)], thickness_mm: f64) -> Invalid {
    let rounded = |v: f64| (v * 1e4).round() / 1e4;
    let ranges: Vec<String> =
        ranges.iter().map(|(low, high)| format!("{} to {}", rounded(*low), rounded(*high))).collect();
    let mut wanted = [axis, &[thickness_mm]].concat();
    wanted.sort_by(f64::total_cmp);
    let allowed = format!(
        "the dictionary has {} and predicts {} mm; `farmctl submit GRID.toml` computes one with all of them if the \
         grid file says thickness_mm = [{}], and takes over what is there",
        list(axis),
        ranges.join(", "),
        list(&wanted)
    );
    Invalid::new("thickness_mm", thickness_mm, allowed)
}
