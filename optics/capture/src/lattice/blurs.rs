//! Estimates the blur of an edge from the pixels around its points, in pixels.

use super::scan::{EdgePoint, Run};
use crate::blur::{self, EdgeBins};
use crate::estimate::Estimate;
use crate::view::PhotoView;

/// Width of the bins, in pixels.
const WIDTH: f64 = 0.25;

/// Fewest points that determine a blur.
const POINTS: usize = 10;

/// σ of the Gaussian across points on a line at = offset + slope · on, lens and pixel together.
pub(super) fn blur_px(
    view: PhotoView<'_>,
    run: Run,
    points: &[EdgePoint],
    slope: f64,
    reach: f64,
) -> Option<Estimate> {
    if points.len() < POINTS {
        return None;
    }
    let frame = view.frame();
    let half = (reach / WIDTH).ceil() as usize;
    let mut sums = vec![[0.0; 3]; 2 * half];
    let (length, cosine) = match run {
        Run::Down => (frame.width(), libm::hypot(slope, 1.0).recip()),
        Run::Across => (frame.height(), libm::hypot(slope, 1.0).recip()),
    };
    for point in smooth(points) {
        let on = point.on as usize;
        for site in frame.sites_of(view.sharpest()) {
            if !(if run == Run::Down { site.has_row(on) } else { site.has_column(on) }) {
                continue;
            }
            let from = (point.at - reach / cosine - 1.0).max(0.0) as usize;
            let to = ((point.at + reach / cosine + 1.0) as usize).min(length);
            let has = |i: &usize| if run == Run::Down { site.has_column(*i) } else { site.has_row(*i) };
            for i in (from..to).filter(has) {
                let distance = (i as f64 + 0.5 - point.at) * cosine;
                let bin = (distance / WIDTH + half as f64).floor();
                if (0.0..2.0 * half as f64).contains(&bin) {
                    let (x, y) = if run == Run::Down { (i, on) } else { (on, i) };
                    let value = view.signal(site, x, y);
                    let value = if point.rises { value } else { -value };
                    let sum = &mut sums[bin as usize];
                    *sum = [sum[0] + 1.0, sum[1] + value, sum[2] + value * value];
                }
            }
        }
    }
    let point = |(k, [n, sum, squares]): (usize, &[f64; 3])| {
        let mean = sum / n;
        let variance = (squares / n - mean * mean).max(1.0) / n;
        [(k as f64 + 0.5 - half as f64) * WIDTH, mean, variance.sqrt()]
    };
    let points = sums.iter().enumerate().filter(|(_, s)| s[0] > 2.0).map(point).collect();
    let fitted = blur::fit(&EdgeBins { width: WIDTH, reach, points })?;
    Some(fitted.blur)
}

/// Each point's place on a line through its neighbours, since the noise of single points would count as blur.
fn smooth(points: &[EdgePoint]) -> Vec<EdgePoint> {
    const AROUND: usize = 40;
    let n = points.len();
    (0..n)
        .map(|i| {
            let near = &points[i.saturating_sub(AROUND)..(i + AROUND + 1).min(n)];
            let m = near.len() as f64;
            let [on, at] =
                [near.iter().map(|p| p.on).sum::<f64>() / m, near.iter().map(|p| p.at).sum::<f64>() / m];
            let sxx: f64 = near.iter().map(|p| (p.on - on).powi(2)).sum();
            let sxy: f64 = near.iter().map(|p| (p.on - on) * (p.at - at)).sum();
            let slope = if sxx > 0.0 { sxy / sxx } else { 0.0 };
            EdgePoint { at: at + slope * (points[i].on - on), ..points[i] }
        })
        .collect()
}
