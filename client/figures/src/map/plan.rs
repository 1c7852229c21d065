//! Lays out and draws the maps and the colour bar.

use anyhow::{Context as _, ensure};
use optics_model::fit::{DistanceMap, MapLayer};
use tiny_skia::{Pixmap, PremultipliedColorU8};

use super::nodes::Nodes;
use super::overlay::marks;
use crate::drawing::axis::{Axis, extent};
use crate::drawing::canvas::{Canvas, PlotArea, at};
use crate::drawing::frame::{AxesFrame, Labels, TICKS_BELOW, tick_width};
use crate::drawing::head::MARGIN;
use crate::drawing::number::number;
use crate::drawing::rgb::Rgb;
use crate::drawing::text::{Anchor, HEADING, LABEL, Text};

const MOST_COLUMNS: usize = 4;
const BETWEEN: f64 = 16.0;
const HEADING_HEIGHT: f64 = 19.0;
/// Width of the name of the vertical axis.
const NAME: f64 = 18.0;
/// Height of the tick labels and the name of a horizontal axis.
const BELOW: f64 = TICKS_BELOW + 1.7 * LABEL;
const BAR_GAP: f64 = 22.0;
const BAR_WIDTH: f64 = 14.0;
/// Image pixels per CSS pixel, as in the PNG.
pub(super) const FINENESS: f64 = 2.0;
/// Largest ratio that the colours span, however close to zero the best distance is.
const MOST_CONTRAST: f64 = 1e4;

/// Positions and sizes of the maps and of the colour bar.
pub(super) struct MapPlan {
    panels: usize,
    across: usize,
    size: (f64, f64),
    co_albedo: Nodes,
    sigma_t: Nodes,
    colour: Axis,
    is_low_bright: bool,
    /// Width of the tick labels next to the first column.
    tick_width: f64,
    pub(super) width: f64,
}

impl MapPlan {
    pub(super) fn new(map: &DistanceMap, is_low_bright: bool) -> anyhow::Result<Self> {
        let panels = map.layers.len();
        ensure!(panels > 0, "no maps to draw");
        let across = panels.min(MOST_COLUMNS);
        let size = [(400.0, 340.0), (300.0, 260.0), (250.0, 220.0), (210.0, 190.0)][across - 1];
        let co_albedo = Nodes::new(map.albedo.iter().map(|albedo| 1.0 - albedo)).context("albedos")?;
        let sigma_t = Nodes::new(map.sigma_t_per_mm.iter().copied()).context("extinctions")?;
        let colour = colour_axis(map)?;
        let mut plan = Self {
            panels,
            across,
            size,
            co_albedo,
            sigma_t,
            colour,
            is_low_bright,
            tick_width: 0.0,
            width: 0.0,
        };
        plan.tick_width = tick_width(&plan.frame(0, 0.0).y_ticks()).ceil();
        let bar = plan.bar(0.0);
        plan.width = bar.area.right() + tick_width(&bar.y_ticks()) + NAME + MARGIN;
        Ok(plan)
    }

    fn rows(&self) -> usize {
        self.panels.div_ceil(self.across)
    }

    /// Distance from one row of panels to the next.
    fn pitch(&self) -> f64 {
        HEADING_HEIGHT + self.size.1 + BETWEEN
    }

    pub(super) fn height(&self) -> f64 {
        self.pitch() * self.rows() as f64 - BETWEEN + BELOW
    }

    pub(super) fn frame(&self, i: usize, top: f64) -> AxesFrame {
        let (width, height) = self.size;
        let left = MARGIN + NAME + self.tick_width + (i % self.across) as f64 * (width + BETWEEN);
        let top = top + (i / self.across) as f64 * self.pitch() + HEADING_HEIGHT;
        AxesFrame {
            area: PlotArea { left, top, width, height },
            x: self.co_albedo.axis,
            y: self.sigma_t.axis,
        }
    }

