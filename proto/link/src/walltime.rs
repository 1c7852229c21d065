//! Reads and writes walltimes in Slurm's forms, and spans of time with units.

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

const MINUTE_S: u64 = 60;
const HOUR_S: u64 = 60 * MINUTE_S;
const DAY_S: u64 = 24 * HOUR_S;
/// Longest walltime: no job runs for longer, and sums below it do not overflow.
const LONGEST_S: u64 = 10 * 365 * DAY_S;

/// A time limit of a Slurm job: above zero, in whole seconds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Walltime {
    seconds: u64,
}

impl Walltime {
    pub fn duration(self) -> Duration {
        Duration::from_secs(self.seconds)
    }

    /// The limit that Slurm applies: it counts in minutes and rounds up.
    pub fn rounded_to_minutes(self) -> Duration {
        Duration::from_secs(self.seconds.next_multiple_of(MINUTE_S))
    }
}

/// Reads Slurm's forms: minutes, MM:SS, HH:MM:SS, D-HH, D-HH:MM and D-HH:MM:SS.
impl FromStr for Walltime {
    type Err = TimeError;

    fn from_str(text: &str) -> Result<Self, TimeError> {
        let seconds = match digits(text) {
            Some(minutes) => minutes.checked_mul(MINUTE_S).ok_or_else(|| TimeError::too_long(text))?,
            None => in_fields(text)?.ok_or_else(|| TimeError::NotAWalltime(text.to_owned()))?,
        };
        Ok(Self { seconds: above_zero(text, within_bounds(text, seconds)?)? })
    }
}

/// Writes D-HH:MM:SS, which Slurm reads as the same time.
impl fmt::Display for Walltime {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let s = self.seconds;
        let (days, hours) = (s / DAY_S, s % DAY_S / HOUR_S);
        write!(f, "{days}-{hours:02}:{:02}:{:02}", s % HOUR_S / MINUTE_S, s % MINUTE_S)
    }
}

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum TimeError {
    #[error("{0:?} is no time: write minutes, MM:SS, HH:MM:SS, D-HH, D-HH:MM or D-HH:MM:SS")]
    NotAWalltime(String),
    #[error(
        "{0:?} is no time: write it with units, as in 90s, 15m, 2h or 1h30m, or as MM:SS, HH:MM:SS or D-HH:MM:SS"
    )]
    NotASpan(String),
    #[error("{text:?} is ambiguous: write {text}s or {text}m")]
    NoUnit { text: String },
    #[error("{text:?} has {value} in the field of {field}: at most {most} is allowed there")]
    Field { text: String, field: &'static str, value: u64, most: u64 },
    #[error("{0:?} is no time to work in: it must be above zero")]
    Zero(String),
    #[error("{0:?} is too long: at most 3650 days are allowed")]
    TooLong(String),
}

impl TimeError {
    fn too_long(text: &str) -> Self {
        Self::TooLong(text.to_owned())
    }
}

/// Reads a span of time: `90s`, `15m`, `2h`, `1d`, `1h30m`, or one of Slurm's forms with colons or days. A bare number
/// is refused, since Slurm would take it for minutes and others for seconds.
pub fn parse_span(text: &str) -> Result<Duration, TimeError> {
    if digits(text).is_some() {
        return Err(TimeError::NoUnit { text: text.to_owned() });
    }
    let seconds = match in_fields(text)? {
        Some(seconds) => seconds,
        None => in_units(text)?,
    };
    Ok(Duration::from_secs(within_bounds(text, seconds)?))
}

/// Reads a span of time above zero.
pub fn parse_time_limit(text: &str) -> Result<Duration, TimeError> {
    let span = parse_span(text)?;
    above_zero(text, span.as_secs())?;
    Ok(span)
}

