//! Draws Fig. 7: measured profiles with the best fits.

use optics_model::Medium;
use optics_model::fit::{ChannelFit, FitCurves, MaterialFit};

use crate::drawing::canvas::Stroke;
use crate::drawing::legend::Key;
use crate::drawing::picture::Picture;
use crate::drawing::rgb::Rgb;
use crate::drawing::sheet::{GRADIENT, LEFT_OUT, Residuals, Sheet, SheetCell};
use crate::misfit::misfit_short;
use crate::numbers::{albedo, significant};

const MEASURED: Stroke = Stroke::dots(Rgb::GREY, 2.0);
const NEIGHBOUR: Stroke = Stroke::solid(Rgb::SKY_BLUE, 0.6);
const GRID: Stroke = Stroke::solid(Rgb::BLUE, 1.3);
const REFINED: Stroke = Stroke::solid(Rgb::BLUE, 1.0);

/// Draws the fits of one material: channels in columns, thicknesses in rows. Below each profile are the residuals of the
/// likelihood, or the gradients that the paper's distance compares.
pub fn fit_figure(fit: &MaterialFit) -> anyhow::Result<Picture> {
    let curves = || fit.channels.iter().flat_map(|channel| &channel.curves);
    let mut legend = vec![Key::line(MEASURED, "measured")];
    if curves().any(has_residuals) {
        legend.push(Key::line(REFINED, "fit"));
        if curves().any(|curves| !curves.left_out.is_empty()) {
            legend.push(Key::line(LEFT_OUT, "left out"));
        }
        legend.push(Key::note("σ: standard error of a pixel; dashed: ± 2 σ"));
    }
    if curves().any(|curves| !has_residuals(curves)) {
        legend.push(Key::line(GRID, "nearest record of the dictionary"));
        if curves().any(|curves| curves.candidates.len() > 1) {
            legend.push(Key::line(NEIGHBOUR, "next records"));
        }
        legend.push(Key::note("|∇| per pixel of 10 mm / 360"));
    }
    let cells =
        fit.channels.iter().flat_map(|channel| channel.curves.iter().filter_map(|c| cell(channel, c)));
    Sheet { title: &fit.material, legend, cells: cells.collect(), alike: false, lower: GRADIENT }.draw()
}

fn has_residuals(curves: &FitCurves) -> bool {
    curves.refined.is_some() && !curves.residuals.is_empty()
}

/// The panel of one measured profile; `None` without a record to compare with.
fn cell<'a>(channel: &'a ChannelFit, compared: &'a FitCurves) -> Option<SheetCell<'a>> {
    let (column, thickness_mm, x_mm) = (&channel.channel, compared.thickness_mm, &compared.x_mm);
    let mut curves = vec![(MEASURED, &compared.measured)];
    let note = channel.refined.as_ref().and_then(misfit_short).map(Key::note);
    if let (Some(curve), Some(refined), true) = (&compared.refined, &channel.refined, has_residuals(compared))
    {
        curves.push((REFINED, curve));
        let keys = std::iter::once(Key::line(REFINED, label(&refined.best.medium))).chain(note).collect();
        let residuals = Some(Residuals { values: &compared.residuals, left_out: &compared.left_out });
        return Some(SheetCell { column, thickness_mm, keys, x_mm, curves, residuals });
    }
    let (best, neighbours) = compared.candidates.split_first()?;
    curves.extend(neighbours.iter().map(|curve| (NEIGHBOUR, curve)));
    curves.push((GRID, best));
    let best = Key::line(GRID, label(&channel.candidates.first()?.medium));
    let keys = std::iter::once(best).chain(note).collect();
    Some(SheetCell { column, thickness_mm, keys, x_mm, curves, residuals: None })
}

fn label(m: &Medium) -> String {
    let three = |v| significant(v, 3);
    format!("σ_t {}, α {}, g {}", three(m.sigma_t_per_mm()), albedo(m.albedo()), three(m.g()))
}

#[cfg(test)]
mod tests {
    use optics_model::fit::Curve;

    use super::*;
    use crate::checks::{assert_shows, assert_well_laid_out, edge, texts, x_mm};
    use crate::testing;

