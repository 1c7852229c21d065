//! The profiles that a dictionary predicts for a medium: question and answer.

use serde::Serialize;

use super::PixelRow;
use crate::invalid::{Invalid, Result};
use crate::medium::{Medium, check_ior, check_thickness};
use crate::scene::MAX_CHANNELS;

/// A question for the profiles of a slab of this medium over the edge.
#[derive(Debug, Clone, PartialEq)]
pub struct ProfileQuestion {
    medium: Medium,
    thickness_mm: f64,
    sample_ior: Option<f64>,
    channels: Vec<String>,
}

impl ProfileQuestion {
    /// `sample_ior` is one of the dictionary's; none for its first. An empty list of channels selects the dictionary's
    /// first.
    pub fn new(
        medium: Medium,
        thickness_mm: f64,
        sample_ior: Option<f64>,
        channels: Vec<String>,
    ) -> Result<Self> {
        check_thickness(thickness_mm)?;
        if let Some(ior) = sample_ior {
            check_ior("sample_ior", ior)?;
        }
        if channels.len() > MAX_CHANNELS {
            let allowed = format!("at most {MAX_CHANNELS} are allowed");
            return Err(Invalid::new("channels", channels.len(), allowed));
        }
        Ok(Self { medium, thickness_mm, sample_ior, channels })
    }

    pub fn medium(&self) -> &Medium {
        &self.medium
    }

    pub fn thickness_mm(&self) -> f64 {
        self.thickness_mm
    }

    pub fn sample_ior(&self) -> Option<f64> {
        self.sample_ior
    }

    pub fn channels(&self) -> &[String] {
        &self.channels
    }
}

/// The profiles of a slab as a dictionary predicts them.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PredictedProfiles {
    #[serde(flatten)]
    pub medium: Medium,
    pub thickness_mm: f64,
    pub sample_ior: f64,
    /// Whether the dictionary has a record of this medium and thickness; otherwise it lies between records. In either
    /// case the values come from the model, which averages the noise of neighbouring records.
    pub recorded: bool,
    pub pixels: PixelRow,
    pub channels: Vec<PredictedChannel>,
}

/// A number for each pixel.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PredictedChannel {
    pub channel: String,
    /// Radiance factors.
    pub values: Vec<f64>,
    /// Standard errors of the values due to the records' noise, at the nearest of the dictionary's thicknesses; none if
    /// too few records are near.
    pub std_errors: Option<Vec<f64>>,
    /// Derivatives of the values by x in 1/mm, by the paper's wavelet, half a pixel to the right of each pixel's centre.
    pub gradient: Vec<f64>,
}
