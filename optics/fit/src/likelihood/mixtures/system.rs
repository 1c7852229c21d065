//! Profiles of mixtures whose media follow from what is known of their inks, and the descent to the least −2 ln L.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::blend::{Blend, InkQuantity};
use crate::likelihood::system::{State, Unknown, clamped, damped_step, inverse_over_free};
use crate::likelihood::term::{Linear, Reduced, Term};
use crate::likelihood::{BLUR, LN_SCALE, LN_THICKNESS, Line, Point, SHARED};
use crate::surrogate::Surrogate;

/// Steps that one descent may take.
const MOST_STEPS: usize = 60;

/// One measured profile.
#[derive(Debug, Clone)]
pub(super) struct Member<'a> {
    pub term: Term,
    pub surrogate: &'a Surrogate<'a>,
    pub blend: Blend,
    /// Slots of the factor on μ, of the blur and of the slab's thickness.
    pub setup: [usize; 3],
    /// What the dictionary predicts, in its coordinates. Beyond it a profile stays as it is at the end.
    pub limits: [(f64, f64); 3],
    /// Stands for the profile where it is as good.
    pub parabola: Option<Parabola>,
}

/// −2 ln L of a profile as a quadratic in what it shares, its own unknowns following.
#[derive(Debug, Clone)]
pub(super) struct Parabola {
    pub at: [f64; SHARED],
    pub cost: f64,
    pub downhill: DVector<f64>,
    pub information: DMatrix<f64>,
}

/// What a profile shares at some place of the unknowns, and the derivatives of it.
#[derive(Debug)]
struct Place {
    point: [f64; SHARED],
    slopes: DMatrix<f64>,
    slots: Vec<usize>,
}

/// A profile at some place of the unknowns.
#[derive(Debug)]
pub(super) struct Look {
    place: Place,
    pub linear: Option<Linear>,
    pub cost: f64,
}

/// Second derivative and gradient of −2 ln L, halved, with what each profile says for itself.
#[derive(Debug)]
pub(super) struct Normal {
    pub information: DMatrix<f64>,
    pub downhill: DVector<f64>,
    pub reduced: Vec<Option<Reduced>>,
}

/// A quantity of an ink held at a value, by a spring so stiff that it does not give.
#[derive(Debug, Clone, Copy)]
pub(super) struct Held {
    pub quantity: InkQuantity,
    pub at: f64,
    pub stiffness: f64,
}

impl Held {
    fn cost(&self, x: &DVector<f64>) -> f64 {
        self.stiffness * (self.quantity.value(x) - self.at).powi(2)
    }
}

/// All profiles, and all that they depend on.
#[derive(Debug, Clone)]
pub(super) struct Chart<'a> {
    pub members: Vec<Member<'a>>,
    pub unknowns: Vec<Unknown>,
}

impl Member<'_> {
    fn place(&self, x: &DVector<f64>) -> Place {
        let blended = self.blend.at(x);
        let mut slots: Vec<usize> = self.blend.slots().collect();
        let parts = slots.len();
        slots.extend(self.setup);
        let mut slopes = DMatrix::zeros(SHARED, slots.len());
        let mut point = [0.0; SHARED];
        for (i, (low, high)) in self.limits.into_iter().enumerate() {
            point[i] = blended.medium[i].clamp(low, high);
            if point[i] == blended.medium[i] {
                slopes.view_mut((i, 0), (1, parts)).copy_from(&blended.slopes.row(i));
            }
        }
        for (k, i) in [LN_SCALE, BLUR, LN_THICKNESS].into_iter().enumerate() {
            point[i] = x[self.setup[k]];
            slopes[(i, parts + k)] = 1.0;
        }
        Place { point, slopes, slots }
    }

    fn look(&self, x: &DVector<f64>, own: &[f64]) -> Look {
        let place = self.place(x);
        if let Some(parabola) = &self.parabola {
            let cost = parabola.cost(&place.point);
            return Look { place, linear: None, cost };
        }
        let linear = self.term.linear(self.surrogate, &Point(place.point), own);
        Look { cost: linear.cost, place, linear: Some(linear) }
    }

    /// Information and downhill of the slots of a place, and what the profile's own unknowns do.
    fn reduce(&self, look: &Look, own: &[f64]) -> (DMatrix<f64>, DVector<f64>, Option<Reduced>) {
        let slopes = &look.place.slopes;
        let through = |information: &DMatrix<f64>, downhill: &DVector<f64>| {
            (slopes.transpose() * information * slopes, slopes.transpose() * downhill)
        };
        if let Some(parabola) = &self.parabola {
            let downhill = &parabola.downhill - &parabola.information * parabola.away(&look.place.point);
            let (information, downhill) = through(&parabola.information, &downhill);
            return (information, downhill, None);
        }
        let reduced = look.linear.as_ref().map(|linear| self.term.reduce(linear, own));
        let (information, downhill) = match &reduced {
            Some(reduced) => through(&reduced.information, &reduced.downhill),
            None => (DMatrix::zeros(slopes.ncols(), slopes.ncols()), DVector::zeros(slopes.ncols())),
        };
        (information, downhill, reduced)
    }
}

impl Parabola {
    fn away(&self, point: &[f64; SHARED]) -> DVector<f64> {
        DVector::from_fn(SHARED, |i, _| point[i] - self.at[i])
    }

    fn cost(&self, point: &[f64; SHARED]) -> f64 {
        let away = self.away(point);
        self.cost + away.dot(&(&self.information * &away)) - 2.0 * self.downhill.dot(&away)
    }
}

