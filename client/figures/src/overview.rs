//! Draws Fig. 5: small multiples of a part of the dictionary.

use anyhow::ensure;

use crate::drawing::axis::{Axis, extent};
use crate::drawing::canvas::{Canvas, PlotArea, Stroke, at};
use crate::drawing::frame::{AxesFrame, Labels, TICKS_BELOW, tick_width};
use crate::drawing::head::{Head, MARGIN};
use crate::drawing::legend::Key;
use crate::drawing::number::number;
use crate::drawing::picture::Picture;
use crate::drawing::rgb::Rgb;
use crate::drawing::text::{Anchor, HEADING, LABEL, TICK, Text};

/// Largest width of a figure; blocks that exceed it are placed in the next row.
const MOST_WIDTH: f64 = 1500.0;
const BETWEEN_BLOCKS: f64 = 26.0;
const GAP: (f64, f64) = (7.0, 10.0);
const NAME: f64 = 18.0;
const HEADING_HEIGHT: f64 = 20.0;
/// Height of the names of the columns and their values.
const ABOVE: f64 = 2.0 * 15.0;
const BELOW: f64 = TICKS_BELOW + 1.7 * LABEL;
const EDGE: Stroke = Stroke::solid(Rgb::SKY_BLUE, 0.8);
/// The brightest part of viridis is too pale for lines on white.
const BRIGHTEST: f64 = 0.84;

/// Profiles of the records of one channel.
#[derive(Clone, Debug)]
pub struct OverviewFigure {
    pub title: String,
    pub channel: String,
    pub thickness_mm: Vec<f64>,
    pub sigma_t_per_mm: Vec<f64>,
    pub albedo: Vec<f64>,
    pub g: Vec<f64>,
    pub x_mm: Vec<f64>,
    /// Over `[thickness][σ_t][albedo][g]`, each as long as `x_mm` or empty if there is no record.
    pub profiles: Vec<Vec<f64>>,
}

pub fn overview_figure(figure: &OverviewFigure) -> anyhow::Result<Picture> {
    let plan = OverviewLayout::new(figure)?;
    let stroke = |i: usize| {
        let last = figure.g.len().saturating_sub(1).max(1);
        Stroke::solid(Rgb::viridis(BRIGHTEST * i as f64 / last as f64), 1.1)
    };
    let strokes: Vec<_> = (0..figure.g.len()).map(stroke).collect();
    let mut keys: Vec<_> = strokes
        .iter()
        .zip(&figure.g)
        .map(|(stroke, g)| Key::line(*stroke, format!("g = {}", number(*g, 4))))
        .collect();
    keys.push(Key::line(EDGE, "edge below the sample"));
    let title = [figure.title.as_str(), figure.channel.as_str()];
    let title = title.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join(" · ");
    let head = Head::new(&title, &keys, plan.width() - 2.0 * MARGIN);
    let mut canvas = Canvas::new(plan.width(), head.height() + plan.height() + MARGIN);
    head.draw(&mut canvas);
    for block in 0..figure.thickness_mm.len() {
        plan.draw_block(&mut canvas, block, head.height(), &strokes);
    }
    Ok(canvas.finish())
}

/// Positions and sizes of the blocks and cells.
struct OverviewLayout<'a> {
    figure: &'a OverviewFigure,
    x: Axis,
    y: Axis,
    cell: (f64, f64),
    /// Distances from a block's left edge to its first cell, and from its last cell to its right edge.
    sides: (f64, f64),
    /// Blocks side by side.
    across: usize,
}

