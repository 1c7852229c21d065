//! Waits for signals that request the end of a program.

use tokio::signal::unix::{Signal, SignalKind, signal};

/// Returns when the process is to end: on Ctrl-C (SIGINT), SIGTERM, or SIGHUP, which comes when a terminal is closed or
/// a connection to it is lost. A SIGHUP that was ignored when the process started, as by `nohup`, stays ignored.
pub async fn termination() {
    let hangup = (!ignores(SignalKind::hangup())).then_some(SignalKind::hangup());
    let kinds = [Some(SignalKind::interrupt()), Some(SignalKind::terminate()), hangup];
    let [mut interrupt, mut terminate, mut hangup] =
        kinds.map(|kind| kind.and_then(|kind| signal(kind).ok()));
    tokio::select! {
        () = comes(&mut interrupt) => {}
        () = comes(&mut terminate) => {}
        () = comes(&mut hangup) => {}
    }
}

async fn comes(signal: &mut Option<Signal>) {
    match signal {
        Some(signal) => {
            signal.recv().await;
        }
        None => std::future::pending().await,
    }
}

/// Whether this process ignores a signal, as set by its parent.
fn ignores(kind: SignalKind) -> bool {
    std::fs::read_to_string("/proc/self/status").is_ok_and(|status| is_ignored(&status, kind.as_raw_value()))
}

/// Reads the mask in the status of a process: `SigIgn:\t0000000000001001`.
fn is_ignored(status: &str, signal: i32) -> bool {
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    mask.is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The signal mask of a process lists the signals that it ignores.
    #[test]
    fn signal_mask_lists_ignored_signals() {
        let status = "Name:\tfarm-worker\nSigBlk:\t0000000000000001\nSigIgn:\t0000000000001001\n";
        assert!(is_ignored(status, 1) && is_ignored(status, 13));
        assert!(!is_ignored(status, 15) && !is_ignored("", 1));
    }
}
