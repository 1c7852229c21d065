//! Fig. 6: the aggregate error over the scaling factor μ, and over g.

use anyhow::ensure;

use super::axis::{Axis, extent};
use super::canvas::{Area, Canvas, Stroke, at};
use super::color::Color;
use super::frame::{Frame, Labels, TICKS_BELOW, ticks_beside};
use super::head::{Head, MARGIN};
use super::legend::{Column, Key, Mark, Sample};
use super::number::{number, signed};
use super::picture::Picture;
use super::text::{Anchor, LABEL, Text};

const HEIGHT: f64 = 250.0;
const MU_WIDTH: f64 = 440.0;
const G_WIDTH: f64 = 280.0;
const NAME: f64 = 18.0;
const BETWEEN: f64 = 26.0;
const BELOW: f64 = TICKS_BELOW + 1.7 * LABEL;
const LINE: Stroke = Stroke::solid(Color::BLUE, 1.5);
const BAND: Color = Color(0xf8, 0xe2, 0xd2);

/// How well all materials together fit when measurements are scaled by μ.
#[derive(Clone, Debug)]
pub(crate) struct ScaleFigure {
    pub title: String,
    pub mu: Vec<f64>,
    /// One for each μ.
    pub error: Vec<f64>,
    pub best_mu: f64,
    pub std_error: Option<f64>,
    /// Empty if not wanted.
    pub by_g: Vec<ErrorAtG>,
    pub best_g: Option<f64>,
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct ErrorAtG {
    pub g: f64,
    pub error: f64,
}

pub(crate) fn scale_figure(figure: &ScaleFigure) -> anyhow::Result<Picture> {
    let (n, errors) = (figure.mu.len(), figure.error.len());
    ensure!(n > 0, "no errors to draw");
    ensure!(n == errors, "{n} scaling factors and {errors} errors");
    let mut panels = vec![over_mu(figure)];
    if !figure.by_g.is_empty() {
        panels.push(over_g(figure));
    }
    let mut left = MARGIN;
    for panel in &mut panels {
        left += NAME + ticks_beside(&panel.frame.y_ticks());
        panel.frame.area.left = left;
        left += panel.frame.area.width + BETWEEN;
    }
    let width = left - BETWEEN + MARGIN;
    let head = Head::new(&figure.title, &[], width - 2.0 * MARGIN);
    let keys =
        panels.iter().map(|p| Column::new(&p.keys, p.frame.area.width).height()).fold(0.0, f64::max) + 4.0;
    let top = head.height() + keys;
    let mut canvas = Canvas::new(width, top + HEIGHT + BELOW + MARGIN);
    head.draw(&mut canvas);
    for panel in &mut panels {
        panel.frame.area.top = top;
        panel.draw(&mut canvas);
    }
    Ok(canvas.finish())
}

struct Panel {
    frame: Frame,
    name: &'static str,
    keys: Vec<Key>,
    x: Vec<f64>,
    y: Vec<f64>,
    dots: bool,
    /// The best value and its standard error.
    best: Option<(f64, Option<f64>)>,
}

impl Panel {
    fn new(name: &'static str, width: f64, x: Vec<f64>, y: Vec<f64>) -> Self {
        let area = Area { left: 0.0, top: 0.0, width, height: HEIGHT };
        let x_axis = Axis::around(extent(x.iter().copied()), 1e-3);
        let y_axis = Axis::around(extent(y.iter().copied()), 0.01);
        let frame = Frame { area, x: x_axis, y: y_axis };
        Self { frame, name, keys: Vec::new(), x, y, dots: false, best: None }
    }

    fn draw(&self, canvas: &mut Canvas) {
        let (frame, area) = (&self.frame, self.frame.area);
        let keys = Column::new(&self.keys, area.width);
        keys.draw(canvas, area.left, area.top - keys.height() - 4.0);
        let inside = |x: f64| frame.across(x).clamp(area.left, area.right());
        if let Some((best, Some(std_error))) = self.best {
            let (left, right) = (inside(best - std_error), inside(best + std_error));
            canvas.fill(Area { left, width: right - left, ..area }, BAND);
        }
        frame.rules(canvas);
        frame.curve(canvas, &self.x, &self.y, LINE);
        if self.dots {
            for (&x, &y) in self.x.iter().zip(&self.y).filter(|(x, y)| x.is_finite() && y.is_finite()) {
                canvas.circle(frame.place(x, y), 2.2, Some(LINE.color), Stroke::solid(LINE.color, 0.0));
            }
        }
        if let Some((best, _)) = self.best.filter(|(best, _)| (0.0..=1.0).contains(&frame.x.fraction(*best)))
        {
            let x = frame.across(best);
            let bottom = area.bottom();
            let y = self.error_at(best).map_or(bottom, |error| frame.up(error));
            canvas.line(at(x, y), at(x, bottom), Stroke::dashed(Color::VERMILLION, 0.9, "3 2"));
            Mark::Dot.draw(canvas, at(x, y));
        }
        frame.axes(canvas, Labels { x: true, y: true });
        let middle = area.center();
        let name = Text::new(self.name, LABEL).anchor(Anchor::Middle);
        canvas.text(at(middle.x, area.bottom() + TICKS_BELOW + 1.3 * LABEL), &name);
        let name = Text::new("aggregate error", LABEL).anchor(Anchor::Middle);
        canvas.text_upwards(at(area.left - ticks_beside(&frame.y_ticks()) - 6.0, middle.y), &name);
    }

