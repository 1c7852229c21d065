//! Computes the answer for inks and mixtures.

use nalgebra::{DMatrix, DVector, Matrix2, Vector2};
use optics_model::fit::{
    Agreement, ChannelFit, Common, FitOptions, InkChannel, InkFit, Interval, MeasurePlan, MixtureFit,
    MixturePart, Mixtures, Unmixed, Z,
};
use optics_model::{Invalid, Medium};

use super::{HARDLY, Slab, Solved};
use crate::dictionary::FitDictionary;
use crate::dictionary::axes::held;
use crate::dictionary::sum::dot;
use crate::likelihood::answer::is_resolved;
use crate::likelihood::interval::chi2::exceedance;
use crate::likelihood::interval::profile_likelihood::{IntervalEnd, ProfileLikelihood, interval};
use crate::likelihood::point::{LN_ONE_MINUS_G, LN_SCALE, LN_SIGMA_T, ROOT_CO_ALBEDO};
use crate::likelihood::system::Normal;
use crate::likelihood::system::part::slot_in;
use crate::likelihood::system::quantity::Quantity;
use crate::likelihood::system::unknowns::inverse_over_free;
use crate::likelihood::term::Linear;
use crate::likelihood::term::blend::{Ink, InkPart, ink_medium, unlimited};
use crate::surrogate::{albedo, g, sigma_t};

/// Probability below which a disagreement counts as more than noise.
const UNLIKELY: f64 = 0.01;

/// The request, and the separate fit of each slab's material.
#[derive(Clone, Copy)]
pub(super) struct MixtureRequest<'b> {
    pub dictionary: &'b FitDictionary,
    pub options: &'b FitOptions,
    pub plan: &'b MeasurePlan,
    pub mixtures: &'b Mixtures,
    /// In the order of the slabs.
    pub fits: &'b [&'b ChannelFit],
}

/// Inks at the least −2 ln L.
pub(super) struct Solution<'a, 'b> {
    request: MixtureRequest<'b>,
    slabs: &'b [Slab<'a>],
    solved: &'b Solved<'a>,
    linear: Vec<Linear>,
    normal: Normal,
    covariance: DMatrix<f64>,
}

