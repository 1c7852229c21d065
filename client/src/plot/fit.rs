//! Fig. 7: measured profiles with the best fits.

use super::canvas::Stroke;
use super::color::Color;
use super::curve::Curve;
use super::legend::Key;
use super::picture::Picture;
use super::sheet::{Cell, Sheet};

const MEASURED: Stroke = Stroke::dots(Color::GREY, 2.0);
const NEIGHBOUR: Stroke = Stroke::solid(Color::SKY_BLUE, 0.6);
const GRID: Stroke = Stroke::solid(Color::BLUE, 1.3);
const REFINED: Stroke = Stroke::dashed(Color::VERMILLION, 1.3, "5 3");

/// Fits of one material, the panels in reading order: channels beside each other, thicknesses below each other.
#[derive(Clone, Debug)]
pub(crate) struct FitFigure {
    pub title: String,
    pub panels: Vec<FitPanel>,
}

#[derive(Clone, Debug)]
pub(crate) struct FitPanel {
    pub channel: String,
    pub thickness_mm: f64,
    pub measured: Curve,
    /// The best record of the dictionary.
    pub grid: Curve,
    /// Its parameters, as in "σ_t 6, α 0.999, g 0.4".
    pub grid_label: String,
    /// The best medium between the records.
    pub refined: Option<Curve>,
    pub refined_label: String,
    /// Records next to the best.
    pub neighbours: Vec<Curve>,
    /// Why the fit may not be trusted.
    pub warning: Option<String>,
}

pub(crate) fn fit_figure(figure: &FitFigure) -> anyhow::Result<Picture> {
    let mut legend = vec![Key::line(MEASURED, "measured"), Key::line(GRID, "best record of the dictionary")];
    if figure.panels.iter().any(|panel| panel.refined.is_some()) {
        legend.push(Key::line(REFINED, "refined between records"));
    }
    if figure.panels.iter().any(|panel| !panel.neighbours.is_empty()) {
        legend.push(Key::line(NEIGHBOUR, "adjacent records"));
    }
    legend.push(Key::note("|∇| per pixel of 10 mm / 360"));
    Sheet { title: &figure.title, legend, cells: figure.panels.iter().map(cell).collect(), alike: false }
        .draw()
}

fn cell(panel: &FitPanel) -> Cell<'_> {
    let mut keys = vec![Key::line(GRID, panel.grid_label.as_str())];
    let mut curves = vec![(MEASURED, &panel.measured)];
    curves.extend(panel.neighbours.iter().map(|curve| (NEIGHBOUR, curve)));
    curves.push((GRID, &panel.grid));
    if let Some(refined) = &panel.refined {
        keys.push(Key::line(REFINED, panel.refined_label.as_str()));
        curves.push((REFINED, refined));
    }
    if let Some(warning) = &panel.warning {
        keys.push(Key::note(warning.as_str()));
    }
    Cell { column: &panel.channel, thickness_mm: panel.thickness_mm, keys, curves }
}

#[cfg(test)]
mod tests {
    use super::super::checks::{assert_well_laid_out, edge, texts};
    use super::*;

    fn panel(channel: &str, thickness_mm: f64) -> FitPanel {
        FitPanel {
            channel: channel.into(),
            thickness_mm,
            measured: edge(0.1, 0.8, 0.5),
            grid: edge(0.12, 0.79, 0.5),
            grid_label: "σ_t 6.25, α 0.9991, g 0.45".into(),
            refined: Some(edge(0.11, 0.8, 0.5)),
            refined_label: "σ_t 6.21 ± 0.04, α 0.99912 ± 0.00003, g 0.452 ± 0.013".into(),
            neighbours: vec![edge(0.14, 0.78, 0.6), edge(0.1, 0.8, 0.4)],
            warning: Some("misfit 3.4: edge 0.07 mm off?".into()),
        }
    }

    fn figure(channels: usize, thicknesses_mm: &[f64]) -> FitFigure {
        let names = (0..channels).map(|i| format!("{} nm", 400 + 10 * i));
        let panels = names.flat_map(|name| thicknesses_mm.iter().map(move |&t| panel(&name, t))).collect();
        FitFigure { title: "Vero White".into(), panels }
    }

    #[test]
    fn one_panel_or_many_are_well_laid_out() {
        for (channels, thicknesses) in
            [(1, &[0.5][..]), (3, &[0.5, 1.0]), (9, &[0.5]), (31, &[0.5, 1.0, 2.0])]
        {
            let picture = fit_figure(&figure(channels, thicknesses)).unwrap();
            assert_well_laid_out(&picture);
            let texts = texts(&picture);
            assert_eq!(texts.iter().filter(|text| text.ends_with(" nm")).count(), channels);
            for label in
                ["Vero White", "x [mm]", "radiance factor", "|∇| per pixel", "t = 0.5 mm", "measured"]
            {
                assert!(texts.iter().any(|text| text == label), "{label} in {texts:?}");
            }
        }
    }

    #[test]
    fn parameters_are_told_once_where_all_thicknesses_share_them() {
        let mut shared = figure(1, &[0.5, 1.0]);
        let count = |figure: &FitFigure| {
            let texts = texts(&fit_figure(figure).unwrap());
            texts.iter().filter(|text| text.starts_with("σt 6.25")).count()
        };
        assert_eq!(count(&shared), 1);
        shared.panels[1].refined_label = "σ_t 6.3".into();
        assert_eq!(count(&shared), 2);
    }

    #[test]
    fn odd_data_are_drawn_and_wrong_data_refused() {
        let mut figure = figure(2, &[0.5, 1.0]);
        figure.title = "a title that is <longer> than the figure & ".repeat(6);
        figure.panels.remove(3);
        figure.panels[0].channel = "a channel with a name that does not fit above its panel at all".into();
        figure.panels[2].measured = Curve { x_mm: vec![], values: vec![], gradient: vec![] };
        let flat =
            |value: f64| Curve { x_mm: vec![-5.0, 0.0, 5.0], values: vec![value; 3], gradient: vec![0.0; 3] };
        figure.panels[1].measured = flat(f64::NAN);
        figure.panels[1].grid = flat(0.5);
        figure.panels[1].refined = None;
        figure.panels[1].neighbours.clear();
        assert_well_laid_out(&fit_figure(&figure).unwrap());

        let twice = figure.panels[0].clone();
        figure.panels.push(twice);
        assert!(fit_figure(&figure).unwrap_err().to_string().starts_with("two panels for a channel"));
        figure.panels.truncate(1);
        figure.panels[0].grid.gradient.pop();
        assert!(fit_figure(&figure).unwrap_err().to_string().contains("360 values and 359 gradients"));
        figure.panels.clear();
        assert_eq!(fit_figure(&figure).unwrap_err().to_string(), "no panels to draw");
    }
}
