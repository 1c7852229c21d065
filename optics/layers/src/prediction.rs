//! The radiance factor of prints of measured media, with its changes by the errors of the media and of the set-up.

use std::sync::Arc;

use optics_model::phase::{PhaseShape, SecondLobe};
use optics_model::{Invalid, Medium};
use rayon::prelude::*;

use crate::operator::Operator;
use crate::print::{Print, PrintLayer};
use crate::uncertain::Uncertain;

/// A slab of a medium, or of a mixture of media.
#[derive(Debug, Clone, PartialEq)]
pub struct PrintedSlab {
    /// Index of each medium, and its share by volume.
    pub shares: Vec<(usize, f64)>,
    pub thickness_mm: f64,
}

/// The effect of an error of the set-up: the difference of two prints, times the error.
#[derive(Debug, Clone, Copy)]
pub struct SetUpChange<'a> {
    pub from: &'a Print,
    /// The set-up with the quantity larger by one step.
    pub to: &'a Print,
    /// Reflectances of the bases there.
    pub to_rho: &'a [f64],
    /// Difference of the quantity from that of `from`, in steps.
    pub offset: f64,
    /// Changes of the quantity in steps, by one standard deviation of each shared source.
    pub shared: &'a [f64],
}

/// Origin of a change of a prediction.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ChangeSource {
    /// A source of errors that media, channels and set-up share.
    Shared(usize),
    /// A direction in which a medium is uncertain by itself, in its channel.
    Own { medium: usize, direction: usize },
    /// A direction of the error that predictions have besides those of media and set-up, as charts show it.
    Model(usize),
}

/// A radiance factor.
#[derive(Debug, Clone, PartialEq)]
pub struct Predicted {
    pub value: f64,
    /// Changes by one standard deviation of independent sources, in their order.
    pub changes: Vec<(ChangeSource, f64)>,
}

impl Predicted {
    /// Root of the sum of the squares of the changes.
    pub fn std_error(&self) -> f64 {
        self.changes.iter().map(|(_, change)| change * change).sum::<f64>().sqrt()
    }
}

/// Radiance factors over bases of these reflectances.
///
/// # Errors
/// If the shares of a slab are not positive or do not add up to 1, or a slab has no thickness.
pub fn radiance_factors(
    print: &Print,
    media: &[Uncertain],
    slabs: &[PrintedSlab],
    rho: &[f64],
) -> Result<Vec<f64>, Invalid> {
    Ok(print.factors(&operators(print, media, slabs, None)?, rho))
}

/// The operators of slabs, with those without the changed medium from `before`; alike slabs share one.
fn operators(
    print: &Print,
    media: &[Uncertain],
    slabs: &[PrintedSlab],
    before: Option<(&[Arc<Operator>], usize)>,
) -> Result<Vec<Arc<Operator>>, Invalid> {
    let mut all: Vec<Arc<Operator>> = Vec::new();
    for (i, slab) in slabs.iter().enumerate() {
        check(slab, media.len()).map_err(|e| e.within(format_args!("slab[{i}]")))?;
        let has = |medium: usize| slab.shares.iter().any(|(own, _)| *own == medium);
        let kept = before.filter(|(_, changed)| !has(*changed)).map(|(before, _)| before[i].clone());
        let alike = || slabs[..i].iter().position(|above| above == slab).map(|above| all[above].clone());
        let known = kept.or_else(alike);
        all.push(known.map_or_else(|| mixed(media, slab).map(|layer| Arc::new(print.operator(&layer))), Ok)?);
    }
    Ok(all)
}

