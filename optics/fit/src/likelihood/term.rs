//! Evaluates one measured profile: residuals and derivatives, with the errors of this profile alone eliminated.
//!
//! The model of a pixel's value, times the question's μ, is
//!
//! y = F(x − x₀) · (e^(−m) + γ + (s + w L) x/10 mm) + z + Σ_k c_k φ_k,
//!
//! F is the simulated profile at this slab's thickness, blurred by the camera; m is the logarithm of a factor on μ, x₀ the
//! position of the edge; γ, z and s are gain, zero and slope of the profile, w the slope of its slab's thickness, L the
//! derivative of ln F by the logarithm of the thickness, and φ_k modes of the noise of the dictionary's records. Where the
//! base's ρ was measured with the same white reference, whose error is μ, F includes (m + ln μ) D, where D is the response
//! of F through ρ to a brighter reference. x₀, c_k and parts of γ, z, s and w belong to this profile, the other parts to
//! all channels of its slab. Those of the profile have normal priors and are counted here in units of the priors' standard
//! deviations, so that each adds its square to −2 ln L. Eliminating them (a Schur complement) leaves a gradient and an
//! information matrix of the unknowns that the profile shares with others.

pub(crate) mod blend;
pub(crate) mod blur;
pub(crate) mod camera;
pub(crate) mod records_noise;
pub(crate) mod reduced;
pub(crate) mod robust;
pub(crate) mod scatter;
pub(crate) mod white;

use nalgebra::{DMatrix, DVector};
use optics_model::fit::FitSettings;

use crate::dictionary::sum::{dot, dots};
use crate::dictionary::wide::wide;
use crate::likelihood::point::{Line, Point, SHARED, SLAB_FLAWS};
use crate::surrogate::responses::LocalResponses;
use crate::surrogate::thickness::NearThickness;
use crate::surrogate::{Coordinates, SIGMA_T, Surrogate, add_scaled};
use blend::Blend;
use camera::Camera;
use reduced::{Quadratic, Reduced};
use robust::{rho, weight};
use white::White;

/// Least value of which the change with thickness is a share.
const DARKEST: f64 = 1e-3;

/// A kind of a profile's own unknowns, apart from modes of the dictionary's noise.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Own {
    Origin,
    Gain,
    Zero,
    Slope,
    /// Slope of the thickness.
    Wedge,
}

/// The kinds of which all channels of a slab share a part, in the order of [`SLAB_FLAWS`].
pub(crate) const OF_SLABS: [Own; 4] = [Own::Gain, Own::Zero, Own::Slope, Own::Wedge];

impl Own {
    /// Index of the slab's part among the shared unknowns.
    pub(crate) fn of_slab(self) -> Option<usize> {
        OF_SLABS.iter().position(|own| *own == self).map(|i| SLAB_FLAWS[i])
    }
}

/// The prior of one of a profile's own unknowns.
#[derive(Debug, Clone, Copy)]
pub(crate) struct OwnPrior {
    pub own: Own,
    pub std_error: f64,
    /// Standard deviation of the part that all channels of the slab have; 0 if there is one channel.
    pub slab_std_error: f64,
}

#[derive(Debug, Clone)]
pub(crate) struct Term {
    /// The inks that determine the medium; none if the medium itself is unknown.
    pub blend: Option<Blend>,
    /// Nominal.
    pub thickness_mm: f64,
    pub camera: Camera,
    pub x_mm: Line,
    /// Measured values times the question's μ, and their standard errors.
    pub values: Line,
    pub std_errors: Line,
    /// Stated position of the edge.
    pub origin_mm: f64,
    pub priors: Vec<OwnPrior>,
    /// Modes of the records' noise on the measured pixels, each of variance 1.
    pub modes: Vec<Line>,
    /// Variance of the records' noise that the modes leave, by pixel.
    pub rest_variances: Line,
    /// Number of profiles with the same noise of the records, this one included: its variance is multiplied by that
    /// number, since it does not average out over them.
    pub alike: f64,
    /// Pixels that are left out, such as dust.
    pub left_out: Vec<bool>,
    /// Whether pixels may be outliers; if not, every pixel that is not left out has normal noise.
    pub robust: bool,
    /// Factor on the noise where pixels may be outliers: above 1 on the way from a poor model to a good one.
    pub softness: f64,
    /// For predictions near one of the dictionary's thicknesses, if the thickness is near one.
    pub near: Option<NearThickness>,
    pub white: Option<White>,
    /// L x/10 mm, by which a wedge of 1 per 10 mm multiplies the profile; 0 if the thickness has no slope.
    pub by_wedge: Line,
    /// The responses to the uncertain quantities of the scene; none if it is exact.
    pub responses: Option<LocalResponses>,
}

