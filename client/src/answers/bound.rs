//! Formats intervals next to the Cramér–Rao bound of the pixels.

use farm_figures::estimates::estimate_rows;
use farm_figures::numbers::{short, significant};
use optics_model::fit::{Ends, Interval, MaterialFit, Refined};

use crate::output::{table, wrapped};

/// One row per quantity: half-widths of the interval and of the Cramér–Rao bound, in per cent of it, and their ratio.
pub(super) fn bounds(fits: &[MaterialFit]) -> String {
    let mut rows = Vec::new();
    for fit in fits {
        for channel in &fit.channels {
            let Some(refined) = &channel.refined else { continue };
            for (i, cells) in quantities(refined).into_iter().enumerate() {
                let names = [short(&fit.material), channel.channel.clone()];
                rows.push(
                    names
                        .map(|name| if i == 0 { name } else { String::new() })
                        .into_iter()
                        .chain(cells)
                        .collect(),
                );
            }
        }
    }
    if rows.is_empty() {
        return wrapped("no bound: only --objective likelihood computes it");
    }
    let head = ["material", "ch", "quantity", "95 %\n± %", "bound\n± %", "ratio"];
    let scene = if estimate_rows(fits).is_empty() {
        "the scene is exact in this bound, as in the intervals"
    } else {
        "the quantities of the set-up below are unknowns of this bound, with their priors"
    };
    format!(
        "intervals next to the Cramér–Rao bound, the least that these pixels allow\n{}\n{}",
        table(&head, &[3, 4, 5], rows),
        wrapped(scene)
    )
}

fn quantities(r: &Refined) -> [Vec<String>; 5] {
    let (m, b) = (&r.best.medium, &r.likelihood.bound);
    [
        row(
            "σ_s(1−g)",
            m.reduced_scattering_per_mm(),
            &r.reduced_scattering_per_mm,
            &b.reduced_scattering_per_mm,
        ),
        row("σ_a", m.absorption_per_mm(), &r.absorption_per_mm, &b.absorption_per_mm),
        row("σ_t", m.sigma_t_per_mm(), &r.sigma_t_per_mm, &b.sigma_t_per_mm),
        row("1−α", 1.0 - m.albedo(), &r.albedo, &b.albedo),
        row("1−g", 1.0 - m.g(), &r.g, &b.g),
    ]
}

fn row(name: &str, value: f64, interval: &Interval, bound: &Ends) -> Vec<String> {
    let half = |low: f64, high: f64| 50.0 * (high - low) / value.abs();
    let (width, least) = (half(interval.low, interval.high), half(bound.low, bound.high));
    let closed = !interval.open_low && !interval.open_high && width.is_finite();
    let shown = |known: bool, v: f64| if known { significant(v, 2) } else { "–".to_owned() };
    let interval = if closed && width == 0.0 { "held".to_owned() } else { shown(closed, width) };
    let ratio = shown(closed && least.is_finite() && least > 0.0, width / least);
    vec![name.to_owned(), interval, shown(least.is_finite(), least), ratio]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Half-widths are in per cent of the quantity, followed by their ratio to the bound.
    #[test]
    fn half_widths_are_in_per_cent() {
        let interval = |low, high| Interval { low, high, open_low: false, open_high: false };
        let open = Interval { open_high: true, ..interval(4.0, 9.0) };
        for (value, interval, [low, high], expected) in [
            (5.0, interval(4.9, 5.1), [4.92, 5.08], ["2", "1.6", "1.2"]),
            (5.0, interval(5.0, 5.0), [5.0, 5.0], ["held", "0", "–"]),
            (5.0, open, [4.0, 6.0], ["–", "20", "–"]),
            (5.0, interval(4.9, 5.1), [f64::NEG_INFINITY, f64::INFINITY], ["2", "–", "–"]),
            (0.0, interval(0.999, 1.0), [0.999, 1.001], ["–", "–", "–"]),
        ] {
            assert_eq!(row("σ_t", value, &interval, &Ends { low, high })[1..], expected);
        }
    }
}
