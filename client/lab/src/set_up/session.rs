//! Reads session files in JSON: the set-up that all measurements of one session share.

use std::path::Path;

use anyhow::{Context, Result};
use optics_model::measurement::colour;
use optics_model::quantities::{Form, Quantity};
use optics_model::scene::PriorKind;
use optics_model::{Invalid, with_quantities};
use serde_json::{Map, Value};

use crate::bounded_file;
use crate::measurement_file::plain;

/// The supported `format` of session files.
const FORMAT: &str = "farmctl-session/1";

/// Largest file that is read, in bytes: 32 bands of a hundred slabs with their media have a tenth of it.
const LARGEST: u64 = 256 << 20;

/// A value for all channels, or one for each named channel.
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

    /// The value of a channel; colours match in any spelling.
    pub fn of(&self, channel: &str) -> Option<f64> {
        let Self::Named(values) = self else { return self.common() };
        let same_colour = |name: &str| colour(name).is_some() && colour(name) == colour(channel);
        let exact = values.iter().find(|(name, _)| name == channel);
        exact.or_else(|| values.iter().find(|(name, _)| same_colour(name))).map(|(_, value)| *value)
    }
}

macro_rules! session {
    ($($name:ident $row:tt)+) => {
        /// The contents of a session file, or the values of the command line that replace them.
        #[derive(Debug, Clone, Default, PartialEq)]
        pub struct Session {
            /// Standard error of the gain that all profiles share: that of the white reference.
            pub mu_std_error: Option<f64>,
            /// Measured values with their standard errors, in the order of [`PriorKind::OF_SESSION`].
            pub measured: [Option<[f64; 2]>; PriorKind::OF_SESSION.len()],
            $(pub $name: Option<ByChannel>,)+
        }

        impl Session {
            /// The quantities, in the order of their table.
            pub fn values(&self) -> impl Iterator<Item = (&'static Quantity, Option<&ByChannel>)> {
                Quantity::OF_OPTIONS.iter().zip([$(self.$name.as_ref()),+])
            }

            pub(super) fn values_mut(&mut self) -> impl Iterator<Item = (&'static Quantity, &mut Option<ByChannel>)> {
                Quantity::OF_OPTIONS.iter().zip([$(&mut self.$name),+])
            }

            /// These values; those of the other where there is none.
            #[must_use]
            pub fn or(self, other: Self) -> Self {
                Self {
                    mu_std_error: self.mu_std_error.or(other.mu_std_error),
                    measured: std::array::from_fn(|i| self.measured[i].or(other.measured[i])),
                    $($name: self.$name.or(other.$name),)+
                }
            }
        }
    };
}

with_quantities!(options session);

impl Session {
    pub fn read(path: &Path) -> Result<Self> {
        let place = || format!("session file {}", path.display());
        let bytes = bounded_file::read(path, LARGEST).with_context(place)?;
        let text = plain(&bytes).with_context(place)?;
        let value: Value = serde_json::from_str(&text).with_context(place)?;
        Self::parse(&value).with_context(place)
    }

    /// Unknown fields are ignored: they belong to other programs.
    fn parse(value: &Value) -> Result<Self, Invalid> {
        let Value::Object(fields) = value else {
            return Err(Invalid::new("session", kind(value), "must be a JSON object"));
        };
        match fields.get("format") {
            Some(Value::String(format)) if format == FORMAT => {}
            given => {
                let given = given.map_or("nothing".to_owned(), ToString::to_string);
                return Err(Invalid::new("format", given, format!("allowed is \"{FORMAT}\"")));
            }
        }
        let mu_std_error = present(fields, "mu_std_error");
        let mut session = Self {
            mu_std_error: mu_std_error.map(|v| number("mu_std_error", v, (0.0, 1.0))).transpose()?,
            ..Self::default()
        };
        for (kind, measured) in PriorKind::OF_SESSION.into_iter().zip(&mut session.measured) {
            let (key, range) = kind.session_key();
            *measured = present(fields, key).map(|given| read_measured(key, given, range)).transpose()?;
        }
        for (quantity, value) in session.values_mut() {
            *value = present(fields, quantity.name).map(|given| read_value(quantity, given)).transpose()?;
        }
        Ok(session)
    }
}

/// The value of a field; null counts as absent.
fn present<'a>(fields: &'a Map<String, Value>, name: &str) -> Option<&'a Value> {
    fields.get(name).filter(|value| !value.is_null())
}

