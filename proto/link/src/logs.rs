//! Sets up the logs of the programs: text for people or JSON lines for machines, on standard error.

mod patient;

use std::fmt;
use std::io::{IsTerminal, Write};
use std::str::FromStr;
use std::sync::OnceLock;

use tracing_subscriber::filter::{self, LevelFilter, Targets};
use tracing_subscriber::fmt::MakeWriter;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

use patient::Patient;

/// Variable with the filter of the logs, such as `info,farm_coordinator=debug`.
pub const FILTER_VARIABLE: &str = "FARM_LOG";

/// Errors of logging would be printed to standard error, which panics if standard error is what failed.
const LOG_ERRORS_OF_LOGGING: bool = false;

#[derive(Debug, thiserror::Error)]
pub enum LogError {
    #[error("log format `{0}`: `text` or `json` is allowed")]
    Format(String),
    #[error(
        "{FILTER_VARIABLE}=`{filter}`: {source}; allowed are a level (error, warn, info, debug, trace, off) or \
         levels by module, such as `info,farm_coordinator=debug`"
    )]
    Filter { filter: String, source: filter::ParseError },
    #[error(
        "{FILTER_VARIABLE}=`{filter}`: `{word}` is no level; allowed are error, warn, info, debug, trace, off, or \
         levels by module, such as `info,farm_coordinator=debug`"
    )]
    Word { filter: String, word: String },
    #[error("{FILTER_VARIABLE}: is not UTF-8 text")]
    NotText,
    #[error("logs have been set up already")]
    Twice,
}

/// The format of a line of the log.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LogFormat {
    /// For people; in colour on a terminal, unless `NO_COLOR` is set.
    #[default]
    Text,
    /// One object a line, with the fields of the event and of the spans around it.
    Json,
}

impl FromStr for LogFormat {
    type Err = LogError;

    fn from_str(text: &str) -> Result<Self, LogError> {
        match text {
            "text" => Ok(Self::Text),
            "json" => Ok(Self::Json),
            other => Err(LogError::Format(other.to_owned())),
        }
    }
}

impl fmt::Display for LogFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Text => "text",
            Self::Json => "json",
        })
    }
}

/// Writes a line for people to standard error. An output that is full, closed or not read neither ends the program nor
/// blocks it for long.
pub fn to_stderr(line: impl fmt::Display) {
    let _ = standard_error().write_all(format!("{line}\n").as_bytes());
}

/// The only way to write to standard error.
fn standard_error() -> Box<dyn Write> {
    static OUTPUT: OnceLock<Option<Patient>> = OnceLock::new();
    match OUTPUT.get_or_init(|| Patient::new(std::io::stderr())) {
        Some(output) => Box::new(output.clone()),
        None => Box::new(std::io::stderr()),
    }
}

/// Starts logging to standard error with the filter in `FARM_LOG` or, without it, `default_filter`.
pub fn init(format: LogFormat, default_filter: &str) -> Result<(), LogError> {
    let asked = match std::env::var(FILTER_VARIABLE) {
        Ok(filter) => Some(filter),
        Err(std::env::VarError::NotPresent) => None,
        Err(std::env::VarError::NotUnicode(_)) => return Err(LogError::NotText),
    };
    let filter = parse_filter(asked.as_deref(), default_filter)?;
    let no_colour = std::env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty());
    let colour = std::io::stderr().is_terminal() && !no_colour;
    match format {
        LogFormat::Text => text(filter, colour, standard_error).try_init(),
        LogFormat::Json => json(filter, standard_error).try_init(),
    }
    .map_err(|_| LogError::Twice)
}

fn parse_filter(asked: Option<&str>, default_filter: &str) -> Result<Targets, LogError> {
    let filter = asked.map(str::trim).filter(|f| !f.is_empty()).unwrap_or(default_filter);
    // A module without a level would be traced in full, and a misspelt level would count as a module.
    let parts: Vec<&str> = filter.split(',').map(str::trim).filter(|part| !part.is_empty()).collect();
    if let Some(word) = parts.iter().find(|part| !part.contains('=') && part.parse::<LevelFilter>().is_err())
    {
        return Err(LogError::Word { filter: filter.to_owned(), word: (*word).to_owned() });
    }
    parts.join(",").parse().map_err(|source| LogError::Filter { filter: filter.to_owned(), source })
}

