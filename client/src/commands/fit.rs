use anyhow::{Context, Result};
use farm_proto::fit::{Candidate, ChannelFit, FitOptions};
use farm_proto::wire::FitRequest;
use farm_proto::{DictionaryName, Measurement};
use serde::Serialize;

use crate::cli::{FitArgs, Global};
use crate::connection::{Connection, Purpose, with_farm};
use crate::measurement_file::read_measurements;
use crate::output::{Output, table};

pub(crate) async fn run(global: &Global, args: FitArgs, output: &Output) -> Result<()> {
    FitOptions::new(args.lambda, args.mu, args.g, args.top)?;
    DictionaryName::new(args.dictionary.as_str()).map_err(|e| e.within("dictionary"))?;
    let measurements = read_measurements(&args.measurement)?;
    let fits =
        with_farm(global, Purpose::Ask, async |connection| fit_all(connection, &args, &measurements).await)
            .await?;
    let data = FitJson::new(&args, &fits);
    output.print("fit", &data, || text(&fits, args.top))
}

/// A material with the answer for each of its channels.
struct MaterialFit {
    material: String,
    channels: Vec<ChannelFit>,
}

async fn fit_all(
    connection: &Connection,
    args: &FitArgs,
    materials: &[Measurement],
) -> Result<Vec<MaterialFit>> {
    let mut fits = Vec::new();
    for measurement in materials {
        let request = FitRequest {
            dictionary: args.dictionary.clone(),
            measurement: Some(measurement.into()),
            lambda: Some(args.lambda),
            mu: Some(args.mu),
            g: args.g,
            top: Some(args.top),
        };
        let answer = connection.fits().fit(request).await;
        let answer = answer.with_context(|| format!("material {}", measurement.material()))?.into_inner();
        let channels = answer.channels.into_iter().map(ChannelFit::try_from).collect::<Result<_, _>>()?;
        fits.push(MaterialFit { material: answer.material, channels });
    }
    Ok(fits)
}

/// The paper's Table 1, then the best media of each channel.
fn text(fits: &[MaterialFit], top: u32) -> String {
    let mut channels: Vec<&str> = Vec::new();
    for fit in fits.iter().flat_map(|f| &f.channels) {
        if !channels.contains(&fit.channel.as_str()) {
            channels.push(&fit.channel);
        }
    }
    let mut text = summary(fits, &channels);
    if top > 1 {
        for fit in fits {
            for channel in &fit.channels {
                text += &format!("\n\n{}, channel {}: best media\n", fit.material, channel.channel);
                text += &neighbours(&channel.candidates);
            }
        }
    }
    text
}

fn summary(fits: &[MaterialFit], channels: &[&str]) -> String {
    type Tell = fn(&Candidate) -> String;
    let quantities: [(&str, Tell); 4] = [
        ("σ_t /mm", |c| c.medium.sigma_t_per_mm().to_string()),
        ("α", |c| c.medium.albedo().to_string()),
        ("g", |c| c.medium.g().to_string()),
        ("error", |c| format!("{:.4}", c.error)),
    ];
    let mut head = vec!["material".to_owned()];
    for (name, _) in quantities {
        head.extend(channels.iter().map(|c| format!("{name}\n{c}")));
    }
    let row = |fit: &MaterialFit| {
        let best = |channel: &str| {
            fit.channels.iter().find(|c| c.channel == channel).and_then(|c| c.candidates.first())
        };
        let mut row = vec![fit.material.clone()];
        for (_, tell) in quantities {
            row.extend(channels.iter().map(|c| best(c).map_or("–".to_owned(), tell)));
        }
        row
    };
    let right: Vec<usize> = (1..head.len()).collect();
    table(&head.iter().map(String::as_str).collect::<Vec<_>>(), &right, fits.iter().map(row))
}

fn neighbours(candidates: &[Candidate]) -> String {
    let terms = candidates.first().map_or(&[][..], |c| &c.thicknesses);
    let mut head = vec!["error".to_owned(), "σ_t /mm".into(), "α".into(), "g".into(), "index".into()];
    for term in terms {
        head.push(format!("rms values\n{} mm", term.thickness_mm));
        head.push(format!("rms gradients\n{} mm", term.thickness_mm));
    }
    let rows = candidates.iter().map(|c| {
        let m = &c.medium;
        let mut row = vec![format!("{:.5}", c.error)];
        row.extend([m.sigma_t_per_mm(), m.albedo(), m.g(), c.sample_ior].map(|v| v.to_string()));
        for t in &c.thicknesses {
            row.extend([format!("{:.5}", t.value_rms), format!("{:.6}", t.gradient_rms)]);
        }
        row
    });
    let right: Vec<usize> = (0..head.len()).collect();
    table(&head.iter().map(String::as_str).collect::<Vec<_>>(), &right, rows)
}

#[derive(Debug, Serialize)]
struct FitJson {
    dictionary: String,
    lambda: f64,
    mu: f64,
    g: Option<f64>,
    materials: Vec<MaterialJson>,
}

#[derive(Debug, Serialize)]
struct MaterialJson {
    material: String,
    channels: Vec<ChannelJson>,
}

#[derive(Debug, Serialize)]
struct ChannelJson {
    channel: String,
    candidates: Vec<CandidateJson>,
}

#[derive(Debug, Serialize)]
struct CandidateJson {
    sigma_t_per_mm: f64,
    albedo: f64,
    g: f64,
    sample_ior: f64,
    error: f64,
    thicknesses: Vec<ThicknessJson>,
}

#[derive(Debug, Serialize)]
struct ThicknessJson {
    thickness_mm: f64,
    value_rms: f64,
    gradient_rms: f64,
    record: usize,
}

impl FitJson {
    fn new(args: &FitArgs, fits: &[MaterialFit]) -> Self {
        let channel = |c: &ChannelFit| ChannelJson {
            channel: c.channel.clone(),
            candidates: c.candidates.iter().map(CandidateJson::from).collect(),
        };
        let material = |f: &MaterialFit| MaterialJson {
            material: f.material.clone(),
            channels: f.channels.iter().map(channel).collect(),
        };
        Self {
            dictionary: args.dictionary.clone(),
            lambda: args.lambda,
            mu: args.mu,
            g: args.g,
            materials: fits.iter().map(material).collect(),
        }
    }
}

impl From<&Candidate> for CandidateJson {
    fn from(c: &Candidate) -> Self {
        let thickness = |t: &farm_proto::fit::ThicknessError| ThicknessJson {
            thickness_mm: t.thickness_mm,
            value_rms: t.value_rms,
            gradient_rms: t.gradient_rms,
            record: t.record,
        };
        Self {
            sigma_t_per_mm: c.medium.sigma_t_per_mm(),
            albedo: c.medium.albedo(),
            g: c.medium.g(),
            sample_ior: c.sample_ior,
            error: c.error,
            thicknesses: c.thicknesses.iter().map(thickness).collect(),
        }
    }
}
