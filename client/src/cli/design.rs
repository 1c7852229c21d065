//! Arguments of `design`.

use std::path::PathBuf;
use std::str::FromStr;

use clap::Args;
use farm_lab::set_up::SetUp;
use optics_model::fit::{DesignQuestion, DesignSettings, FitOptions, FitSettings, PixelRow};
use optics_model::{Invalid, Medium};

use super::set_up::{SET_UP, SetUpArgs};

/// Headings of the help.
const MEDIUM: &str = "Guess of the medium";
const PHOTOGRAPHS: &str = "Photographs to compare";

#[derive(Debug, Args)]
pub struct DesignArgs {
    /// Dictionary to predict the profiles from [default: the only one, or paper].
    #[arg(long, value_name = "NAME")]
    pub dictionary: Option<String>,
    /// Extinction coefficient, per mm.
    #[arg(long, value_name = "PER_MM", allow_negative_numbers = true, help_heading = MEDIUM)]
    pub sigma_t: f64,
    /// Single-scattering albedo.
    #[arg(long, allow_negative_numbers = true, help_heading = MEDIUM)]
    pub albedo: f64,
    /// Anisotropy.
    #[arg(long, allow_negative_numbers = true, help_heading = MEDIUM)]
    pub g: f64,
    /// Refractive index of the sample [default: the dictionary's first].
    #[arg(long, value_name = "N", allow_negative_numbers = true, help_heading = MEDIUM)]
    pub sample_ior: Option<f64>,
    /// Channel of the camera [default: the dictionary's first].
    #[arg(long, value_name = "NAME", help_heading = MEDIUM)]
    pub channel: Option<String>,
    /// Thicknesses in mm of one set of slabs, as in 0.5,1; give it once for each set [default: all sets of one to three
    /// of the dictionary's thicknesses].
    #[arg(long, value_name = "LIST", allow_hyphen_values = true, help_heading = PHOTOGRAPHS)]
    pub slabs: Vec<SlabList>,
    /// Photographs of each slab; every number is tried with every set.
    #[arg(
        long,
        value_name = "LIST",
        value_delimiter = ',',
        default_value = "1,2",
        help_heading = PHOTOGRAPHS
    )]
    pub shots: Vec<u32>,
    /// Standard error of one pixel of one photograph, as a share of its value.
    #[arg(
        long,
        value_name = "SHARE",
        default_value_t = 0.01,
        allow_negative_numbers = true,
        help_heading = PHOTOGRAPHS
    )]
    pub noise: f64,
    /// Standard error of a dark pixel of one photograph, as a radiance factor.
    #[arg(
        long,
        value_name = "ERROR",
        default_value_t = 0.0005,
        allow_negative_numbers = true,
        help_heading = PHOTOGRAPHS
    )]
    pub noise_floor: f64,
    /// Pixels of the camera in mm: left end of the first, right end of the last, pitch, as in -4,4,0.02 [default: the
    /// dictionary's].
    #[arg(long, value_name = "FROM,TO,PITCH", allow_hyphen_values = true, help_heading = PHOTOGRAPHS)]
    pub pixels: Option<PixelsArg>,
    /// Factor on the measured values, μ.
    #[arg(long, default_value_t = 1.0, allow_negative_numbers = true, help_heading = SET_UP)]
    pub mu: f64,
    /// Standard error of that factor.
    #[arg(
        long,
        value_name = "ERROR",
        default_value_t = 0.0,
        allow_negative_numbers = true,
        help_heading = SET_UP
    )]
    pub mu_std_error: f64,
    /// The factor is unknown and must be determined from the photographs.
    #[arg(long, conflicts_with = "mu_std_error", help_heading = SET_UP)]
    pub free_mu: bool,
    #[command(flatten)]
    pub set_up: SetUpArgs,
    /// Draw the half-widths over the sets of slabs: FILE.svg or FILE.png.
    #[arg(long, value_name = "FILE")]
    pub plot: Option<PathBuf>,
}

/// Thicknesses of the slabs of one set.
#[derive(Debug, Clone, PartialEq)]
pub struct SlabList(Vec<f64>);

impl FromStr for SlabList {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        numbers(text).map(Self)
    }
}

/// A row of pixels, not yet checked.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PixelsArg([f64; 3]);

impl FromStr for PixelsArg {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers = numbers(text)?;
        let count = numbers.len();
        let three = |_| format!("{count} numbers where three are wanted, as in -4,4,0.02");
        numbers.try_into().map(Self).map_err(three)
    }
}

fn numbers(text: &str) -> Result<Vec<f64>, String> {
    let number = |part: &str| part.trim().parse().map_err(|_| format!("{part:?} is not a number"));
    text.split(',').map(number).collect()
}

impl DesignArgs {
    /// `set_up` combines its arguments with the session file.
    pub(crate) fn question(&self, set_up: &SetUp) -> anyhow::Result<DesignQuestion> {
        let known = FitSettings { mu: self.mu, mu_std_error: self.mu_std_error, ..FitSettings::default() };
        let known = set_up.settings_of(known, self.channel.as_deref())?;
        let pixels = |PixelsArg([from, to, pitch])| PixelRow::new(from, to, pitch);
        Ok(DesignQuestion::new(DesignSettings {
            channel: self.channel.clone(),
            medium: Medium::new(self.sigma_t, self.albedo, self.g)?,
            sample_ior: self.sample_ior,
            slab_sets: self.slabs.iter().map(|SlabList(slabs)| slabs.clone()).collect(),
            shots: self.shots.clone(),
            noise: self.noise,
            noise_floor: self.noise_floor,
            pixels: self.pixels.map(pixels).transpose().map_err(named_as_given)?,
            set_up: FitOptions::new(known)?,
            mu_free: self.free_mu,
        })?)
    }
}

/// On the command line the pixels are one option.
fn named_as_given(error: Invalid) -> Invalid {
    let part = error.field().trim_start_matches("pixels.").to_owned();
    error.renamed(format!("pixels ({part})"))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A list of thicknesses is a set of slabs, and pixels are three numbers.
    #[test]
    fn lists_are_sets_and_pixels_three_numbers() {
        assert_eq!("0.5, 1".parse(), Ok(SlabList(vec![0.5, 1.0])));
        assert_eq!("".parse::<SlabList>(), Err("\"\" is not a number".to_owned()));
        assert_eq!("-4,4,0.02".parse(), Ok(PixelsArg([-4.0, 4.0, 0.02])));
        let message = "-4,4".parse::<PixelsArg>().unwrap_err();
        assert!(message.starts_with("2 numbers where three are wanted"), "{message}");
    }
}
