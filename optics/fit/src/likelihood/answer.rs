//! Computes the answer of a channel at its minimum.

pub(crate) mod budget;
pub(crate) mod nuisances;
pub(crate) mod suspicion;

use nalgebra::DMatrix;
use optics_model::fit::{
    Candidate, ChannelFit, Curve, FitCurves, Interval, Likelihood, Outside, Refined, ThicknessError,
};
use optics_model::{Grid, Medium};

use crate::dictionary::axes::held;
use crate::dictionary::sum::{dot, rms};
use crate::dictionary::view::Slope;
use crate::likelihood::answer::nuisances::second_lobe;
use crate::likelihood::interval::bound::{bound, ideal_covariance};
use crate::likelihood::interval::chi2::exceedance;
use crate::likelihood::interval::profile_likelihood::{IntervalEnd, ProfileLikelihood, interval};
use crate::likelihood::interval::residuals::{clustering, outliers, stretches};
use crate::likelihood::point::{LN_ONE_MINUS_G, LN_SIGMA_T, Line, ROOT_CO_ALBEDO};
use crate::likelihood::problem::ChannelData;
use crate::likelihood::system::quantity::Quantity;
use crate::likelihood::system::unknowns::inverse_over_free;
use crate::likelihood::system::{Normal, State, System};
use crate::likelihood::term::{Linear, Term};
use crate::surrogate::{albedo, g, sigma_t};

/// Probability of χ² below which residuals count as more than noise.
const UNLIKELY: f64 = 0.001;

/// A channel is resolved if its intervals of σ_t and of the albedo span at most this factor …
const RESOLVED_FACTOR: f64 = 2.0;
/// … and that of the albedo at most this.
const RESOLVED_ALBEDO: f64 = 0.2;
/// Magnitude of the correlation of ln σ_t with ln(1 − g) above which a valley is reported.
const VALLEY: f64 = 0.9;

/// A channel at its minimum.
pub(crate) struct Found<'a, 'b> {
    pub data: &'b ChannelData<'a>,
    pub system: &'b System<'a>,
    pub state: &'b State,
    pub sample_ior: f64,
    /// The interval of an anisotropy that was chosen for all channels together.
    pub common_g: Option<Interval>,
}

/// The goodness of fit.
pub(crate) struct Goodness {
    pub chi2: f64,
    pub degrees_of_freedom: f64,
    pub probability: f64,
    /// Factor on the rise of the cost that intervals allow.
    inflation: f64,
}

impl Goodness {
    /// Root mean square of the residuals over their noise.
    pub(crate) fn misfit(&self) -> f64 {
        (self.chi2 / self.degrees_of_freedom.max(1.0)).sqrt()
    }
}

impl Found<'_, '_> {
    pub(crate) fn slots(&self) -> &[usize] {
        &self.system.slots[0]
    }

    fn grid(&self) -> &Grid {
        self.data.dictionary.grid()
    }

    pub(crate) fn x(&self, unknown: usize) -> f64 {
        self.state.x[self.slots()[unknown]]
    }

    /// A parameter from its coordinate: a held one as it was given, others clamped to the dictionary against rounding.
    fn parameter(&self, index: usize, x: f64) -> f64 {
        let grid = self.grid();
        let axis = [grid.sigma_t_per_mm(), grid.albedo(), grid.g()][index];
        let held = held(grid, &self.data.options)[index];
        held.unwrap_or_else(|| [sigma_t, albedo, g][index](x).clamp(axis[0], axis[axis.len() - 1]))
    }

    pub(crate) fn medium(&self, state: &State) -> Medium {
        let at = |i: usize| self.parameter(i, state.x[self.slots()[i]]);
        Medium::new(at(LN_SIGMA_T), at(ROOT_CO_ALBEDO), at(LN_ONE_MINUS_G)).expect("within the dictionary")
    }

