//! Checks that tests apply to every figure.

use optics_model::fit::Curve;
use resvg::usvg::{Group, Node, Rect};

use crate::drawing::picture::Picture;

/// The middles of 360 pixels over ± 5 mm.
pub(super) fn x_mm() -> Vec<f64> {
    (0..360).map(|i| (f64::from(i) + 0.5) / 36.0 - 5.0).collect()
}

/// A blurred edge at the positions of `x_mm`.
pub(super) fn edge(dark: f64, light: f64, width_mm: f64) -> Curve {
    let x_mm = x_mm();
    let values = x_mm.iter().map(|x| dark + (light - dark) * 0.5 * (1.0 + (x / width_mm).tanh()));
    let gradient = x_mm.iter().map(|x| (light - dark) / (72.0 * width_mm) / (x / width_mm).cosh().powi(2));
    Curve { values: values.collect(), gradient: gradient.collect() }
}

/// The words of all text elements, in their order.
pub(super) fn texts(picture: &Picture) -> Vec<String> {
    let document = roxmltree::Document::parse(picture.svg()).unwrap();
    let elements = document.descendants().filter(|node| node.has_tag_name("text"));
    elements
        .map(|e| e.descendants().filter(roxmltree::Node::is_text).filter_map(|n| n.text()).collect())
        .collect()
}

/// Asserts that nothing is cut off and that no texts overlap.
pub(super) fn assert_well_laid_out(picture: &Picture) {
    let tree = picture.tree().unwrap();
    let (mut inked, mut texts) = (Vec::new(), Vec::new());
    collect(tree.root(), &mut inked, &mut texts);
    assert!(!texts.is_empty());
    let (width, height) = (tree.size().width(), tree.size().height());
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

fn collect(group: &Group, inked: &mut Vec<(String, Rect)>, texts: &mut Vec<(String, Rect)>) {
    for node in group.children() {
        match node {
            Node::Group(group) => collect(group, inked, texts),
            Node::Text(text) => {
                let words = text.chunks().iter().map(|chunk| chunk.text().to_owned()).collect();
                texts.push((words, text.abs_stroke_bounding_box()));
            }
            Node::Path(_) | Node::Image(_) => inked.push(("a shape".into(), node.abs_stroke_bounding_box())),
        }
    }
}
