//! Numerics of the fit over plain slices: no SQL, no gRPC.
//!
//! Eqs. 1 to 6 of Elek, Sumin et al. 2017 (supplement, Secs. 5.5 and 6.1), and what goes beyond them: refinement
//! between the records of the dictionary, and error bars.

mod design;
mod dictionary;
mod likelihood;
mod measure;
mod measured;
mod paper;
mod profile;
mod stop;
mod surrogate;
#[cfg(test)]
mod testing;

use optics_model::fit::{ChannelFit, DistanceMap, FitOptions, MaterialFit, Objective};
use optics_model::{Invalid, Measurement};
use rayon::prelude::*;

pub use design::design;
pub use dictionary::axes::channels_called;
pub use dictionary::gradient::{derivative, shown_derivative};
pub use dictionary::{DictionaryBuilder, FitChannel, FitDictionary};
pub use likelihood::objective;
pub use measure::{measure, measure_refined, unmix};
pub use measured::{MeasurePlan, Measured};
pub use paper::scale::scale;
pub use paper::similarity::similar;
pub use profile::profile;
pub use stop::{Stop, Stopped};

use paper::question::{Question, questions};
use paper::uncertainty::Analysis;

/// Fits every channel of a measurement on its own, jointly over its thicknesses.
pub fn fit(
    dictionary: &FitDictionary,
    measurement: &Measurement,
    options: &FitOptions,
) -> Result<MaterialFit, Invalid> {
    if likelihood::objective(options, [measurement]) == Objective::Likelihood {
        return likelihood::fit(dictionary, measurement, options);
    }
    let questions = questions(dictionary, measurement, options)?;
    let channels = match questions.as_slice() {
        // Not worth waking other threads for.
        [one] => vec![answer(one)],
        several => several.par_iter().map(answer).collect(),
    };
    Ok(MaterialFit { material: measurement.material().to_owned(), channels })
}

/// One map per channel of a measurement, over every admissible medium: the error of Eq. 1, or for the likelihood the root
/// mean square of the residuals over their noise, with the set-up at its likeliest.
pub fn distance_map(
    dictionary: &FitDictionary,
    measurement: &Measurement,
    options: &FitOptions,
) -> Result<Vec<DistanceMap>, Invalid> {
    if likelihood::objective(options, [measurement]) == Objective::Likelihood {
        return likelihood::distance_map(dictionary, measurement, options);
    }
    Ok(questions(dictionary, measurement, options)?.iter().map(paper::map::map).collect())
}

fn answer(question: &Question) -> ChannelFit {
    let settings = question.options.settings();
    let candidates = paper::search::best(question, settings.top as usize);
    let refined = settings.refine.then(|| Analysis::new(question, &candidates[0]).refined(None));
    let curves = if settings.curves {
        paper::curves::curves(question, &candidates, refined.as_ref())
    } else {
        Vec::new()
    };
    ChannelFit { channel: question.name.to_owned(), candidates, refined, outside: question.outside(), curves }
}
