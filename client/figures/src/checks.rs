//! Checks that tests apply to every figure.

use optics_model::fit::Curve;
use tiny_skia::Rect;

use crate::drawing::picture::Picture;
use crate::drawing::picture::png::{outline, pen};
use crate::drawing::shape::{Shape, ShapeKind};

/// The middles of 360 pixels over ± 5 mm.
pub(super) fn x_mm() -> Vec<f64> {
    (0..360).map(|i| (f64::from(i) + 0.5) / 36.0 - 5.0).collect()
}

/// A blurred edge at the positions of `x_mm`.
pub(super) fn edge(dark: f64, light: f64, width_mm: f64) -> Curve {
    let x_mm = x_mm();
    let values = x_mm.iter().map(|x| dark + (light - dark) * 0.5 * (1.0 + libm::tanh(x / width_mm)));
    let gradient = x_mm.iter().map(|x| (light - dark) / (72.0 * width_mm) / libm::cosh(x / width_mm).powi(2));
    Curve { values: values.collect(), gradient: gradient.collect() }
}

/// The words of all text elements, in their order.
pub(super) fn texts(picture: &Picture) -> Vec<String> {
    let svg = picture.svg();
    let document = roxmltree::Document::parse(&svg).unwrap();
    let elements = document.descendants().filter(|node| node.has_tag_name("text"));
    elements
        .map(|e| e.descendants().filter(roxmltree::Node::is_text).filter_map(|n| n.text()).collect())
        .collect()
}

/// Asserts that a figure is well laid out and has texts with all of these parts; returns its texts.
pub(super) fn assert_shows(picture: &Picture, parts: &[&str]) -> Vec<String> {
    assert_well_laid_out(picture);
    let texts = texts(picture);
    for part in parts {
        assert!(texts.iter().any(|text| text.contains(part)), "{part} in {texts:?}");
    }
    texts
}

/// Asserts that nothing is cut off and that no texts overlap.
pub(super) fn assert_well_laid_out(picture: &Picture) {
    let (mut inked, mut texts) = (Vec::new(), Vec::new());
    for shape in &picture.shapes {
        match (&shape.kind, inked_area(shape)) {
            (_, None) => {}
            (ShapeKind::Text(_, text) | ShapeKind::TextUpwards(_, text), Some(area)) => {
                texts.push((text.content.clone(), area));
            }
            (_, Some(area)) => inked.push(("a shape".to_owned(), area)),
        }
    }
    assert!(!texts.is_empty());
    let (width, height) = (picture.width as f32, picture.height as f32);
    for (name, area) in inked.iter().chain(&texts) {
        let inside =
            area.left() >= 0.0 && area.top() >= 0.0 && area.right() <= width && area.bottom() <= height;
        assert!(inside, "{name} at {area:?} is cut off by {width} × {height}");
    }
    for (i, (a, area_a)) in texts.iter().enumerate() {
        for (b, area_b) in &texts[..i] {
            let apart = area_a.left() > area_b.right()
                || area_b.left() > area_a.right()
                || area_a.top() > area_b.bottom()
                || area_b.top() > area_a.bottom();
            assert!(apart, "{a:?} at {area_a:?} lies upon {b:?} at {area_b:?}");
        }
    }
}

/// The bounds of what is drawn, with the width of lines; for texts of the outlines of their letters.
fn inked_area(shape: &Shape) -> Option<Rect> {
    let outline = outline(shape)?;
    let stroked = shape.visible_stroke().and_then(|stroke| outline.stroke(&pen(stroke), 1.0));
    Some(stroked.unwrap_or(outline).bounds())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawing::canvas::Canvas;
    use crate::drawing::rgb::Rgb;
    use crate::drawing::shape::{Stroke, at};
    use crate::drawing::text::{Anchor, Text};

    fn is_well_laid_out(draw: impl Fn(&mut Canvas)) -> bool {
        let mut canvas = Canvas::new(100.0, 60.0);
        canvas.text(at(50.0, 30.0), &Text::new("σ_t 10^{−3}", 10.0).anchor(Anchor::Middle));
        draw(&mut canvas);
        let picture = canvas.finish();
        std::panic::catch_unwind(|| assert_well_laid_out(&picture)).is_ok()
    }

    /// Lines count with their width, and letters with their own outlines.
    #[test]
    fn cut_off_shapes_are_found() {
        let line = |y| move |c: &mut Canvas| c.line(at(2.0, y), at(98.0, y), Stroke::solid(Rgb::INK, 2.0));
        assert!(is_well_laid_out(line(58.9)) && !is_well_laid_out(line(59.1)));
        let dot = |x| move |c: &mut Canvas| c.polyline(&[at(x, 9.0)], Stroke::dots(Rgb::INK, 4.0));
        assert!(is_well_laid_out(dot(2.1)) && !is_well_laid_out(dot(1.9)));
        let end = |x| move |c: &mut Canvas| c.text(at(x, 9.0), &Text::new("mm", 10.0).anchor(Anchor::End));
        assert!(is_well_laid_out(end(99.9)) && !is_well_laid_out(end(101.0)));
        let up = |y| move |c: &mut Canvas| c.text_upwards(at(9.0, y), &Text::new("mm", 10.0));
        assert!(is_well_laid_out(up(21.0)) && !is_well_laid_out(up(18.0)));
    }

    /// An index and an exponent count as well as the letters at the baseline.
    #[test]
    fn overlapping_texts_are_found() {
        let text = |x, y| move |c: &mut Canvas| c.text(at(x, y), &Text::new("mm", 10.0));
        assert!(is_well_laid_out(text(40.0, 12.0)) && is_well_laid_out(text(40.0, 40.0)));
        assert!(!is_well_laid_out(text(40.0, 25.0)) && !is_well_laid_out(text(60.0, 22.0)));
        assert!(!is_well_laid_out(text(30.0, 37.0)) && is_well_laid_out(text(78.0, 30.0)));
        let up = |x| move |c: &mut Canvas| c.text_upwards(at(x, 50.0), &Text::new("mmmm", 10.0));
        assert!(is_well_laid_out(up(25.0)) && !is_well_laid_out(up(33.0)));
    }
}
