//! A folder that `capture` wrote, and what `measure` makes of it.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use farm_figures::fit_figure;
use farm_lab::capture::{Simulated, with_fits};
use farm_lab::grid_file::read_grid;
use farm_proto::DictionaryName;
use optics_model::Grid;
use optics_model::fit::{FitCurves, Interval, MaterialFit, Refined, SourceShare};
use serde::Serialize;

use crate::cli::MeasureArgs;
use crate::output::write_whole;

/// The session whose folder is to be measured.
#[derive(Debug)]
pub(super) struct SessionFolder {
    folder: PathBuf,
    /// The session's own dictionary; none if another was named.
    pub(super) dictionary: Option<(DictionaryName, Grid)>,
}

impl SessionFolder {
    /// Puts the folder's files in the place of what was not given. None if a measurement file was given.
    pub(super) fn open(args: &mut MeasureArgs) -> Result<Option<Self>> {
        if !args.measurements.is_dir() {
            return Ok(None);
        }
        let folder = args.measurements.clone();
        args.measurements = folder.join("measurements.csv");
        if !args.measurements.exists() {
            anyhow::bail!(
                "{} has no measurements.csv: give a folder that `farmctl capture` wrote, or a measurement file",
                folder.display()
            );
        }
        let session = folder.join("session.json");
        if args.options.set_up.session.is_none() && session.exists() {
            args.options.set_up.session = Some(session);
        }
        let dictionary = match args.options.dictionary {
            Some(_) => None,
            None => Some(own_dictionary(&folder)?),
        };
        if let Some((name, _)) = &dictionary {
            args.options.dictionary = Some(name.to_string());
        }
        Ok(Some(Self { folder, dictionary }))
    }

    /// Adds the error budgets to the session, and the fits to the report, if there is one. Returns its path.
    pub(super) fn complete(&self, fits: &[MaterialFit], mu: f64, text: &str) -> Result<Option<PathBuf>> {
        add_to_session(&self.folder.join("session.json"), fits)?;
        let path = self.folder.join("report.html");
        let Ok(page) = std::fs::read_to_string(&path) else { return Ok(None) };
        let figures =
            fits.iter().map(|fit| Ok(fit_figure(fit)?.svg().to_owned())).collect::<Result<Vec<_>>>()?;
        let simulated: Vec<Simulated> = fits.iter().flat_map(|fit| simulated(fit, mu)).collect();
        let text = anstream::adapter::strip_str(text).to_string();
        let Some(page) = with_fits(&page, &text, &figures, &simulated) else { return Ok(None) };
        write_whole(&path, page.as_bytes()).with_context(|| format!("writing {}", path.display()))?;
        Ok(Some(path))
    }
}

/// A channel's 95 % intervals, and what they are made of.
#[derive(Debug, Serialize)]
struct MediumErrors<'a> {
    material: &'a str,
    channel: &'a str,
    sigma_t_per_mm: Interval,
    albedo: Interval,
    budget: &'a [SourceShare],
}

impl<'a> MediumErrors<'a> {
    fn of(material: &'a str, channel: &'a str, refined: &'a Refined) -> Self {
        let budget = refined.likelihood.as_ref().map_or(&[][..], |l| &l.budget);
        Self { material, channel, sigma_t_per_mm: refined.sigma_t_per_mm, albedo: refined.albedo, budget }
    }
}

/// Writes the media's error budgets into the session's file, beside what `capture` wrote.
fn add_to_session(path: &Path, fits: &[MaterialFit]) -> Result<()> {
    let Ok(text) = std::fs::read_to_string(path) else { return Ok(()) };
    let place = || format!("session file {}", path.display());
    let channels = fits.iter().flat_map(|fit| fit.channels.iter().map(|channel| (&fit.material, channel)));
    let errors: Vec<MediumErrors> = channels
        .filter_map(|(material, channel)| {
            let refined = channel.refined.as_ref()?;
            Some(MediumErrors::of(material, &channel.channel, refined))
        })
        .collect();
    let mut session: serde_json::Value = serde_json::from_str(&text).with_context(place)?;
    if let Some(fields) = session.as_object_mut() {
        fields.insert("media_errors_95".to_owned(), serde_json::to_value(errors)?);
    }
    let text = serde_json::to_string_pretty(&session)? + "\n";
    write_whole(path, text.as_bytes()).with_context(place)
}

/// The dictionary of a session's folder, named by its content, so that another session's is another dictionary.
pub(crate) fn own_dictionary(folder: &Path) -> Result<(DictionaryName, Grid)> {
    let path = folder.join("grid.toml");
    let grid = read_grid(&path)?;
    let mut hasher = blake3::Hasher::new();
    for name in ["grid.toml", "scene.toml"] {
        // The grid may hold its scene.
        hasher.update(&std::fs::read(folder.join(name)).unwrap_or_default());
    }
    let digest = hasher.finalize().to_hex();
    Ok((DictionaryName::new(format!("session-{}", &digest[..12]))?, grid))
}

/// Simulated profiles of a material that has red, green and blue, for each slab.
fn simulated(fit: &MaterialFit, mu: f64) -> Vec<Simulated> {
    let curves = |name: &str| fit.channels.iter().find(|c| c.channel == name).map(|c| c.curves.as_slice());
    let (Some(red), Some(green), Some(blue)) = (curves("R"), curves("G"), curves("B")) else {
        return Vec::new();
    };
    let values = |curves: &FitCurves| {
        let curve = curves.refined.as_ref().or(curves.candidates.first());
        curve.map(|curve| curve.values.iter().map(|v| v / mu).collect::<Vec<f64>>()).unwrap_or_default()
    };
    let slabs = red.iter().zip(green).zip(blue);
    let of = |((r, g), b): ((&FitCurves, &FitCurves), &FitCurves)| Simulated {
        label: format!("{} {} mm", fit.material, r.thickness_mm),
        values: [values(r), values(g), values(b)],
    };
    slabs.map(of).filter(|s| s.values.iter().all(|v| !v.is_empty())).collect()
}