/// A profile at given values of the unknowns.
#[derive(Debug)]
pub(crate) struct Linear {
    /// Measured values less the model, over the noise.
    pub residuals: Line,
    /// The model.
    pub model: Line,
    /// Derivatives of the model over the noise: by the shared unknowns, then by the profile's own.
    pub columns: Vec<Line>,
    /// −2 ln L of this profile, with the priors of its own unknowns.
    pub cost: f64,
}

/// The pixels of a profile.
#[derive(Debug)]
pub(crate) struct Exposed {
    /// Nominal.
    pub thickness_mm: f64,
    pub pitch_mm: f64,
    pub x_mm: Line,
    /// Values times the question's μ, and their standard errors.
    pub values: Line,
    pub std_errors: Line,
    /// Stated position of the edge.
    pub origin_mm: f64,
}

/// Priors of a profile's own unknowns, without those that are exact.
fn own_priors(set_up: &FitSettings) -> Vec<OwnPrior> {
    let priors = [
        (Own::Origin, set_up.origin_std_error_mm),
        (Own::Gain, set_up.gain_std_error),
        (Own::Zero, set_up.offset_std_error * set_up.mu),
        (Own::Slope, set_up.slope_std_error),
        (Own::Wedge, set_up.wedge_std_error),
    ];
    let priors = priors.map(|(own, std_error)| OwnPrior { own, std_error, slab_std_error: 0.0 });
    priors.into_iter().filter(|p| p.std_error > 0.0).collect()
}

impl Term {
    /// A profile without noise of the records, all of whose pixels have normal noise. Responses are those at `medium`.
    /// Factors on μ are relative to the one with the logarithm `ln_mu`.
    pub(crate) fn new(
        profile: Exposed,
        set_up: &FitSettings,
        surrogate: &Surrogate,
        medium: Coordinates,
        ln_mu: f64,
    ) -> Self {
        let Exposed { thickness_mm, pitch_mm, x_mm, values, std_errors, origin_mm } = profile;
        let n = x_mm.len();
        let sensor = surrogate.grid().scene().sensor();
        let camera = Camera::new(&x_mm, pitch_mm, sensor.width_mm(), sensor.pixels());
        let mut term = Self {
            blend: None,
            thickness_mm,
            camera,
            left_out: vec![false; n],
            x_mm,
            values,
            std_errors,
            origin_mm,
            priors: own_priors(set_up),
            modes: Vec::new(),
            rest_variances: Vec::new(),
            alike: 1.0,
            robust: false,
            softness: 1.0,
            near: None,
            white: White::of(surrogate, thickness_mm, medium, ln_mu),
            by_wedge: vec![0.0; n],
            responses: surrogate.responses(thickness_mm, medium),
        };
        term.move_wedge(surrogate, thickness_mm, medium);
        term
    }

    /// Computes the effect of a wedge at a medium. Light that spreads sideways hardly leaves its thickness: each place has
    /// the local one.
    pub(crate) fn move_wedge(&mut self, surrogate: &Surrogate, thickness_mm: f64, medium: Coordinates) {
        if self.prior(Own::Wedge).is_some() {
            let predicted = surrogate.predict_at(thickness_mm, medium);
            let pairs = predicted.by_ln_thickness.iter().zip(&predicted.values);
            let shares = pairs.map(|(by, value)| by / value.max(DARKEST)).collect();
            let seen = self.camera.sharp(&[shares], self.origin_mm).remove(0);
            self.by_wedge = seen.iter().zip(&self.x_mm).map(|(share, x)| share * x / 10.0).collect();
        }
    }

    /// Divides the variances of gain, zero, slope and wedge between the profile and its slab: lamps, mounting and stray
    /// light change photographs of different colours together, but not wholly. `part` is the standard deviation of either
    /// over that of both.
    pub(crate) fn share_flaws(&mut self, part: f64) {
        for prior in self.priors.iter_mut().filter(|prior| prior.own.of_slab().is_some()) {
            prior.std_error *= part;
            prior.slab_std_error = prior.std_error;
        }
    }

