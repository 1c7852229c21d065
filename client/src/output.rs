//! Prints results: tables for people, and JSON in one stable envelope for programs.

mod lines;
mod status;
mod terminal;

use std::fmt::Write as _;
use std::path::Path;

use farm_lab::document::{Block, ValueTable};
use farm_lab::measurement_file::{MeasurementFile, Note, read_measurements};
use farm_link::logs::to_stderr;
use farm_proto::status::DictionaryStatus;
use optics_model::Invalid;
use serde::Serialize;

pub(crate) use farm_lab::whole_file::write_whole;
pub(crate) use lines::lines;
pub(crate) use status::{DictionaryJson, WorkerJson};
pub(crate) use terminal::print_line;
use terminal::{harmless, with_escapes};

/// Version of the JSON shapes: fields may be added to a version, never changed or removed.
const API: &str = "farmctl/1";

#[derive(Debug, Serialize)]
struct Envelope<'a, T> {
    api: &'static str,
    kind: &'a str,
    data: T,
}

/// The format of results: text or JSON.
#[derive(Debug)]
pub(crate) struct Output {
    json: bool,
}

impl Output {
    pub(crate) fn new(json: bool) -> Self {
        Self { json }
    }

    pub(crate) fn is_json(&self) -> bool {
        self.json
    }

    /// Prints `data` in the envelope with `--json`, else the text.
    pub(crate) fn print<T: Serialize>(
        &self,
        kind: &str,
        data: &T,
        text: impl FnOnce() -> String,
    ) -> anyhow::Result<()> {
        let line = if self.json { envelope(kind, data)? } else { text() };
        print_line(&line)
    }

    /// Prints `data` in the envelope with `--json`, else the blocks as lines.
    pub(crate) fn answer<T: Serialize>(
        &self,
        kind: &str,
        data: &T,
        blocks: impl FnOnce() -> Vec<Block>,
    ) -> anyhow::Result<()> {
        self.print(kind, data, || lines(&blocks()))
    }

    /// Reads measurements and prints their notes.
    pub(crate) fn read_measurements(&self, path: &Path) -> anyhow::Result<MeasurementFile> {
        let file = read_measurements(path)?;
        self.notes(&file.notes, path);
        Ok(file)
    }

    /// Prints notes on a file on standard error, unless the answer is JSON, which contains them.
    pub(crate) fn notes(&self, notes: &[Note], path: &Path) {
        if !self.json {
            for note in notes {
                to_stderr(format_args!("farmctl: note: {}: {}", path.display(), note.text));
            }
        }
    }

    pub(crate) fn error(&self, error: &anyhow::Error) {
        let message = sentence(error);
        if self.json {
            let invalid = error.chain().find_map(|cause| cause.downcast_ref::<Invalid>());
            let data = match invalid {
                Some(invalid) => {
                    serde_json::json!({ "message": message, "field": invalid.field(), "allowed": invalid.allowed() })
                }
                None => serde_json::json!({ "message": message }),
            };
            let line = envelope("error", &data).unwrap_or_default();
            if print_line(&line).is_ok() {
                return;
            }
        }
        to_stderr(format_args!("farmctl: {message}"));
    }
}

/// One line: the envelope with its data.
pub(crate) fn envelope<T: Serialize>(kind: &str, data: &T) -> anyhow::Result<String> {
    let text = serde_json::to_string(&Envelope { api: API, kind, data })?;
    // All remaining invisible characters are within strings, where JSON has an escape for them.
    Ok(with_escapes(&text, |c| format!("\\u{:04x}", c as u32)))
}

/// The message of work that has panicked.
pub(crate) const INTERNAL_ERROR: &str = "internal error of farmctl: please report it with this request";

/// The chain of causes as one sentence; of a gRPC status only the message is used.
pub(crate) fn sentence(error: &anyhow::Error) -> String {
    let mut text = String::new();
    for cause in error.chain() {
        let part = match cause.downcast_ref::<tonic::Status>() {
            Some(status) => status.message().to_owned(),
            None => cause.to_string(),
        };
        let part = part.trim_end();
        // Some errors repeat their cause in their own text.
        if !text.ends_with(part) {
            let _ = write!(text, "{}{part}", if text.is_empty() { "" } else { ": " });
        }
        // A status made by the transport on this side has a source with the cause.
        if cause.is::<tonic::Status>() && cause.source().is_none() {
            break;
        }
    }
    harmless(&text)
}

/// Whether the reader of standard output has gone, as in `farmctl export … | head`. A broken connection to a farm has
/// the same error at its root, but does not count.
pub(crate) fn is_closed_pipe(error: &anyhow::Error) -> bool {
    let ours = error.chain().take_while(|c| !c.is::<tonic::Status>() && !c.is::<tonic::transport::Error>());
    ours.filter_map(|cause| cause.downcast_ref::<std::io::Error>())
        .any(|io| io.kind() == std::io::ErrorKind::BrokenPipe)
}

/// A text in yellow on a terminal; output to a file or a pipe has no colours.
pub(crate) fn warning(text: &str) -> String {
    format!("\u{1b}[33m{text}\u{1b}[0m")
}