impl Chart<'_> {
    pub(super) fn look(&self, x: &DVector<f64>, own: &[Line]) -> Vec<Look> {
        self.members.par_iter().zip(own).map(|(member, own)| member.look(x, own)).collect()
    }

    fn prior_cost(&self, x: &DVector<f64>) -> f64 {
        let known = self.unknowns.iter().zip(x.iter()).filter(|(u, _)| !u.held);
        known.filter_map(|(u, x)| u.prior.map(|(mean, sd)| ((x - mean) / sd).powi(2))).sum()
    }

    fn cost(&self, x: &DVector<f64>, looks: &[Look]) -> f64 {
        looks.iter().map(|l| l.cost).sum::<f64>() + self.prior_cost(x)
    }

    /// Looks up other thicknesses, and what the white reference does, again where the media now are.
    pub(super) fn move_near(&mut self, x: &DVector<f64>) {
        self.members.par_iter_mut().for_each(|member| {
            let [s, a, g, ..] = member.place(x).point;
            member.term.near = member.surrogate.near(member.term.thickness_mm, [s, a, g]);
            let white = member.term.white.as_ref();
            member.term.white =
                white.and_then(|w| w.moved(member.surrogate, member.term.thickness_mm, [s, a, g]));
        });
    }

    pub(super) fn normal(&self, x: &DVector<f64>, own: &[Line], looks: &[Look]) -> Normal {
        let n = self.unknowns.len();
        let (mut information, mut downhill) = (DMatrix::zeros(n, n), DVector::zeros(n));
        let reduce = |(member, (look, own)): (&Member, (&Look, &Line))| member.reduce(look, own);
        let parts: Vec<_> = self.members.par_iter().zip(looks.par_iter().zip(own)).map(reduce).collect();
        let mut reduced = Vec::with_capacity(parts.len());
        for (look, (of_member, pull, one)) in looks.iter().zip(parts) {
            for (i, slot) in look.place.slots.iter().enumerate() {
                downhill[*slot] += pull[i];
                for (j, other) in look.place.slots.iter().enumerate() {
                    information[(*slot, *other)] += of_member[(i, j)];
                }
            }
            reduced.push(one);
        }
        for (i, unknown) in self.unknowns.iter().enumerate() {
            if let Some((mean, sd)) = unknown.prior.filter(|_| !unknown.held) {
                information[(i, i)] += 1.0 / (sd * sd);
                downhill[i] -= (x[i] - mean) / (sd * sd);
            }
        }
        Normal { information, downhill, reduced }
    }

    /// Goes down to a minimum of −2 ln L, until a step lowers it by less than `tolerance`.
    pub(super) fn descend(&self, from: State, held: Option<&Held>, tolerance: f64) -> State {
        let spring = |x: &DVector<f64>| held.map_or(0.0, |h| h.cost(x));
        let mut state = from;
        let mut looks = self.look(&state.x, &state.own);
        state.cost = self.cost(&state.x, &looks);
        let mut normal = self.normal(&state.x, &state.own, &looks);
        let mut damping = 1e-9;
        for _ in 0..MOST_STEPS {
            let Some(step) = self.step(&state.x, &normal, held, damping) else { break };
            let x = clamped(&self.unknowns, &state.x + step);
            let own = self.own_after(&state, &looks, &normal, &x);
            let there = self.look(&x, &own);
            let cost = self.cost(&x, &there);
            let gain = state.cost + spring(&state.x) - cost - spring(&x);
            if gain.is_nan() || gain < 0.0 {
                if gain > -tolerance || damping > 1e6 {
                    break;
                }
                damping = (damping * 30.0).max(1e-4);
                continue;
            }
            (state, looks) = (State { x, own, cost }, there);
            damping *= 0.03;
            if gain < tolerance {
                break;
            }
            normal = self.normal(&state.x, &state.own, &looks);
        }
        state
    }

    /// The profiles' own unknowns as they follow a step of the others.
    fn own_after(&self, state: &State, looks: &[Look], normal: &Normal, x: &DVector<f64>) -> Vec<Line> {
        let follow = |(i, own): (usize, &Line)| match &normal.reduced[i] {
            Some(reduced) => {
                let to = self.members[i].place(x).point;
                let moved = DVector::from_fn(SHARED, |k, _| to[k] - looks[i].place.point[k]);
                own.iter().zip(reduced.own_step(&moved).iter()).map(|(w, d)| w + d).collect()
            }
            None => own.clone(),
        };
        state.own.iter().enumerate().map(follow).collect()
    }

    fn step(
        &self,
        x: &DVector<f64>,
        normal: &Normal,
        held: Option<&Held>,
        damping: f64,
    ) -> Option<DVector<f64>> {
        let (mut information, mut downhill) = (normal.information.clone(), normal.downhill.clone());
        if let Some(Held { quantity, at, stiffness }) = held {
            let gradient = quantity.gradient(x);
            downhill += &gradient * (*stiffness * (at - quantity.value(x)));
            information += &gradient * gradient.transpose() * *stiffness;
        }
        damped_step(&self.unknowns, x, &information, &downhill, damping)
    }

    /// The inverse of an information matrix over the unknowns that can move; zeros elsewhere. What no profile tells has
    /// a very large variance.
    pub(super) fn covariance(&self, information: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        inverse_over_free(&self.unknowns, information, 1e-9)
    }

    /// What stands for a profile near a state.
    pub(super) fn parabola(look: &Look, reduced: &Reduced) -> Parabola {
        Parabola {
            at: look.place.point,
            cost: look.cost,
            downhill: reduced.downhill.clone(),
            information: reduced.information.clone(),
        }
    }
}
