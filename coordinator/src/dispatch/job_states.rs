//! How far each job of a dictionary is.

use farm_proto::ids::DictionaryId;
use farm_proto::status::JobState;

use super::job::{Job, Stage};
use super::{Dispatcher, Purpose};

impl Dispatcher {
    /// The states of all jobs of a dictionary, in their order; none if there is no such dictionary.
    pub fn job_states(&self, id: DictionaryId) -> Vec<JobState> {
        let Some(dictionary) = self.dictionaries.get(&id) else { return Vec::new() };
        let mut states: Vec<JobState> = dictionary.jobs.iter().map(state).collect();
        for (part, held) in self.leases.of_dictionary(id) {
            if held != Purpose::Check
                && let Some(state @ JobState::Waiting) = states.get_mut(part.job as usize)
            {
                *state = JobState::Computing;
            }
        }
        for ((_, job), by) in self.confirmed.range((id, 0)..=(id, u32::MAX)) {
            if !by.is_empty()
                && let Some(state @ JobState::Done) = states.get_mut(*job as usize)
            {
                *state = JobState::Checked;
            }
        }
        states
    }
}

fn state(job: &Job) -> JobState {
    match &job.stage {
        Stage::Open { .. } => JobState::Waiting,
        Stage::Done { .. } => JobState::Done,
        Stage::GivenUp { .. } => JobState::Failed,
    }
}
