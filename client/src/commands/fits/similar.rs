//! Implements `farmctl similar`: lists the media that similarity theory considers equivalent to a given one.

use anyhow::Result;
use clap::Args;
use farm_figures::numbers::{albedo, significant};
use farm_lab::document::ValueTable;
use optics_model::Medium;
use serde::Serialize;

use crate::output::Output;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  farmctl similar --sigma-t 6 --albedo 0.9991 --g 0.4
  farmctl similar --sigma-t 6 --albedo 0.9991 --g 0.4 --to 0,0.8")]
pub(crate) struct SimilarArgs {
    /// Extinction coefficient, per mm.
    #[arg(long, value_name = "PER_MM", allow_negative_numbers = true)]
    pub(crate) sigma_t: f64,
    /// Single-scattering albedo.
    #[arg(long, allow_negative_numbers = true)]
    pub(crate) albedo: f64,
    /// Anisotropy.
    #[arg(long, allow_negative_numbers = true)]
    pub(crate) g: f64,
    /// Anisotropies of the similar media, as in 0,0.4,0.8.
    #[arg(
        long,
        value_name = "LIST",
        value_delimiter = ',',
        allow_negative_numbers = true,
        default_value = "0,0.1,0.2,0.3,0.4,0.45,0.5,0.55,0.6,0.7,0.8"
    )]
    pub(crate) to: Vec<f64>,
}

/// Computes locally, with the formulas of the service's `Similar`.
pub(crate) fn run(args: &SimilarArgs, output: &Output) -> Result<()> {
    let data = data(args)?;
    output.answer("similar", &data, || {
        let row = |m: &SimilarMedia| {
            vec![
                m.medium.g().to_string(),
                significant(m.medium.sigma_t_per_mm(), 4),
                albedo(m.medium.albedo()),
                significant(m.reduced_scattering_per_mm, 4),
                significant(m.absorption_per_mm, 4),
            ]
        };
        let head = ">g | >σ_t /mm | >α | >σ_s(1−g) /mm | >σ_a /mm";
        vec![ValueTable::new(head, data.similar.iter().map(row)).block()]
    })
}

pub(crate) fn data(args: &SimilarArgs) -> Result<SimilarJson> {
    let medium = Medium::new(args.sigma_t, args.albedo, args.g)?;
    let media = args
        .to
        .iter()
        .map(|g| optics_model::phase::check_g(*g).and_then(|g| optics_fit::similar(&medium, g)))
        .collect::<Result<Vec<Medium>, _>>()?;
    Ok(SimilarJson { medium: medium.into(), similar: media.iter().map(|m| (*m).into()).collect() })
}

#[derive(Debug, Serialize)]
pub(crate) struct SimilarJson {
    medium: SimilarMedia,
    similar: Vec<SimilarMedia>,
}

/// A medium with the coefficients that similar media share.
#[derive(Debug, Serialize)]
struct SimilarMedia {
    #[serde(flatten)]
    medium: Medium,
    reduced_scattering_per_mm: f64,
    absorption_per_mm: f64,
}

impl From<Medium> for SimilarMedia {
    fn from(medium: Medium) -> Self {
        Self {
            medium,
            reduced_scattering_per_mm: medium.reduced_scattering_per_mm(),
            absorption_per_mm: medium.absorption_per_mm(),
        }
    }
}
