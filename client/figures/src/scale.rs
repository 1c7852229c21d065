//! Draws Fig. 6: the error of the best records (Eq. 3) over the scaling factor μ, and the objective of refined media
//! over g.

use anyhow::ensure;
use optics_model::fit::{Common, Objective, ScaleCurve};

use crate::drawing::axis::{Axis, extent};
use crate::drawing::canvas::{Canvas, PlotArea, Stroke, at};
use crate::drawing::frame::{AxesFrame, Labels, TICKS_BELOW, tick_width};
use crate::drawing::head::{Head, MARGIN};
use crate::drawing::legend::{Key, KeySample, LegendColumn, Mark};
use crate::drawing::number::{number, signed};
use crate::drawing::picture::Picture;
use crate::drawing::rgb::Rgb;
use crate::drawing::text::{Anchor, LABEL, Text};

const HEIGHT: f64 = 250.0;
const MU_WIDTH: f64 = 440.0;
const G_WIDTH: f64 = 280.0;
const NAME: f64 = 18.0;
const BETWEEN: f64 = 26.0;
const BELOW: f64 = TICKS_BELOW + 1.7 * LABEL;
const LINE: Stroke = Stroke::solid(Rgb::BLUE, 1.5);
const REFINED: Stroke = Stroke::dashed(Rgb::GREEN, 1.2, &[5, 3]);
const BAND: Rgb = Rgb(0xf8, 0xe2, 0xd2);

/// Draws how well all materials together fit when measurements are scaled by μ, and with each g. The ordinates may be
/// two quantities: the paper's distance over μ, the objective of the fit over g.
pub fn scale_figure(curve: &ScaleCurve, common: &Common, objective: Objective) -> anyhow::Result<Picture> {
    ensure!(!curve.points.is_empty(), "no errors to draw");
    let mut panels = vec![over_mu(curve, common)];
    if !common.by_g.is_empty() {
        panels.push(over_g(common, objective));
    }
    let mut left = MARGIN;
    for panel in &mut panels {
        left += NAME + tick_width(&panel.frame.y_ticks());
        panel.frame.area.left = left;
        left += panel.frame.area.width + BETWEEN;
    }
    let width = left - BETWEEN + MARGIN;
    let head = Head::new("Scale factor common to all materials", &[], width - 2.0 * MARGIN);
    let keys =
        panels.iter().map(|p| LegendColumn::new(&p.keys, p.frame.area.width).height()).fold(0.0, f64::max)
            + 4.0;
    let top = head.height() + keys;
    let mut canvas = Canvas::new(width, top + HEIGHT + BELOW + MARGIN);
    head.draw(&mut canvas);
    for panel in &mut panels {
        panel.frame.area.top = top;
        panel.draw(&mut canvas);
    }
    Ok(canvas.finish())
}

struct ScalePanel {
    frame: AxesFrame,
    name: &'static str,
    /// Name of the ordinate.
    error: &'static str,
    keys: Vec<Key>,
    x: Vec<f64>,
    y: Vec<f64>,
    dots: bool,
    /// The best value and its standard error.
    best: Option<(f64, Option<f64>)>,
    /// The answer's value if it differs from the best.
    refined: Option<f64>,
}

impl ScalePanel {
    fn new(name: &'static str, error: &'static str, width: f64, x: Vec<f64>, y: Vec<f64>) -> Self {
        let area = PlotArea { left: 0.0, top: 0.0, width, height: HEIGHT };
        let x_axis = Axis::around(extent(x.iter().copied()), 1e-3);
        let y_axis = Axis::around(extent(y.iter().copied()), 0.01);
        let frame = AxesFrame { area, x: x_axis, y: y_axis };
        Self { frame, name, error, keys: Vec::new(), x, y, dots: false, best: None, refined: None }
    }