fn text<W>(filter: Targets, colour: bool, writer: W) -> impl tracing::Subscriber + Send + Sync
where
    W: for<'a> MakeWriter<'a> + Send + Sync + 'static,
{
    tracing_subscriber::fmt()
        .with_max_level(LevelFilter::TRACE)
        .with_ansi(colour)
        .log_internal_errors(LOG_ERRORS_OF_LOGGING)
        .with_writer(writer)
        .finish()
        .with(filter)
}

/// The list of spans includes the current one, which is therefore not written a second time.
fn json<W>(filter: Targets, writer: W) -> impl tracing::Subscriber + Send + Sync
where
    W: for<'a> MakeWriter<'a> + Send + Sync + 'static,
{
    tracing_subscriber::fmt()
        .json()
        .with_current_span(false)
        .with_span_list(true)
        .with_max_level(LevelFilter::TRACE)
        .log_internal_errors(LOG_ERRORS_OF_LOGGING)
        .with_writer(writer)
        .finish()
        .with(filter)
}

#[cfg(test)]
mod tests {
    use std::fs::File;
    use std::sync::Arc;

    use super::*;

    fn talk() {
        let method = "/farm.v1.Leases/Take";
        let span = tracing::info_span!("rpc", request_id = "r-1", method, caller = tracing::field::Empty);
        let _entered = span.enter();
        span.record("caller", "worker");
        tracing::info!(jobs = 3, "granted\n\u{1b}[31m");
        tracing::debug!("not asked for");
    }

    fn logged(subscriber: impl FnOnce(Arc<File>) -> Box<dyn tracing::Subscriber + Send + Sync>) -> String {
        let page = tempfile::NamedTempFile::new().unwrap();
        tracing::subscriber::with_default(subscriber(Arc::new(page.reopen().unwrap())), talk);
        std::fs::read_to_string(page.path()).unwrap()
    }

    fn info() -> Targets {
        parse_filter(None, "info").unwrap()
    }

    /// A JSON line has the fields of the event and of its spans.
    #[test]
    fn json_line_has_event_and_span_fields() {
        let lines = logged(|page| Box::new(json(info(), page)));
        assert_eq!(lines.lines().count(), 1, "{lines}");
        let line: serde_json::Value = serde_json::from_str(&lines).unwrap();
        assert_eq!(line["level"], "INFO");
        assert_eq!(line["fields"]["jobs"], 3);
        let method = "/farm.v1.Leases/Take";
        for (field, value) in
            [("name", "rpc"), ("request_id", "r-1"), ("method", method), ("caller", "worker")]
        {
            assert_eq!(line["spans"][0][field], value);
        }
    }

    /// Text has the same fields, without colours or control characters.
    #[test]
    fn text_log_has_no_control_characters() {
        let lines = logged(|page| Box::new(text(info(), false, page)));
        for part in ["INFO", "request_id=\"r-1\"", "caller=\"worker\"", "jobs=3"] {
            assert!(lines.contains(part), "{part} is not in {lines}");
        }
        assert!(!lines.contains('\u{1b}') && !lines.contains("not asked for"), "{lines}");
    }

    /// The variable overrides the default, unless it is empty. A wrong filter or format is refused with the allowed values.
    #[test]
    fn wrong_filter_or_format_is_refused() {
        assert_eq!(parse_filter(Some("farm=debug"), "info").unwrap().to_string(), "farm=debug");
        assert_eq!(parse_filter(Some(" "), "info").unwrap().to_string(), "info");
        assert!(parse_filter(Some("WARN, farm_proto=trace,off"), "info").is_ok());
        for (given, begin) in [
            ("farm=loud", "FARM_LOG=`farm=loud`: "),
            ("info, verbose", "FARM_LOG=`info, verbose`: `verbose` is no level; allowed are error"),
        ] {
            let error = parse_filter(Some(given), "info").unwrap_err().to_string();
            assert!(error.starts_with(begin) && error.contains("off"), "{error}");
        }
        let error = "xml".parse::<LogFormat>().unwrap_err().to_string();
        assert_eq!(error, "log format `xml`: `text` or `json` is allowed");
        for format in [LogFormat::Text, LogFormat::Json] {
            assert_eq!(format.to_string().parse::<LogFormat>().unwrap(), format);
        }
    }
}
