//! The section of media: the fits with the estimates of the scene and the error budget, and each photograph above its
//! simulation, as in Fig. 2 of the paper.

use std::collections::BTreeMap;

use farm_figures::estimates::{self, EstimateRow};
use farm_figures::{ChannelBudget, ErrorBudget};

use super::verdict::MeasureVerdict;
use crate::capture::strip::simulated_uri;
use crate::document::{Block, Figure, PagePicture, ValueTable};

/// Files that `measure` writes next to the report, and what to do with them.
const FILES: [(&[&str], &str); 5] = [
    (&["uncertainty.html"], "statement of uncertainty, to be signed"),
    (&["table.csv"], "all media with their intervals"),
    (
        &["media.json"],
        "media with their covariance: `farmctl predict` computes how prints look, `farmctl validate` compares a printed \
         chart, `farmctl recipe` finds mixtures",
    ),
    (
        &["media.py", "media.xml", "media.pbrt", "media_blender.py"],
        "media for Mitsuba 3, pbrt-v4 and Blender",
    ),
    (&["measurements.csv"], "the measured profiles"),
];

/// The parts of the page from `measure`.
#[derive(Debug)]
pub struct Media {
    pub verdict: MeasureVerdict,
    /// The answer without estimates of the scene and budget.
    pub numbers: Vec<Block>,
    /// Empty if the scene was taken as exact.
    pub estimates: Vec<EstimateRow>,
    pub budget: Option<ErrorBudget>,
    /// The media over wavelength, as SVG, if there are three bands or more; then numbers are folded.
    pub spectra: Option<String>,
    /// Figures of the fits, as SVG.
    pub figures: Vec<String>,
    pub simulated: Vec<Simulated>,
}

/// Simulated profiles of one slab at its fitted medium, as seen in the photograph.
#[derive(Debug)]
pub struct Simulated {
    /// The sample's label.
    pub label: String,
    /// Radiance factors of red, green and blue.
    pub values: [Vec<f64>; 3],
}

impl Media {
    /// The section; the strips of photographs are by the sample's label.
    pub(super) fn blocks(&self, strips: &BTreeMap<String, PagePicture>) -> Vec<Block> {
        let figures: Vec<Block> = self.figures.iter().map(|svg| Block::chart(svg.clone(), "")).collect();
        let budget = self.budget.as_ref().map(budget_blocks).unwrap_or_default();
        let estimates = estimate_blocks(&self.estimates);
        let folded = |summary: &str, blocks| vec![Block::Folded(summary.to_owned(), blocks)];
        let numbers = self.numbers.clone();
        let parts = match &self.spectra {
            None => {
                let simulated = self.simulated.iter().filter_map(|s| Some(s.below(strips.get(&s.label)?)));
                [numbers, simulated.collect(), figures, estimates, budget]
            }
            Some(spectra) => [
                vec![Block::chart(spectra.clone(), "")],
                folded("All numbers", numbers),
                folded("Profiles with their fits", figures),
                estimates,
                folded("Error budgets of all bands", budget),
            ],
        };
        let file = |(names, purpose): (&[&str], &str)| {
            (names.iter().map(ToString::to_string).collect(), purpose.to_owned())
        };
        let mut blocks = vec![Block::heading(2, "Media")];
        blocks.extend(parts.into_iter().flatten());
        blocks.push(Block::heading(2, "Files, and what comes next"));
        blocks.push(Block::Files(FILES.map(file).to_vec()));
        blocks
    }
}

/// Estimates of the scene next to their priors; empty if the scene was taken as exact.
pub fn estimate_blocks(rows: &[EstimateRow]) -> Vec<Block> {
    if rows.is_empty() {
        return Vec::new();
    }
    let cells = |r: &EstimateRow| [&r.quantity, &r.of, &r.estimate, &r.prior].map(Clone::clone).to_vec();
    let warnings: Vec<&String> = rows.iter().filter_map(|row| row.warning.as_ref()).collect();
    let doubtful = (0..rows.len()).filter(|i| rows[*i].warning.is_some()).collect();
    let table = ValueTable::new("quantity | of | estimate | prior", rows.iter().map(cells)).cards();
    vec![
        Block::heading(3, "Estimates of the set-up"),
        Block::warnings(&warnings),
        ValueTable { doubtful, ..table }.block(),
        Block::aside(format!("Note: {}.", estimates::NOTE)),
    ]
}

