//! Progress of a dictionary on standard error: a bar on a terminal, plain lines elsewhere.

use std::io::IsTerminal;
use std::time::Duration;

use farm_proto::status::DictionaryStatus;
use indicatif::{ProgressBar, ProgressStyle};

use crate::output::{duration, grouped};

/// Time between plain lines.
const LINE: Duration = Duration::from_secs(10);

/// Tells records done, their rate since the start, and when the rest will be done at the farm's present pace.
#[derive(Debug)]
pub(crate) struct Progress {
    look: Look,
    start: tokio::time::Instant,
    records_at_start: usize,
}

#[derive(Debug)]
enum Look {
    Bar(ProgressBar),
    Lines { last: Option<tokio::time::Instant> },
    Nothing,
}

impl Progress {
    pub(crate) fn new(first: &DictionaryStatus, quiet: bool) -> Self {
        let look = if quiet {
            Look::Nothing
        } else if std::io::stderr().is_terminal() {
            let bar = ProgressBar::new(first.records_total() as u64);
            let style = ProgressStyle::with_template("{prefix} [{wide_bar}] {percent}%  {msg}");
            bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()).progress_chars("=> "));
            bar.set_prefix(first.name.to_string());
            Look::Bar(bar)
        } else {
            Look::Lines { last: None }
        };
        Self { look, start: tokio::time::Instant::now(), records_at_start: first.records_done() }
    }

    pub(crate) fn show(&mut self, status: &DictionaryStatus) {
        let text = self.text(status);
        match &mut self.look {
            Look::Bar(bar) => {
                bar.set_position(status.records_done() as u64);
                bar.set_message(text);
            }
            Look::Lines { last } => {
                if last.is_none_or(|last| last.elapsed() >= LINE) {
                    *last = Some(tokio::time::Instant::now());
                    eprintln!("{}: {text}", status.name);
                }
            }
            Look::Nothing => {}
        }
    }

    /// Takes the bar away.
    pub(crate) fn end(&self) {
        if let Look::Bar(bar) = &self.look {
            bar.finish_and_clear();
        }
    }

    fn text(&self, status: &DictionaryStatus) -> String {
        let (done, total) = (status.records_done(), status.records_total());
        let count = format!("{} of {} records", grouped(done as u64), grouped(total as u64));
        let elapsed = self.start.elapsed();
        // Before the first jobs are back there is nothing to measure a rate with.
        let Some(left) = status.eta_s.filter(|_| elapsed >= Duration::from_secs(1)) else { return count };
        let rate = (done - self.records_at_start) as f64 / elapsed.as_secs_f64();
        format!("{count}, {rate:.0} records/s, {} left", duration(Duration::from_secs_f64(left)))
    }
}
