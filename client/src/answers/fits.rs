//! Fits as tables and remarks.

use farm_figures::estimates::estimate_rows;
use farm_figures::numbers::{short, significant};
use farm_lab::capture::estimate_blocks;
use farm_lab::document::{Block, ValueTable};
use optics_model::fit::{Candidate, ChannelFit, Ends, MaterialFit, Refined};

use super::remarks::all_remarks;
use super::summary::{ChannelSummary, Estimated, quantities};

/// Fits, and options of their printing.
#[derive(Debug, Clone)]
pub(crate) struct FitsReport<'a> {
    pub(crate) fits: &'a [MaterialFit],
    /// Assumptions about the set-up, in one line.
    pub(crate) assumed: Option<String>,
    /// Print the Cramér–Rao bound next to the intervals.
    pub(crate) bound: bool,
    /// Print the estimates of the scene's quantities.
    pub(crate) scene: bool,
}

/// The fits of all channels: the best determined quantities, the media, and remarks on them.
pub(crate) fn fits_blocks(report: &FitsReport) -> Vec<Block> {
    let fits = report.fits;
    let mut blocks = if is_refined(fits) { media(fits) } else { records(fits) };
    if report.bound {
        blocks.extend(bounds(fits));
    }
    if report.scene {
        blocks.extend(estimate_blocks(&estimate_rows(fits)));
    }
    let objective = objective(fits, report.assumed.clone()).into_iter().map(Block::Paragraph);
    let remarks = objective.chain([Block::Remarks(all_remarks(fits))]).collect();
    blocks.push(Block::Folded("Objective, and remarks on each channel".to_owned(), remarks));
    blocks
}

fn is_refined(fits: &[MaterialFit]) -> bool {
    fits.iter().flat_map(|fit| &fit.channels).any(|channel| channel.refined.is_some())
}

/// The objective and its assumptions; empty without refinement.
pub(crate) fn objective(fits: &[MaterialFit], assumed: Option<String>) -> Vec<String> {
    let exact = "scene: taken as exact (roughness, refractive indices, gel, lamps); a dictionary of a scene with their \
                 standard errors, such as `lab`, includes them in the intervals";
    let exact = estimate_rows(fits).is_empty().then(|| exact.to_owned());
    let all = std::iter::once("objective: likelihood".to_owned()).chain(assumed).chain(exact);
    if is_refined(fits) { all.collect() } else { Vec::new() }
}

/// A row for each channel, which begins with material and channel.
pub(super) fn rows(fits: &[MaterialFit], cells: impl Fn(&ChannelFit) -> Vec<String>) -> Vec<Vec<String>> {
    let channels = fits.iter().flat_map(|fit| fit.channels.iter().map(move |c| (fit, c)));
    let row = |(fit, c): (&MaterialFit, &ChannelFit)| {
        let star = if c.refined.as_ref().is_some_and(|r| r.from_mixtures) { "*" } else { "" };
        [vec![short(&fit.material), format!("{}{star}", c.channel)], cells(c)].concat()
    };
    channels.map(row).collect()
}

/// Two tables with a row per channel: σ_s(1 − g) and σ_a, which similar media share, with the function of the medium that
/// the data determine best, whatever the others are; then σ_t, α and g.
fn media(fits: &[MaterialFit]) -> Vec<Block> {
    let unknown = || vec!["–".to_owned(); 6];
    let known = |c: &ChannelFit| {
        let known = |r: &Refined| {
            let shown = ChannelSummary::of(r);
            let last = vec![shown.misfit.clone(), determined_best(r)];
            [shown.shared_cells(), last].concat()
        };
        c.refined.as_ref().map_or_else(unknown, known)
    };
    let whole =
        |c: &ChannelFit| c.refined.as_ref().map_or_else(unknown, |r| ChannelSummary::of(r).medium_cells());
    let (shared, medium) = (ChannelSummary::SHARED, ChannelSummary::MEDIUM);
    let shared = format!("material | ch | {shared} | >misfit | determined\nbest, ± %");
    let mut blocks = vec![
        Block::heading(3, "Shared by similar media, whatever g is"),
        ValueTable::new(&shared, rows(fits, known)).cards().block(),
        Block::heading(3, "Whole media"),
        ValueTable::new(&format!("material | ch | {medium}"), rows(fits, whole)).cards().block(),
    ];
    let any = |is: fn(&Refined) -> bool| {
        fits.iter().flat_map(|f| &f.channels).filter_map(|c| c.refined.as_ref()).any(is)
    };
    let notes = [
        (
            any(|r| !r.resolved_at_g),
            "(…) unresolved: these data leave the medium open within the given bounds",
        ),
        (any(Refined::g_is_open), "(…) g open: σ_t and α are valid for this g only"),
        (any(|r| r.from_mixtures), "* from mixtures with other inks"),
    ];
    blocks.extend(notes.into_iter().filter(|(is, _)| *is).map(|(_, note)| Block::aside(note)));
    blocks
}

