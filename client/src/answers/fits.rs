//! Formats fits as tables and remarks.

use farm_figures::numbers::{short, significant};
use optics_model::fit::{Candidate, ChannelFit, Interval, MaterialFit, Refined};

use super::bound::bounds;
use super::scene::{exact_scene, scene_text};
use super::summary::{ChannelSummary, NumberWithInterval, Remark, all_remarks};
use crate::output::{table, warning, wrapped};

/// Fits, and options of their printing.
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
pub(crate) fn fits_text(report: &FitsReport) -> String {
    let fits = report.fits;
    let all = || fits.iter().flat_map(|f| f.channels.iter().map(move |c| (f, c)));
    let mut text = String::new();
    if all().any(|(_, c)| c.refined.is_some()) {
        text += &known(fits);
        text += "\n\n";
    }
    text += &media(fits);
    if report.bound {
        text += &format!("\n\n{}\n", bounds(fits));
    }
    if report.scene
        && let Some(scene) = scene_text(fits)
    {
        text += &format!("\n\n{scene}\n");
    }
    for line in objective(fits, report.assumed.clone()) {
        text += &format!("\n{}", wrapped(&line));
    }
    for Remark { about, text: remark, warning: is_warning } in all_remarks(fits) {
        let line = wrapped(&format!("{}: {remark}", about.join(", ")));
        text += &format!("\n{}", if is_warning { warning(&line) } else { line });
    }
    text
}

/// The objective and its assumptions; empty without refinement.
pub(crate) fn objective(fits: &[MaterialFit], assumed: Option<String>) -> Vec<String> {
    if fits.iter().flat_map(|f| &f.channels).all(|c| c.refined.is_none()) {
        return Vec::new();
    }
    std::iter::once("objective: likelihood".to_owned()).chain(assumed).chain(exact_scene(fits)).collect()
}

/// One row per channel: σ_s(1 − g) and σ_a, which similar media share, and the function of the medium that the data
/// determine best, whatever the others are.
fn known(fits: &[MaterialFit]) -> String {
    let head = [
        "material",
        "ch",
        "σ_s(1−g)\n/mm",
        "\n95 %",
        "σ_a\n/mm",
        "\n95 %",
        "misfit",
        "determined\nbest, ± %",
    ];
    let row = |material: &str, channel: &ChannelFit| {
        let mut row = vec![short(material), channel.channel.clone()];
        if let Some(r) = &channel.refined {
            let shown = ChannelSummary::of(r);
            for NumberWithInterval { value, interval } in
                [shown.reduced_scattering_per_mm, shown.absorption_per_mm]
            {
                row.extend([value, interval]);
            }
            row.push(shown.misfit);
            row.push(determined_best(r));
        } else {
            row.extend(std::iter::repeat_n("–".to_owned(), 6));
        }
        row
    };
    let rows = fits.iter().flat_map(|fit| fit.channels.iter().map(|c| row(&fit.material, c)));
    format!("shared by similar media, whatever g is\n{}", table(&head, &[2, 4, 6], rows))
}

/// The function of the medium with the least relative half-width of 95 % in per cent, such as `σ_a 4.1`. The
/// intervals contain the uncertainty of g, of a second lobe of the phase function, and of the set-up.
fn determined_best(r: &Refined) -> String {
    let m = &r.best.medium;
    let complement = |i: &Interval| Interval {
        low: 1.0 - i.high,
        high: 1.0 - i.low,
        open_low: i.open_high,
        open_high: i.open_low,
    };
    let functions = [
        ("σ_s(1−g)", m.reduced_scattering_per_mm(), r.reduced_scattering_per_mm),
        ("σ_a", m.absorption_per_mm(), r.absorption_per_mm),
        ("σ_t", m.sigma_t_per_mm(), r.sigma_t_per_mm),
        ("1−α", 1.0 - m.albedo(), complement(&r.albedo)),
    ];
    let closed = functions.iter().filter(|(_, value, i)| !(i.open_low || i.open_high) && *value > 0.0);
    let shares = closed.map(|(name, value, i)| (*name, 0.5 * (i.high - i.low) / value));
    let best = shares.min_by(|a, b| a.1.total_cmp(&b.1));
    best.map_or_else(|| "–".to_owned(), |(name, share)| format!("{name} {}", significant(100.0 * share, 2)))
}