/// Radiance factors with their errors, whose slopes are those of `slopes`: `Print::for_slopes`, as prints of the set-up are.
///
/// # Errors
/// As those of [`radiance_factors`].
pub fn predict(
    print: &Print,
    slopes: &Print,
    media: &[Uncertain],
    set_up: &[SetUpChange],
    slabs: &[PrintedSlab],
    rho: &[f64],
) -> Result<Vec<Predicted>, Invalid> {
    let values = radiance_factors(print, media, slabs, rho)?;
    let unmoved = operators(slopes, media, slabs, None)?;
    let unmoved_values = slopes.factors(&unmoved, rho);
    let is_used = |medium: usize| slabs.iter().any(|slab| slab.shares.iter().any(|(of, _)| *of == medium));
    let used: Vec<usize> = (0..media.len()).filter(|medium| is_used(*medium)).collect();
    let moved: Vec<(usize, Uncertain)> = used
        .iter()
        .flat_map(|medium| media[*medium].moved_both_ways().into_iter().flatten().map(|m| (*medium, m)))
        .collect();
    let at = |(medium, moved): &(usize, Uncertain)| {
        let mut media = media.to_vec();
        media[*medium] = moved.clone();
        Ok(slopes.factors(&operators(slopes, &media, slabs, Some((&unmoved, *medium)))?, rho))
    };
    let ends: Vec<Vec<f64>> = moved.par_iter().map(at).collect::<Result<_, Invalid>>()?;
    let by_set_up = |change: &SetUpChange| -> Result<Vec<f64>, Invalid> {
        let factors = |print, rho| radiance_factors(print, media, slabs, rho);
        let (from, to) = (factors(change.from, rho), factors(change.to, change.to_rho));
        Ok(to?.iter().zip(from?).map(|(to, from)| to - from).collect())
    };
    let steps: Vec<Vec<f64>> = set_up.par_iter().map(by_set_up).collect::<Result<_, Invalid>>()?;
    let predicted = |(i, value): (usize, &f64)| {
        let mut sum = ChangeSum::default();
        for medium in &used {
            let own = moved.iter().zip(&ends).filter(|((of, _), _)| of == medium);
            let own: Vec<f64> = own.map(|(_, ends)| ends[i]).collect();
            sum.add_medium(*medium, &media[*medium], unmoved_values[i], &own);
        }
        let mut by_offset = 0.0;
        for (change, step) in set_up.iter().zip(&steps) {
            sum.add_shared(change.shared.iter().map(|shared| shared * step[i]));
            by_offset += change.offset * step[i];
        }
        Predicted { value: value + by_offset, changes: sum.changes() }
    };
    Ok(values.iter().enumerate().map(predicted).collect())
}

/// Changes under construction.
#[derive(Debug, Default)]
struct ChangeSum {
    shared: Vec<f64>,
    own: Vec<(ChangeSource, f64)>,
}

impl ChangeSum {
    fn add_shared(&mut self, changes: impl Iterator<Item = f64>) {
        for (k, change) in changes.enumerate() {
            if k == self.shared.len() {
                self.shared.push(0.0);
            }
            self.shared[k] += change;
        }
    }

    fn add_medium(&mut self, medium: usize, uncertain: &Uncertain, value: f64, ends: &[f64]) {
        let slopes = uncertain.slopes(value, ends);
        self.add_shared(uncertain.shared_changes(&slopes).into_iter());
        let own = uncertain.own_changes(&slopes).into_iter().enumerate();
        self.own.extend(own.map(|(direction, change)| (ChangeSource::Own { medium, direction }, change)));
    }

    fn changes(self) -> Vec<(ChangeSource, f64)> {
        let shared = self.shared.into_iter().enumerate().map(|(k, change)| (ChangeSource::Shared(k), change));
        shared.chain(self.own).collect()
    }
}

fn check(slab: &PrintedSlab, media: usize) -> Result<(), Invalid> {
    let sum: f64 = slab.shares.iter().map(|(_, share)| share).sum();
    if slab.shares.iter().any(|(medium, share)| *medium >= media || *share <= 0.0) || (sum - 1.0).abs() > 1e-6
    {
        let allowed = "shares by volume are above 0 and add up to 1";
        return Err(Invalid::new("shares", format!("{:?}", slab.shares), allowed));
    }
    optics_model::medium::check_thickness(slab.thickness_mm).map(|_| ())
}

