//! Estimates the noise of profiles without standard errors.

use optics_model::measurement::MIN_PIXELS;

use crate::likelihood::point::Line;

/// Standard errors from the scatter of values from pixel to pixel, on the dark and on the light side separately.
pub(crate) fn scatter_by_side(x_mm: &[f64], values: &[f64]) -> Line {
    let edge = x_mm.partition_point(|x| *x < 0.0);
    if edge.min(x_mm.len() - edge) < MIN_PIXELS {
        return vec![scatter(values); x_mm.len()];
    }
    let (dark, light) = (scatter(&values[..edge]), scatter(&values[edge..]));
    (0..x_mm.len()).map(|i| if i < edge { dark } else { light }).collect()
}

/// Standard deviation of independent noise: second differences remove smooth parts, the median rare ones.
fn scatter(values: &[f64]) -> f64 {
    let mut bends: Line = values.windows(3).map(|w| (w[0] - 2.0 * w[1] + w[2]).abs()).collect();
    bends.sort_by(f64::total_cmp);
    1.4826 * bends[bends.len() / 2] / 6.0_f64.sqrt()
}