/// A line of text in lines of at most 80 columns; units stay with their numbers.
pub(crate) fn wrapped(text: &str) -> String {
    let mut words: Vec<String> = Vec::new();
    for word in text.split(' ') {
        let unit = ["%", "mm", "σ", "±", "/"].iter().any(|unit| word.starts_with(unit));
        match words.last_mut() {
            Some(number)
                if number.ends_with('±') || (unit && number.ends_with(|c: char| c.is_ascii_digit())) =>
            {
                *number += &format!(" {word}");
            }
            _ => words.push(word.to_owned()),
        }
    }
    let mut lines = vec![String::new()];
    for word in &words {
        let last = lines.last_mut().expect("there is a line");
        let wide = last.chars().count() + 1 + word.chars().count() > 80;
        if last.is_empty() || !wide {
            let space = if last.is_empty() { "" } else { " " };
            *last += space;
            *last += word;
        } else {
            lines.push(format!("  {word}"));
        }
    }
    lines.join("\n")
}

/// The lines of a table, whose head is that of [`ValueTable::new`].
pub(crate) fn table(head: &str, rows: impl IntoIterator<Item = Vec<String>>) -> String {
    lines(&[ValueTable::new(head, rows).block()])
}

/// 34276 → "34,276".
pub(crate) fn grouped(n: u64) -> String {
    let digits = n.to_string();
    let mut text = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

/// 75 s → "1 min 15 s".
pub(crate) fn duration(d: std::time::Duration) -> String {
    let s = d.as_secs_f64().round() as u64;
    match s {
        0 => format!("{} ms", d.as_millis()),
        1..60 => format!("{s} s"),
        60..3600 => format!("{} min {} s", s / 60, s % 60),
        _ => format!("{} h {} min", s / 3600, s % 3600 / 60),
    }
}

/// Share of a dictionary's work that is done, as in "36.2 % of the work". Work is proportional to time, unlike the
/// number of records, so that it determines the remaining time.
pub(crate) fn share_of_work(work_done: f64) -> String {
    // Rounded down, so that unfinished work is never shown as done.
    let tenths = (1000.0 * work_done).floor();
    format!("{:.1} %", tenths / 10.0)
}

/// A time as "2026-11-21T09:30:00Z".
pub(crate) fn utc(unix_ms: u64) -> String {
    jiff::Timestamp::from_second((unix_ms / 1000) as i64)
        .map_or_else(|_| unix_ms.to_string(), |t| t.to_string())
}

/// A count with its noun, as in "1 worker" and "1,000 workers".
pub(crate) fn counted(n: u64, what: &str) -> String {
    format!("{} {what}{}", grouped(n), if n == 1 { "" } else { "s" })
}

/// Seconds since 1970.
#[expect(clippy::disallowed_methods, reason = "certificates hold from now on")]
pub(crate) fn now_unix_s() -> i64 {
    let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    since.map_or(0, |d| d.as_secs() as i64)
}

/// The state of a dictionary, as in "done, 2 disputed".
pub(crate) fn state(status: &DictionaryStatus) -> String {
    match (
        if status.is_interrupted() { "interrupted" } else { status.state().as_str() },
        status.jobs_disputed,
    ) {
        (state, 0) => state.to_owned(),
        (state, disputed) => format!("{state}, {disputed} disputed"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_stays_with_its_number() {
        let text = format!("{} 0.512 mm is, 3 % and 0.4 ± 0.1 σ", "word ".repeat(15).trim_end());
        let wrapped = wrapped(&text);
        assert!(wrapped.contains("\n  0.512 mm is, 3 % and 0.4 ± 0.1 σ"), "{wrapped}");
        assert_eq!(super::wrapped("a b"), "a b");
    }

    /// Numbers have separators, and durations have two units.
    #[test]
    fn numbers_and_times_are_grouped() {
        assert_eq!(
            [0, 999, 1000, 34_276, 1_000_000].map(grouped),
            ["0", "999", "1,000", "34,276", "1,000,000"]
        );
        let message = [0.25, 59.0, 75.0, 7260.0].map(|s| duration(std::time::Duration::from_secs_f64(s)));
        assert_eq!(message, ["250 ms", "59 s", "1 min 15 s", "2 h 1 min"]);
    }

    /// Characters that are not visible are escaped in JSON.
    #[test]
    fn json_escapes_invisible_characters() {
        let line = envelope("x", &"a\u{202e}b\u{9b}c\u{1b}\n").unwrap();
        assert!(line.contains(r"a\u202eb\u009bc\u001b\n"), "{line}");
        let back: serde_json::Value = serde_json::from_str(&line).unwrap();
        assert_eq!(back["data"], "a\u{202e}b\u{9b}c\u{1b}\n");
    }

    #[test]
    fn only_our_own_pipe_counts_as_closed() {
        let broken = || std::io::Error::from(std::io::ErrorKind::BrokenPipe);
        assert!(is_closed_pipe(&anyhow::Error::new(broken()).context("writing")));
        let status = tonic::Status::from_error(Box::new(broken()));
        assert!(!is_closed_pipe(&anyhow::Error::new(status)));
    }

    #[test]
    fn causes_become_one_sentence_without_repetition() {
        let error = anyhow::anyhow!("file: not there").context("reading").context("grid file: reading");
        assert_eq!(sentence(&error), "grid file: reading: file: not there");
        let status = anyhow::Error::new(tonic::Status::not_found("dictionary x does not exist"));
        assert_eq!(sentence(&status), "dictionary x does not exist");
    }
}
