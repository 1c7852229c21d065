//! Inks that are estimated from mixtures, as tables and sentences.

use farm_figures::numbers::{short, significant};
use farm_lab::document::{Block, ValueTable};
use optics_model::fit::{Agreement, InkChannel, InkFit, MISFIT, MixtureFit, Unmixed};

use super::scale::common_blocks;
use super::summary::ChannelSummary;

/// Number of standard errors above which a mixture's deviation from its inks means that it was mixed or measured
/// wrongly.
const PULL: f64 = 3.0;

/// The inks, and the mixtures that do not agree with them.
pub(crate) fn inks_blocks(unmixed: &Unmixed) -> Vec<Block> {
    let rows = |cells: fn(ChannelSummary) -> Vec<String>| -> Vec<Vec<String>> {
        let channels = unmixed.inks.iter().flat_map(|ink| ink.channels.iter().map(move |c| (ink, c)));
        let row = |(ink, c): (&InkFit, &InkChannel)| {
            let star = if c.from_mixtures { "*" } else { "" };
            let names = vec![short(&ink.material), format!("{}{star}", c.channel)];
            [names, cells(ChannelSummary::ink(c))].concat()
        };
        channels.map(row).collect()
    };
    let head = |columns: &str| format!("ink | ch | {columns}");
    let mut blocks = vec![Block::heading(3, "Inks, from all their mixtures together")];
    blocks.extend(common_blocks(&unmixed.common));
    blocks.extend([
        ValueTable::new(&head(ChannelSummary::SHARED), rows(ChannelSummary::shared_cells)).block(),
        Block::heading(3, "Media of the inks"),
        ValueTable::new(&head(ChannelSummary::MEDIUM), rows(ChannelSummary::medium_cells)).block(),
        Block::aside("* not determined by its own slabs"),
        Block::warnings(&disagreements(&unmixed.mixtures)),
    ]);
    blocks.extend(furthest(&unmixed.mixtures).map(Block::Paragraph));
    blocks
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
