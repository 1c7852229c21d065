//! Session files: what all measurements of one session share, as JSON.

use std::path::Path;

use anyhow::{Context, Result};
use optics_model::Invalid;
use optics_model::measurement::colour;
use serde_json::{Map, Value};

use crate::bounded_file;
use crate::measurement_file::plain;

/// The `format` of the files that are understood.
const FORMAT: &str = "farmctl-session/1";

/// Largest file that is read, in bytes.
const LARGEST: u64 = 1 << 20;

/// A value for all channels, or one for each that is named.
#[derive(Debug, Clone, PartialEq)]
pub enum ByChannel {
    All(f64),
    Named(Vec<(String, f64)>),
}

impl ByChannel {
    /// The value if it is the same for all channels.
    pub fn common(&self) -> Option<f64> {
        match self {
            Self::All(value) => Some(*value),
            Self::Named(_) => None,
        }
    }

    /// The value of a channel, whatever the spelling of its colour.
    pub fn of(&self, channel: &str) -> Option<f64> {
        let Self::Named(values) = self else { return self.common() };
        let same_colour = |name: &str| colour(name).is_some() && colour(name) == colour(channel);
        let exact = values.iter().find(|(name, _)| name == channel);
        exact.or_else(|| values.iter().find(|(name, _)| same_colour(name))).map(|(_, value)| *value)
    }
}

/// The values of a session file.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Session {
    pub gain_std_error: Option<f64>,
    /// Of the gain that all profiles share: that of the white reference.
    pub mu_std_error: Option<f64>,
    pub offset_std_error: Option<f64>,
    pub slope_std_error: Option<f64>,
    pub thickness_std_error_mm: Option<f64>,
    pub origin_std_error_mm: Option<f64>,
    pub blur_mm: Option<ByChannel>,
    pub blur_std_error_mm: Option<ByChannel>,
}

impl Session {
    pub fn read(path: &Path) -> Result<Self> {
        let place = || format!("session file {}", path.display());
        let bytes = bounded_file::read(path, LARGEST).with_context(place)?;
        let text = plain(&bytes).with_context(place)?;
        let value: Value = serde_json::from_str(&text).with_context(place)?;
        Self::parse(&value).with_context(place)
    }

    /// Unknown fields are ignored: they are for other programs.
    fn parse(value: &Value) -> Result<Self, Invalid> {
        let Value::Object(fields) = value else {
            return Err(Invalid::new("session", kind(value), "a JSON object is wanted"));
        };
        match fields.get("format") {
            Some(Value::String(format)) if format == FORMAT => {}
            given => {
                let given = given.map_or("nothing".to_owned(), ToString::to_string);
                return Err(Invalid::new("format", given, format!("allowed is \"{FORMAT}\"")));
            }
        }
        let one = |name: &str| present(fields, name).map(|value| number(name, value)).transpose();
        let by_channel = |name: &str| present(fields, name).map(|value| by_channel(name, value)).transpose();
        Ok(Self {
            gain_std_error: one("gain_std_error")?,
            mu_std_error: one("mu_std_error")?,
            offset_std_error: one("offset_std_error")?,
            slope_std_error: one("slope_std_error")?,
            thickness_std_error_mm: one("thickness_std_error_mm")?,
            origin_std_error_mm: one("origin_std_error_mm")?,
            blur_mm: by_channel("blur_mm")?,
            blur_std_error_mm: by_channel("blur_std_error_mm")?,
        })
    }
}

/// The value of a field; null counts as absent.
fn present<'a>(fields: &'a Map<String, Value>, name: &str) -> Option<&'a Value> {
    fields.get(name).filter(|value| !value.is_null())
}

fn number(field: &str, value: &Value) -> Result<f64, Invalid> {
    match value.as_f64() {
        Some(v) if (0.0..=1.0).contains(&v) => Ok(v),
        Some(v) => Err(Invalid::new(field, v, "allowed are 0 to 1")),
        None => Err(Invalid::new(field, kind(value), "allowed are numbers from 0 to 1")),
    }
}

