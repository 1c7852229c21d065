//! The whole job of the paper: scale factor, common anisotropy, fits, refinement, uncertainty.

use optics_model::fit::{
    Candidate, ChannelFit, Common, FitOptions, FitSettings, Interval, MaterialFit, Mixtures, Objective,
    Unmixed,
};
use optics_model::{Invalid, Measurement};
use rayon::prelude::*;

use crate::dictionary::FitDictionary;
use crate::likelihood;
use crate::measured::{MeasurePlan, Measured, mu_interval};
use crate::paper::common::{Found, Wanted, all_questions, find};
use crate::paper::curves;
use crate::paper::intervals::Z;
use crate::paper::question::Question;
use crate::paper::refine::SCALE;
use crate::paper::scale::scale;
use crate::paper::search;
use crate::paper::shared::{Part, Shared};
use crate::paper::uncertainty::{Analysis, Company};
use crate::surrogate::{G, Surrogate};

/// Measures a set of materials that were photographed in the same set-up.
pub fn measure(
    dictionary: &FitDictionary,
    materials: &[Measurement],
    options: &FitOptions,
    plan: &MeasurePlan,
) -> Result<Measured, Invalid> {
    let by_records = likelihood::objective(options, materials) == Objective::Paper;
    let range = plan.search_mu.filter(|_| by_records);
    let scale = range.map(|range| scale(dictionary, materials, options, &range)).transpose()?;
    Ok(Measured { scale, ..measure_refined(dictionary, materials, options, plan)? })
}

/// The same without the paper's search by records.
pub fn measure_refined(
    dictionary: &FitDictionary,
    materials: &[Measurement],
    options: &FitOptions,
    plan: &MeasurePlan,
) -> Result<Measured, Invalid> {
    if likelihood::objective(options, materials) == Objective::Likelihood {
        return likelihood::measure(dictionary, materials, options, plan);
    }
    let settings = *options.settings();
    let wanted = Wanted {
        mu: plan.search_mu,
        g: plan.common_g && !settings.g.is_fixed() && dictionary.grid().g().len() > 1,
    };
    let set = Set { dictionary, materials, options };
    let mut found = set.find(&wanted)?;
    let mut measured = set.fits(&found, &wanted, None)?;
    if let Some(range) = wanted.mu {
        let (min, max, _) = range.parts();
        // The standard deviation of a factor of which nothing but the range is known, in the logarithm.
        let unknown = (max / min).ln() / 12.0_f64.sqrt();
        let deviation = measured.common.mu_std_error / measured.common.mu;
        if max > min && (deviation == 0.0 || deviation > unknown) {
            let wanted = Wanted { mu: None, ..wanted };
            let mu = 1.0_f64.clamp(min, max);
            let options = options.with_mu(mu, 0.0)?;
            let set = Set { options: &options, ..set };
            found = set.find(&wanted)?;
            measured = set.fits(&found, &wanted, Some(unknown * mu))?;
            measured.common.mu_interval = Interval { low: min, high: max, open_low: true, open_high: true };
        }
        measured.common.mu_chosen = true;
    }
    Ok(measured)
}

/// Finds inks from their own slabs and those of their mixtures together, after all were measured one by one in the same
/// way. It minimises the likelihood's objective, whatever the objective was.
pub fn unmix(
    dictionary: &FitDictionary,
    materials: &[Measurement],
    mixtures: &Mixtures,
    measured: &Measured,
    options: &FitOptions,
    plan: &MeasurePlan,
) -> Result<Unmixed, Invalid> {
    likelihood::unmix(dictionary, materials, mixtures, measured, options, plan)
}

/// What is measured, and with what.
#[derive(Clone, Copy)]
struct Set<'a> {
    dictionary: &'a FitDictionary,
    materials: &'a [Measurement],
    options: &'a FitOptions,
}

