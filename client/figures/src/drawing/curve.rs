//! Simplifies the polylines of profiles.

use super::canvas::{CanvasPoint, at};

/// Points nearer than this to the line between their neighbours are not drawn, in pixels.
const TOLERANCE: f64 = 0.05;

/// The pieces of a curve between values that are not finite, without points that would be invisible.
pub(crate) fn pieces(points: impl IntoIterator<Item = CanvasPoint>) -> Vec<Vec<CanvasPoint>> {
    let mut pieces = vec![Vec::new()];
    for point in points {
        if point.x.is_finite() && point.y.is_finite() {
            if let Some(piece) = pieces.last_mut() {
                piece.push(point);
            }
        } else if pieces.last().is_some_and(|piece| !piece.is_empty()) {
            pieces.push(Vec::new());
        }
    }
    pieces.retain(|piece| !piece.is_empty());
    pieces.iter().map(|piece| simplified(piece)).collect()
}

/// The Douglas–Peucker algorithm with an explicit stack.
fn simplified(points: &[CanvasPoint]) -> Vec<CanvasPoint> {
    let Some(end) = points.len().checked_sub(1) else { return Vec::new() };
    let mut kept = vec![false; points.len()];
    (kept[0], kept[end]) = (true, true);
    let mut spans = vec![(0, end)];
    while let Some((a, b)) = spans.pop() {
        let distances = (a + 1..b).map(|i| (i, distance(points[i], points[a], points[b])));
        if let Some((i, d)) = distances.max_by(|x, y| x.1.total_cmp(&y.1))
            && d > TOLERANCE
        {
            kept[i] = true;
            spans.extend([(a, i), (i, b)]);
        }
    }
    points.iter().zip(kept).filter_map(|(point, kept)| kept.then_some(*point)).collect()
}

/// Distance of a point from the segment between two others.
fn distance(point: CanvasPoint, from: CanvasPoint, to: CanvasPoint) -> f64 {
    let along = at(to.x - from.x, to.y - from.y);
    let length = libm::hypot(along.x, along.y);
    let offset = at(point.x - from.x, point.y - from.y);
    if length == 0.0 {
        return libm::hypot(offset.x, offset.y);
    }
    let part = ((offset.x * along.x + offset.y * along.y) / (length * length)).clamp(0.0, 1.0);
    libm::hypot(offset.x - part * along.x, offset.y - part * along.y)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A curve breaks where a value is missing.
    #[test]
    fn curve_breaks_at_missing_values() {
        let points = [0.0, 1.0, f64::NAN, f64::NAN, 3.0].map(|y| at(2.0 * y, y));
        assert_eq!(pieces(points), [vec![at(0.0, 0.0), at(2.0, 1.0)], vec![at(6.0, 3.0)]]);
        assert!(pieces([at(f64::NAN, 0.0)]).is_empty());
    }

    /// Only points that would not be visible are left out.
    #[test]
    fn only_invisible_points_are_left_out() {
        let height = |i: i32| if i == 50 { 8.0 } else { 0.01 * f64::from(i % 2) };
        let kept = pieces((0..=100).map(|i| at(f64::from(i), height(i)))).remove(0);
        assert_eq!(kept.iter().map(|p| p.x).collect::<Vec<_>>(), [0.0, 49.0, 50.0, 51.0, 100.0]);
    }
}