/// The slab of a mixture: σ_s, σ_a and σ_s p add up by volume. The phase function is that of two lobes with the mean
/// cosine, and the mean weight and anisotropy of the second lobe, of all scattering.
fn mixed(media: &[Uncertain], slab: &PrintedSlab) -> Result<PrintLayer, Invalid> {
    let (mut absorption, mut scattering, mut forward, mut weight, mut of_lobe) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for (medium, share) in &slab.shares {
        let Uncertain { medium: m, second_lobe, .. } = &media[*medium];
        let scattered = share * m.sigma_t_per_mm() * m.albedo();
        absorption += share * m.absorption_per_mm();
        scattering += scattered;
        forward += scattered * m.g();
        weight += scattered * second_lobe.weight();
        of_lobe += scattered * second_lobe.weight() * second_lobe.g();
    }
    let mean = |sum: f64, of: f64| if of > 0.0 { sum / of } else { 0.0 };
    let g = mean(forward, scattering);
    let lobe = SecondLobe::new(mean(weight, scattering), mean(of_lobe, weight))?.limited_to(g);
    // Rounded shares of media at the least extinction may lie below it.
    let extinction = (scattering + absorption).max(1e-6);
    let medium = Medium::new(extinction, scattering / extinction, g)?;
    Ok(PrintLayer { medium, phase: PhaseShape::Lobes(lobe), thickness_mm: slab.thickness_mm })
}

#[cfg(test)]
mod tests {
    use optics_model::Scene;

    use super::*;

    fn medium(sigma_t: f64, albedo: f64, variances: [f64; 3]) -> Uncertain {
        let covariance =
            std::array::from_fn(|i| std::array::from_fn(|j| if i == j { variances[i] } else { 0.0 }));
        let medium = Medium::new(sigma_t, albedo, 0.4).unwrap();
        Uncertain { covariance, ..Uncertain::exact(medium, SecondLobe::new(0.05, -0.5).unwrap()) }
    }

    fn slab(shares: &[(usize, f64)]) -> PrintedSlab {
        PrintedSlab { shares: shares.to_vec(), thickness_mm: 0.7 }
    }

    /// A mixture of a medium with itself is the medium; one with a clear medium has half of its coefficients.
    #[test]
    fn mixtures_add_by_volume() {
        let (white, clear) = (medium(6.0, 0.99, [0.0; 3]), medium(1e-6, 0.0, [0.0; 3]));
        let same = mixed(&[white.clone(), white.clone()], &slab(&[(0, 0.3), (1, 0.7)])).unwrap();
        assert!(
            (same.medium.sigma_t_per_mm() - 6.0).abs() < 1e-12 && (same.medium.albedo() - 0.99).abs() < 1e-12
        );
        assert!((same.phase.second_lobe().unwrap().weight() - 0.05).abs() < 1e-12);
        let half = mixed(&[white, clear], &slab(&[(0, 0.5), (1, 0.5)])).unwrap();
        assert!((half.medium.sigma_t_per_mm() - 3.0).abs() < 1e-5, "{half:?}");
        assert!((half.medium.g() - 0.4).abs() < 1e-9 && (half.medium.albedo() - 0.99).abs() < 1e-5);
    }

    /// The standard error is the slope times that of the medium, and errors of two media add up as squares.
    #[test]
    fn errors_follow_from_covariances() {
        let print = Print::new(&Scene::smooth(), 1.53, 0.5);
        let value = |sigma_t: f64| {
            let media = [medium(sigma_t, 0.9, [0.0; 3])];
            radiance_factors(&print, &media, &[slab(&[(0, 1.0)])], &[0.5]).unwrap()[0]
        };
        let slope = (value(6.0 * libm::exp(0.01_f64)) - value(6.0 * libm::exp(-0.01_f64))) / 0.02;
        let uncertain = medium(6.0, 0.9, [0.02_f64.powi(2), 0.0, 0.0]);
        let errors = |media: &[Uncertain], shares: &[(usize, f64)]| {
            predict(&print, &print, media, &[], &[slab(shares)], &[0.5]).unwrap()[0].std_error()
        };
        let one = errors(std::slice::from_ref(&uncertain), &[(0, 1.0)]);
        assert!((one / (0.02 * slope.abs()) - 1.0).abs() < 1e-3, "{one} {slope}");
        let halves = [(0, 0.5), (1, 0.5)];
        let own = errors(&[uncertain.clone(), uncertain.clone()], &halves);
        assert!((own / one - 0.5_f64.sqrt()).abs() < 1e-2, "{own} {one}");
        // An error of both media adds up, and one that is opposite in both cancels out.
        let shared = |by: f64| Uncertain { shared: vec![[by, 0.0, 0.0, 0.0, 0.0]], ..uncertain.clone() };
        let same = errors(&[shared(0.02), shared(0.02)], &halves);
        assert!((same / one - 1.0).abs() < 1e-2, "{same} {one}");
        assert!(errors(&[shared(0.02), shared(-0.02)], &halves) < 0.05 * one);
    }