/// Writes whole seconds as `parse_span` reads them: 5400 s → "1h30m".
pub fn span_text(span: Duration) -> String {
    let s = span.as_secs();
    let parts =
        [(s / DAY_S, 'd'), (s % DAY_S / HOUR_S, 'h'), (s % HOUR_S / MINUTE_S, 'm'), (s % MINUTE_S, 's')];
    let text: String = parts.iter().filter(|(n, _)| *n > 0).map(|(n, unit)| format!("{n}{unit}")).collect();
    if text.is_empty() { "0s".to_owned() } else { text }
}

/// The number, if the text consists of digits only; `u64::MAX` if it is larger.
fn digits(text: &str) -> Option<u64> {
    let all = !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit());
    all.then(|| text.parse().unwrap_or(u64::MAX))
}

fn within_bounds(text: &str, seconds: u64) -> Result<u64, TimeError> {
    if seconds > LONGEST_S { Err(TimeError::too_long(text)) } else { Ok(seconds) }
}

fn above_zero(text: &str, seconds: u64) -> Result<u64, TimeError> {
    if seconds == 0 { Err(TimeError::Zero(text.to_owned())) } else { Ok(seconds) }
}

/// Seconds of a text in fields: [D-]HH:MM:SS and its short forms. None if it has another form.
fn in_fields(text: &str) -> Result<Option<u64>, TimeError> {
    let (days, rest) = match text.split_once('-') {
        Some((days, rest)) => (digits(days), rest),
        None => (Some(0), text),
    };
    let fields: Option<Vec<u64>> = rest.split(':').map(digits).collect();
    let (Some(days), Some(fields)) = (days, fields) else { return Ok(None) };
    let after_days = text.contains('-');
    // The first field may be of any size, except hours that follow days.
    let (hours, minutes, seconds) = match (after_days, fields.as_slice()) {
        (true, &[hours]) => (hours, 0, 0),
        (true, &[hours, minutes]) => (hours, field(text, "minutes", minutes, 59)?, 0),
        (false, &[minutes, seconds]) => (0, minutes, field(text, "seconds", seconds, 59)?),
        (_, &[hours, minutes, seconds]) => {
            (hours, field(text, "minutes", minutes, 59)?, field(text, "seconds", seconds, 59)?)
        }
        _ => return Ok(None),
    };
    let hours = if after_days { field(text, "hours", hours, 23)? } else { hours };
    sum(text, &[(days, DAY_S), (hours, HOUR_S), (minutes, MINUTE_S), (seconds, 1)]).map(Some)
}

fn field(text: &str, field: &'static str, value: u64, most: u64) -> Result<u64, TimeError> {
    if value > most { Err(TimeError::Field { text: text.to_owned(), field, value, most }) } else { Ok(value) }
}

/// Seconds of numbers with units, from the largest unit to the smallest, each at most once.
fn in_units(text: &str) -> Result<u64, TimeError> {
    let wrong = || TimeError::NotASpan(text.to_owned());
    let mut rest = text;
    let mut parts = Vec::new();
    let mut last_unit_s = u64::MAX;
    while !rest.is_empty() {
        let end = rest.find(|c: char| !c.is_ascii_digit()).ok_or_else(wrong)?;
        let number = digits(&rest[..end]).ok_or_else(wrong)?;
        let unit_s = match rest.as_bytes()[end] {
            b'd' => DAY_S,
            b'h' => HOUR_S,
            b'm' => MINUTE_S,
            b's' => 1,
            _ => return Err(wrong()),
        };
        if unit_s >= last_unit_s {
            return Err(wrong());
        }
        last_unit_s = unit_s;
        parts.push((number, unit_s));
        rest = &rest[end + 1..];
    }
    if parts.is_empty() { Err(wrong()) } else { sum(text, &parts) }
}

