//! Implements `farmctl design`: compares sets of slabs by how well photographs of them would determine a medium.

use std::path::PathBuf;
use std::str::FromStr;

use anyhow::Result;
use clap::Args;
use farm_figures::design_figure;
use farm_lab::document::Block;
use farm_lab::set_up::{Assumed, SetUp};
use farm_proto::wire::DesignRequest;
use optics_model::fit::{Design, DesignQuestion, DesignSettings, FitOptions, FitSettings, PixelRow};
use optics_model::{Invalid, Medium};
use serde::Serialize;

use super::chosen_dictionary;
use crate::answers::{SetUpJson, design_blocks};
use crate::cli::set_up::SET_UP;
use crate::cli::{FigureArgs, Global, SetUpArgs};
use crate::figure_files::{self, drawn};
use crate::output::Output;

/// Headings of the help.
const MEDIUM: &str = "Guess of the medium";
const PHOTOGRAPHS: &str = "Photographs to compare";

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  farmctl design --sigma-t 6 --albedo 0.9991 --g 0.4
  farmctl design --sigma-t 6 --albedo 0.9991 --g 0.4 --slabs 0.5,1 --slabs 0.5,0.5,1,1 --plot sets.svg
  farmctl design --sigma-t 6 --albedo 0.9991 --g 0.4 --shots 1,4,16 --thickness-std-error-mm 0.002")]
pub(crate) struct DesignArgs {
    /// Dictionary to predict the profiles from [default: lab, else the only one but paper].
    #[arg(long, value_name = "NAME")]
    dictionary: Option<String>,
    /// Extinction coefficient, per mm.
    #[arg(long, value_name = "PER_MM", allow_negative_numbers = true, help_heading = MEDIUM)]
    sigma_t: f64,
    /// Single-scattering albedo.
    #[arg(long, allow_negative_numbers = true, help_heading = MEDIUM)]
    albedo: f64,
    /// Anisotropy.
    #[arg(long, allow_negative_numbers = true, help_heading = MEDIUM)]
    g: f64,
    /// Refractive index of the sample [default: the dictionary's first].
    #[arg(long, value_name = "N", allow_negative_numbers = true, help_heading = MEDIUM)]
    sample_ior: Option<f64>,
    /// Channel of the camera [default: the dictionary's first].
    #[arg(long, value_name = "NAME", help_heading = MEDIUM)]
    channel: Option<String>,
    /// Thicknesses in mm of one set of slabs, as in 0.5,1; give it once for each set [default: all sets of one to three
    /// of the dictionary's thicknesses].
    #[arg(long, value_name = "LIST", allow_hyphen_values = true, help_heading = PHOTOGRAPHS)]
    slabs: Vec<SlabList>,
    /// Photographs of each slab; every number is tried with every set.
    #[arg(
        long,
        value_name = "LIST",
        value_delimiter = ',',
        default_value = "1,2",
        help_heading = PHOTOGRAPHS
    )]
    shots: Vec<u32>,
    /// Standard error of one pixel of one photograph, as a share of its value.
    #[arg(
        long,
        value_name = "SHARE",
        default_value_t = 0.01,
        allow_negative_numbers = true,
        help_heading = PHOTOGRAPHS
    )]
    noise: f64,
    /// Standard error of a dark pixel of one photograph, as a radiance factor.
    #[arg(
        long,
        value_name = "ERROR",
        default_value_t = 0.0005,
        allow_negative_numbers = true,
        help_heading = PHOTOGRAPHS
    )]
    noise_floor: f64,
    /// Pixels of the camera in mm: left end of the first, right end of the last, pitch, as in -4,4,0.02 [default: the
    /// dictionary's].
    #[arg(long, value_name = "FROM,TO,PITCH", allow_hyphen_values = true, help_heading = PHOTOGRAPHS)]
    pixels: Option<PixelsArg>,
    /// Factor on the measured values, μ.
    #[arg(long, default_value_t = 1.0, allow_negative_numbers = true, help_heading = SET_UP)]
    mu: f64,
    /// Standard error of that factor.
    #[arg(
        long,
        value_name = "ERROR",
        default_value_t = 0.0,
        allow_negative_numbers = true,
        help_heading = SET_UP
    )]
    mu_std_error: f64,
    /// The factor is unknown and must be determined from the photographs.
    #[arg(long, conflicts_with = "mu_std_error", help_heading = SET_UP)]
    free_mu: bool,
    #[command(flatten)]
    set_up: SetUpArgs,
    /// Draw the half-widths over the sets of slabs: FILE.svg, FILE.png or FILE.pdf.
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    #[command(flatten)]
    figure: FigureArgs,
}