    fn compared(thickness_mm: f64) -> FitCurves {
        FitCurves {
            thickness_mm,
            x_mm: x_mm(),
            measured: edge(0.1, 0.8, 0.5),
            candidates: vec![edge(0.12, 0.79, 0.5), edge(0.14, 0.78, 0.6), edge(0.1, 0.8, 0.4)],
            refined: Some(edge(0.11, 0.8, 0.5)),
            residuals: x_mm().iter().map(|x| 2.5 * libm::sin(3.0 * x)).collect(),
            left_out: vec![10, 11],
        }
    }

    fn figure(channels: usize, thicknesses_mm: &[f64]) -> MaterialFit {
        let channel = |i| ChannelFit {
            curves: thicknesses_mm.iter().map(|t| compared(*t)).collect(),
            ..testing::channel(&format!("{} nm", 400 + 10 * i), 6.2134, 3.4)
        };
        MaterialFit { material: "Vero White".into(), channels: (0..channels).map(channel).collect() }
    }

    /// One panel or many are well laid out.
    #[test]
    fn fit_panels_are_well_laid_out() {
        for (channels, thicknesses) in
            [(1, &[0.5][..]), (3, &[0.5, 1.0]), (9, &[0.5]), (31, &[0.5, 1.0, 2.0])]
        {
            let picture = fit_figure(&figure(channels, thicknesses)).unwrap();
            let labels =
                ["Vero White", "x [mm]", "radiance factor", "residual [σ]", "t = 0.5 mm", "measured"];
            let texts = assert_shows(&picture, &[&labels[..], &["left out"]].concat());
            assert_eq!(texts.iter().filter(|text| text.ends_with(" nm")).count(), channels);
            let warnings = texts.iter().filter(|text| text.ends_with("mm off?"));
            assert_eq!(warnings.count(), channels);
        }
    }

    /// Parameters are shown once if all thicknesses share them.
    #[test]
    fn shared_parameters_are_shown_once() {
        let mut shared = figure(1, &[0.5, 1.0]);
        let count = |figure: &MaterialFit| {
            let texts = texts(&fit_figure(figure).unwrap());
            texts.iter().filter(|text| text.starts_with("σt ")).count()
        };
        assert_eq!(count(&shared), 1);
        shared.channels[0].curves[1].refined = None;
        assert_eq!(count(&shared), 2);
    }

    /// Unusual data are drawn, and wrong data are refused.
    #[test]
    fn odd_data_are_drawn_wrong_data_refused() {
        let mut figure = figure(2, &[0.5, 1.0]);
        figure.material = "a title that is <longer> than the figure & ".repeat(6);
        figure.channels[0].channel = "a channel with a name that does not fit above its panel at all".into();
        figure.channels[1].curves.pop();
        let empty = || Curve { values: vec![], gradient: vec![] };
        let nothing =
            FitCurves { x_mm: vec![], measured: empty(), candidates: vec![empty()], ..compared(0.5) };
        figure.channels[1].curves[0] = FitCurves { refined: None, ..nothing };
        let flat = |value: f64| Curve { values: vec![value; 3], gradient: vec![0.0; 3] };
        figure.channels[0].curves[1] = FitCurves {
            thickness_mm: 1.0,
            x_mm: vec![-5.0, 0.0, 5.0],
            measured: flat(f64::NAN),
            candidates: vec![flat(0.5)],
            refined: None,
            residuals: Vec::new(),
            left_out: Vec::new(),
        };
        assert_well_laid_out(&fit_figure(&figure).unwrap());

        figure.channels[0].curves.push(compared(0.5));
        assert!(fit_figure(&figure).unwrap_err().to_string().starts_with("two panels for a channel"));
        figure.channels[0].curves.truncate(1);
        figure.channels[0].curves[0].measured.gradient.pop();
        assert!(fit_figure(&figure).unwrap_err().to_string().contains("360 values and 359 gradients"));
        figure.channels.clear();
        assert_eq!(fit_figure(&figure).unwrap_err().to_string(), "no panels to draw");
    }
}
