use anyhow::Result;
use optics_model::Medium;
use serde::Serialize;

use crate::answers::{albedo, significant};
use crate::cli::SimilarArgs;
use crate::output::{Output, table};

/// Needs no farm: the formulas are those of the service's `Similar`.
pub(crate) fn run(args: &SimilarArgs, output: &Output) -> Result<()> {
    let data = data(args)?;
    output.print("similar", &data, || {
        let row = |m: &MediumJson| {
            vec![
                m.g.to_string(),
                significant(m.sigma_t_per_mm, 4),
                albedo(m.albedo),
                significant(m.reduced_scattering_per_mm, 4),
                significant(m.absorption_per_mm, 4),
            ]
        };
        let head = ["g", "σ_t /mm", "α", "σ_s(1−g) /mm", "σ_a /mm"];
        table(&head, &[0, 1, 2, 3, 4], data.similar.iter().map(row))
    })
}

pub(super) fn data(args: &SimilarArgs) -> Result<JsonData> {
    let medium = Medium::new(args.sigma_t, args.albedo, args.g)?;
    let media = args
        .to
        .iter()
        .map(|g| optics_model::medium::check_g(*g).and_then(|g| optics_fit::similar(&medium, g)))
        .collect::<Result<Vec<Medium>, _>>()?;
    let json = |m: &Medium| MediumJson {
        sigma_t_per_mm: m.sigma_t_per_mm(),
        albedo: m.albedo(),
        g: m.g(),
        reduced_scattering_per_mm: m.sigma_t_per_mm() * m.albedo() * (1.0 - m.g()),
        absorption_per_mm: m.sigma_t_per_mm() * (1.0 - m.albedo()),
    };
    Ok(JsonData { medium: json(&medium), similar: media.iter().map(json).collect() })
}

#[derive(Debug, Serialize)]
pub(super) struct JsonData {
    medium: MediumJson,
    similar: Vec<MediumJson>,
}

#[derive(Debug, Serialize)]
struct MediumJson {
    sigma_t_per_mm: f64,
    albedo: f64,
    g: f64,
    reduced_scattering_per_mm: f64,
    absorption_per_mm: f64,
}
