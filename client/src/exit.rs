//! Exit codes, the same for all commands.

use std::process::ExitCode;

use farm_proto::status::{DictionaryState, DictionaryStatus};

/// Some jobs were given up: they could not be computed.
pub(crate) const FAILED: u8 = 3;
/// Some jobs were given up: workers died while they computed them.
pub(crate) const QUARANTINED: u8 = 4;
/// Cancelled, or of another physics version: it will not be continued.
pub(crate) const CANCELLED: u8 = 5;
/// The timeout has passed.
pub(crate) const TIMEOUT: u8 = 6;
/// All jobs are done, but machines disagree about some of them: the correct result is not known yet.
pub(crate) const DISPUTED: u8 = 7;
/// Deleted, and perhaps replaced by another dictionary of the same name, while the command waited.
pub(crate) const DELETED: u8 = 8;
/// The measurement is answered, but not kept with the farm.
pub(crate) const NOT_KEPT: u8 = 9;
/// Stopped by a signal.
pub(crate) const INTERRUPTED: u8 = 130;

/// The exit code for the state of a dictionary.
pub(crate) fn code_of(status: &DictionaryStatus) -> ExitCode {
    ExitCode::from(number_of(status))
}

pub(crate) fn number_of(status: &DictionaryStatus) -> u8 {
    match status.state() {
        DictionaryState::Done if status.jobs_disputed > 0 => DISPUTED,
        DictionaryState::Done | DictionaryState::Running | DictionaryState::Paused => 0,
        DictionaryState::Failed if status.has_quarantined() => QUARANTINED,
        DictionaryState::Failed => FAILED,
        DictionaryState::Cancelled | DictionaryState::Outdated => CANCELLED,
    }
}