/// One row per channel: the best record.
fn records(fits: &[MaterialFit]) -> Vec<Block> {
    let cells = |channel: &ChannelFit| {
        let Some(c) = channel.candidates.first() else { return vec!["–".to_owned(); 4] };
        let m = &c.medium;
        let error = format!("{:.4}", c.error);
        [m.sigma_t_per_mm(), m.albedo(), m.g()].map(|v| v.to_string()).into_iter().chain([error]).collect()
    };
    let table = ValueTable::new("material | ch | >σ_t\n/mm | >α | >g | >error", rows(fits, cells));
    vec![Block::heading(3, "Best records of the dictionary"), table.block()]
}

/// The function of the medium with the least relative half-width of 95 % in per cent, such as `σ_a 4.1`. The
/// intervals contain the uncertainty of g, of a second lobe of the phase function, and of the set-up.
fn determined_best(r: &Refined) -> String {
    let [reduced_scattering, absorption, sigma_t, (albedo, interval), _] = quantities(r);
    let functions = [
        ("σ_s(1−g)", reduced_scattering),
        ("σ_a", absorption),
        ("σ_t", sigma_t),
        ("1−α", (1.0 - albedo, interval)),
    ];
    let closed = functions.iter().filter(|(_, (value, i))| !(i.open_low || i.open_high) && *value > 0.0);
    let shares = closed.map(|(name, (value, i))| (*name, 0.5 * (i.high - i.low) / value));
    let best = shares.min_by(|a, b| a.1.total_cmp(&b.1));
    best.map_or_else(|| "–".to_owned(), |(name, share)| format!("{name} {}", significant(100.0 * share, 2)))
}

/// The best records of one channel, with the terms of their errors: root mean squares of differences.
pub(crate) fn neighbours(candidates: &[Candidate]) -> Block {
    let terms = candidates.first().map_or(&[][..], |c| &c.thicknesses);
    let columns = terms
        .iter()
        .flat_map(|term| ["values", "gradients"].map(|what| format!("{what}\n{} mm", term.thickness_mm)));
    let rows = candidates.iter().map(|c| {
        let m = &c.medium;
        let mut row = vec![format!("{:.5}", c.error)];
        row.extend([m.sigma_t_per_mm(), m.albedo(), m.g(), c.sample_ior].map(|v| v.to_string()));
        for t in &c.thicknesses {
            row.extend([format!("{:.5}", t.value_rms), format!("{:.6}", t.gradient_rms)]);
        }
        row
    });
    ValueTable::of_numbers(">error | >σ_t /mm | >α | >g | >index", columns, rows).block()
}

/// One row per quantity: half-widths of the interval and of the Cramér–Rao bound, in per cent of it, and their ratio.
pub(super) fn bounds(fits: &[MaterialFit]) -> Vec<Block> {
    let channels = fits.iter().flat_map(|fit| fit.channels.iter().map(move |c| (fit, c)));
    let rows = channels.filter_map(|(fit, c)| {
        // The names stand in the first row only.
        let names = std::iter::once([short(&fit.material), c.channel.clone()]);
        let names = names.chain(std::iter::repeat_with(Default::default));
        Some(
            names.zip(bound_rows(c.refined.as_ref()?)).map(|(names, cells)| [names.to_vec(), cells].concat()),
        )
    });
    let rows: Vec<Vec<String>> = rows.flatten().collect();
    if rows.is_empty() {
        return vec![Block::paragraph("no bound: only --objective likelihood computes it")];
    }
    let scene = if estimate_rows(fits).is_empty() {
        "the scene is exact in this bound, as in the intervals"
    } else {
        "the quantities of the set-up below are unknowns of this bound, with their priors"
    };
    vec![
        Block::heading(3, "Intervals next to the Cramér–Rao bound, the least that these pixels allow"),
        ValueTable::new("material | ch | quantity | >95 %\n± % | >bound\n± % | >ratio", rows).block(),
        Block::aside(scene),
    ]
}

fn bound_rows(r: &Refined) -> [Vec<String>; 5] {
    let b = &r.likelihood.bound;
    let [reduced_scattering, absorption, sigma_t, (albedo, albedo_interval), (g, g_interval)] = quantities(r);
    [
        bound_row("σ_s(1−g)", reduced_scattering, &b.reduced_scattering_per_mm),
        bound_row("σ_a", absorption, &b.absorption_per_mm),
        bound_row("σ_t", sigma_t, &b.sigma_t_per_mm),
        bound_row("1−α", (1.0 - albedo, albedo_interval), &b.albedo),
        bound_row("1−g", (1.0 - g, g_interval), &b.g),
    ]
}

fn bound_row(name: &str, (value, interval): Estimated, bound: &Ends) -> Vec<String> {
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
    use optics_model::fit::Interval;

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
            assert_eq!(bound_row("σ_t", (value, interval), &Ends { low, high })[1..], expected);
        }
    }
}