    fn draw(&self, canvas: &mut Canvas) {
        let (frame, area) = (&self.frame, self.frame.area);
        let keys = LegendColumn::new(&self.keys, area.width);
        keys.draw(canvas, area.left, area.top - keys.height() - 4.0);
        let inside = |x: f64| frame.across(x).clamp(area.left, area.right());
        if let Some((best, Some(std_error))) = self.best {
            let (left, right) = (inside(best - std_error), inside(best + std_error));
            canvas.fill(PlotArea { left, width: right - left, ..area }, BAND);
        }
        frame.rules(canvas);
        frame.curve(canvas, &self.x, &self.y, LINE);
        if self.dots {
            for (&x, &y) in self.x.iter().zip(&self.y).filter(|(x, y)| x.is_finite() && y.is_finite()) {
                canvas.circle(frame.place(x, y), 2.2, Some(LINE.colour), Stroke::solid(LINE.colour, 0.0));
            }
        }
        if let Some((best, _)) = self.best.filter(|(best, _)| (0.0..=1.0).contains(&frame.x.fraction(*best)))
        {
            let x = frame.across(best);
            let bottom = area.bottom();
            let y = self.error_at(best).map_or(bottom, |error| frame.up(error));
            canvas.line(at(x, y), at(x, bottom), Stroke::dashed(Rgb::VERMILLION, 0.9, &[3, 2]));
            Mark::Dot.draw(canvas, at(x, y));
        }
        if let Some(refined) = self.refined.filter(|x| (0.0..=1.0).contains(&frame.x.fraction(*x))) {
            let x = frame.across(refined);
            canvas.line(at(x, area.top), at(x, area.bottom()), REFINED);
        }
        frame.axes(canvas, Labels { x: true, y: true });
        let middle = area.center();
        let name = Text::new(self.name, LABEL).anchor(Anchor::Middle);
        canvas.text(at(middle.x, area.bottom() + TICKS_BELOW + 1.3 * LABEL), &name);
        let name = Text::new(self.error, LABEL).anchor(Anchor::Middle);
        canvas.text_upwards(at(area.left - tick_width(&frame.y_ticks()) - 6.0, middle.y), &name);
    }

    /// The curve's height at a position, interpolated between the points on both sides.
    fn error_at(&self, place: f64) -> Option<f64> {
        let points = self.x.iter().copied().zip(self.y.iter().copied()).filter(|(_, y)| y.is_finite());
        let below = points.clone().filter(|(x, _)| *x <= place).max_by(|a, b| a.0.total_cmp(&b.0))?;
        let above = points.filter(|(x, _)| *x >= place).min_by(|a, b| a.0.total_cmp(&b.0))?;
        let part = if above.0 > below.0 { (place - below.0) / (above.0 - below.0) } else { 0.0 };
        Some(below.1 + part * (above.1 - below.1))
    }
}

fn over_mu(curve: &ScaleCurve, common: &Common) -> ScalePanel {
    let (mu, error) = curve.points.iter().map(|point| (point.mu, point.error)).unzip();
    let mut panel =
        ScalePanel::new("scaling factor μ", "error of the best records, Eq. 3", MU_WIDTH, mu, error);
    let positive = |e: &f64| e.is_finite() && *e > 0.0;
    let (best, std_error) = (curve.best.mu, curve.std_error.filter(positive));
    let by_records = value_with_error(best, std_error);
    panel.keys.push(Key::mark(Mark::Dot, format!("minimum, by records alone: μ* = {by_records}")));
    if common.mu_chosen {
        let refined = value_with_error(common.mu, Some(common.mu_std_error).filter(positive));
        panel.refined = common.mu.is_finite().then_some(common.mu);
        panel.keys.push(Key::line(REFINED, format!("of the answer, by refined media: μ = {refined}")));
    }
    if std_error.is_some() {
        panel.keys.push(Key { sample: KeySample::Patch(BAND), label: "± standard error".into() });
    }
    panel.best = best.is_finite().then_some((best, std_error));
    panel
}

