//! Numerics of the fit over plain slices: no SQL, no gRPC.
//!
//! Eqs. 1 to 6 of Elek, Sumin et al. 2017 (supplement, Secs. 5.5 and 6.1), and what goes beyond them: refinement
//! between the records of the dictionary, and error bars.

mod channel;
mod common;
mod curves;
mod design;
mod dictionary;
mod gradient;
mod interpolation;
mod intervals;
mod layers;
mod likelihood;
mod local_axis;
mod map;
mod measure;
mod measured;
mod noise;
mod place;
mod profile;
mod question;
mod records;
mod refine;
mod resample;
mod scale;
mod search;
mod shared;
mod similarity;
mod sketch;
mod stop;
mod sum;
mod surrogate;
mod suspicion;
#[cfg(test)]
mod testing;
mod thickness;
mod uncertainty;
mod view;
mod wide;

use optics_model::fit::{ChannelFit, FitOptions, MaterialFit, Objective};
use optics_model::{Invalid, Measurement};
use rayon::prelude::*;

pub use design::design;
pub use dictionary::{DictionaryBuilder, FitChannel, FitDictionary};
pub use gradient::{derivative, shown_derivative};
pub use likelihood::objective;
pub use map::distance_map;
pub use measure::{measure, measure_refined, unmix};
pub use measured::{MeasurePlan, Measured};
pub use profile::profile;
pub use question::channels_called;
pub use scale::scale;
pub use similarity::similar;
pub use stop::{Stop, Stopped};

use question::{Question, questions};
use uncertainty::Analysis;

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

fn answer(question: &Question) -> ChannelFit {
    let settings = question.options.settings();
    let candidates = search::best(question, settings.top as usize);
    let refined = settings.refine.then(|| Analysis::new(question, &candidates[0]).refined(None));
    let curves =
        if settings.curves { curves::curves(question, &candidates, refined.as_ref()) } else { Vec::new() };
    ChannelFit { channel: question.name.to_owned(), candidates, refined, outside: question.outside(), curves }
}
