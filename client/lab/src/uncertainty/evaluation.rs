//! Combined standard uncertainties of the measurands of each channel, with their contributions and correlations.

use farm_figures::misfit::is_unlikely;
use farm_figures::numbers::{interval, significant};
use farm_figures::source_name;
use optics_model::fit::{
    ChannelFit, ErrorSource, Interval, MaterialFit, Refined, SharedErrors, SourceShare, Z,
};

pub(super) const MEASURANDS: [&str; 3] = ["σ_t", "σ_s(1 − g)", "σ_a"];

/// The measurands of a channel.
#[derive(Debug, Clone)]
pub(super) struct EvaluatedChannel<'a> {
    pub material: &'a str,
    pub channel: &'a str,
    pub refined: &'a Refined,
    pub measurands: [EvaluatedMeasurand; 3],
}

/// A measurand with its uncertainty, in 1/mm.
#[derive(Debug, Clone)]
pub(super) struct EvaluatedMeasurand {
    pub value: f64,
    /// u_c; None where the data leave an end of the interval open.
    pub std_uncertainty: Option<f64>,
    pub interval: String,
    /// ν_eff by Welch and Satterthwaite; None if no contribution has finite degrees of freedom.
    pub degrees_of_freedom: Option<f64>,
    /// k of 95 %.
    pub coverage_factor: f64,
    /// Contributions of sources to u_c in per cent of the value.
    pub contributions: Vec<(String, f64)>,
    /// Standard deviation, also where the interval is open.
    deviation: f64,
    /// Changes by one standard deviation of each source of errors that channels share.
    shared: Vec<f64>,
}

/// Every channel with a refined medium.
pub(super) fn evaluated<'a>(fits: &'a [MaterialFit], errors: &SharedErrors) -> Vec<EvaluatedChannel<'a>> {
    let channels = fits.iter().flat_map(|fit| fit.channels.iter().map(move |c| (fit, c))).enumerate();
    let evaluation = |(number, (fit, channel)): (usize, (&'a MaterialFit, &'a ChannelFit))| {
        let refined = channel.refined.as_ref()?;
        let measurands = measurands(refined, errors.of_channel(number));
        Some(EvaluatedChannel { material: &fit.material, channel: &channel.channel, refined, measurands })
    };
    channels.filter_map(evaluation).collect()
}

impl EvaluatedChannel<'_> {
    /// Whether the residuals exceed what the input quantities explain, so that u_c was enlarged.
    pub(super) fn is_enlarged(&self) -> bool {
        is_unlikely(&self.refined.likelihood)
    }

    pub(super) fn label(&self) -> String {
        format!("{} {}", self.material, self.channel)
    }

    /// Correlation of a measurand with that of another channel; 1 with itself.
    pub(super) fn correlation(&self, other: &Self, measurand: usize) -> f64 {
        if (&self.material, &self.channel) == (&other.material, &other.channel) {
            return 1.0;
        }
        let (a, b) = (&self.measurands[measurand], &other.measurands[measurand]);
        let covariance: f64 = a.shared.iter().zip(&b.shared).map(|(a, b)| a * b).sum();
        let product = a.deviation * b.deviation;
        if product > 0.0 { (covariance / product).clamp(-1.0, 1.0) } else { 0.0 }
    }
}

/// Slopes of σ_t, σ_s(1 − g) and σ_a in (ln σ_t, r, ln(1 − g)) with r = √(1 − α).
fn slopes(refined: &Refined) -> [[f64; 3]; 3] {
    let m = &refined.best.medium;
    let (sigma_t, albedo, root) = (m.sigma_t_per_mm(), m.albedo(), (1.0 - m.albedo()).max(0.0).sqrt());
    let reduced = m.reduced_scattering_per_mm();
    [
        [sigma_t, 0.0, 0.0],
        [reduced, -2.0 * root * reduced / albedo.max(f64::MIN_POSITIVE), reduced],
        [m.absorption_per_mm(), 2.0 * root * sigma_t, 0.0],
    ]
}