    /// Counts the records' noise as that of `alike` profiles, and scales the coefficients of the modes so that the model
    /// is unchanged.
    pub(crate) fn count_alike(&mut self, own: &mut Line, alike: f64) {
        let factor = alike / self.alike;
        self.alike = alike;
        self.modes.iter_mut().flatten().for_each(|v| *v *= factor.sqrt());
        self.rest_variances.iter_mut().for_each(|v| *v *= factor);
        own[self.priors.len()..].iter_mut().for_each(|c| *c /= factor.sqrt());
    }

    /// Profiles f_k such that Σ f_k f_kᵀ is the covariance of the error of the scene's responses.
    pub(crate) fn model_errors(&self, shared: &Point, width_mm: f64) -> Vec<Line> {
        self.responses.as_ref().map_or(Vec::new(), |r| r.model_errors(shared.scene(), width_mm))
    }

    /// Unknowns that the profile may share with others.
    fn shared_count(&self) -> usize {
        SHARED + self.responses.as_ref().map_or(0, LocalResponses::count)
    }

    pub(crate) fn own_count(&self) -> usize {
        self.priors.len() + self.modes.len()
    }

    fn prior(&self, which: Own) -> Option<(usize, &OwnPrior)> {
        self.priors.iter().enumerate().find(|(_, prior)| prior.own == which)
    }

    pub(crate) fn origin_mm(&self, own: &[f64]) -> f64 {
        self.origin_mm + self.prior(Own::Origin).map_or(0.0, |(i, prior)| own[i] * prior.std_error)
    }

    /// Gain, zero, slope and wedge: the profile's own and the slab's.
    fn flaws(&self, shared: &Point, own: &[f64]) -> [f64; 4] {
        let slab = shared.slab_flaws();
        std::array::from_fn(|k| {
            let value =
                |(i, prior): (usize, &OwnPrior)| own[i] * prior.std_error + slab[k] * prior.slab_std_error;
            self.prior(OF_SLABS[k]).map_or(0.0, value)
        })
    }

    /// Standard error of a pixel: that of the measurement, and the records' noise that the modes leave.
    fn deviation(&self, pixel: usize) -> f64 {
        let own = self.std_errors[pixel];
        match self.rest_variances.get(pixel) {
            Some(rest) => (own * own + rest).sqrt(),
            None => own,
        }
    }

