//! Computes the Cramér–Rao bound of a planned measurement: that of `bound`, at a guess of the medium and with the model's
//! values in place of measured ones.

use nalgebra::DMatrix;
use optics_model::fit::{FitSettings, HalfWidths, PixelRow};
use optics_model::scene::{Prior, Scope};

use crate::likelihood::interval::bound::{bound, ideal_covariance};
use crate::likelihood::point::{Line, SHARED, SLAB_FLAWS};
use crate::likelihood::system::quantity::Quantity;
use crate::likelihood::system::unknowns::{ANYWHERE, OF_MEAN, Unknowns, thickness_prior};
use crate::likelihood::system::{State, System};
use crate::likelihood::term::blur;
use crate::likelihood::term::{Exposed, Term};
use crate::surrogate::{Coordinates, SIGMA_T, Surrogate};

/// Standard deviation of the prior of a medium's coordinates, and of the logarithm of an unknown μ: so large that it has
/// no effect on determined quantities, and that undetermined ones have no effect on the others.
const UNKNOWN: f64 = 10.0;
/// Standard deviation of a coordinate from which on it counts as undetermined: a factor of e on σ_t, the whole range of
/// √(1 − α).
const UNDETERMINED: f64 = 1.0;

/// Standard errors of all but the medium.
#[derive(Debug, Clone)]
pub(crate) struct KnownErrors {
    /// Noise of a pixel relative to its value, and a constant that is added to it in quadrature.
    pub noise: f64,
    pub noise_floor: f64,
    pub set_up: FitSettings,
    /// Whether the common factor is unknown, whatever its standard error.
    pub mu_free: bool,
    /// Standard errors of the scene's uncertain quantities, in units of their priors'.
    pub scene: Line,
}

/// The precision of a planned measurement.
#[derive(Debug)]
pub(crate) struct Precision {
    pub medium: HalfWidths,
    /// Standard errors of the scene's uncertain quantities, in units of their priors'; of the first slab for quantities
    /// that each slab has separately.
    pub scene: Line,
}

/// A medium, and the pixels that record slabs of it.
#[derive(Debug)]
pub(crate) struct DesignPlan<'a> {
    pub surrogate: &'a Surrogate<'a>,
    pub medium: Coordinates,
    /// Whether each coordinate is held.
    pub held: [bool; 3],
    pub pixels: PixelRow,
}

impl DesignPlan<'_> {
    /// Half-widths of the medium's intervals from slabs of these thicknesses.
    pub(crate) fn half_widths(&self, slabs_mm: &[f64], known: &KnownErrors) -> HalfWidths {
        self.precision(slabs_mm, known).map_or(HalfWidths::UNKNOWN, |precision| precision.medium)
    }

    /// None if the pixels do not determine the medium.
    pub(crate) fn precision(&self, slabs_mm: &[f64], known: &KnownErrors) -> Option<Precision> {
        let (system, state) = self.system(slabs_mm, known);
        let covariance = ideal_covariance(&system, &state).filter(|c| c.iter().all(|v| v.is_finite()))?;
        let of_scene = system.slots[0][SHARED..].iter();
        let scene = of_scene.map(|slot| covariance[(*slot, *slot)].max(0.0).sqrt()).collect();
        Some(Precision { medium: self.medium_widths(&system, &state, &covariance), scene })
    }

    fn medium_widths(&self, system: &System, state: &State, covariance: &DMatrix<f64>) -> HalfWidths {
        let slots = &system.slots[0];
        let bound = bound(covariance, state, slots);
        let ends = [
            bound.sigma_t_per_mm,
            bound.albedo,
            bound.g,
            bound.reduced_scattering_per_mm,
            bound.absorption_per_mm,
        ];
        // √σ_a is √(1 − α), which is at most 1, times √σ_t.
        let units = [1.0, 1.0, 1.0, 1.0, libm::exp(0.5 * self.medium[SIGMA_T])];
        let mut widths =
            Quantity::all(slots).into_iter().zip(units).zip(ends).map(|((quantity, unit), ends)| {
                let gradient = quantity.gradient(&state.x);
                let deviation = gradient.dot(&(covariance * &gradient)).max(0.0).sqrt();
                if deviation < UNDETERMINED * unit { 0.5 * (ends.high - ends.low) } else { f64::INFINITY }
            });
        let mut next = || widths.next().unwrap_or(f64::INFINITY);
        HalfWidths {
            sigma_t_per_mm: next(),
            albedo: next(),
            g: next(),
            reduced_scattering_per_mm: next(),
            absorption_per_mm: next(),
        }
    }

    /// The system of these slabs. Every slab is a separate profile, also if another one is as thick.
    fn system(&self, slabs_mm: &[f64], known: &KnownErrors) -> (System<'_>, State) {
        let mut unknowns = Unknowns::default();
        let [s, a, g] = [0, 1, 2]
            .map(|i| unknowns.add(Some((self.medium[i], UNKNOWN)), ANYWHERE, self.held[i], self.medium[i]));
        let set_up = &known.set_up;
        let scale = if known.mu_free { UNKNOWN } else { set_up.ln_mu_std_error() };
        let scale = unknowns.known((0.0, scale), ANYWHERE);
        // Slabs share nothing with other channels.
        let flaws = unknowns.known((0.0, 0.0), ANYWHERE);
        let blur = unknowns.known(blur::prior(set_up), ANYWHERE);
        let grid = self.surrogate.grid();
        let priors = if grid.responses().is_some() { grid.scene().priors() } else { &[] };
        // All slabs are of one material.
        let shared: Vec<usize> = priors
            .iter()
            .zip(&known.scene)
            .map(|(prior, sd)| {
                let of_slab = if prior.scope() == Scope::Slab { OF_MEAN } else { 1.0 };
                unknowns.known((0.0, of_slab * sd), ANYWHERE)
            })
            .collect();
        let profile = |slab: &f64| {
            let thickness = unknowns.known(thickness_prior(*slab, set_up), ANYWHERE);
            let own = |((slot, prior), sd): ((&usize, &Prior), &f64)| match prior.scope() {
                Scope::Slab => unknowns.about(*slot, OF_MEAN * sd, ANYWHERE),
                _ => *slot,
            };
            let scene = shared.iter().zip(priors).zip(&known.scene).map(own).collect();
            let slots =
                [vec![s, a, g, scale], vec![flaws; SLAB_FLAWS.len()], vec![blur, thickness], scene].concat();
            (self.term(*slab, set_up), self.surrogate, slots)
        };
        let profiles = slabs_mm.iter().map(profile).collect();
        let (mut system, state) = System::new(profiles, unknowns, Vec::new());
        let models = system.linear(&state.x, &state.own).into_iter().map(|linear| linear.model);
        for (term, model) in system.terms.iter_mut().zip(models.collect::<Vec<_>>()) {
            let noise = |v: &f64| libm::hypot(known.noise * v, known.noise_floor).max(f64::MIN_POSITIVE);
            term.std_errors = model.iter().map(noise).collect();
            term.values = model;
        }
        (system, state)
    }

    /// A profile whose values and noise are set later.
    fn term(&self, thickness_mm: f64, set_up: &FitSettings) -> Term {
        let x_mm = self.pixels.x_mm();
        let exposed = Exposed {
            thickness_mm,
            pitch_mm: self.pixels.pitch_mm(),
            values: vec![0.0; x_mm.len()],
            std_errors: vec![1.0; x_mm.len()],
            x_mm,
            origin_mm: 0.0,
        };
        Term::new(exposed, set_up, self.surrogate, self.medium, 0.0)
    }
}
