//! Shows the progress of a dictionary on standard error: a bar on a terminal, optionally with the jobs as cells; plain
//! lines elsewhere.

mod cells;

use std::ffi::OsStr;
use std::io::IsTerminal;
use std::time::Duration;

use console::Term;
use farm_link::logs::to_stderr;
use farm_proto::status::DictionaryStatus;
use indicatif::{ProgressBar, ProgressStyle};

use crate::output::{duration, grouped, share_of_work};
pub(crate) use cells::Cells;

/// Time between plain lines.
const LINE: Duration = Duration::from_secs(10);

/// Resolution of the bar.
const STEPS: u64 = 10_000;

/// Whether standard error is a terminal on which lines can be overwritten.
pub(crate) fn has_bars() -> bool {
    std::io::stderr().is_terminal() && moves_cursor(std::env::var_os("TERM").as_deref())
}

fn moves_cursor(term: Option<&OsStr>) -> bool {
    term.is_some_and(|term| !term.is_empty() && term != "dumb")
}

/// Prints the done share of the work, and the remaining time at the farm's current pace.
#[derive(Debug)]
pub(crate) struct Progress {
    look: BarLook,
}

#[derive(Debug)]
enum BarLook {
    /// A bar, and the text below it.
    Bar(ProgressBar, String),
    Lines {
        last: Option<tokio::time::Instant>,
    },
    Nothing,
}

impl Progress {
    pub(crate) fn new(first: &DictionaryStatus, quiet: bool) -> Self {
        let look = if quiet {
            BarLook::Nothing
        } else if has_bars() {
            let bar = ProgressBar::new(STEPS);
            let style = ProgressStyle::with_template("{prefix} [{wide_bar}] {msg}");
            bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()).progress_chars("=> "));
            bar.set_prefix(first.name.to_string());
            BarLook::Bar(bar, String::new())
        } else {
            BarLook::Lines { last: None }
        };
        Self { look }
    }

    /// Whether nothing is shown.
    pub(crate) fn is_quiet(&self) -> bool {
        matches!(self.look, BarLook::Nothing)
    }

    /// Whether cells can be shown.
    pub(crate) fn has_room(&self) -> bool {
        matches!(self.look, BarLook::Bar(..))
    }

    /// Shows the jobs below the bar.
    pub(crate) fn show_cells(&mut self, cells: &Cells) {
        if let BarLook::Bar(bar, below) = &mut self.look {
            let width = usize::from(Term::stderr().size().1);
            let text = bar.message();
            let text = text.strip_suffix(below.as_str()).unwrap_or(&text).to_owned();
            *below = format!("\n{}\n{}", cells.lines(width).join("\n"), cells::LEGEND);
            bar.set_message(text + below);
        }
    }

    pub(crate) fn show(&mut self, status: &DictionaryStatus) {
        let text = text(status);
        match &mut self.look {
            BarLook::Bar(bar, below) => {
                bar.set_position((status.work_done * STEPS as f64) as u64);
                bar.set_message(text + below);
            }
            BarLook::Lines { last } => {
                if last.is_none_or(|last| last.elapsed() >= LINE) {
                    *last = Some(tokio::time::Instant::now());
                    to_stderr(format_args!("{}: {text}", status.name));
                }
            }
            BarLook::Nothing => {}
        }
    }

    /// Prints a line on standard error, above the bar; also without progress.
    pub(crate) fn print(&self, line: &str) {
        match &self.look {
            BarLook::Bar(bar, _) => bar.suspend(|| to_stderr(line)),
            BarLook::Lines { .. } | BarLook::Nothing => to_stderr(line),
        }
    }

    /// Removes the bar.
    pub(crate) fn end(&self) {
        if let BarLook::Bar(bar, _) = &self.look {
            bar.finish_and_clear();
        }
    }
}

/// Share of the work, number of records, and the remaining time if it is known.
fn text(status: &DictionaryStatus) -> String {
    let (done, total) = (status.records_done(), status.records_total());
    let mut text = format!(
        "{} of the work, {} of {} records",
        share_of_work(status.work_done),
        grouped(done as u64),
        grouped(total as u64)
    );
    if let Some(first) = &status.goes_first {
        text += &format!(", {first} goes first");
    }
    if let Some(left) = status.eta_s {
        text += &format!(", about {} left", duration(Duration::from_secs_f64(left)));
    }
    text
}

#[cfg(test)]
mod tests {
    use farm_proto::DictionaryName;
    use optics_model::Grid;

    use super::*;

    #[test]
    fn terminal_without_a_cursor_gets_lines() {
        assert!(moves_cursor(Some(OsStr::new("xterm"))));
        assert!(!moves_cursor(Some(OsStr::new("dumb"))) && !moves_cursor(Some(OsStr::new(""))));
        assert!(!moves_cursor(None));
    }

    /// The progress is the share of the work, and a dictionary that waits names its reason.
    #[test]
    fn progress_shows_work_and_reason_to_wait() {
        let mut status = DictionaryStatus {
            grid: Grid::paper(),
            jobs_done: 418,
            work_done: 0.3629,
            eta_s: None,
            goes_first: Some(DictionaryName::new("coarse").unwrap()),
            ..crate::testing::dictionary(false)
        };
        assert_eq!(text(&status), "36.2 % of the work, 17,138 of 34,276 records, coarse goes first");
        (status.goes_first, status.eta_s) = (None, Some(75.0));
        assert_eq!(text(&status), "36.2 % of the work, 17,138 of 34,276 records, about 1 min 15 s left");
    }
}