impl<'a> OverviewLayout<'a> {
    fn new(figure: &'a OverviewFigure) -> anyhow::Result<Self> {
        let (columns, rows) = (figure.sigma_t_per_mm.len(), figure.albedo.len());
        let expected = figure.thickness_mm.len() * columns * rows * figure.g.len();
        ensure!(expected > 0, "no profiles to draw");
        ensure!(
            figure.profiles.len() == expected,
            "{} profiles for {expected} records",
            figure.profiles.len()
        );
        let pixels = figure.x_mm.len();
        let wrong = figure.profiles.iter().find(|profile| !profile.is_empty() && profile.len() != pixels);
        ensure!(wrong.is_none(), "a profile of {} values for {pixels} positions", wrong.map_or(0, Vec::len));

        let cell_width = (540.0 / columns as f64).clamp(52.0, 150.0).round();
        let cell = (cell_width, (0.72 * cell_width).max(36.0).round());
        let x = Axis::exact(extent(figure.x_mm.iter().copied()));
        let y = Axis::from_zero(extent(figure.profiles.iter().flatten().copied()));
        let mut plan = Self { figure, x, y, cell, sides: (0.0, 0.0), across: 1 };
        let values = figure.albedo.iter().map(|albedo| albedo_label(*albedo).width());
        plan.sides =
            (NAME + tick_width(&plan.frame(0, 0, (0.0, 0.0)).y_ticks()), 6.0 + values.fold(0.0, f64::max));
        let fitting =
            ((MOST_WIDTH - 2.0 * MARGIN + BETWEEN_BLOCKS) / (plan.block_width() + BETWEEN_BLOCKS)) as usize;
        plan.across = fitting.clamp(1, figure.thickness_mm.len());
        Ok(plan)
    }

    fn block_width(&self) -> f64 {
        self.sides.0 + span(self.figure.sigma_t_per_mm.len(), self.cell.0, GAP.0) + self.sides.1
    }

    fn block_height(&self) -> f64 {
        HEADING_HEIGHT + ABOVE + span(self.figure.albedo.len(), self.cell.1, GAP.1) + BELOW
    }

    fn width(&self) -> f64 {
        2.0 * MARGIN + self.across as f64 * (self.block_width() + BETWEEN_BLOCKS) - BETWEEN_BLOCKS
    }

    fn height(&self) -> f64 {
        let blocks = self.figure.thickness_mm.len().div_ceil(self.across);
        blocks as f64 * (self.block_height() + BETWEEN_BLOCKS) - BETWEEN_BLOCKS
    }

    /// The frame of one cell in the block whose first cell is at `origin`.
    fn frame(&self, column: usize, row: usize, origin: (f64, f64)) -> AxesFrame {
        let (width, height) = self.cell;
        let left = origin.0 + column as f64 * (width + GAP.0);
        let top = origin.1 + row as f64 * (height + GAP.1);
        AxesFrame { area: PlotArea { left, top, width, height }, x: self.x, y: self.y }
    }

    fn draw_block(&self, canvas: &mut Canvas, block: usize, top: f64, strokes: &[Stroke]) {
        let figure = self.figure;
        let (columns, rows) = (figure.sigma_t_per_mm.len(), figure.albedo.len());
        let left = MARGIN + (block % self.across) as f64 * (self.block_width() + BETWEEN_BLOCKS);
        let top = top + (block / self.across) as f64 * (self.block_height() + BETWEEN_BLOCKS);
        let origin = (left + self.sides.0, top + HEADING_HEIGHT + ABOVE);
        let heading = Text::new(format!("t = {} mm", figure.thickness_mm[block]), HEADING).bold();
        canvas.text(at(origin.0, top + HEADING), &heading);
        for column in 0..columns {
            for row in 0..rows {
                let frame = self.frame(column, row, origin);
                let first = ((block * columns + column) * rows + row) * figure.g.len();
                self.draw_cell(canvas, &frame, &figure.profiles[first..first + figure.g.len()], strokes);
                frame.axes(canvas, Labels { x: row + 1 == rows, y: column == 0 });
            }
        }
        self.draw_names(canvas, origin);
    }

    fn draw_cell(&self, canvas: &mut Canvas, frame: &AxesFrame, profiles: &[Vec<f64>], strokes: &[Stroke]) {
        if (0.0..=1.0).contains(&self.x.fraction(0.0)) {
            let x = frame.across(0.0);
            canvas.line(at(x, frame.area.top), at(x, frame.area.bottom()), EDGE);
        }
        for (profile, stroke) in profiles.iter().zip(strokes) {
            frame.curve(canvas, &self.figure.x_mm, profile, *stroke);
        }
    }

