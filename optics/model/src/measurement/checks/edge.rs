//! Checks whether the edge is at `origin_mm`, or at x = 0, with the light side on the right.

use super::trace::Trace;
use super::{Kind, Seen};

/// Standard deviations from which on a difference of two levels is significant.
pub(super) const SURE: f64 = 5.0 * std::f64::consts::SQRT_2;
/// Standard deviations from which on the greatest of hundreds of differences is significant.
const SURE_OF_THE_GREATEST: f64 = 7.0 * std::f64::consts::SQRT_2;

/// Half the width of the window in which a rise is measured.
const WINDOW_MM: f64 = 0.5;

/// Finds a light side on the left, or a rise away from the edge.
pub(super) fn misplaced(trace: &Trace) -> Option<Seen> {
    falling(trace).or_else(|| elsewhere(trace))
}

/// Compares the levels of the outer quarters: the light side is brighter for every medium.
fn falling(trace: &Trace) -> Option<Seen> {
    let n = trace.len();
    let (left, right) = (trace.level(0..n / 4), trace.level(n - n / 4..n));
    let drop = left - right;
    if drop < SURE * trace.noise(n / 4) || drop < 0.05 * left {
        return None;
    }
    let finding = format!(
        "values fall from {left:.3} at x = {:.2} to {right:.3} at x = {:.2} mm",
        trace.x[0] + trace.origin,
        trace.x[n - 1] + trace.origin
    );
    if drop < 0.2 * left {
        let text = format!("{finding}: is the light uneven, or are dark and light side swapped?");
        return Some(Seen::warning(Kind::Falling, text));
    }
    let text = format!(
        "{finding}: dark and light side are swapped; x must rise from the dark side to the light side, so change its sign"
    );
    Some(Seen::refusal(Kind::Falling, text))
}

/// Compares the greatest rise of the profile with its rise at the edge: in every medium the rise is greatest at the edge,
/// to within a few per cent of the rise.
fn elsewhere(trace: &Trace) -> Option<Seen> {
    let n = trace.len();
    let width = trace.pixels(WINDOW_MM, 5).min(n / 4);
    if width < 3 {
        return None;
    }
    let rises: Vec<f64> = (width..=n - width).map(|place| trace.rise(place, width)).collect();
    let most = rises.iter().copied().fold(f64::MIN, f64::max);
    let here = rises[trace.edge().clamp(width, n - width) - width];
    let light = trace.level(n - n / 4..n);
    // The difference of two rises has √2 times the noise of one.
    let noise = std::f64::consts::SQRT_2 * trace.noise(width);
    if most - here < SURE_OF_THE_GREATEST * noise || most < 0.1 * light || here > 0.85 * most {
        return None;
    }
    let steep: Vec<usize> = (0..rises.len()).filter(|i| rises[*i] > 0.95 * most).collect();
    let place = steep[steep.len() / 2] + width;
    let at = 0.5 * (trace.x[place - 1] + trace.x[place]);
    let (said, place, advice) = if trace.origin == 0.0 {
        ("x = 0".to_owned(), at, at_zero(at))
    } else {
        let place = at + trace.origin;
        (format!("origin_mm = {}", trace.origin), place, format!("set origin_mm = {place:.2}"))
    };
    if here < 0.5 * most {
        let text = format!(
            "the profile does not rise at {said}; its edge seems to be at x = {place:.2} mm: {advice}"
        );
        return Some(Seen::refusal(Kind::EdgeElsewhere, text).at(0));
    }
    let text =
        format!("the profile rises more at x = {place:.2} mm than at {said}: if that is the edge, {advice}");
    Some(Seen::warning(Kind::EdgeElsewhere, text))
}

/// Advice for an edge that lies at `at` instead of 0.
fn at_zero(at: f64) -> String {
    let (how, way) = if at > 0.0 { ("subtract", "from") } else { ("add", "to") };
    format!("x = 0 must be at the edge, so {how} {:.2} mm {way} every x", at.abs())
}

/// Level of the middle of a profile relative to its ends.
pub(super) struct Middle {
    /// Mean of both sides near the edge less their mean at the ends.
    pub excess: f64,
    /// Light level less dark level at the ends.
    pub contrast: f64,
    /// Light level.
    light: f64,
    /// Standard deviation of `excess`.
    pub noise: f64,
}

/// None if the profile is too narrow, or shows no contrast.
///
/// A walk that met the base m times scores ρ_light^k ρ_dark^(m − k), which is convex in k, and its mirror image
/// scores the same with m − k. So F(x) + F(−x) is never larger than far from the edge, in any medium, under any
/// light that is even from left to right: half of it is smaller by up to a tenth of the contrast. Gamma raises it.
pub(super) fn middle(trace: &Trace) -> Option<Middle> {
    let reach = trace.reach();
    let near = (0.3f64).max(3.0 * trace.pitch);
    if reach < (5.0 * near).max(1.5) {
        return None;
    }
    let within = |from: f64, to: f64| {
        let place = |x: f64| trace.x.partition_point(|v| *v < x);
        place(from)..place(to)
    };
    let light = trace.level(within(0.75 * reach, reach));
    let contrast = light - trace.level(within(-reach, -0.75 * reach));
    let excess = trace.mean_of_both(0.0, near) - trace.mean_of_both(0.75 * reach, reach);
    let noise = trace.noise((2.0 * near / trace.pitch) as usize);
    let ends = trace.noise((0.25 * reach / trace.pitch) as usize);
    (contrast > SURE * ends && contrast > 0.02 * light).then_some(Middle { excess, contrast, light, noise })
}

/// Finds a middle above or below the possible range. A light that is brighter in the middle has the same effect, so this
/// is a warning.
pub(super) fn uneven(trace: &Trace) -> Option<Seen> {
    let m = middle(trace)?;
    let slack = 0.02 * m.light + 3.0 * m.noise;
    let text = if m.excess > 0.03 * m.contrast + slack {
        "is brighter than any linear profile's: x = 0 lies to the right of the edge, or the values are gamma-encoded, or the light falls off towards the ends"
    } else if m.excess < -0.15 * m.contrast - slack {
        "is darker than any medium's: x = 0 lies to the left of the edge, or the light is weaker in the middle"
    } else {
        return None;
    };
    let share = 100.0 * m.excess / m.contrast;
    let text =
        format!("the middle of the profile, {share:+.0} % of the contrast off the mean of its ends, {text}");
    Some(Seen::warning(Kind::Uneven, text))
}
