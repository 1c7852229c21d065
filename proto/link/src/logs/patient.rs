//! Writes to an output with a time limit: a pipe that is not read and a stopped terminal stop no program.

use std::io::Write;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::Duration;

/// Time limit for writing a line, after which the program continues without it.
const PATIENCE: Duration = Duration::from_secs(1);
/// Largest number of lines that wait for a blocked output; further ones are dropped.
const WAITING_LINES: usize = 1000;

/// A line, and the sender that drops when it is written.
type QueuedLine = (Vec<u8>, SyncSender<()>);

/// Writes lines in a separate thread. While the output takes them, each is written when `write` returns, so that lines
/// keep their order with other outputs and none is lost at the end of the program.
#[derive(Debug, Clone)]
pub(super) struct Patient {
    lines: SyncSender<QueuedLine>,
    stuck: Arc<AtomicBool>,
}

impl Patient {
    /// None if no further thread can be started.
    pub(super) fn new(output: impl Write + Send + 'static) -> Option<Self> {
        let (lines, queue) = sync_channel(WAITING_LINES);
        let stuck = Arc::new(AtomicBool::new(false));
        let writer = {
            let stuck = stuck.clone();
            move || write_all(output, &queue, &stuck)
        };
        std::thread::Builder::new().name("log".to_owned()).spawn(writer).ok()?;
        Some(Self { lines, stuck })
    }
}

/// Ignores errors of the output: there is no other place to report them.
fn write_all(mut output: impl Write, queue: &Receiver<QueuedLine>, stuck: &AtomicBool) {
    for (line, _written) in queue {
        let _ = output.write_all(&line);
        stuck.store(false, Ordering::Relaxed);
    }
}

impl Write for Patient {
    fn write(&mut self, line: &[u8]) -> std::io::Result<usize> {
        let (written, wait) = sync_channel(0);
        let queued = self.lines.try_send((line.to_vec(), written)).is_ok();
        if queued
            && !self.stuck.load(Ordering::Relaxed)
            && wait.recv_timeout(PATIENCE) == Err(RecvTimeoutError::Timeout)
        {
            self.stuck.store(true, Ordering::Relaxed);
        }
        Ok(line.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::io::{Read as _, pipe};

    use tokio::time::Instant;

    use super::*;

    /// More than a pipe holds.
    const LONG: usize = 1 << 20;

    /// A line that was written has arrived at the reader; without a reader, writing succeeds.
    #[test]
    fn written_lines_have_arrived() {
        let (mut reader, writer) = pipe().unwrap();
        let mut patient = Patient::new(writer).unwrap();
        patient.write_all(b"one\n").unwrap();
        patient.write_all(b"two\n").unwrap();
        let mut text = [0; 8];
        reader.read_exact(&mut text).unwrap();
        assert_eq!(&text, b"one\ntwo\n");
        drop(reader);
        (0..3).for_each(|_| patient.write_all(b"line\n").unwrap());
    }

    /// An output that accepts nothing does not delay the writer for long.
    #[test]
    fn blocked_output_delays_no_writer() {
        let (mut reader, writer) = pipe().unwrap();
        let mut patient = Patient::new(writer).unwrap();
        let start = Instant::now();
        patient.write_all(&vec![b'-'; LONG]).unwrap();
        for _ in 0..2 * WAITING_LINES {
            patient.write_all(b"line\n").unwrap();
        }
        assert!(start.elapsed() < 5 * PATIENCE, "{:?}", start.elapsed());
        let mut text = vec![0; LONG + 5 * WAITING_LINES];
        reader.read_exact(&mut text).unwrap();
        assert!(text.ends_with(b"line\nline\n"));
    }
}
