//! Reports the state of each job of a dictionary.

use farm_proto::ids::DictionaryId;
use farm_proto::status::JobState;

use super::Schedule;
use super::job::{Job, Stage};

impl Schedule {
    /// The states of all jobs of a dictionary, in their order; none if there is no such dictionary.
    pub fn job_states(&self, id: DictionaryId) -> Vec<JobState> {
        let Some(dictionary) = self.by_id(id) else { return Vec::new() };
        let mut states: Vec<JobState> = dictionary.jobs.iter().map(state).collect();
        for part in self.leases.of_dictionary(id) {
            if let Some(state @ JobState::Waiting) = states.get_mut(part.job as usize) {
                *state = JobState::Computing;
            }
        }
        states
    }
}

fn state(job: &Job) -> JobState {
    match &job.stage {
        Stage::Open { .. } => JobState::Waiting,
        Stage::Done(done) if done.verified => JobState::Checked,
        Stage::Done(_) => JobState::Done,
        Stage::GivenUp { .. } => JobState::Failed,
    }
}