fn measurands(refined: &Refined, shared: &[[f64; SharedErrors::OF_MEDIUM]]) -> [EvaluatedMeasurand; 3] {
    let medium = &refined.best.medium;
    let values = [medium.sigma_t_per_mm(), medium.reduced_scattering_per_mm(), medium.absorption_per_mm()];
    let intervals = [&refined.sigma_t_per_mm, &refined.reduced_scattering_per_mm, &refined.absorption_per_mm];
    let shares: [fn(&SourceShare) -> f64; 3] = [|s| s.sigma_t, |s| s.reduced_scattering, |s| s.absorption];
    let slopes = slopes(refined);
    std::array::from_fn(|i| {
        let product = |c: &[f64]| (0..3).map(|k| slopes[i][k] * c[k]).sum::<f64>();
        let rows = refined.covariance.map(|row| product(&row));
        let u = if refined.from_mixtures { half_width(intervals[i]) } else { product(&rows).max(0.0).sqrt() };
        // Budget and shared errors are those of the fit without mixtures.
        let (budget, shared) =
            if refined.from_mixtures { (&[][..], &[][..]) } else { (&refined.likelihood.budget[..], shared) };
        let degrees_of_freedom = degrees_of_freedom(budget, refined.likelihood.degrees_of_freedom, shares[i]);
        EvaluatedMeasurand {
            value: values[i],
            std_uncertainty: (!intervals[i].open_low && !intervals[i].open_high).then_some(u),
            deviation: u,
            interval: interval(intervals[i], |v| significant(v, 3)),
            coverage_factor: coverage_factor(degrees_of_freedom),
            degrees_of_freedom,
            contributions: contributions(budget, shares[i], u, values[i]),
            shared: shared.iter().map(|changes| product(changes)).collect(),
        }
    })
}

/// Standard uncertainty of an ink from mixtures, whose covariance is not known.
fn half_width(i: &Interval) -> f64 {
    0.5 * (i.high - i.low) / Z
}

fn contributions(
    budget: &[SourceShare],
    share: fn(&SourceShare) -> f64,
    u: f64,
    value: f64,
) -> Vec<(String, f64)> {
    let relative = 100.0 * u / value.max(f64::MIN_POSITIVE);
    let contribution =
        |source: &SourceShare| (source_name(source).to_owned(), share(source).max(0.0).sqrt() * relative);
    budget.iter().map(contribution).collect()
}

/// Welch and Satterthwaite: u⁴ / Σ uᵢ⁴/νᵢ. The noise of the pixels has the degrees of freedom of the fit, other inputs are
/// of type B or have very many.
fn degrees_of_freedom(budget: &[SourceShare], of_fit: f64, share: fn(&SourceShare) -> f64) -> Option<f64> {
    let noise = budget.iter().find(|s| s.source == ErrorSource::Noise).map(share)?;
    let nu = of_fit / (noise * noise);
    (nu.is_finite() && nu < 1e4).then_some(nu)
}

/// Two-sided 95 % quantile of Student's t, by the expansion of Cornish and Fisher: within 0.002 from ν = 10 on.
fn coverage_factor(nu: Option<f64>) -> f64 {
    let Some(nu) = nu else { return Z };
    let z2 = Z * Z;
    let first = (z2 + 1.0) / 4.0;
    let second = ((5.0 * z2 + 16.0) * z2 + 3.0) / 96.0;
    let third = (((3.0 * z2 + 19.0) * z2 + 17.0) * z2 - 15.0) / 384.0;
    Z * (1.0 + (first + (second + third / nu) / nu) / nu)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Tabulated two-sided quantiles of Student's t.
    #[test]
    fn coverage_factors_are_those_of_student() {
        for (nu, t) in [(10.0, 2.228), (20.0, 2.086), (50.0, 2.009), (100.0, 1.984)] {
            assert!((coverage_factor(Some(nu)) - t).abs() < 2e-3, "{nu}");
        }
        assert_eq!(coverage_factor(None), Z);
    }
}