    /// Values of σ_t above and of α on the right, names of the axes on the left and below.
    fn draw_names(&self, canvas: &mut Canvas, origin: (f64, f64)) {
        let figure = self.figure;
        let (columns, rows) = (figure.sigma_t_per_mm.len(), figure.albedo.len());
        let width = span(columns, self.cell.0, GAP.0);
        let (right, bottom) = (origin.0 + width, origin.1 + span(rows, self.cell.1, GAP.1));
        let (middle, center) = (origin.0 + width / 2.0, f64::midpoint(origin.1, bottom));
        let name = |text: &str| Text::new(text, LABEL).anchor(Anchor::Middle);
        canvas.text(at(middle, origin.1 - 20.0), &name("σ_t [1/mm]"));
        canvas.text(at(middle, bottom + TICKS_BELOW + 1.3 * LABEL), &name("x [mm]"));
        canvas.text_upwards(at(origin.0 - self.sides.0 + LABEL, center), &name("radiance factor"));
        canvas.text(at(right + 6.0, origin.1 - 6.0), &Text::new("α", LABEL));
        for (column, sigma_t) in figure.sigma_t_per_mm.iter().enumerate() {
            let x = self.frame(column, 0, origin).area.center().x;
            let value = Text::new(number(*sigma_t, 5), TICK).anchor(Anchor::Middle);
            canvas.text(at(x, origin.1 - 6.0), &value);
        }
        for (row, albedo) in figure.albedo.iter().enumerate() {
            let y = self.frame(0, row, origin).area.center().y;
            canvas.text(at(right + 6.0, y + 0.36 * TICK), &albedo_label(*albedo));
        }
    }
}

/// Length of `n` cells with the gaps between them.
fn span(n: usize, cell: f64, gap: f64) -> f64 {
    n as f64 * (cell + gap) - gap
}

fn albedo_label(albedo: f64) -> Text {
    Text::new(number(albedo, 7), TICK)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::{assert_well_laid_out, edge, texts, x_mm};

    fn figure(thicknesses: usize, sigma_ts: usize, albedos: usize, gs: usize) -> OverviewFigure {
        let records = thicknesses * sigma_ts * albedos * gs;
        let profile = |i: usize| edge(0.1, 0.1 + 0.8 * i as f64 / records as f64, 0.5).values;
        OverviewFigure {
            title: "Dictionary".into(),
            channel: "R".into(),
            thickness_mm: (1..=thicknesses).map(|i| 0.5 * i as f64).collect(),
            sigma_t_per_mm: (1..=sigma_ts).map(|i| 0.25 * i as f64).collect(),
            albedo: (1..=albedos).map(|i| 1.0 - 0.9 * 0.5_f64.powi(i as i32)).collect(),
            g: (0..gs).map(|i| 0.1 * i as f64).collect(),
            x_mm: x_mm(),
            profiles: (0..records).map(profile).collect(),
        }
    }

    /// Blocks of any size are well laid out.
    #[test]
    fn overview_blocks_are_well_laid_out() {
        for (thicknesses, sigma_ts, albedos, gs) in
            [(2, 6, 8, 3), (1, 1, 1, 1), (3, 2, 2, 11), (2, 20, 10, 2)]
        {
            let picture = overview_figure(&figure(thicknesses, sigma_ts, albedos, gs)).unwrap();
            assert_well_laid_out(&picture);
            let texts = texts(&picture);
            let count = |start: &str| texts.iter().filter(|text| text.starts_with(start)).count();
            assert_eq!((count("t = "), count("g = ")), (thicknesses, gs));
            assert_eq!(
                (count("σt [1/mm]"), count("x [mm]"), count("Dictionary · R")),
                (thicknesses, thicknesses, 1)
            );
        }
    }

    /// Missing records are left out, and wrong data are refused.
    #[test]
    fn missing_records_are_left_out() {
        let mut figure = figure(1, 2, 2, 2);
        figure.profiles[3].clear();
        figure.profiles[4].fill(f64::NAN);
        let curves = |figure: &OverviewFigure| {
            let picture = overview_figure(figure).unwrap();
            picture.svg().matches(r#"stroke-width="1.1""#).count()
        };
        // Six profiles and the legend's two samples.
        assert_eq!(curves(&figure), 8);
        figure.profiles[0].pop();
        let message = overview_figure(&figure).unwrap_err().to_string();
        assert_eq!(message, "a profile of 359 values for 360 positions");
        figure.profiles.pop();
        assert_eq!(overview_figure(&figure).unwrap_err().to_string(), "7 profiles for 8 records");
        figure.g.clear();
        assert_eq!(overview_figure(&figure).unwrap_err().to_string(), "no profiles to draw");
    }
}
