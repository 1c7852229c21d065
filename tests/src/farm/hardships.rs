//! Sets up environments with faults: a log without a reader, little memory.

use super::Farm;
use crate::memory_group::MemoryGroup;

impl Farm {
    /// From its next start on, the coordinator's log is a pipe without a reader.
    pub fn abandon_log(&mut self) {
        self.log_abandoned = true;
    }

    /// Runs programs of this farm that start from now on in a control group.
    pub fn limit_memory(&mut self, group: MemoryGroup) {
        self.surroundings.memory = Some(group);
    }

    /// The control group of this farm's programs, if there is one.
    pub fn memory(&self) -> Option<&MemoryGroup> {
        self.surroundings.memory.as_ref()
    }
}
