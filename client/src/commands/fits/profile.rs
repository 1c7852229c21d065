use std::fmt::Write as _;

use anyhow::Result;
use farm_figures::profile_figure;
use farm_proto::wire::ProfileRequest;
use optics_model::Medium;
use optics_model::fit::{PredictedProfiles, ProfileQuestion};
use serde::Serialize;

use super::chosen_dictionary;
use crate::cli::{Global, ProfileArgs};
use crate::figure_files;
use crate::output::Output;

pub(crate) async fn run(global: &Global, args: ProfileArgs, output: &Output) -> Result<()> {
    let medium = Medium::new(args.sigma_t, args.albedo, args.g)?;
    let question = ProfileQuestion::new(medium, args.thickness, args.sample_ior, args.channel)?;
    let given = args.dictionary.as_ref();
    chosen_dictionary::check(given)?;
    args.plot.as_deref().map_or(Ok(()), figure_files::check_path)?;
    let (dictionary, profiles) = chosen_dictionary::ask(global, given, async |connection, dictionary| {
        let request = ProfileRequest { dictionary, ..(&question).into() };
        Ok(PredictedProfiles::try_from(connection.fits().profile(request).await?.into_inner())?)
    })
    .await?;
    if let Some(path) = &args.plot {
        figure_files::write(&profile_figure(&profiles)?, path)?;
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

/// CSV as `simulate` writes it, with the gradient.
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