    pub(crate) fn refined(&self) -> Refined {
        let linear = self.system.linear(&self.state.x, &self.state.own);
        let normal = self.system.normal(&self.state.x, &self.state.own, &linear);
        let nothing = || DMatrix::from_element(self.state.x.len(), self.state.x.len(), 0.0);
        let covariance = self.system.covariance(&normal.information);
        let goodness = self.goodness(&linear);
        let ideal = ideal_covariance(self.system, self.state);
        let intervals = self.intervals(&normal, covariance.as_ref(), goodness.inflation);
        let budget = self.budget(&linear, &normal, covariance.as_ref());
        // Quantities that the data do not determine have a very large variance; those of the set-up are limited by their
        // priors.
        let covariance =
            covariance.or_else(|| inverse_over_free(&self.system.unknowns, &normal.information, 1e-9));
        let covariance = covariance.unwrap_or_else(nothing);
        let step = &covariance * &normal.downhill;
        let covariance = covariance * goodness.inflation;
        let slots = self.slots();
        let entry = |i: usize, k: usize| covariance[(slots[i], slots[k])];
        let both = (entry(LN_SIGMA_T, LN_SIGMA_T) * entry(LN_ONE_MINUS_G, LN_ONE_MINUS_G)).max(0.0).sqrt();
        let correlation = if both > 0.0 { entry(LN_SIGMA_T, LN_ONE_MINUS_G) / both } else { 0.0 };
        let free_g = !self.system.unknowns[slots[LN_ONE_MINUS_G]].held;
        let [sigma_t, albedo, g, reduced, absorption] = intervals;
        let is_minimum = self.state.end.is_minimum();
        let resolved = is_minimum && is_resolved(&sigma_t, &albedo);
        let resolved_at_g = resolved || (is_minimum && free_g && self.resolved_at_g(goodness.inflation));
        let errors = self.errors(&linear);
        let misfit = goodness.misfit();
        let nuisances = self.nuisances(&covariance, &normal.reduced);
        let std_errors = self.system.terms.iter().flat_map(|t| &t.std_errors);
        let std_errors: Line = std_errors.copied().collect();
        Refined {
            best: Candidate {
                medium: self.medium(self.state),
                sample_ior: self.sample_ior,
                error: misfit,
                thicknesses: errors,
            },
            sigma_t_per_mm: sigma_t,
            albedo,
            g,
            reduced_scattering_per_mm: reduced,
            absorption_per_mm: absorption,
            covariance: [0, 1, 2].map(|i| [0, 1, 2].map(|k| entry(i, k))),
            correlation,
            valley: free_g && correlation.abs() > VALLEY,
            resolved,
            resolved_at_g,
            measurement_noise: rms(&std_errors),
            dictionary_share: self.dictionary_share(&covariance),
            misfit,
            suspicion: self.suspicion(&goodness, &nuisances),
            from_mixtures: false,
            descent: self.state.end,
            second_lobe: second_lobe(self.grid().scene(), self.system, self.state, 0),
            likelihood: Likelihood {
                chi2: goodness.chi2,
                degrees_of_freedom: goodness.degrees_of_freedom,
                probability: goodness.probability,
                nuisances,
                outliers: outliers(self.system, &linear),
                stretches: stretches(self.system, &linear),
                scene: self.scene_estimates(&covariance, &step),
                bound: bound(&ideal.unwrap_or_else(|| covariance.clone()), self.state, slots),
                budget,
            },
        }
    }

    /// χ² of the pixels that are not left out, with the deviations of nuisances from their priors.
    pub(crate) fn goodness(&self, linear: &[Linear]) -> Goodness {
        let (mut chi2, mut pixels) = (0.0, 0.0);
        for ((term, linear), own) in self.system.terms.iter().zip(linear).zip(&self.state.own) {
            let kept = linear.residuals.iter().zip(&term.left_out).filter(|(_, out)| !**out);
            for (r, _) in kept {
                chi2 += r * r;
                pixels += 1.0;
            }
            chi2 += dot(own, own);
        }
        let mut parameters = 0.0;
        for slot in self.system.free() {
            match self.system.cost_of_prior(slot, &self.state.x) {
                Some(cost) => chi2 += cost,
                None => parameters += 1.0,
            }
        }
        let degrees_of_freedom: f64 = pixels - parameters;
        let probability = exceedance(chi2, degrees_of_freedom);
        let inflation = if probability < UNLIKELY {
            (chi2 / degrees_of_freedom.max(1.0)) * clustering(self.system, linear)
        } else {
            1.0
        };
        Goodness { chi2, degrees_of_freedom, probability, inflation }
    }

