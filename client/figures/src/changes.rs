//! Draws Fig. 3: the effect of small changes of one parameter on a profile.

use optics_model::fit::Curve;

use crate::drawing::canvas::Stroke;
use crate::drawing::legend::Key;
use crate::drawing::picture::Picture;
use crate::drawing::rgb::Rgb;
use crate::drawing::sheet::{GRADIENT, Sheet, SheetCell};

const REFERENCE: Stroke = Stroke::solid(Rgb::BLUE, 1.5);
const CHANGED: [Stroke; 4] = [
    Stroke::dashed(Rgb::VERMILLION, 1.5, &[6, 3]),
    Stroke::dashed(Rgb::ORANGE, 1.5, &[3, 2]),
    Stroke::dashed(Rgb::GREEN, 1.5, &[8, 3]),
    Stroke::dashed(Rgb::PURPLE, 1.5, &[2, 2]),
];

/// Profiles about one medium, the panels in reading order: parameters in columns, thicknesses in rows.
#[derive(Clone, Debug)]
pub struct ChangesFigure {
    pub title: String,
    pub x_mm: Vec<f64>,
    pub panels: Vec<ChangesPanel>,
}

#[derive(Clone, Debug)]
pub struct ChangesPanel {
    /// The parameter changed, as in "σ_t".
    pub parameter: String,
    pub thickness_mm: f64,
    pub reference: LabelledCurve,
    pub changed: Vec<LabelledCurve>,
}

/// A curve and the value it is for, as in "σ_t = 6 / mm".
#[derive(Clone, Debug)]
pub struct LabelledCurve {
    pub label: String,
    pub curve: Curve,
}

pub fn changes_figure(figure: &ChangesFigure) -> anyhow::Result<Picture> {
    let legend = vec![
        Key::line(REFERENCE, "reference"),
        Key::note("dashed: one parameter changed"),
        Key::note("|∇| per pixel of 10 mm / 360"),
    ];
    let cells = figure.panels.iter().map(|panel| cell(panel, &figure.x_mm)).collect();
    Sheet { title: &figure.title, legend, cells, alike: true, lower: GRADIENT }.draw()
}

fn cell<'a>(panel: &'a ChangesPanel, x_mm: &'a [f64]) -> SheetCell<'a> {
    let changed = CHANGED.into_iter().cycle().zip(&panel.changed);
    let lines: Vec<_> = std::iter::once((REFERENCE, &panel.reference)).chain(changed).collect();
    let keys = lines.iter().map(|(stroke, line)| Key::line(*stroke, line.label.as_str())).collect();
    let curves = lines.iter().map(|(stroke, line)| (*stroke, &line.curve)).collect();
    SheetCell {
        column: &panel.parameter,
        thickness_mm: panel.thickness_mm,
        keys,
        x_mm,
        curves,
        residuals: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::{assert_shows, edge, x_mm};

    fn labelled(label: &str, width_mm: f64) -> LabelledCurve {
        LabelledCurve { label: label.into(), curve: edge(0.2, 0.6, width_mm) }
    }

    #[test]
    fn parameters_are_columns_with_the_values_above() {
        let panels = ["σ_t", "α", "g"].into_iter().flat_map(|parameter| {
            [0.5, 1.0].map(|thickness_mm| ChangesPanel {
                parameter: parameter.into(),
                thickness_mm,
                reference: labelled("6", 0.5),
                changed: vec![labelled("5", 0.6), labelled("7", 0.4)],
            })
        });
        let picture =
            changes_figure(&ChangesFigure { title: "White".into(), x_mm: x_mm(), panels: panels.collect() })
                .unwrap();
        let texts = assert_shows(&picture, &["σt", "α", "g", "t = 1 mm", "reference", "x [mm]"]);
        assert_eq!(texts.iter().filter(|text| *text == "7").count(), 3, "printed once per column");
    }
}