fn by_channel(field: &str, value: &Value) -> Result<ByChannel, Invalid> {
    match value {
        Value::Object(channels) => {
            let of = |(name, value): (&String, &Value)| {
                Ok((name.clone(), number(&format!("{field}.{name}"), value)?))
            };
            channels
                .iter()
                .filter(|(_, v)| !v.is_null())
                .map(of)
                .collect::<Result<_, _>>()
                .map(ByChannel::Named)
        }
        Value::Number(_) => number(field, value).map(ByChannel::All),
        _ => {
            let allowed = "allowed are numbers from 0 to 1, or an object of these by the channels' names";
            Err(Invalid::new(field, kind(value), allowed))
        }
    }
}

/// A value in few words.
fn kind(value: &Value) -> String {
    match value {
        Value::Array(_) => "a list".to_owned(),
        Value::Object(_) => "an object".to_owned(),
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Session, Invalid> {
        Session::parse(&serde_json::from_str(text).unwrap())
    }

    /// The fields of the set-up are read. Those of other programs may be there, too.
    #[test]
    fn unknown_fields_of_a_session_are_ignored() {
        let session = parse(
            r#"{"format": "farmctl-session/1", "gain_std_error": 0.01, "offset_std_error": 0, "slope_std_error": null,
                "thickness_std_error_mm": 0.002, "origin_std_error_mm": 0.004, "camera": {"name": "x"},
                "blur_mm": {"red": 0.025, "G": 0.024}, "blur_std_error_mm": 0.001}"#,
        )
        .unwrap();
        let blur = session.blur_mm.clone().unwrap();
        assert_eq!([blur.of("R"), blur.of("G"), blur.of("B")], [Some(0.025), Some(0.024), None]);
        let expected = Session {
            gain_std_error: Some(0.01),
            mu_std_error: None,
            offset_std_error: Some(0.0),
            slope_std_error: None,
            thickness_std_error_mm: Some(0.002),
            origin_std_error_mm: Some(0.004),
            blur_mm: Some(blur),
            blur_std_error_mm: Some(ByChannel::All(0.001)),
        };
        assert_eq!(session, expected);
        assert_eq!(parse(r#"{"format": "farmctl-session/1"}"#).unwrap(), Session::default());
    }

    #[test]
    fn invalid_fields_are_refused_with_the_allowed_values() {
        let with = |field: &str| {
            parse(&format!(r#"{{"format": "farmctl-session/1", {field}}}"#)).unwrap_err().to_string()
        };
        for (field, message) in [
            (r#""gain_std_error": -1"#, "gain_std_error = -1 is not valid: allowed are 0 to 1"),
            (
                r#""slope_std_error": "small""#,
                "slope_std_error = \"small\" is not valid: allowed are numbers from 0 to 1",
            ),
            (
                r#""origin_std_error_mm": {"R": 0.1}"#,
                "origin_std_error_mm = an object is not valid: allowed are numbers from 0 to 1",
            ),
            (r#""blur_mm": {"R": 0.02, "G": 2}"#, "blur_mm.G = 2 is not valid: allowed are 0 to 1"),
            (
                r#""blur_std_error_mm": [0.1]"#,
                "blur_std_error_mm = a list is not valid: allowed are numbers from 0 to 1, or an object of these by \
                 the channels' names",
            ),
        ] {
            assert_eq!(with(field), message);
        }
        let refused = |text: &str| parse(text).unwrap_err().to_string();
        let format = "is not valid: allowed is \"farmctl-session/1\"";
        assert_eq!(refused("{}"), format!("format = nothing {format}"));
        assert_eq!(
            refused(r#"{"format": "farmctl-session/2"}"#),
            format!("format = \"farmctl-session/2\" {format}")
        );
        assert_eq!(refused("[]"), "session = a list is not valid: a JSON object is wanted");
    }
}