    pub(super) fn draw_panel(
        &self,
        canvas: &mut Canvas,
        map: &DistanceMap,
        i: usize,
        top: f64,
    ) -> anyhow::Result<()> {
        let (layer, best_of_all) = (&map.layers[i], i == map.best_layer);
        let frame = self.frame(i, top);
        let heading = Text::new(format!("g = {}", number(layer.g, 4)), HEADING);
        let heading = if best_of_all { heading.bold() } else { heading };
        canvas.text(at(frame.area.left, frame.area.top - 6.0), &heading);
        canvas.image(frame.area, self.pixels(layer)?);
        let first = i.is_multiple_of(self.across);
        let lowest = i + self.across >= self.panels;
        frame.axes(canvas, Labels { x: lowest, y: first });
        frame.close(canvas);
        let middle = frame.area.center();
        if first {
            let name = Text::new("σ_t [1/mm]", LABEL).anchor(Anchor::Middle);
            canvas.text_upwards(at(MARGIN + LABEL, middle.y), &name);
        }
        if lowest {
            let name = Text::new("1 − α", LABEL).anchor(Anchor::Middle);
            canvas.text(at(middle.x, frame.area.bottom() + TICKS_BELOW + 1.3 * LABEL), &name);
        }
        marks(canvas, &frame, layer, best_of_all);
        Ok(())
    }

    fn pixels(&self, layer: &MapLayer) -> anyhow::Result<Pixmap> {
        let [width, height] = [self.size.0, self.size.1].map(|length| (FINENESS * length) as u32);
        let part = |i: u32, n: u32| (f64::from(i) + 0.5) / f64::from(n);
        let columns: Vec<_> = (0..width).map(|x| self.co_albedo.index(part(x, width))).collect();
        let rows: Vec<_> = (0..height).map(|y| self.sigma_t.index(1.0 - part(y, height))).collect();
        pixmap(width, height, |x, y| self.colour_of(layer.errors[rows[y as usize]][columns[x as usize]]))
    }

    /// Small distances are bright, and so is noise.
    fn colour_of(&self, value: f64) -> Rgb {
        let fraction = self.colour.fraction(value);
        match value.is_finite() {
            true if self.is_low_bright => Rgb::viridis(1.0 - fraction),
            true => Rgb::viridis(fraction),
            false => Rgb::NO_DATA,
        }
    }

    /// The frame of the colour bar; its vertical axis is the distance.
    fn bar(&self, top: f64) -> AxesFrame {
        let last = self.frame(self.across - 1, top).area;
        let panels = self.pitch() * self.rows() as f64 - BETWEEN - HEADING_HEIGHT;
        let area = PlotArea { left: last.right() + BAR_GAP, top: last.top, width: BAR_WIDTH, height: panels };
        AxesFrame { area, x: Axis::exact(None), y: self.colour }
    }

    pub(super) fn draw_bar(&self, canvas: &mut Canvas, value_name: &str, top: f64) -> anyhow::Result<()> {
        let bar = self.bar(top);
        let height = (FINENESS * bar.area.height) as u32;
        let value = |y: u32| self.colour.value(1.0 - (f64::from(y) + 0.5) / f64::from(height));
        let pixels = pixmap(1, height, |_, y| self.colour_of(value(y)))?;
        canvas.image(bar.area, pixels);
        bar.scale_on_the_right(canvas);
        let name = Text::new(value_name, LABEL).anchor(Anchor::Middle);
        canvas.text_upwards(at(self.width - MARGIN - 2.0, bar.area.center().y), &name);
        Ok(())
    }
}

fn colour_axis(map: &DistanceMap) -> anyhow::Result<Axis> {
    let distances = || map.layers.iter().flat_map(|layer| layer.errors.iter().flatten().copied());
    let (_, high) = extent(distances()).context("no distances to draw")?;
    let Some((low, _)) = extent(distances().filter(|&d| d > 0.0)) else {
        // Every record is an exact match: one colour.
        return Ok(Axis::logarithmic(1e-3, 1e-3));
    };
    Ok(Axis::logarithmic(low.max(high / MOST_CONTRAST), high))
}

fn pixmap(width: u32, height: u32, colour: impl Fn(u32, u32) -> Rgb) -> anyhow::Result<Pixmap> {
    let mut pixels = Pixmap::new(width, height)
        .with_context(|| format!("{width} × {height} pixels of a map are none, or too many"))?;
    let places = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
    for ((x, y), pixel) in places.zip(pixels.pixels_mut()) {
        let Rgb(r, g, b) = colour(x, y);
        *pixel =
            PremultipliedColorU8::from_rgba(r, g, b, u8::MAX).expect("an opaque colour is premultiplied");
    }
    Ok(pixels)
}
