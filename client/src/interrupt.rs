//! Handles Ctrl-C, SIGTERM and SIGHUP for commands that need to clean up.

use farm_link::signals::termination;

/// A signal stopped the command before its work was done.
#[derive(Debug, thiserror::Error)]
#[error("interrupted")]
pub(crate) struct Interrupted;

/// Ends when the process is requested to stop. A second signal exits immediately, without waiting for the clean-up.
pub(crate) async fn interrupted() {
    termination().await;
    tokio::spawn(async {
        termination().await;
        std::process::exit(crate::exit::INTERRUPTED.into());
    });
}
