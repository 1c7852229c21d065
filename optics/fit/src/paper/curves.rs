//! The profiles and gradients of a fit, for those who draw them.

use optics_model::fit::{Candidate, Curve, FitCurves, Refined};

use crate::paper::question::{Question, Term};
use crate::paper::refine::Objective;

pub(crate) fn curves(
    question: &Question,
    candidates: &[Candidate],
    refined: Option<&Refined>,
) -> Vec<FitCurves> {
    let sensor = question.dictionary.grid().scene().sensor();
    let objective = refined.map(|r| {
        let objective = Objective::new(question, &r.best);
        let x = objective.start(&r.best.medium);
        (objective, x)
    });
    let curves = |(i, term): (usize, &Term)| FitCurves {
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
        refined: objective.as_ref().map(|(objective, x)| curve(term, objective.predict(term, *x).values)),
    };
    question.terms.iter().enumerate().map(curves).collect()
}

fn curve(term: &Term, values: Vec<f64>) -> Curve {
    Curve { gradient: term.view.slope().shown(&values), values }
}
