//! Parses bounds, on the command line and of the page: `0.4`, `0.2..0.6`, `4..`, `..8`.

use std::str::FromStr;

use optics_model::fit::Bounds;
use serde::Deserialize;

/// One value or a range, as given.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(try_from = "String")]
pub(crate) struct BoundsArg {
    min: Option<f64>,
    max: Option<f64>,
}

impl FromStr for BoundsArg {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let number = |part: &str| -> Result<Option<f64>, String> {
            if part.is_empty() {
                return Ok(None);
            }
            let value: f64 = part.trim().parse().map_err(|_| format!("{part:?} is not a number"))?;
            if value.is_finite() { Ok(Some(value)) } else { Err(format!("{value} is not a finite number")) }
        };
        match text.split_once("..") {
            Some(("", "")) => Err("one end at least is needed, as in 4..8, 4.. or ..8".to_owned()),
            Some((min, max)) => Ok(Self { min: number(min)?, max: number(max)? }),
            None => {
                let value = number(text)?.ok_or("a number or a range is needed, as in 0.4 or 0.2..0.6")?;
                Ok(Self { min: Some(value), max: Some(value) })
            }
        }
    }
}

impl TryFrom<String> for BoundsArg {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl BoundsArg {
    /// The one value that was given; None for a range.
    pub(crate) fn held(&self) -> Option<f64> {
        self.min.filter(|_| self.min == self.max)
    }

    /// The checked bounds; free if nothing was given.
    pub(crate) fn check(arg: Option<Self>, field: &str) -> optics_model::Result<Bounds> {
        arg.map_or(Ok(Bounds::FREE), |b| Bounds::new(field, b.min, b.max))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_and_ranges_are_read() {
        let read = |text: &str| BoundsArg::check(Some(text.parse().unwrap()), "g").unwrap();
        assert!(read("0.4").is_fixed());
        assert_eq!((read("-0.2..0.6").min(), read("-0.2..0.6").max()), (-0.2, 0.6));
        assert_eq!((read("4..").min(), read("4..").max()), (4.0, f64::INFINITY));
        assert_eq!(read("..8").min(), f64::NEG_INFINITY);
        for bad in ["", "..", "x", "1..y", "inf", "1..NaN"] {
            assert!(bad.parse::<BoundsArg>().is_err(), "{bad}");
        }
        let wrong: BoundsArg = "8..4".parse().unwrap();
        assert_eq!(BoundsArg::check(Some(wrong), "g").unwrap_err().field(), "g");
    }
}