impl Set<'_> {
    fn find(&self, wanted: &Wanted) -> Result<Found, Invalid> {
        if wanted.mu.is_none() && !wanted.g {
            return Ok(Found { mu: self.options.settings().mu, g: None, by_g: Vec::new() });
        }
        find(self.dictionary, self.materials, self.options, wanted)
    }

    /// Refined fits of all channels with what was found for all, whose uncertainty they contain.
    fn fits(&self, found: &Found, wanted: &Wanted, mu_std_error: Option<f64>) -> Result<Measured, Invalid> {
        let settings = *self.options.settings();
        let told = if wanted.mu.is_some() { 0.0 } else { settings.mu_std_error };
        let told = mu_std_error.unwrap_or(told);
        let options =
            FitOptions::new(FitSettings { mu: found.mu, mu_std_error: told, refine: true, ..settings })?;
        let options = found.g.map_or(Ok(options), |g| options.with_g(g))?;
        let questions = all_questions(self.dictionary, self.materials, &options)?;
        let searched: Vec<(Vec<Candidate>, Analysis)> = questions
            .par_iter()
            .map(|question| {
                let candidates = search::best(question, settings.top as usize);
                let analysis = Analysis::new(question, &candidates[0]);
                (candidates, analysis)
            })
            .collect();
        let parts: Vec<Part> = searched.iter().map(|(_, analysis)| analysis.part()).collect();
        let searches_mu = wanted.mu.is_some();
        let shared = Shared::new(&parts, [false, false, found.g.is_some(), searches_mu]);
        let at_g = Shared::new(&parts, [false, false, false, searches_mu]);
        let covariance = shared.covariance();
        let deviation = |i: usize| covariance.col(i)[i].max(0.0).sqrt();
        let g_interval = found.g.map(|g| self.g_interval(&questions[0], g, deviation(G)));
        let answer = |(channel, (question, (candidates, analysis))): (
            usize,
            (&Question, (Vec<Candidate>, Analysis)),
        )| {
            let company = Company { channel, shared: &shared, at_g: &at_g, g: g_interval };
            let refined = Some(analysis.refined(Some(&company)));
            let curves = if settings.curves {
                curves::curves(question, &candidates, refined.as_ref())
            } else {
                Vec::new()
            };
            let outside = question.outside();
            ChannelFit { channel: question.name.to_owned(), candidates, refined, outside, curves }
        };
        let numbered: Vec<_> = questions.iter().zip(searched).enumerate().collect();
        let mut answers = numbered.into_par_iter().map(answer).collect::<Vec<_>>().into_iter();
        let material = |m: &Measurement| MaterialFit {
            material: m.material().to_owned(),
            channels: answers.by_ref().take(m.channels().len()).collect(),
        };
        let materials = self.materials.iter().map(material).collect();
        let mu_std_error = if searches_mu { found.mu * deviation(SCALE) } else { told };
        let common = Common {
            mu: found.mu,
            mu_std_error,
            mu_interval: mu_interval(found.mu, mu_std_error, wanted.mu.as_ref()),
            mu_chosen: searches_mu,
            g: found.g.or_else(|| self.only_g()),
            g_interval,
            by_g: found.by_g.clone(),
        };
        Ok(Measured { scale: None, common, materials })
    }

    /// The anisotropy, if there is no choice.
    fn only_g(&self) -> Option<f64> {
        let bounds = self.options.settings().g;
        match self.dictionary.grid().g() {
            _ if bounds.is_fixed() => Some(bounds.min()),
            [only] => Some(*only),
            _ => None,
        }
    }

    /// Linear in ln(1 − g), in which similar media lie on straight lines.
    fn g_interval(&self, question: &Question, g: f64, deviation: f64) -> Interval {
        let (low, high) = Surrogate::new(self.dictionary, question.channel, 0).limits()[G];
        let bounds = self.options.settings().g;
        let (least, greatest) = ((1.0 - high.exp()).max(bounds.min()), (1.0 - low.exp()).min(bounds.max()));
        let end = |side: f64| 1.0 - ((1.0 - g).ln() - side * Z * deviation).exp();
        // A valley without a bottom.
        let unknown = deviation == 0.0;
        let (low, high) = (end(-1.0), end(1.0));
        let (open_low, open_high) = (unknown || low < least, unknown || high > greatest);
        Interval {
            low: if open_low { least } else { low },
            high: if open_high { greatest } else { high },
            open_low,
            open_high,
        }
    }
}