/// Thicknesses of the slabs of one set.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct SlabList(Vec<f64>);

impl FromStr for SlabList {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        numbers(text).map(Self)
    }
}

/// A row of pixels, not yet validated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PixelsArg([f64; 3]);

impl FromStr for PixelsArg {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers = numbers(text)?;
        let count = numbers.len();
        let three = |_| format!("{count} numbers instead of three, as in -4,4,0.02");
        numbers.try_into().map(Self).map_err(three)
    }
}

fn numbers(text: &str) -> Result<Vec<f64>, String> {
    let number = |part: &str| part.trim().parse().map_err(|_| format!("{part:?} is not a number"));
    text.split(',').map(number).collect()
}

impl DesignArgs {
    /// The question; `set_up` combines the arguments with the session file.
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

/// Renames the field of an error: on the command line the pixels are one option.
fn named_as_given(error: Invalid) -> Invalid {
    let part = error.field().trim_start_matches("pixels.").to_owned();
    error.renamed(format!("pixels ({part})"))
}

pub(crate) async fn run(global: &Global, args: DesignArgs, output: &Output) -> Result<()> {
    let set_up = args.set_up.read(None)?;
    let question = args.question(&set_up)?;
    let assumed = set_up.assumed_of(args.channel.as_deref());
    let given = args.dictionary.as_ref();
    chosen_dictionary::check(given)?;
    args.figure.check(args.plot.as_deref())?;
    let (dictionary, design) = chosen_dictionary::ask(global, given, async |connection, dictionary| {
        let request = DesignRequest { dictionary, ..(&question).into() };
        Ok(Design::try_from(connection.fits().design(request).await?.into_inner())?)
    })
    .await?;
    if let Some(path) = &args.plot {
        figure_files::write(&design_figure(&design)?, path, args.figure.size()?)?;
    }
    let data = data(&dictionary, &question, &assumed, &design);
    output.answer("design", &data, || {
        let assumed = assumed.text(question.settings().set_up.settings()).map(Block::Paragraph);
        [design_blocks(&design, &question), assumed.into_iter().collect(), drawn(&args.plot)].concat()
    })
}

/// The question and its answer.
#[derive(Debug, Serialize)]
pub(crate) struct DesignJson<'a> {
    dictionary: &'a str,
    noise: f64,
    noise_floor: f64,
    mu: f64,
    /// Null if μ is unknown.
    mu_std_error: Option<f64>,
    #[serde(flatten)]
    set_up: SetUpJson<'a>,
    /// The quantities of the set-up without a value.
    assumed: Vec<&'static str>,
    #[serde(flatten)]
    design: &'a Design,
}

pub(crate) fn data<'a>(
    dictionary: &'a str,
    question: &'a DesignQuestion,
    assumed: &Assumed,
    design: &'a Design,
) -> DesignJson<'a> {
    let (asked, known) = (question.settings(), question.settings().set_up.settings());
    DesignJson {
        dictionary,
        noise: asked.noise,
        noise_floor: asked.noise_floor,
        mu: known.mu,
        mu_std_error: (!asked.mu_free).then_some(known.mu_std_error),
        set_up: SetUpJson(known),
        assumed: assumed.names(),
        design,
    }
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
        assert!(message.starts_with("2 numbers instead of three"), "{message}");
    }
}