/// One row per channel: σ_t, α and g with their intervals; without refinement, those of the best record.
fn media(fits: &[MaterialFit]) -> String {
    let refined = fits.iter().flat_map(|f| &f.channels).any(|c| c.refined.is_some());
    let mut head = vec!["material", "ch", "σ_t\n/mm", "\n95 %", "α", "\n95 %", "g", "\n95 %"];
    if !refined {
        head = vec!["material", "ch", "σ_t\n/mm", "α", "g", "error"];
    }
    let row = |material: &str, channel: &ChannelFit| {
        let from_mixtures = channel.refined.as_ref().is_some_and(|r| r.from_mixtures);
        let star = if from_mixtures { "*" } else { "" };
        let mut row = vec![short(material), format!("{}{star}", channel.channel)];
        match (&channel.refined, channel.candidates.first()) {
            (Some(r), _) => {
                let shown = ChannelSummary::of(r);
                let mark = |value: String| if r.resolved { value } else { format!("({value})") };
                row.extend([mark(shown.sigma_t_per_mm.value), shown.sigma_t_per_mm.interval]);
                row.extend([mark(shown.albedo.value), shown.albedo.interval]);
                row.extend([shown.g.value, shown.g.interval]);
            }
            (None, Some(c)) => {
                let m = &c.medium;
                row.extend([m.sigma_t_per_mm(), m.albedo(), m.g()].map(|v| v.to_string()));
                row.push(format!("{:.4}", c.error));
            }
            (None, None) => row.resize(head.len(), "–".to_owned()),
        }
        row
    };
    let rows = fits.iter().flat_map(|fit| fit.channels.iter().map(|c| row(&fit.material, c)));
    let right: &[usize] = if refined { &[2, 4, 6] } else { &[2, 3, 4, 5] };
    let any = |is: fn(&Refined) -> bool| {
        fits.iter().flat_map(|f| &f.channels).filter_map(|c| c.refined.as_ref()).any(is)
    };
    let mut note = String::new();
    if any(|r| !r.resolved_at_g) {
        note += "\n(…) unresolved: these data leave the medium open within the given bounds";
    }
    if any(Refined::g_is_open) {
        note += "\n(…) g open: σ_t and α are valid for this g only";
    }
    if any(|r| r.from_mixtures) {
        note += "\n* from mixtures with other inks";
    }
    let title = if refined { "media" } else { "best records of the dictionary" };
    format!("{title}\n{}{note}", table(&head, right, rows))
}

/// The best records of one channel, with the terms of their errors: root mean squares of differences.
pub(crate) fn neighbours(candidates: &[Candidate]) -> String {
    let terms = candidates.first().map_or(&[][..], |c| &c.thicknesses);
    let mut head = vec!["error".to_owned(), "σ_t /mm".into(), "α".into(), "g".into(), "index".into()];
    for term in terms {
        head.push(format!("values\n{} mm", term.thickness_mm));
        head.push(format!("gradients\n{} mm", term.thickness_mm));
    }
    let rows = candidates.iter().map(|c| {
        let m = &c.medium;
        let mut row = vec![format!("{:.5}", c.error)];
        row.extend([m.sigma_t_per_mm(), m.albedo(), m.g(), c.sample_ior].map(|v| v.to_string()));
        for t in &c.thicknesses {
            row.extend([format!("{:.5}", t.value_rms), format!("{:.6}", t.gradient_rms)]);
        }
        row
    });
    let right: Vec<usize> = (0..head.len()).collect();
    table(&head.iter().map(String::as_str).collect::<Vec<_>>(), &right, rows)
}
