//! The Cramér–Rao bound of a planned measurement: that of `bound`, at a guess of the medium and with the model itself for
//! the values.

use nalgebra::DVector;
use optics_model::fit::{HalfWidths, PixelRow};
use optics_model::scene::Scope;

use super::bound::{bound, ideal_covariance};
use super::camera::Camera;
use super::quantity::Quantity;
use super::system::{State, System};
use super::term::{Exposed, OwnErrors, Term, White};
use super::unknowns::Unknown;
use super::{Line, blur};
use crate::surrogate::{Coordinates, SIGMA_T, Surrogate};

/// Standard deviation of the coordinates of a medium, and of the logarithm of μ, of which nothing is known beforehand: so
/// large that it does not matter for what is determined, and that what is not leaves the rest alone.
const UNKNOWN: f64 = 10.0;
/// Standard deviation of a coordinate from which on it counts as undetermined: a factor of e on σ_t, the whole range of
/// √(1 − α).
const UNDETERMINED: f64 = 1.0;

/// How well all but the medium is known: standard errors.
#[derive(Debug, Clone)]
pub(crate) struct KnownErrors {
    /// Noise of a pixel relative to its value, and what is added to it in quadrature.
    pub noise: f64,
    pub noise_floor: f64,
    pub thickness_mm: f64,
    pub origin_mm: f64,
    /// The blur is this large, and known to this accuracy.
    pub blur_mm: f64,
    pub blur_std_error_mm: f64,
    pub gain: f64,
    pub zero: f64,
    pub slope: f64,
    /// Standard error of the logarithm of the common factor; none if nothing is known of it.
    pub scale: Option<f64>,
    /// Standard errors of the scene's uncertain quantities, in units of their priors'.
    pub scene: Line,
}

/// A medium, and pixels that look at slabs of it.
#[derive(Debug)]
pub(crate) struct DesignPlan<'a> {
    pub surrogate: &'a Surrogate<'a>,
    pub medium: Coordinates,
    /// Coordinates that are known.
    pub held: [bool; 3],
    pub pixels: PixelRow,
}

impl DesignPlan<'_> {
    /// How well slabs of these thicknesses determine the medium.
    pub(crate) fn half_widths(&self, slabs_mm: &[f64], known: &KnownErrors) -> HalfWidths {
        let (system, state) = self.system(slabs_mm, known);
        let slots = &system.slots[0];
        let covariance = ideal_covariance(&system, &state).filter(|c| c.iter().all(|v| v.is_finite()));
        let Some(covariance) = covariance else { return HalfWidths::UNKNOWN };
        let bound = bound(&covariance, &state, slots);
        let ends = [
            bound.sigma_t_per_mm,
            bound.albedo,
            bound.g,
            bound.reduced_scattering_per_mm,
            bound.absorption_per_mm,
        ];
        // √σ_a is √(1 − α), which is at most 1, times √σ_t.
        let units = [1.0, 1.0, 1.0, 1.0, (0.5 * self.medium[SIGMA_T]).exp()];
        let mut widths =
            Quantity::all(slots).into_iter().zip(units).zip(ends).map(|((quantity, unit), ends)| {
                let gradient = quantity.gradient(&state.x);
                let deviation = gradient.dot(&(&covariance * &gradient)).max(0.0).sqrt();
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

    /// Every slab is a profile of its own, also if another one is as thick.
    fn system(&self, slabs_mm: &[f64], known: &KnownErrors) -> (System<'_>, State) {
        let mut unknowns = Vec::new();
        let mut x = Vec::new();
        let mut add = |prior: Option<(f64, f64)>, held: bool, value: f64| {
            unknowns.push(Unknown { prior, limits: (f64::NEG_INFINITY, f64::INFINITY), held });
            x.push(value);
            x.len() - 1
        };
        let known_to = |value: f64, deviation: f64| (Some((value, deviation)), deviation == 0.0, value);
        let [s, a, g] = [0, 1, 2].map(|i| add(Some((self.medium[i], UNKNOWN)), self.held[i], self.medium[i]));
        let (prior, held, value) = known_to(0.0, known.scale.unwrap_or(UNKNOWN));
        let scale = add(prior, held, value);
        let (value, deviation) = blur::prior(known.blur_mm, known.blur_std_error_mm);
        let (prior, held, value) = known_to(value, deviation);
        let blur = add(prior, held, value);
        let grid = self.surrogate.grid();
        let priors = if grid.responses().is_some() { grid.scene().priors() } else { &[] };
        let mut add_known = |value: f64, deviation: f64| {
            let (prior, held, value) = known_to(value, deviation);
            add(prior, held, value)
        };
        // The material is one.
        let shared: Vec<Option<usize>> = priors
            .iter()
            .zip(&known.scene)
            .map(|(prior, sd)| (prior.scope() != Scope::Slab).then(|| add_known(0.0, *sd)))
            .collect();
        let slots = slabs_mm.iter().map(|slab| {
            let thickness = add_known(slab.ln(), known.thickness_mm / slab);
            let own = |(slot, sd): (&Option<usize>, &f64)| slot.unwrap_or_else(|| add_known(0.0, *sd));
            let scene: Vec<usize> = shared.iter().zip(&known.scene).map(own).collect();
            [vec![s, a, g, scale, blur, thickness], scene].concat()
        });
        let slots: Vec<_> = slots.collect();
        let terms: Vec<Term> = slabs_mm.iter().map(|slab| self.term(*slab, known)).collect();
        let own: Vec<Line> = terms.iter().map(|t| vec![0.0; t.own_count()]).collect();
        let surrogates = vec![self.surrogate; terms.len()];
        let mut system = System { terms, surrogates, slots, unknowns, of_scene: Vec::new(), coupling: None };
        let state = State { x: DVector::from_vec(x), own, cost: 0.0 };
        let models = system.linear(&state.x, &state.own).into_iter().map(|linear| linear.model);
        for (term, model) in system.terms.iter_mut().zip(models.collect::<Vec<_>>()) {
            let noise = |v: &f64| (known.noise * v).hypot(known.noise_floor).max(f64::MIN_POSITIVE);
            term.std_errors = model.iter().map(noise).collect();
            term.values = model;
        }
        (system, state)
    }

    /// A profile whose values and noise are still to come.
    fn term(&self, thickness_mm: f64, known: &KnownErrors) -> Term {
        let sensor = self.surrogate.grid().scene().sensor();
        let x_mm = self.pixels.x_mm();
        let camera = Camera::new(&x_mm, self.pixels.pitch_mm(), sensor.width_mm(), sensor.pixels());
        let exposed = Exposed {
            thickness_mm,
            camera,
            values: vec![0.0; x_mm.len()],
            std_errors: vec![1.0; x_mm.len()],
            x_mm,
            origin_mm: 0.0,
        };
        let KnownErrors { origin_mm, gain, zero, slope, .. } = *known;
        Term {
            white: White::of(self.surrogate, thickness_mm, self.medium, 0.0),
            responses: self.surrogate.responses(thickness_mm, self.medium),
            ..Term::new(exposed, &OwnErrors { origin_mm, gain, zero, slope })
        }
    }
}
