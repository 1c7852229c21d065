//! From answers to pictures.

mod changes;
mod overview;

use std::path::{Path, PathBuf};

use anyhow::Result;
use optics_model::Medium;
use optics_model::fit::{ChannelFit, Common, Curve, DistanceMap, MaterialFit, ScaleCurve};

use crate::answers::{albedo, misfit_short, significant};
use crate::plot::{
    self, ErrorAtG, FitFigure, FitPanel, MapFigure, MapPanel, MapPoint, Picture, ScaleFigure, fit_figure,
    map_figure, scale_figure,
};

pub(crate) use changes::changes;
pub(crate) use overview::{chosen_axes, overview};

/// One picture per material: `FILE.svg`, or `FILE-MATERIAL.svg` if there are several. Returns the files.
pub(crate) fn write_fits(fits: &[MaterialFit], path: &Path) -> Result<Vec<PathBuf>> {
    let mut written = Vec::new();
    for fit in fits {
        let figure =
            FitFigure { title: fit.material.clone(), panels: fit.channels.iter().flat_map(panels).collect() };
        let path = if fits.len() == 1 { path.to_owned() } else { named(path, &fit.material) };
        fit_figure(&figure)?.write(&path)?;
        written.push(path);
    }
    Ok(written)
}

/// A line that names the picture, if one was drawn.
pub(crate) fn drawn(path: Option<&Path>) -> String {
    path.map_or(String::new(), |path| format!("\ndrawn: {}", path.display()))
}

fn panels(channel: &ChannelFit) -> Vec<FitPanel> {
    let label = |m: &Medium| {
        format!(
            "σ_t {}, α {}, g {}",
            significant(m.sigma_t_per_mm(), 3),
            albedo(m.albedo()),
            significant(m.g(), 3)
        )
    };
    let panel = |c: &optics_model::fit::FitCurves| {
        let curve = |curve: &Curve| plot::Curve {
            x_mm: c.x_mm.clone(),
            values: curve.values.clone(),
            gradient: curve.gradient.clone(),
        };
        let mut candidates = c.candidates.iter().map(curve);
        Some(FitPanel {
            channel: channel.channel.clone(),
            thickness_mm: c.thickness_mm,
            measured: curve(&c.measured),
            grid: candidates.next()?,
            grid_label: channel.candidates.first().map(|c| label(&c.medium)).unwrap_or_default(),
            refined: c.refined.as_ref().map(curve),
            refined_label: channel.refined.as_ref().map(|r| label(&r.best.medium)).unwrap_or_default(),
            neighbours: candidates.collect(),
            warning: channel.refined.as_ref().and_then(misfit_short),
        })
    };
    channel.curves.iter().filter_map(panel).collect()
}

/// One picture per map: `FILE.svg`, or `FILE-MATERIAL-CHANNEL.svg` if there are several.
pub(crate) fn write_maps(maps: &[(String, DistanceMap)], path: &Path) -> Result<()> {
    for (material, map) in maps {
        let path = if maps.len() == 1 {
            path.to_owned()
        } else {
            named(path, &format!("{material}-{}", map.channel))
        };
        map_figure(&map_data(material, map))?.write(&path)?;
    }
    Ok(())
}

fn map_data(material: &str, map: &DistanceMap) -> MapFigure {
    let point = |m: &Medium| MapPoint { sigma_t_per_mm: m.sigma_t_per_mm(), albedo: m.albedo() };
    let panels = map.layers.iter().enumerate().map(|(i, layer)| MapPanel {
        g: layer.g,
        distance: layer.errors.clone(),
        best: (i == map.best_layer).then(|| point(&layer.best.medium)),
        best_of_g: point(&layer.best.medium),
        predicted: layer.similar.as_ref().map(point),
    });
    MapFigure {
        title: format!("{material}, channel {}: distance to every medium", map.channel),
        sigma_t_per_mm: map.sigma_t_per_mm.clone(),
        albedo: map.albedo.clone(),
        panels: panels.collect(),
    }
}

/// The paper's curve over μ by records, and the refined errors over g.
pub(crate) fn scale(curve: &ScaleCurve, common: &Common) -> Result<Picture> {
    scale_figure(&ScaleFigure {
        title: "Scale factor common to all materials".to_owned(),
        mu: curve.points.iter().map(|p| p.mu).collect(),
        error: curve.points.iter().map(|p| p.error).collect(),
        best_mu: curve.best.mu,
        std_error: curve.std_error,
        by_g: common.by_g.iter().map(|e| ErrorAtG { g: e.g, error: e.error }).collect(),
        best_g: common.g_interval.and(common.g),
    })
}

/// `dir/name-SUFFIX.ext`, with what does not belong in a file name replaced.
fn named(path: &Path, suffix: &str) -> PathBuf {
    let safe: String =
        suffix.chars().map(|c| if c.is_alphanumeric() || "-_.".contains(c) { c } else { '_' }).collect();
    let (stem, extension) = (path.file_stem().unwrap_or_default(), path.extension().unwrap_or_default());
    path.with_file_name(format!("{}-{safe}.{}", stem.to_string_lossy(), extension.to_string_lossy()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn several_pictures_get_names_of_their_own() {
        assert_eq!(named(Path::new("a/fit.svg"), "Vero White/1"), Path::new("a/fit-Vero_White_1.svg"));
    }
}