fn sum(text: &str, parts: &[(u64, u64)]) -> Result<u64, TimeError> {
    parts
        .iter()
        .try_fold(0_u64, |sum, &(number, unit_s)| sum.checked_add(number.checked_mul(unit_s)?))
        .ok_or_else(|| TimeError::too_long(text))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn slurm_seconds(text: &str) -> Result<u64, TimeError> {
        text.parse::<Walltime>().map(|w| w.duration().as_secs())
    }

    /// Every form of Slurm is read. Times that Slurm would refuse or read differently are refused.
    #[test]
    fn times_are_read_as_slurm_does() {
        let cases = "90 5400, 90:30 5430, 0:01:00 60, 30:00:00 108000, 1-2 93600, 1-02:03 93780, 2-23:59:59 259199, \
                     0-00:02:00 120";
        for case in cases.split(", ") {
            let (text, seconds) = case.split_once(' ').unwrap();
            assert_eq!(slurm_seconds(text), Ok(seconds.parse().unwrap()), "{text}");
        }
        for text in ",-,1-,-5,1:2:3:4,1-2:3:4:5,a,1:b, 5,5 ,+5,1.5,１,2h,1-1-1".split(',') {
            assert!(matches!(slurm_seconds(text), Err(TimeError::NotAWalltime(_))), "{text}");
        }
        for text in ["1:60", "0:60:00", "1-24", "1-0:60", "1-0:0:60"] {
            assert!(matches!(slurm_seconds(text), Err(TimeError::Field { .. })), "{text}");
        }
        for text in ["0", "0:00", "0-0"] {
            assert_eq!(slurm_seconds(text), Err(TimeError::Zero(text.to_owned())), "{text}");
        }
        for text in ["99999999999999999999", "3651-0", "18446744073709551615-0", "5256001"] {
            assert_eq!(slurm_seconds(text), Err(TimeError::TooLong(text.to_owned())), "{text}");
        }
    }

    /// Spans of time are read with units and in fields; other forms are refused.
    #[test]
    fn spans_accept_units_and_fields() {
        let cases =
            "90s 90,15m 900,2h 7200,1h30m 5400,1d 86400,0s 0,90m5s 5405,1:00 60,1-00:00:01 86401,1-12 129600";
        for case in cases.split(',') {
            let (text, seconds) = case.split_once(' ').unwrap();
            assert_eq!(parse_span(text), Ok(Duration::from_secs(seconds.parse().unwrap())), "{text}");
        }
        let ambiguous = parse_span("90").unwrap_err().to_string();
        assert_eq!(ambiguous, r#""90" is ambiguous: write 90s or 90m"#);
        for text in ",s,h1,1h2h,30m1h,1.5h,1 h,-5s,5ms,5é,5s5,1:00s,99é".split(',') {
            assert_eq!(parse_span(text), Err(TimeError::NotASpan(text.to_owned())), "{text}");
        }
        for text in ["99999999999999999999s", "9999999999999999999d", "87601h"] {
            assert_eq!(parse_span(text), Err(TimeError::TooLong(text.to_owned())), "{text}");
        }
        for text in ["0s", "0:00"] {
            assert_eq!(parse_time_limit(text), Err(TimeError::Zero(text.to_owned())));
        }
    }

    /// Walltimes and spans of time are written as they are read.
    #[test]
    fn times_round_trip() {
        for seconds in (1..200_000).step_by(37).chain([LONGEST_S]) {
            let walltime = Walltime { seconds };
            assert_eq!(walltime.to_string().parse(), Ok(walltime));
        }
        for seconds in (0..400_000).step_by(41) {
            let span = Duration::from_secs(seconds);
            assert_eq!(parse_span(&span_text(span)), Ok(span));
        }
        assert_eq!(span_text(Duration::from_mins(90)), "1h30m");
        let walltime = |text: &str| text.parse::<Walltime>().unwrap();
        assert_eq!(walltime("1500").to_string(), "1-01:00:00");
        assert_eq!(
            ["0:01:01", "0:02:00"].map(|text| walltime(text).rounded_to_minutes().as_secs()),
            [120; 2]
        );
    }
}