/// The error budget of σ_t of every channel that has one.
pub fn budget_blocks(budget: &ErrorBudget) -> Vec<Block> {
    let row = |c: &ChannelBudget| [&c.about, &c.sigma_t, &c.shares].map(Clone::clone).to_vec();
    let shares = budget.channels.iter().map(|channel| channel.parts.clone()).collect();
    let table = ValueTable {
        shares,
        ..ValueTable::new("channel | 95 % | shares of the variance", budget.channels.iter().map(row))
    };
    vec![Block::heading(3, "Error budget of σ_t (95 %): shares of the variance"), table.block()]
}

impl Simulated {
    /// The photograph above its simulation.
    fn below(&self, photograph: &PagePicture) -> Block {
        let alt = "strip across the edge, simulated".to_owned();
        let simulation = PagePicture::Strip { uri: simulated_uri(&self.values), alt };
        let caption = format!("{}: photograph above, simulation below.", self.label);
        Block::Figure(Figure { pictures: vec![photograph.clone(), simulation], caption })
    }
}

#[cfg(test)]
mod tests {
    use farm_figures::error_budget;
    use farm_figures::estimates::estimate_rows;
    use farm_figures::testing::{channel, scene_estimates};
    use optics_model::fit::MaterialFit;

    use super::*;
    use crate::capture::CaptureReport;

    /// A page with these estimates and this budget, without slabs.
    fn page(estimates: Vec<EstimateRow>, budget: Option<ErrorBudget>, spectra: Option<&str>) -> String {
        let numbers = vec![ValueTable::new("medium", [vec!["white R".to_owned()]]).cards().block()];
        let (verdict, spectra) = (MeasureVerdict::default(), spectra.map(str::to_owned));
        let (figures, simulated) = (Vec::new(), Vec::new());
        let media = Media { verdict, numbers, estimates, budget, spectra, figures, simulated };
        CaptureReport::default().page(Some(&media))
    }

    /// With bands the figure of the media comes first, and the numbers are folded. A scene that was taken as exact has no
    /// table.
    #[test]
    fn spectra_come_before_numbers() {
        let table = "<div class=\"wide\"><table class=\"cards\">";
        let folded = format!("<svg/></figure>\n<details><summary>All numbers</summary>\n{table}");
        assert!(page(Vec::new(), None, Some("<svg/>")).contains(&folded));
        let plain = page(Vec::new(), None, None);
        assert!(plain.contains(&format!("<h2>Media</h2>\n{table}")) && !plain.contains("<h3>"), "{plain}");
    }

    /// Estimates that contradict a prior, or lie at an end of the responses, are marked and explained.
    #[test]
    fn doubtful_estimates_are_marked() {
        let mut channels = vec![channel("R", 6.0, 1.0)];
        channels[0].refined.as_mut().unwrap().likelihood.scene = scene_estimates();
        let fits = [MaterialFit { material: "<white>".into(), channels }];
        let page = page(estimate_rows(&fits), error_budget(&fits), None);
        for part in [
            "<tr class=\"doubtful\"><td data-name=\"quantity\">gel thickness</td><td data-name=\"of\">&lt;white&gt; 0.5 \
             mm</td><td data-name=\"estimate\">0.097 ± 0.003 mm</td><td data-name=\"prior\">0.02 ± 0.02 mm</td></tr>",
            "<td data-name=\"estimate\">45.2 ± 0.9 °</td><td data-name=\"prior\">45 ± 1 °</td></tr>",
            "is 3.9 standard deviations from its prior",
            "lies where the dictionary's responses end",
            "<td>&lt;white&gt; R</td><td>5.4…6.6 / mm</td>",
            "<span style=\"width:80.0%\" title=\"g\"></span>",
        ] {
            assert!(page.contains(part), "{part}: {page}");
        }
    }
}
