//! Exit codes, the same for all commands.

use std::process::ExitCode;

use farm_proto::status::{DictionaryState, DictionaryStatus};

/// Some jobs were given up: they could not be computed.
pub(crate) const FAILED: u8 = 3;
/// Some jobs were given up: workers died while they computed them.
pub(crate) const QUARANTINED: u8 = 4;
/// Cancelled, or of another physics version: it does not go on.
pub(crate) const CANCELLED: u8 = 5;
/// The time to wait was over.
pub(crate) const TIMEOUT: u8 = 6;
/// All jobs are done, and machines disagree about some of them: which result is right is not known yet.
pub(crate) const DISPUTED: u8 = 7;
/// Deleted, and perhaps replaced by another one of its name, while it was waited for.
pub(crate) const DELETED: u8 = 8;
/// Stopped by a signal.
pub(crate) const INTERRUPTED: u8 = 130;

/// How a dictionary has ended.
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
