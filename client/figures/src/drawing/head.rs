//! Draws the title and the legend above the panels.

use super::canvas::{Canvas, at};
use super::legend::{Key, LegendRow};
use super::text::{TITLE, Text};

/// White space around every figure.
pub(crate) const MARGIN: f64 = 14.0;

const GAP: f64 = 8.0;

#[derive(Debug)]
pub(crate) struct Head<'a> {
    title: Vec<Text>,
    legend: LegendRow<'a>,
}

impl<'a> Head<'a> {
    pub(crate) fn new(title: &str, keys: &'a [Key], width: f64) -> Self {
        let mut title = Text::new(title, TITLE).bold().wrapped(width);
        title.retain(|line| !line.content.is_empty());
        Self { title, legend: LegendRow::new(keys, width) }
    }

    /// Height down to the top of the panels.
    pub(crate) fn height(&self) -> f64 {
        let legend = self.legend.height();
        self.legend_top() + if legend > 0.0 { legend + GAP } else { 0.0 }
    }

    pub(crate) fn draw(&self, canvas: &mut Canvas) {
        for (i, line) in self.title.iter().enumerate() {
            canvas.text(at(MARGIN, MARGIN + TITLE * (0.9 + 1.3 * i as f64)), line);
        }
        self.legend.draw(canvas, MARGIN, self.legend_top());
    }

    fn legend_top(&self) -> f64 {
        MARGIN + 1.3 * TITLE * self.title.len() as f64 + GAP
    }
}