    /// The profile at the shared unknowns and its own.
    pub(crate) fn linear(&self, surrogate: &Surrogate, shared: &Point, own: &[f64]) -> Linear {
        let (thickness_mm, medium) = (shared.thickness_mm(), shared.medium());
        let mut predicted = match &self.near {
            Some(near) => surrogate.predict_near(near, thickness_mm, medium),
            None => surrogate.predict_at(thickness_mm, medium),
        };
        let change = self
            .responses
            .as_ref()
            .map(|r| r.change(&predicted.values, &predicted.slopes, thickness_mm, medium, shared.scene()));
        if let Some(change) = &change {
            add_scaled(&mut predicted.values, 1.0, &change.values);
            let slopes = predicted.slopes.iter_mut().zip(&change.slopes);
            slopes.for_each(|(slope, by)| add_scaled(slope, 1.0, by));
            add_scaled(&mut predicted.by_ln_thickness, 1.0, &change.slopes[SIGMA_T]);
        }
        let mut slopes = predicted.slopes.to_vec();
        slopes.push(predicted.by_ln_thickness);
        slopes.extend(change.into_iter().flat_map(|change| change.by_quantity));
        if let Some(white) = &self.white {
            let off = shared.ln_scale() + white.ln_mu;
            predicted.values.iter_mut().zip(&white.slope).for_each(|(v, by)| *v += off * by);
            slopes.push(white.slope.clone());
        }
        let blur_mm2 = blur::variance_mm2(shared.blur());
        let mut seen = self.camera.expose(&predicted.values, &slopes, self.origin_mm(own), blur_mm2);
        let by_white = self.white.as_ref().and_then(|_| seen.slopes.pop());
        let scale = shared.scale();
        let [gain, zero, slope, wedge] = self.flaws(shared, own);
        let n = self.values.len();
        let mut factors: Line = self.x_mm.iter().map(|x| scale + gain + slope * x / 10.0).collect();
        add_scaled(&mut factors, wedge, &self.by_wedge);
        let [by_sigma_t, by_albedo, by_g, by_thickness, by_scene @ ..] = &seen.slopes[..] else {
            unreachable!("four slopes at least")
        };
        let mut model: Line = (0..n).map(|i| seen.values[i] * factors[i] + zero).collect();
        let mode_values = &own[self.priors.len()..];
        for (mode, c) in self.modes.iter().zip(mode_values) {
            model.iter_mut().zip(mode).for_each(|(m, v)| *m += c * v);
        }
        let inverse: Line = (0..n).map(|i| 1.0 / self.deviation(i)).collect();
        let over_factors: Line = factors.iter().zip(&inverse).map(|(f, i)| f * i).collect();
        let times = |by: &[f64], with: &[f64]| -> Line { by.iter().zip(with).map(|(a, b)| a * b).collect() };
        let mut columns = Vec::with_capacity(self.shared_count() + self.own_count());
        for by in [by_sigma_t, by_albedo, by_g] {
            columns.push(times(by, &over_factors));
        }
        let values = times(&seen.values, &inverse);
        let mut by_scale: Line = values.iter().map(|v| -scale * v).collect();
        if let Some(by) = &by_white {
            add_scaled(&mut by_scale, 1.0, &times(by, &over_factors));
        }
        columns.push(by_scale);
        let by_own = |own: Own, sd: f64| -> Line {
            match own {
                Own::Origin => times(&seen.by_origin, &over_factors).iter().map(|v| sd * v).collect(),
                Own::Gain => values.iter().map(|v| sd * v).collect(),
                Own::Zero => inverse.iter().map(|v| sd * v).collect(),
                Own::Slope => values.iter().zip(&self.x_mm).map(|(v, x)| sd * v * x / 10.0).collect(),
                Own::Wedge => times(&values, &self.by_wedge).iter().map(|v| sd * v).collect(),
            }
        };
        columns
            .extend(OF_SLABS.map(|own| by_own(own, self.prior(own).map_or(0.0, |(_, p)| p.slab_std_error))));
        let by_blur = blur::slope(shared.blur());
        columns.push(times(&seen.by_blur, &over_factors).iter().map(|v| by_blur * v).collect());
        columns.push(times(by_thickness, &over_factors));
        columns.extend(by_scene.iter().map(|by| times(by, &over_factors)));
        columns.extend(self.priors.iter().map(|prior| by_own(prior.own, prior.std_error)));
        columns.extend(self.modes.iter().map(|mode| times(mode, &inverse)));
        let residuals: Line = (0..n).map(|i| (self.values[i] - model[i]) * inverse[i]).collect();
        let kept = residuals.iter().zip(&self.left_out).filter(|(_, out)| !**out);
        let squares = kept
            .map(|(r, _)| if self.robust { self.softness.powi(2) * rho(r / self.softness) } else { r * r });
        let cost = squares.sum::<f64>() + dot(own, own);
        Linear { residuals, model, columns, cost }
    }

    /// Weights of the pixels.
    pub(crate) fn weights(&self, linear: &Linear) -> Line {
        let weight = |(r, out): (&f64, &bool)| match (out, self.robust) {
            (true, _) => 0.0,
            (false, true) => weight(r / self.softness),
            (false, false) => 1.0,
        };
        linear.residuals.iter().zip(&self.left_out).map(weight).collect()
    }

    /// The profile's information on the shared unknowns, its own eliminated.
    pub(crate) fn reduce(&self, linear: &Linear, own: &[f64]) -> Reduced {
        let shared = self.shared_count();
        let weights = self.weights(linear);
        let n = linear.columns.len();
        let weighted: Vec<Line> =
            linear.columns.iter().map(|c| c.iter().zip(&weights).map(|(c, w)| c * w).collect()).collect();
        let mut all = DMatrix::zeros(n, n);
        wide(
            #[inline(always)]
            || {
                for i in 0..n {
                    let mut put = |j: usize, product: f64| {
                        all[(i, j)] = product;
                        all[(j, i)] = product;
                    };
                    let (fours, others) = linear.columns[..=i].as_chunks::<4>();
                    for (k, four) in fours.iter().enumerate() {
                        let products = dots(&weighted[i], four.each_ref().map(Vec::as_slice));
                        (4 * k..).zip(products).for_each(|(j, product)| put(j, product));
                    }
                    for (k, column) in others.iter().enumerate() {
                        put(4 * fours.len() + k, dot(&weighted[i], column));
                    }
                }
            },
        );
        let mut downhill = DVector::from_iterator(n, weighted.iter().map(|w| dot(w, &linear.residuals)));
        for (i, own) in own.iter().enumerate() {
            all[(shared + i, shared + i)] += 1.0;
            downhill[shared + i] -= own;
        }
        Reduced::new(Quadratic { downhill, information: all }, shared)
    }
}

#[cfg(test)]
mod tests;