impl<'a, 'b> Solution<'a, 'b> {
    pub(super) fn new(
        request: MixtureRequest<'b>,
        slabs: &'b [Slab<'a>],
        solved: &'b Solved<'a>,
    ) -> Result<Self, Invalid> {
        let Solved { system, state, .. } = solved;
        let linear = system.linear(&state.x, &state.own);
        let normal = system.normal(&state.x, &state.own, &linear);
        let covariance =
            inverse_over_free(&system.unknowns, &normal.information, HARDLY).ok_or_else(|| {
                let allowed = "the slabs do not determine their inks: measure more, or in other fractions";
                Invalid::new("mixtures", format!("{} inks", request.mixtures.inks().len()), allowed)
            })?;
        Ok(Self { request, slabs, solved, linear, normal, covariance })
    }

    pub(super) fn answer(&self) -> Unmixed {
        let mixtures: Vec<MixtureFit> = self.slabs.iter().map(|slab| self.mixture(slab)).collect();
        let common = self.common();
        let by_channel: Vec<(&str, Vec<InkChannel>)> = self
            .solved
            .inks
            .iter()
            .map(|(channel, inks)| self.channel(*channel, inks, common.g_interval))
            .collect();
        let ink_fit = |(i, name): (usize, &str)| InkFit {
            material: name.to_owned(),
            channels: by_channel.iter().map(|(_, inks)| inks[i].clone()).collect(),
        };
        let inks = self.request.mixtures.inks().into_iter().enumerate().map(ink_fit).collect();
        Unmixed { common, inks, mixtures }
    }

    fn channel(&self, channel: usize, inks: &[Ink], common_g: Option<Interval>) -> (&str, Vec<InkChannel>) {
        let of_channel: Vec<&Slab> = self.slabs.iter().filter(|s| s.data.channel == channel).collect();
        let name = of_channel[0].data.name;
        let intervals = self.intervals(channel, inks, common_g);
        let one = |(i, ink): (usize, &Ink)| {
            let found = &intervals[i];
            let x = &self.solved.state.x;
            // For an absorber 1 − α must be determined, for others α.
            let a = found.albedo;
            let co_albedo = Interval { low: 1.0 - a.high, high: 1.0 - a.low, ..a };
            let descent = self.solved.state.end;
            let of_either = [a, co_albedo].iter().any(|share| is_resolved(&found.sigma_t_per_mm, share));
            let resolved = descent.is_minimum() && of_either;
            InkChannel {
                channel: name.to_owned(),
                medium: medium(ink_medium(*ink, x)),
                sigma_t_per_mm: found.sigma_t_per_mm,
                albedo: found.albedo,
                g: found.g,
                reduced_scattering_per_mm: found.reduced_scattering_per_mm,
                absorption_per_mm: found.absorption_per_mm,
                resolved,
                descent,
                from_mixtures: !self.resolved_alone(channel, i),
            }
        };
        (name, inks.iter().enumerate().map(one).collect())
    }

    /// Whether an ink's own slabs determine it.
    fn resolved_alone(&self, channel: usize, ink: usize) -> bool {
        let pure = |slab: &Slab| slab.data.channel == channel && slab.fractions[ink] == 1.0;
        let resolved = |fit: &ChannelFit| fit.refined.as_ref().is_some_and(|r| r.resolved_at_g);
        self.slabs.iter().zip(self.request.fits).any(|(slab, fit)| pure(slab) && resolved(fit))
    }

    /// Intervals of the inks of a channel, whose profiles form a separate system: others contribute to the shared
    /// unknowns only.
    fn intervals(&self, channel: usize, inks: &[Ink], common_g: Option<Interval>) -> Vec<InkIntervals> {
        let Solved { system: whole, state, .. } = self.solved;
        let of_channel = self.members().filter(|(slab, _)| slab.data.channel == channel);
        let terms: Vec<usize> = of_channel.flat_map(|(_, members)| members).collect();
        let (system, mut optimum) = whole.part(&terms, state, &self.normal, 1.0);
        let (cost, normal) = system.look(&optimum);
        optimum.cost = cost;
        let used = whole.used_by(&terms);
        let covariance = inverse_over_free(&system.unknowns, &normal.information, HARDLY);
        let covariance =
            covariance.unwrap_or_else(|| DMatrix::from_element(used.len(), used.len(), f64::INFINITY));
        let inflation = self.disagreement(channel);
        let profile = ProfileLikelihood {
            system: &system,
            optimum: &optimum,
            normal: &normal,
            covariance: &covariance,
            inflation,
        };
        let place = |slot: &usize| slot_in(&used, *slot);
        inks.iter().map(|ink| InkIntervals::of(&profile, ink.each_ref().map(place), common_g)).collect()
    }

    /// Slabs that were not left out, and their profiles among those of the system.
    fn members(&self) -> impl Iterator<Item = (&'b Slab<'a>, std::ops::Range<usize>)> {
        let mut first = 0;
        self.slabs.iter().filter(|s| s.left_out.is_none()).map(move |slab| {
            let members = first..first + slab.terms.len();
            first = members.end;
            (slab, members)
        })
    }

    /// χ² of the pull of a slab's own profiles on its σ_t and α, away from the medium that the inks give.
    fn pull(&self, members: std::ops::Range<usize>) -> f64 {
        let (mut information, mut downhill) = (Matrix2::zeros(), Vector2::zeros());
        for reduced in &self.normal.reduced[members] {
            information += reduced.information.fixed_view::<2, 2>(0, 0);
            downhill += reduced.downhill.fixed_rows::<2>(0);
        }
        let inverse = (information + Matrix2::identity() * 1e-9).try_inverse();
        inverse.map_or(0.0, |inverse| downhill.dot(&(inverse * downhill)))
    }

    /// Factor on the rise of −2 ln L that intervals allow: more than 1 if slabs of a channel contradict one another by
    /// more than their noise.
    fn disagreement(&self, channel: usize) -> f64 {
        let channel_slabs = || self.members().filter(|(slab, _)| slab.data.channel == channel);
        let inks = self.request.mixtures.inks().len();
        let freedom = 2.0 * (channel_slabs().count() as f64 - inks as f64);
        let pulls: f64 = channel_slabs().map(|(_, members)| self.pull(members)).sum();
        let ratio = |chi2: f64, freedom: f64| {
            let more = freedom > 0.0 && exceedance(chi2, freedom) < UNLIKELY;
            if more { chi2 / freedom } else { 1.0 }
        };
        let (chi2, pixels) = channel_slabs()
            .map(|(_, members)| self.chi2(members))
            .fold((0.0, 0.0), |sum, one| (sum.0 + one.0, sum.1 + one.1));
        ratio(pulls, freedom).max(ratio(chi2, pixels - 2.0 * inks as f64))
    }

    /// χ² of the pixels that are not left out, with the deviations of the profiles' own nuisances from their priors; and
    /// the number of these pixels.
    fn chi2(&self, members: std::ops::Range<usize>) -> (f64, f64) {
        let (mut chi2, mut pixels) = (0.0, 0.0);
        for i in members {
            let left_out = &self.solved.system.terms[i].left_out;
            for (r, _) in self.linear[i].residuals.iter().zip(left_out).filter(|(_, out)| !**out) {
                chi2 += r * r;
                pixels += 1.0;
            }
            let own = &self.solved.state.own[i];
            chi2 += dot(own, own);
        }
        (chi2, pixels)
    }

    fn mixture(&self, slab: &Slab<'a>) -> MixtureFit {
        let found = self.members().find(|(s, _)| std::ptr::eq(*s, slab));
        let agreement = found.map(|(_, members)| {
            let (chi2, pixels) = self.chi2(members.clone());
            let (misfit, pull) = ((chi2 / pixels.max(1.0)).sqrt(), (0.5 * self.pull(members)).sqrt());
            Agreement { chi2, pixels, misfit, pull }
        });
        let of_channel = self.solved.inks.iter().find(|(c, _)| *c == slab.data.channel);
        let inks = of_channel.map_or(&[][..], |(_, inks)| inks);
        let names = self.request.mixtures.inks();
        let parts = || slab.fractions.iter().enumerate().filter(|(_, f)| **f > 0.0);
        let blend = unlimited(parts().map(|(i, f)| InkPart { fraction: *f, ink: inks[i] }).collect());
        MixtureFit {
            material: slab.material.clone(),
            channel: slab.data.name.to_owned(),
            parts: parts().map(|(i, f)| MixturePart::new(names[i], *f)).collect(),
            medium: medium(blend.at(&self.solved.state.x).medium),
            agreement,
            left_out: slab.left_out.clone(),
        }
    }

    fn common(&self) -> Common {
        let scale = self.solved.system.slots[0][LN_SCALE];
        let x = &self.solved.state.x;
        let widened = |slot: usize| {
            let worst = self.solved.inks.iter().map(|(c, _)| self.disagreement(*c)).fold(1.0, f64::max);
            (self.covariance[(slot, slot)].max(0.0) * worst).sqrt()
        };
        let mu = self.request.options.settings().mu * libm::exp(x[scale]);
        let mu_std_error = mu * widened(scale);
        let slot = self.solved.inks[0].1[0][LN_ONE_MINUS_G];
        let only = held(self.request.dictionary.grid(), self.request.options)[2];
        let found = self.solved.common_g.then(|| g(x[slot]));
        Common {
            mu,
            mu_std_error,
            mu_interval: self.request.plan.mu_interval(mu, mu_std_error),
            mu_chosen: self.request.plan.search_mu.is_some(),
            g: found.or(only),
            g_spread: None,
            g_equal_probability: None,
            g_change: None,
            g_interval: found.map(|_| self.g_interval(slot, x, widened(slot))),
            by_g: Vec::new(),
        }
    }

    /// The interval of g, symmetric in ln(1 − g) within the limits.
    fn g_interval(&self, slot: usize, x: &DVector<f64>, deviation: f64) -> Interval {
        let (least, greatest) = self.solved.system.unknowns[slot].limits;
        let (low, high) = (x[slot] - Z * deviation, x[slot] + Z * deviation);
        Interval {
            low: g(high.min(greatest)),
            high: g(low.max(least)),
            open_low: high > greatest,
            open_high: low < least,
        }
    }
}

