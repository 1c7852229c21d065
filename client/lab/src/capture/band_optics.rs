//! Compares where the bands of a session show the board: movement, lateral colour and focus.

use serde::Serialize;

use super::captured::CapturedPart;

/// Blur over that of the sharpest band from which on a band counts as out of focus.
const DEFOCUSED: f64 = 1.3;
/// Movement of the whole picture, in pixels, above which a filter or the camera must have moved.
const MOVED_PX: f64 = 3.0;
/// Distance within which corners of two bands are the same, in pixels.
const SAME_CORNER_PX: f64 = 20.0;

/// How the board appears in a band, against the sharpest one.
#[derive(Debug, Clone, Serialize)]
pub struct BandOptics {
    pub band: String,
    pub wavelength_nm: f64,
    /// Standard deviation of the filter's transmission.
    pub std_dev_nm: f64,
    /// Whether the others are compared with this band.
    pub is_reference: bool,
    /// Mean movement of the corners in pixels, to the right and down.
    pub shift_px: [f64; 2],
    /// Lateral colour: relative change of the picture's scale about its middle.
    pub magnification: f64,
    /// Root mean square of what shift and magnification leave, in pixels.
    pub left_px: f64,
    /// Standard deviation of the blur over that of the reference.
    pub blur_ratio: f64,
}

impl BandOptics {
    /// All bands; none of a session of red, green and blue.
    pub fn of(parts: &[CapturedPart]) -> Vec<Self> {
        let blur = |part: &CapturedPart| part.channels()[0].blur_mm().value;
        let sharpest = parts.iter().min_by(|a, b| blur(a).total_cmp(&blur(b)));
        let Some(reference) = sharpest.filter(|part| part.band.is_some()) else { return Vec::new() };
        let optics = |part: &CapturedPart| {
            let band = part.band.as_ref()?;
            let pairs = pairs(&reference.board.corners_px, &part.board.corners_px);
            let (shift_px, magnification, left_px) = similarity(&pairs);
            Some(Self {
                band: band.name.clone(),
                wavelength_nm: band.wavelength_nm,
                std_dev_nm: band.std_dev_nm(),
                is_reference: std::ptr::eq(part, reference),
                shift_px,
                magnification,
                left_px,
                blur_ratio: blur(part) / blur(reference),
            })
        };
        parts.iter().filter_map(optics).collect()
    }

    /// A remark on a band that is out of focus, or whose picture moved.
    pub fn doubt(&self) -> Option<String> {
        let [x, y] = self.shift_px;
        let name = &self.band;
        if self.blur_ratio > DEFOCUSED {
            let times = self.blur_ratio;
            return Some(format!(
                "band {name:?} is blurred {times:.2} times as much as the sharpest: focus each band"
            ));
        }
        (libm::hypot(x, y) > MOVED_PX).then(|| {
            format!(
                "the picture of band {name:?} lies {x:+.1}, {y:+.1} px from that of the sharpest: filter or camera moved; \
                 each band is measured with its own bare shots, so this does no harm if all of its shots moved"
            )
        })
    }
}

/// Corners that both pictures show.
fn pairs(of_reference: &[[f64; 2]], of_band: &[[f64; 2]]) -> Vec<[[f64; 2]; 2]> {
    let distance = |a: &[f64; 2], b: &[f64; 2]| libm::hypot(a[0] - b[0], a[1] - b[1]);
    let nearest = |corner: &[f64; 2]| {
        let other = of_band.iter().min_by(|a, b| distance(a, corner).total_cmp(&distance(b, corner)))?;
        (distance(other, corner) < SAME_CORNER_PX).then_some([*corner, *other])
    };
    of_reference.iter().filter_map(nearest).collect()
}

/// Shift and magnification that map the first places onto the second by least squares, and the root mean square of what
/// they leave.
fn similarity(pairs: &[[[f64; 2]; 2]]) -> ([f64; 2], f64, f64) {
    let n = pairs.len().max(1) as f64;
    let mean = |of: &dyn Fn(&[[f64; 2]; 2]) -> f64| pairs.iter().map(of).sum::<f64>() / n;
    let middle = [0, 1].map(|k| mean(&|p| p[0][k]));
    let shift = [0, 1].map(|k| mean(&|p| p[1][k] - p[0][k]));
    let from_middle = |p: &[[f64; 2]; 2]| [0, 1].map(|k| p[0][k] - middle[k]);
    let moved = |p: &[[f64; 2]; 2]| [0, 1].map(|k| p[1][k] - p[0][k] - shift[k]);
    let square: f64 = pairs.iter().map(|p| from_middle(p).iter().map(|v| v * v).sum::<f64>()).sum();
    let product =
        |p: &[[f64; 2]; 2]| -> f64 { from_middle(p).iter().zip(moved(p)).map(|(a, b)| a * b).sum() };
    let magnification = if square > 0.0 { pairs.iter().map(product).sum::<f64>() / square } else { 0.0 };
    let left = |p: &[[f64; 2]; 2]| -> f64 {
        let (from, moved) = (from_middle(p), moved(p));
        (0..2).map(|k| (moved[k] - magnification * from[k]).powi(2)).sum()
    };
    (shift, magnification, (pairs.iter().map(left).sum::<f64>() / n).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A picture that is shifted and 0.1 % larger is found as such; corners that only one band shows are left out.
    #[test]
    fn lateral_colour_is_a_magnification() {
        let corners = [[100.0, 100.0], [500.0, 100.0], [100.0, 400.0], [500.0, 400.0]];
        let moved = |[x, y]: [f64; 2]| [x + 1.5 + 1e-3 * (x - 300.0), y - 0.5 + 1e-3 * (y - 250.0)];
        let mut of_band: Vec<[f64; 2]> = corners.map(moved).to_vec();
        of_band.push([900.0, 900.0]);
        let (shift, magnification, left) = similarity(&pairs(&corners, &of_band));
        for (found, expected) in [(shift[0], 1.5), (shift[1], -0.5), (magnification, 1e-3), (left, 0.0)] {
            assert!((found - expected).abs() < 1e-9, "{found} for {expected}");
        }
    }
}
