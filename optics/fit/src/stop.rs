//! Cancels queries by unwinding: a cancelled query panics with a private payload, without invoking the panic hook, and
//! the panic is caught where the query began. Rayon propagates it from its threads to the calling thread.
//!
//! A query runs on several threads, deep in loops. With an error for cancellation every function there would return a
//! `Result`.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Cancels a question whose answer is no longer awaited. Copies cancel the same question.
#[derive(Debug, Clone, Default)]
pub struct Stop(Arc<AtomicBool>);

/// The question was stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stopped;

impl Stop {
    pub fn stop(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Unwinds from the question if it was stopped. At every call shared state must be consistent.
    pub(super) fn check(&self) {
        if self.0.load(Ordering::Relaxed) {
            resume_unwind(Box::new(Stopped));
        }
    }

    /// Answers a question, unless it is stopped before.
    pub(super) fn guard<T>(&self, question: impl FnOnce() -> T) -> Result<T, Stopped> {
        let answered = catch_unwind(AssertUnwindSafe(|| {
            self.check();
            question()
        }));
        answered.map_err(|unwound: Box<dyn Any + Send>| match unwound.downcast::<Stopped>() {
            Ok(stopped) => *stopped,
            Err(panic) => resume_unwind(panic),
        })
    }
}

#[cfg(test)]
mod tests {
    use optics_model::fit::{FitOptions, FitSettings, MuRange, Objective};
    use optics_model::{Invalid, Measurement};

    use super::*;
    use crate::testing::{dense_axes, noisy_dictionary, noisy_measurement};
    use crate::{FitDictionary, MeasurePlan, distance_map, fit, measure, scale};

    type Question = fn(&FitDictionary, &Measurement, &FitOptions) -> Result<(), Invalid>;

    const QUESTIONS: [(&str, Question); 4] = [
        ("fit", |d, m, o| fit(d, m, o).map(drop)),
        ("map", |d, m, o| distance_map(d, m, o).map(drop)),
        ("scale", |d, m, o| scale(d, std::slice::from_ref(m), o, &MuRange::default()).map(drop)),
        ("measure", |d, m, o| {
            let plan = MeasurePlan { search_mu: Some(MuRange::default()), ..MeasurePlan::default() };
            measure(d, std::slice::from_ref(m), o, &plan).map(drop)
        }),
    ];

    /// Every kind of question checks whether it was stopped, under both objectives.
    #[test]
    fn every_question_ends_when_it_is_stopped() {
        let measurement = noisy_measurement((3.0, 0.75, 0.3), 1, true);
        for objective in [Objective::Paper, Objective::Likelihood] {
            let settings = FitSettings { objective: Some(objective), ..FitSettings::default() };
            let options = FitOptions::new(settings).unwrap();
            for (name, question) in QUESTIONS {
                let dictionary = noisy_dictionary(dense_axes(), 90, 0.01);
                let stop = Stop::default();
                let answered = dictionary.ask(&stop, |d| {
                    stop.stop();
                    question(d, &measurement, &options)
                });
                assert_eq!(answered, Err(Stopped), "{name}, {objective:?}");
            }
        }
    }

    /// A question is answered unless it is stopped, and other panics propagate.
    #[test]
    fn stop_ends_questions_and_panics_pass() {
        let dictionary = || noisy_dictionary(dense_axes(), 30, 0.0);
        assert_eq!(dictionary().ask(&Stop::default(), |_| 3), Ok(3));
        let stop = Stop::default();
        stop.stop();
        assert_eq!(dictionary().ask(&stop, |_| 3), Err(Stopped));
        let panicking = || dictionary().ask(&Stop::default(), |_| resume_unwind(Box::new("a bug")));
        let panic = catch_unwind(AssertUnwindSafe(|| panicking().map(|()| {}))).unwrap_err();
        assert_eq!(panic.downcast_ref(), Some(&"a bug"));
    }
}