fn number(field: &str, value: &Value, (lowest, highest): (f64, f64)) -> Result<f64, Invalid> {
    match value.as_f64() {
        Some(v) if (lowest..=highest).contains(&v) => Ok(v),
        Some(v) => Err(Invalid::new(field, v, format!("allowed are {lowest} to {highest}"))),
        None => {
            Err(Invalid::new(field, kind(value), format!("allowed are numbers from {lowest} to {highest}")))
        }
    }
}

/// A value with its standard error.
fn read_measured(field: &str, given: &Value, [low, high]: [f64; 2]) -> Result<[f64; 2], Invalid> {
    let Value::Object(fields) = given else {
        let allowed = "an object with value and std_error is needed";
        return Err(Invalid::new(field, kind(given), allowed));
    };
    let part = |name: &str, range: (f64, f64)| {
        number(&format!("{field}.{name}"), fields.get(name).unwrap_or(&Value::Null), range)
    };
    Ok([part("value", (low, high))?, part("std_error", (1e-6, 1.0))?])
}

fn read_value(quantity: &Quantity, value: &Value) -> Result<ByChannel, Invalid> {
    let (field, range) = (quantity.name, (quantity.lowest, quantity.highest));
    match value {
        Value::Object(channels) if quantity.form == Form::PerChannel => {
            let named_value = |(name, value): (&String, &Value)| {
                Ok((name.clone(), number(&format!("{field}.{name}"), value, range)?))
            };
            let values = channels.iter().filter(|(_, v)| !v.is_null()).map(named_value);
            values.collect::<Result<_, _>>().map(ByChannel::Named)
        }
        Value::Number(_) => number(field, value, range).map(ByChannel::All),
        _ if quantity.form == Form::PerChannel => {
            let (lowest, highest) = range;
            let allowed = format!(
                "allowed are numbers from {lowest} to {highest}, or an object of these by the channels' names"
            );
            Err(Invalid::new(field, kind(value), allowed))
        }
        _ => number(field, value, range).map(ByChannel::All),
    }
}

/// A short description of a value for error messages.
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

    /// The fields of the set-up are read; fields of other programs are ignored.
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
            gain_std_error: Some(ByChannel::All(0.01)),
            offset_std_error: Some(ByChannel::All(0.0)),
            thickness_std_error_mm: Some(ByChannel::All(0.002)),
            origin_std_error_mm: Some(ByChannel::All(0.004)),
            blur_mm: Some(blur),
            blur_std_error_mm: Some(ByChannel::All(0.001)),
            ..Session::default()
        };
        assert_eq!(session, expected);
        assert_eq!(parse(r#"{"format": "farmctl-session/1"}"#).unwrap(), Session::default());
    }

    /// Invalid fields are refused with the allowed values.
    #[test]
    fn invalid_fields_are_refused_with_range() {
        for (text, message) in [
            (r#"FORMAT, "gain_std_error": -1}"#, "gain_std_error = -1 is not valid: allowed are 0 to 1"),
            (r#"FORMAT, "slope_std_error": "small"}"#, "slope_std_error = \"small\" NUMBERS"),
            (r#"FORMAT, "origin_std_error_mm": {"R": 0.1}}"#, "origin_std_error_mm = an object NUMBERS"),
            (r#"FORMAT, "blur_mm": {"R": 0.02, "G": 2}}"#, "blur_mm.G = 2 is not valid: allowed are 0 to 1"),
            (
                r#"FORMAT, "blur_std_error_mm": [0.1]}"#,
                "blur_std_error_mm = a list NUMBERS, or an object of these by the channels' names",
            ),
            ("{}", "format = nothing is not valid: allowed is \"farmctl-session/1\""),
            (
                r#"{"format": "farmctl-session/2"}"#,
                "format = \"farmctl-session/2\" is not valid: allowed is \"farmctl-session/1\"",
            ),
            ("[]", "session = a list is not valid: must be a JSON object"),
        ] {
            let refused = parse(&text.replace("FORMAT", r#"{"format": "farmctl-session/1""#)).unwrap_err();
            let numbers = "is not valid: allowed are numbers from 0 to 1";
            assert_eq!(refused.to_string(), message.replace("NUMBERS", numbers));
        }
    }
}
