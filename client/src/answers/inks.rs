//! Formats inks estimated from mixtures as tables and sentences.

use farm_figures::numbers::{albedo, albedo_end, interval, short, significant};
use optics_model::fit::{Agreement, InkChannel, MISFIT, MixtureFit, Unmixed};

use super::scale::common_text;
use crate::output::{table, warning, wrapped};

/// Number of standard errors above which a mixture's deviation from its inks means that it was mixed or measured
/// wrongly.
const PULL: f64 = 3.0;

/// The inks, and the mixtures that do not agree with them.
pub(crate) fn inks_text(unmixed: &Unmixed) -> String {
    let mut text = format!("inks, from all their mixtures together\n{}\n", common_text(&unmixed.common));
    text += &format!("\n{}\n\n{}", shared(unmixed), media(unmixed));
    for line in disagreements(&unmixed.mixtures) {
        text += &format!("\n{}", warning(&wrapped(&line)));
    }
    if let Some(line) = furthest(&unmixed.mixtures) {
        text += &format!("\n{}", wrapped(&line));
    }
    text
}

fn rows(unmixed: &Unmixed, cells: impl Fn(&InkChannel) -> Vec<String>) -> Vec<Vec<String>> {
    let row = |material: &str, channel: &InkChannel| {
        let star = if channel.from_mixtures { "*" } else { "" };
        let mut row = vec![short(material), format!("{}{star}", channel.channel)];
        row.extend(cells(channel));
        row
    };
    unmixed.inks.iter().flat_map(|ink| ink.channels.iter().map(|c| row(&ink.material, c))).collect()
}

fn shared(unmixed: &Unmixed) -> String {
    let three = |v: f64| significant(v, 3);
    let cells = |c: &InkChannel| {
        let m = &c.medium;
        vec![
            three(m.reduced_scattering_per_mm()),
            interval(&c.reduced_scattering_per_mm, three),
            three(m.absorption_per_mm()),
            interval(&c.absorption_per_mm, three),
        ]
    };
    table(&["ink", "ch", "σ_s(1−g)\n/mm", "\n95 %", "σ_a\n/mm", "\n95 %"], &[2, 4], rows(unmixed, cells))
}

fn media(unmixed: &Unmixed) -> String {
    let three = |v: f64| significant(v, 3);
    let cells = |c: &InkChannel| {
        let mark = |value: String| if c.resolved { value } else { format!("({value})") };
        vec![
            mark(three(c.medium.sigma_t_per_mm())),
            interval(&c.sigma_t_per_mm, three),
            mark(albedo(c.medium.albedo())),
            interval(&c.albedo, albedo_end),
            three(c.medium.g()),
            interval(&c.g, |v| significant(v, 2)),
        ]
    };
    let head = ["ink", "ch", "σ_t\n/mm", "\n95 %", "α", "\n95 %", "g", "\n95 %"];
    let note = "* not determined by its own slabs";
    format!("{}\n{note}", table(&head, &[2, 4, 6], rows(unmixed, cells)))
}

/// Mixtures that deviate from the ink model, and mixtures that were left out.
fn disagreements(mixtures: &[MixtureFit]) -> Vec<String> {
    let line = |m: &MixtureFit| {
        let who = format!("{} {}", m.material, m.channel);
        match (&m.agreement, &m.left_out) {
            (Some(a), _) if a.pull > PULL || a.misfit > MISFIT => Some(format!(
                "{who}: it deviates from the ink model: σ_t and α by {} σ, misfit {}; check how it \
                 was mixed",
                significant(a.pull, 2),
                significant(a.misfit, 2)
            )),
            (None, Some(why)) => Some(format!("{who}: left out: {why}")),
            _ => None,
        }
    };
    mixtures.iter().filter_map(line).collect()
}

/// The mixture with the largest deviation, which shows how well all agree.
fn furthest(mixtures: &[MixtureFit]) -> Option<String> {
    let pull =
        |m: &'_ MixtureFit| m.agreement.map(|a: Agreement| (format!("{} {}", m.material, m.channel), a.pull));
    let all: Vec<(String, f64)> = mixtures.iter().filter_map(pull).collect();
    let (who, pull) = all.iter().max_by(|a, b| a.1.total_cmp(&b.1))?;
    let pull = significant(*pull, 2);
    Some(format!("{} slabs and channels; largest deviation from the ink model: {who}, {pull} σ", all.len()))
}