fn medium(x: [f64; 3]) -> Medium {
    let (sigma_t, albedo) = (sigma_t(x[LN_SIGMA_T]), albedo(x[ROOT_CO_ALBEDO].clamp(0.0, 1.0)));
    Medium::new(sigma_t, albedo, g(x[LN_ONE_MINUS_G])).expect("inks are kept within what media may be")
}

/// The intervals of an ink's σ_t, α, g, σ_s (1 − g) and σ_a.
#[derive(Debug)]
struct InkIntervals {
    sigma_t_per_mm: Interval,
    albedo: Interval,
    g: Interval,
    reduced_scattering_per_mm: Interval,
    absorption_per_mm: Interval,
}

impl InkIntervals {
    fn of(profile: &ProfileLikelihood, ink: Ink, common_g: Option<Interval>) -> Self {
        let [s, a, g_] = ink.map(|slot| profile.system.unknowns[slot].limits);
        let limits = [
            (s.0 + a.0 * a.0, s.1 + a.1 * a.1),
            (0.0, 1.0),
            g_,
            (s.0 * libm::exp(g_.0), s.1 * libm::exp(g_.1)),
            a,
        ];
        let quantities = Quantity::of_ink(ink);
        let ends = |i: usize| -> [IntervalEnd; 2] { profile.ends(quantities[i], limits[i]) };
        let positive = |v: f64| v.max(0.0);
        Self {
            sigma_t_per_mm: from_nothing(interval(ends(0), positive, false)),
            albedo: Interval {
                open_high: false,
                ..from_nothing(interval(ends(1), |x| albedo(x.clamp(0.0, 1.0)), true))
            },
            g: common_g.unwrap_or_else(|| interval(ends(2), g, true)),
            reduced_scattering_per_mm: from_nothing(interval(ends(3), positive, false)),
            absorption_per_mm: from_nothing(interval(ends(4), |x| positive(x).powi(2), false)),
        }
    }
}

/// The interval of a quantity that cannot be negative. Its lower limit is not one of the dictionary, so the lower end is
/// not open.
fn from_nothing(found: Interval) -> Interval {
    Interval { open_low: false, ..found }
}