    /// The curve's height at a place, between the points on both sides.
    fn error_at(&self, place: f64) -> Option<f64> {
        let points = self.x.iter().copied().zip(self.y.iter().copied()).filter(|(_, y)| y.is_finite());
        let below = points.clone().filter(|(x, _)| *x <= place).max_by(|a, b| a.0.total_cmp(&b.0))?;
        let above = points.filter(|(x, _)| *x >= place).min_by(|a, b| a.0.total_cmp(&b.0))?;
        let part = if above.0 > below.0 { (place - below.0) / (above.0 - below.0) } else { 0.0 };
        Some(below.1 + part * (above.1 - below.1))
    }
}

fn over_mu(figure: &ScaleFigure) -> Panel {
    let mut panel = Panel::new("scaling factor μ", MU_WIDTH, figure.mu.clone(), figure.error.clone());
    let std_error = figure.std_error.filter(|e| e.is_finite() && *e > 0.0);
    let value = value_with_error(figure.best_mu, std_error);
    panel.keys.push(Key::mark(Mark::Dot, format!("minimum: μ = {value}")));
    if std_error.is_some() {
        panel.keys.push(Key { sample: Sample::Patch(BAND), label: "± standard error".into() });
    }
    panel.best = figure.best_mu.is_finite().then_some((figure.best_mu, std_error));
    panel
}

fn over_g(figure: &ScaleFigure) -> Panel {
    let (g, error) = figure.by_g.iter().map(|at| (at.g, at.error)).unzip();
    let mut panel = Panel::new("anisotropy g", G_WIDTH, g, error);
    panel.dots = true;
    if let Some(g) = figure.best_g {
        panel.keys.push(Key::mark(Mark::Dot, format!("minimum: g = {}", number(g, 4))));
        panel.best = Some((g, None));
    }
    panel
}

/// "0.9130 ± 0.0042": the error with two significant digits.
fn value_with_error(value: f64, std_error: Option<f64>) -> String {
    match std_error {
        Some(e) => {
            let decimals = (1.0 - e.log10().floor()).clamp(0.0, 9.0) as usize;
            signed(&format!("{value:.decimals$} ± {e:.decimals$}"))
        }
        None => number(value, 5),
    }
}

#[cfg(test)]
mod tests {
    use super::super::checks::{assert_well_laid_out, texts};
    use super::*;

    fn figure() -> ScaleFigure {
        let mu: Vec<f64> = (0..=200).map(|i| 0.8 + 0.001 * f64::from(i)).collect();
        let error = mu.iter().map(|mu| 0.28 + (mu - 0.913).abs()).collect();
        let by_g = (0_i32..9)
            .map(|i| ErrorAtG { g: 0.1 * f64::from(i), error: 0.3 + 0.02 * f64::from((i - 4).abs()) });
        ScaleFigure {
            title: "Five materials".into(),
            mu,
            error,
            best_mu: 0.913,
            std_error: Some(0.0042),
            by_g: by_g.collect(),
            best_g: Some(0.4),
        }
    }

    #[test]
    fn the_minimum_is_told_with_its_error() {
        let picture = scale_figure(&figure()).unwrap();
        assert_well_laid_out(&picture);
        let texts = texts(&picture);
        for label in ["minimum: μ = 0.9130 ± 0.0042", "minimum: g = 0.4", "scaling factor μ", "anisotropy g"]
        {
            assert!(texts.iter().any(|text| text == label), "{label} in {texts:?}");
        }
    }

    #[test]
    fn one_panel_or_one_value_are_enough() {
        let mut figure = figure();
        (figure.by_g, figure.std_error) = (Vec::new(), None);
        figure.error[7] = f64::NAN;
        let picture = scale_figure(&figure).unwrap();
        assert_well_laid_out(&picture);
        assert!(texts(&picture).iter().any(|text| text == "minimum: μ = 0.913"));
        (figure.mu, figure.error) = (vec![0.913], vec![0.28]);
        assert_well_laid_out(&scale_figure(&figure).unwrap());
        (figure.error[0], figure.best_mu, figure.std_error) = (f64::NAN, f64::NAN, Some(f64::NAN));
        let picture = scale_figure(&figure).unwrap();
        assert_well_laid_out(&picture);
        assert!(!texts(&picture).iter().any(|text| text == "± standard error"));
        figure.error.push(0.3);
        assert_eq!(scale_figure(&figure).unwrap_err().to_string(), "1 scaling factors and 2 errors");
    }

    #[test]
    fn the_mark_lies_on_the_curve() {
        let panel = over_mu(&figure());
        assert!((panel.error_at(0.9131).unwrap() - 0.2801).abs() < 1e-9);
        assert_eq!(panel.error_at(0.7), None);
    }
}
