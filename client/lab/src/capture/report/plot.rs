//! Plots in the colours of the page, as SVG within it.

/// Width and height of a plot, and the room for its labels, in CSS pixels.
const SIZE: [f64; 2] = [480.0, 260.0];
const MARGIN: [f64; 4] = [12.0, 12.0, 40.0, 56.0];

/// One line of a plot.
#[derive(Debug)]
pub(super) struct Curve<'a> {
    /// Class of the page's style, which gives its colour.
    pub(super) class: &'static str,
    pub(super) x: &'a [f64],
    pub(super) y: Vec<f64>,
    /// Half the width of its band; none if empty.
    pub(super) band: Vec<f64>,
}

/// Curves over x; `y` is the range that is shown at least.
pub(super) fn plot(curves: &[Curve], [x_label, y_label]: [&str; 2], y: [f64; 2]) -> String {
    let finite = |values: &mut dyn Iterator<Item = f64>| {
        values
            .filter(|v| v.is_finite())
            .fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], v| [a.min(v), b.max(v)])
    };
    let x_range = finite(&mut curves.iter().flat_map(|c| c.x.iter().copied()));
    let [low, high] = finite(&mut curves.iter().flat_map(|c| c.y.iter().copied()));
    if x_range[0] >= x_range[1] || low > high {
        return String::new();
    }
    let frame = Frame { x: x_range, y: padded([low.min(y[0]), high.max(y[1])]) };
    let lines: String = curves.iter().map(|curve| frame.curve(curve)).collect();
    let [width, height] = SIZE;
    format!(
        "<svg class=\"plot\" viewBox=\"0 0 {width} {height}\" role=\"img\">{}{lines}<text x=\"{:.0}\" y=\"{:.0}\" text-anchor=\"middle\">{x_label}</text>\
         <text transform=\"translate(13 {:.0}) rotate(-90)\" text-anchor=\"middle\">{y_label}</text></svg>",
        frame.axes(),
        0.5 * (width + MARGIN[3]),
        height - 6.0,
        0.5 * height - 10.0,
    )
}

fn padded([low, high]: [f64; 2]) -> [f64; 2] {
    let room = 0.04 * (high - low).max(1e-9);
    [low - if low == 0.0 { 0.0 } else { room }, high + room]
}

struct Frame {
    x: [f64; 2],
    y: [f64; 2],
}

impl Frame {
    fn place(&self, x: f64, y: f64) -> [f64; 2] {
        let [top, right, bottom, left] = MARGIN;
        let across = (x - self.x[0]) / (self.x[1] - self.x[0]);
        let up = (y - self.y[0]) / (self.y[1] - self.y[0]);
        [left + across * (SIZE[0] - left - right), SIZE[1] - bottom - up * (SIZE[1] - top - bottom)]
    }

    fn curve(&self, curve: &Curve) -> String {
        let path = |points: &mut dyn Iterator<Item = (f64, f64)>| {
            let places = points.filter(|p| p.1.is_finite()).map(|(x, y)| self.place(x, y));
            places.map(|[x, y]| format!("{x:.1},{y:.1}")).collect::<Vec<_>>().join(" ")
        };
        let points = || curve.x.iter().copied().zip(curve.y.iter().copied());
        let mut text = String::new();
        if !curve.band.is_empty() {
            let band =
                || points().zip(curve.band.iter().copied()).filter(|(p, half)| (p.1 + half).is_finite());
            let up = path(&mut band().map(|((x, y), half)| (x, y + half)));
            let mut below: Vec<_> = band().map(|((x, y), half)| (x, y - half)).collect();
            below.reverse();
            let down = path(&mut below.into_iter());
            text += &format!("<polygon class=\"band {}\" points=\"{up} {down}\"/>", curve.class);
        }
        text + &format!("<polyline class=\"curve {}\" points=\"{}\"/>", curve.class, path(&mut points()))
    }

    fn axes(&self) -> String {
        let mut text = String::new();
        for x in ticks(self.x) {
            let ([x0, y0], [_, y1]) = (self.place(x, self.y[0]), self.place(x, self.y[1]));
            text += &format!("<path class=\"axis\" d=\"M{x0:.1} {y0:.1}V{y1:.1}\"/>");
            text += &format!(
                "<text x=\"{x0:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
                y0 + 15.0,
                label(x)
            );
        }
        for y in ticks(self.y) {
            let ([x0, y0], [x1, _]) = (self.place(self.x[0], y), self.place(self.x[1], y));
            text += &format!("<path class=\"axis\" d=\"M{x0:.1} {y0:.1}H{x1:.1}\"/>");
            text += &format!(
                "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
                x0 - 5.0,
                y0 + 4.0,
                label(y)
            );
        }
        text
    }
}

/// Round numbers within a range: four to ten of them.
fn ticks([from, to]: [f64; 2]) -> Vec<f64> {
    let rough = (to - from) / 5.0;
    let power = 10_f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].into_iter().map(|m| m * power).find(|s| *s >= rough).unwrap_or(rough);
    let first = (from / step).ceil() as i64;
    (first..).map(|i| i as f64 * step).take_while(|t| *t <= to + 1e-9 * step).take(20).collect()
}

fn label(value: f64) -> String {
    let text = format!("{value:.4}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".to_owned() } else { text.replace('-', "−") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_within() {
        assert_eq!(ticks([-5.0, 5.0]), [-4.0, -2.0, 0.0, 2.0, 4.0]);
        assert_eq!(
            ticks([0.0, 0.83]).iter().map(|t| label(*t)).collect::<Vec<_>>(),
            ["0", "0.2", "0.4", "0.6", "0.8"]
        );
    }

    #[test]
    fn values_that_are_not_finite_are_left_out() {
        let x = [0.0, 1.0, 2.0];
        let curve = Curve { class: "R", x: &x, y: vec![0.0, f64::NAN, 1.0], band: vec![0.1; 3] };
        let text = plot(&[curve], ["x", "y"], [0.0, 1.0]);
        assert!(!text.contains("NaN") && text.contains("polyline"), "{text}");
        assert_eq!(plot(&[], ["x", "y"], [0.0, 1.0]), "");
    }
}