    /// An error of the second lobe changes a prediction by its slope, and one of the set-up by the difference of prints.
    #[test]
    fn errors_of_lobe_and_set_up_count() {
        let [print, other] = [1.53, 1.54].map(|ior| Print::new(&Scene::smooth(), ior, 0.5));
        let slab = [slab(&[(0, 1.0)])];
        let with = |print: &Print, weight: f64| {
            let exact =
                Uncertain::exact(medium(6.0, 0.9, [0.0; 3]).medium, SecondLobe::new(weight, -0.5).unwrap());
            radiance_factors(print, &[exact], &slab, &[0.5]).unwrap()[0]
        };
        let by_lobe = with(&print, 0.06) - with(&print, 0.05);
        let by_index = with(&other, 0.05) - with(&print, 0.05);
        let shared = vec![[0.0, 0.0, 0.0, 0.01, 0.0], [0.0; 5]];
        let media = [Uncertain { shared, ..medium(6.0, 0.9, [0.0; 3]) }];
        let set_up =
            [SetUpChange { from: &print, to: &other, to_rho: &[0.5], offset: 0.5, shared: &[0.0, 0.5] }];
        let found = predict(&print, &print, &media, &set_up, &slab, &[0.5]).unwrap();
        let change = |k: usize| found[0].changes[k].1;
        assert!((found[0].value - with(&print, 0.05) - 0.5 * by_index).abs() < 1e-9, "{found:?}");
        assert!((change(0) / by_lobe - 1.0).abs() < 0.02, "{found:?} {by_lobe}");
        assert!((change(1) / (0.5 * by_index) - 1.0).abs() < 1e-9, "{found:?} {by_index}");
    }

    /// Standard errors over as many directions as slopes need are those over all, to 1.5 %, for errors of media and of an
    /// index.
    #[test]
    fn slopes_need_few_directions() {
        let scene = Scene::lab();
        for (g, peak) in [(0.4, 0.6), (0.85, 0.15)] {
            let uncertain = medium(9.0, 0.95, [0.03_f64.powi(2), 0.01_f64.powi(2), 0.1_f64.powi(2)]);
            let media = [Uncertain { medium: Medium::new(9.0, 0.95, g).unwrap(), ..uncertain }];
            let std_errors = |print: fn(&Scene, f64, f64) -> Print| {
                let [from, to] = [1.53, 1.55].map(|ior| print(&scene, ior, peak));
                let change =
                    SetUpChange { from: &from, to: &to, to_rho: &[0.1, 0.9], offset: 0.0, shared: &[1.0] };
                let slab = [slab(&[(0, 1.0)])];
                let with = |set_up: &[SetUpChange]| {
                    let found = predict(&from, &from, &media, set_up, &slab, &[0.1, 0.9]).unwrap();
                    found.iter().map(Predicted::std_error).collect::<Vec<_>>()
                };
                [with(&[]), with(&[change])].concat()
            };
            for (all, few) in std_errors(Print::new).iter().zip(std_errors(Print::for_slopes)) {
                assert!((few / all - 1.0).abs() < 0.015, "{g}: {few} {all}");
            }
        }
    }

    #[test]
    fn wrong_shares_are_refused() {
        let print = Print::new(&Scene::smooth(), 1.53, 0.5);
        let refused = |shares: &[(usize, f64)]| {
            radiance_factors(&print, &[medium(6.0, 0.9, [0.0; 3])], &[slab(shares)], &[0.5])
                .unwrap_err()
                .to_string()
        };
        for shares in [&[(0, 0.9)][..], &[(1, 1.0)], &[(0, 1.5), (0, -0.5)], &[]] {
            assert!(refused(shares).starts_with("slab[0].shares = "), "{}", refused(shares));
        }
    }
}
