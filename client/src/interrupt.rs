//! Ctrl-C, SIGTERM and SIGHUP, for the commands that have something to clean up.

use farm_link::signals::termination;

/// The command was stopped by a signal before it had done its work.
#[derive(Debug, thiserror::Error)]
#[error("interrupted")]
pub(crate) struct Interrupted;

/// Ends when the process is asked to stop. Who asks a second time does not want to wait for what is then cleaned up.
pub(crate) async fn interrupted() {
    termination().await;
    tokio::spawn(async {
        termination().await;
        std::process::exit(crate::exit::INTERRUPTED.into());
    });
}
