//! Implements `farmctl profile`: predicts the profile of a slab of a medium from a dictionary.

use std::fmt::Write as _;
use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use farm_figures::profile_figure;
use farm_proto::wire::ProfileRequest;
use optics_model::Medium;
use optics_model::fit::{PredictedProfiles, ProfileQuestion};
use serde::Serialize;

use super::chosen_dictionary;
use crate::cli::{FigureArgs, Global};
use crate::figure_files;
use crate::output::Output;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  farmctl profile --sigma-t 6.2 --albedo 0.993 --g 0.35 --thickness 0.5
  farmctl profile --sigma-t 6.2 --albedo 0.993 --g 0.35 --thickness 0.7 --channel R,G,B --plot profile.svg")]
pub(crate) struct ProfileArgs {
    /// Dictionary to ask [default: lab, else the only one but paper].
    #[arg(long, value_name = "NAME")]
    dictionary: Option<String>,
    /// Extinction coefficient, per mm.
    #[arg(long, value_name = "PER_MM", allow_negative_numbers = true)]
    sigma_t: f64,
    /// Single-scattering albedo.
    #[arg(long, allow_negative_numbers = true)]
    albedo: f64,
    /// Anisotropy.
    #[arg(long, allow_negative_numbers = true)]
    g: f64,
    /// Thickness in mm: near one of the dictionary's, or between two.
    #[arg(long, value_name = "MM", allow_negative_numbers = true)]
    thickness: f64,
    /// Refractive index of the sample [default: the dictionary's first].
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    sample_ior: Option<f64>,
    /// Channels of the camera, as in R or R,G,B [default: the dictionary's first].
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    channel: Vec<String>,
    /// Draw the profiles and their gradients: FILE.svg, FILE.png or FILE.pdf.
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    #[command(flatten)]
    figure: FigureArgs,
}

pub(crate) async fn run(global: &Global, args: ProfileArgs, output: &Output) -> Result<()> {
    let medium = Medium::new(args.sigma_t, args.albedo, args.g)?;
    let question = ProfileQuestion::new(medium, args.thickness, args.sample_ior, args.channel)?;
    let given = args.dictionary.as_ref();
    chosen_dictionary::check(given)?;
    args.figure.check(args.plot.as_deref())?;
    let (dictionary, profiles) = chosen_dictionary::ask(global, given, async |connection, dictionary| {
        let request = ProfileRequest { dictionary, ..(&question).into() };
        Ok(PredictedProfiles::try_from(connection.fits().profile(request).await?.into_inner())?)
    })
    .await?;
    if let Some(path) = &args.plot {
        figure_files::write(&profile_figure(&profiles)?, path, args.figure.size()?)?;
    }
    let data = ProfileJson { dictionary: &dictionary, x_mm: profiles.pixels.x_mm(), profiles: &profiles };
    output.print("profile", &data, || table(&profiles))
}

#[derive(Debug, Serialize)]
pub(crate) struct ProfileJson<'a> {
    pub(crate) dictionary: &'a str,
    pub(crate) x_mm: Vec<f64>,
    #[serde(flatten)]
    pub(crate) profiles: &'a PredictedProfiles,
}

/// CSV in the format of `simulate`, with the gradient.
fn table(profiles: &PredictedProfiles) -> String {
    let mut text = "channel,x_mm,value,std_error,gradient_per_mm\n".to_owned();
    for channel in &profiles.channels {
        for (i, x) in profiles.pixels.x_mm().iter().enumerate() {
            let (value, gradient) = (channel.values[i] as f32, channel.gradient[i] as f32);
            let error = channel.std_errors.as_ref().map_or_else(String::new, |e| (e[i] as f32).to_string());
            // Writing to a string does not fail.
            let _ = writeln!(text, "{},{:.6},{value},{error},{gradient}", channel.channel, x);
        }
    }
    text.truncate(text.trim_end().len());
    text
}