fn over_g(common: &Common, objective: Objective) -> ScalePanel {
    let (g, error) = common.by_g.iter().map(|at| (at.g, at.error)).unzip();
    let name = match objective {
        Objective::Likelihood => "−2 ln L of all channels",
        Objective::Paper => "error of the best records, Eq. 3",
    };
    let mut panel = ScalePanel::new("anisotropy g", name, G_WIDTH, g, error);
    panel.dots = true;
    // A given anisotropy is no minimum.
    if let Some(g) = common.g_interval.and(common.g) {
        panel.keys.push(Key::mark(Mark::Dot, format!("minimum: g = {}", number(g, 4))));
        panel.best = Some((g, None));
    }
    panel
}

/// "0.9130 ± 0.0042": the error with two significant digits.
fn value_with_error(value: f64, std_error: Option<f64>) -> String {
    match std_error {
        Some(e) => {
            let decimals = (1.0 - libm::log10(e).floor()).clamp(0.0, 9.0) as usize;
            signed(&format!("{value:.decimals$} ± {e:.decimals$}"))
        }
        None => number(value, 5),
    }
}

#[cfg(test)]
mod tests {
    use optics_model::fit::{GError, ScalePoint};

    use super::*;
    use crate::checks::{assert_shows, assert_well_laid_out, texts};
    use crate::testing;

    fn answer() -> (ScaleCurve, Common) {
        let points = (0..=200).map(|i| 0.8 + 0.001 * f64::from(i));
        let points = points.map(|mu| ScalePoint { mu, error: 0.28 + (mu - 0.913).abs() }).collect();
        let at = |g, error| GError { g, error, best_mu: 0.9, best_mu_error: 0.28 };
        let by_g = (0_i32..9).map(|i| at(0.1 * f64::from(i), 0.3 + 0.02 * f64::from((i - 4).abs())));
        let curve = ScaleCurve { points, ..testing::scale_curve() };
        (curve, Common { by_g: by_g.collect(), ..testing::common() })
    }

    fn figure((curve, common): &(ScaleCurve, Common)) -> Picture {
        scale_figure(curve, common, Objective::Likelihood).unwrap()
    }

    /// The minimum is shown with its error.
    #[test]
    fn minimum_is_shown_with_its_error() {
        let picture = figure(&answer());
        assert_shows(
            &picture,
            &[
                "minimum, by records alone: μ* = 0.9130 ± 0.0042",
                "of the answer, by refined media: μ = 0.900 ± 0.010",
                "minimum: g = 0.4",
                "scaling factor μ",
                "error of the best records, Eq. 3",
                "anisotropy g",
                "−2 ln L of all channels",
            ],
        );
    }

    /// An anisotropy that was given is not shown as a minimum.
    #[test]
    fn given_anisotropy_is_no_minimum() {
        let mut answer = answer();
        answer.1.g_interval = None;
        assert!(!texts(&figure(&answer)).iter().any(|text| text.starts_with("minimum: g")));
    }

    #[test]
    fn one_panel_or_one_value_are_enough() {
        let mut answer = answer();
        (answer.1.by_g, answer.0.std_error) = (Vec::new(), None);
        answer.0.points[7].error = f64::NAN;
        let picture = figure(&answer);
        assert_well_laid_out(&picture);
        assert!(texts(&picture).iter().any(|text| text == "minimum, by records alone: μ* = 0.913"));
        answer.0.points = vec![answer.0.best];
        assert_well_laid_out(&figure(&answer));
        let none = ScalePoint { mu: f64::NAN, error: f64::NAN };
        answer.0.points[0].error = f64::NAN;
        (answer.0.best, answer.0.std_error) = (none, Some(f64::NAN));
        let picture = figure(&answer);
        assert_well_laid_out(&picture);
        assert!(!texts(&picture).iter().any(|text| text == "± standard error"));
        answer.0.points.clear();
        let refused = scale_figure(&answer.0, &answer.1, Objective::Paper).unwrap_err();
        assert_eq!(refused.to_string(), "no errors to draw");
    }

    #[test]
    fn mark_lies_on_the_curve() {
        let panel = over_mu(&answer().0, &answer().1);
        assert!((panel.error_at(0.9131).unwrap() - 0.2801).abs() < 1e-9);
        assert_eq!(panel.error_at(0.7), None);
    }
}