    /// Intervals of σ_t, α, g, σ_s(1 − g) and σ_a.
    fn intervals(&self, normal: &Normal, covariance: Option<&DMatrix<f64>>, inflation: f64) -> [Interval; 5] {
        let slots = self.slots();
        let limits = [0, 1, 2].map(|i| self.system.unknowns[slots[i]].limits);
        let corner = |s: f64, a: f64, g: f64| libm::log((1.0 - a * a).max(1e-12)) + s + g;
        let root = |s: f64, a: f64| a * libm::exp(0.5 * s);
        let [s, a, g] = limits;
        let reduced = (corner(s.0, a.1, g.0), corner(s.1, a.0, g.1));
        let absorption = (root(s.0, a.0), root(s.1, a.1));
        let all_limits = [s, a, g, reduced, absorption];
        let quantities = Quantity::all(slots);
        std::array::from_fn(|index| {
            if let Some(common) = self.common_g.filter(|_| index == LN_ONE_MINUS_G) {
                return common;
            }
            let quantity = quantities[index];
            let ends = if let Some(covariance) = covariance {
                let (system, optimum) = (self.system, self.state);
                ProfileLikelihood { system, optimum, normal, covariance, inflation }
                    .ends(quantity, all_limits[index])
            } else {
                // The information is singular: the quantity is undetermined.
                let (low, high) = all_limits[index];
                [low, high].map(|value| IntervalEnd { value, open: true })
            };
            match index {
                0..3 => interval(ends, |x| self.parameter(index, x), index != LN_SIGMA_T),
                3 => interval(ends, libm::exp, false),
                _ => {
                    let found = interval(ends, |x| x.max(0.0).powi(2), false);
                    // 0 is an end of the quantity; any other limit is one of the dictionary.
                    Interval { open_low: found.open_low && found.low > 0.0, ..found }
                }
            }
        })
    }

    /// Whether σ_t and the albedo are determined with the anisotropy held at its estimate.
    fn resolved_at_g(&self, inflation: f64) -> bool {
        let slots = self.slots();
        let mut system = self.system.clone();
        system.unknowns[slots[LN_ONE_MINUS_G]].held = true;
        let linear = system.linear(&self.state.x, &self.state.own);
        let normal = system.normal(&self.state.x, &self.state.own, &linear);
        let Some(covariance) = system.covariance(&normal.information) else { return false };
        let profile = ProfileLikelihood {
            system: &system,
            optimum: self.state,
            normal: &normal,
            covariance: &covariance,
            inflation,
        };
        let interval_at_g = |i: usize| {
            let ends = profile.ends(Quantity::Unknown(slots[i]), system.unknowns[slots[i]].limits);
            interval(ends, |x| self.parameter(i, x), i != LN_SIGMA_T)
        };
        is_resolved(&interval_at_g(LN_SIGMA_T), &interval_at_g(ROOT_CO_ALBEDO))
    }

    /// Share of the records' noise in the variance of ln σ_t.
    fn dictionary_share(&self, covariance: &DMatrix<f64>) -> f64 {
        let slot = self.slots()[LN_SIGMA_T];
        let mut without = self.system.ideal();
        for (term, own) in without.terms.iter_mut().zip(&self.system.terms) {
            term.robust = own.robust;
        }
        let own: Vec<Line> =
            without.terms.iter().zip(&self.state.own).map(|(t, own)| own[..t.own_count()].to_vec()).collect();
        let linear = without.linear(&self.state.x, &own);
        let information = without.normal(&self.state.x, &own, &linear).information;
        let (Some(least), whole) = (without.covariance(&information), covariance[(slot, slot)]) else {
            return 0.0;
        };
        if whole > 0.0 { (1.0 - least[(slot, slot)] / whole).clamp(0.0, 1.0) } else { 0.0 }
    }

    /// The two norms of Eq. 2 for every profile.
    fn errors(&self, linear: &[Linear]) -> Vec<ThicknessError> {
        let settings = self.data.options.settings();
        let term = |(i, (term, linear)): (usize, (&Term, &Linear))| {
            let pitch_mm = self.data.profiles[i].profile.pitch_mm();
            let slope = Slope { wavelet: settings.wavelet, level: settings.level, pitch_mm };
            let rest: Line = term.values.iter().zip(&linear.model).map(|(v, m)| v - m).collect();
            let gradients = slope.magnitude(&term.values).into_iter().zip(slope.magnitude(&linear.model));
            let gradient: Line = gradients.map(|(a, b)| a - b).collect();
            ThicknessError {
                thickness_mm: term.thickness_mm,
                value_rms: rms(&rest),
                gradient_rms: rms(&gradient),
                record: None,
            }
        };
        self.system.terms.iter().zip(linear).enumerate().map(term).collect()
    }

