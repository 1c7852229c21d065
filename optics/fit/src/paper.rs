//! Evaluates the paper's equations over the records of a dictionary: the exact search of Eq. 1, the scale factor of
//! Eq. 3, maps of the distance, and similar media.

pub(crate) mod map;
mod measure;
mod question;
pub(crate) mod scale;
mod search;

use optics_model::fit::{Candidate, ChannelFit, Curve, FitCurves, FitOptions, MaterialFit};
use optics_model::{Invalid, Measurement};
use rayon::prelude::*;

use crate::dictionary::FitDictionary;
pub(crate) use measure::measure;
use question::{ComparedProfile, Question, questions};

/// The best records of every channel of a measurement, jointly over its thicknesses.
pub(crate) fn fit(
    dictionary: &FitDictionary,
    measurement: &Measurement,
    options: &FitOptions,
) -> Result<MaterialFit, Invalid> {
    let questions = questions(dictionary, measurement, options)?;
    let channels = match questions.as_slice() {
        // A single channel is not worth waking other threads for.
        [one] => vec![answer(one)],
        several => several.par_iter().map(answer).collect(),
    };
    Ok(MaterialFit { material: measurement.material().to_owned(), channels })
}

fn answer(question: &Question) -> ChannelFit {
    let settings = question.options.settings();
    let candidates = search::best(question, settings.top as usize);
    let curves = if settings.curves { curves(question, &candidates) } else { Vec::new() };
    let outside = question.outside();
    ChannelFit { channel: question.name.to_owned(), candidates, refined: None, outside, curves }
}

fn curves(question: &Question, candidates: &[Candidate]) -> Vec<FitCurves> {
    let sensor = question.dictionary.grid().scene().sensor();
    let curves = |(i, term): (usize, &ComparedProfile)| FitCurves {
        thickness_mm: question.dictionary.grid().thickness_mm()[term.thickness],
        x_mm: term.view.pixels().map(|pixel| sensor.centre_mm(pixel)).collect(),
        measured: curve(term, term.values.clone()),
        candidates: candidates
            .iter()
            .filter_map(|c| c.thicknesses[i].record)
            .map(|record| {
                let (values, _) = term.view.profile(record);
                curve(term, values.iter().copied().map(f64::from).collect())
            })
            .collect(),
        refined: None,
        residuals: Vec::new(),
        left_out: Vec::new(),
    };
    question.terms.iter().enumerate().map(curves).collect()
}

fn curve(term: &ComparedProfile, values: Vec<f64>) -> Curve {
    Curve { gradient: term.view.slope().shown(&values), values }
}