    /// Media of the dictionary, each with the other unknowns at their most likely values, best first.
    fn candidates(&self, media: &[[usize; 4]]) -> Vec<(Candidate, State)> {
        let grid = self.grid();
        let slots = self.slots();
        let candidate = |[ior, s, g, a]: &[usize; 4]| {
            let (sigma_t, albedo, anisotropy) = (grid.sigma_t_per_mm()[*s], grid.albedo()[*a], grid.g()[*g]);
            let places = [
                (slots[LN_SIGMA_T], libm::log(sigma_t)),
                (slots[ROOT_CO_ALBEDO], (1.0 - albedo).sqrt()),
                (slots[LN_ONE_MINUS_G], libm::log(1.0 - anisotropy)),
            ];
            let state = self.system.held_at(self.state, &places);
            let linear = self.system.linear(&state.x, &state.own);
            let cost: f64 = linear.iter().map(|l| l.cost).sum();
            let mut thicknesses = self.errors(&linear);
            for error in &mut thicknesses {
                let same = |t: &f64| (t / error.thickness_mm - 1.0).abs() < 1e-6;
                let thickness = grid.thickness_mm().iter().position(same);
                error.record = thickness.map(|t| grid.record_at(*ior, *s, *g, t, *a));
            }
            let pixels: usize = self.system.terms.iter().map(|t| t.values.len()).sum();
            let candidate = Candidate {
                medium: Medium::new(sigma_t, albedo, anisotropy).expect("axes hold checked values"),
                sample_ior: grid.sample_ior()[*ior],
                error: (cost / pixels as f64).sqrt(),
                thicknesses,
            };
            (candidate, state)
        };
        let mut all: Vec<(Candidate, State)> = media.iter().map(candidate).collect();
        all.sort_by(|a, b| a.0.error.total_cmp(&b.0.error));
        all
    }

    pub(crate) fn fit(
        &self,
        refined: Option<Refined>,
        nearest: &[[usize; 4]],
        outside: Option<Outside>,
    ) -> ChannelFit {
        let candidates = self.candidates(nearest);
        let curves = if self.data.options.settings().curves {
            self.curves(&candidates, refined.is_some())
        } else {
            Vec::new()
        };
        ChannelFit {
            channel: self.data.name.to_owned(),
            candidates: candidates.into_iter().map(|(c, _)| c).collect(),
            refined,
            outside,
            curves,
        }
    }

    fn curves(&self, candidates: &[(Candidate, State)], refined: bool) -> Vec<FitCurves> {
        let settings = self.data.options.settings();
        let models = |state: &State| self.system.linear(&state.x, &state.own);
        let best = models(self.state);
        let others: Vec<Vec<Linear>> = candidates.iter().map(|(_, state)| models(state)).collect();
        let curves = |(i, term): (usize, &Term)| {
            let pitch_mm = self.data.profiles[i].profile.pitch_mm();
            let slope = Slope { wavelet: settings.wavelet, level: settings.level, pitch_mm };
            let curve = |values: &Line| Curve { gradient: slope.shown(values), values: values.clone() };
            FitCurves {
                thickness_mm: term.thickness_mm,
                x_mm: term.x_mm.clone(),
                measured: curve(&term.values),
                candidates: others.iter().map(|linear| curve(&linear[i].model)).collect(),
                refined: refined.then(|| curve(&best[i].model)),
                residuals: if refined { best[i].residuals.clone() } else { Vec::new() },
                left_out: (0..)
                    .zip(&term.left_out)
                    .filter(|(_, out)| **out)
                    .map(|(pixel, _)| pixel)
                    .collect(),
            }
        };
        self.system.terms.iter().enumerate().map(curves).collect()
    }
}

/// Whether σ_t and the albedo are determined.
pub(crate) fn is_resolved(sigma_t: &Interval, albedo: &Interval) -> bool {
    let bounded = |i: &Interval| !i.open_low && i.high <= RESOLVED_FACTOR * i.low;
    bounded(sigma_t) && !sigma_t.open_high && bounded(albedo) && albedo.high - albedo.low <= RESOLVED_ALBEDO
}
