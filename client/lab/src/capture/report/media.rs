//! Renders the section of media: the fits with the estimates of the scene and the error budget, and each photograph
//! above its simulation, as in Fig. 2 of the paper.

use farm_figures::estimates::{self, EstimateRow};
use farm_figures::{ChannelBudget, ErrorBudget};

use super::samples::SlabSection;
use super::verdict::MeasureVerdict;
use super::warning_list;
use crate::capture::strip::simulated_uri;
use crate::page::{cards, escaped, named_cell};

/// Files that `measure` writes next to the report, and what to do with them.
pub(super) const FILES: &str = "\
<h2>Files, and what comes next</h2>
<table class=\"text wrapped\">
<tr><td><a href=\"uncertainty.html\">uncertainty.html</a></td><td>statement of uncertainty, to be signed</td></tr>
<tr><td><a href=\"table.csv\">table.csv</a></td><td>all media with their intervals</td></tr>
<tr><td><a href=\"media.json\">media.json</a></td><td>media with their covariance: <code>farmctl predict</code> computes how prints \
look, <code>farmctl validate</code> compares a printed chart, <code>farmctl recipe</code> finds mixtures</td></tr>
<tr><td>media.py, media.xml, media.pbrt, media_blender.py</td><td>media for Mitsuba 3, pbrt-v4 and Blender</td></tr>
<tr><td><a href=\"measurements.csv\">measurements.csv</a></td><td>the measured profiles</td></tr>
</table>
";

/// The parts of the page from `measure`.
#[derive(Debug)]
pub struct Media {
    pub verdict: MeasureVerdict,
    /// One row for each channel, with the cells of [`Self::COLUMNS`].
    pub rows: Vec<Vec<String>>,
    /// The answer as it is printed, without estimates of the scene and budget.
    pub text: String,
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
    pub const COLUMNS: [&'static str; 7] =
        ["medium", "σ_s(1−g) [1/mm]", "σ_a [1/mm]", "σ_t [1/mm]", "α", "g", "residuals / noise"];

    pub(super) fn section(&self, slabs: &[SlabSection]) -> String {
        let strips = self.simulated.iter().filter_map(|simulated| {
            let slab = slabs.iter().find(|slab| slab.label == simulated.label)?;
            Some(simulated.next_to(slab))
        });
        let strips: String = strips.collect();
        let figures: String =
            self.figures.iter().map(|svg| format!("<figure class=\"wide\">{svg}</figure>\n")).collect();
        let text = format!("<div class=\"wide\"><pre>{}</pre></div>\n", escaped(&self.text));
        let text = folded("The answer as text", &text);
        let numbers = if self.rows.is_empty() { String::new() } else { cards(&Self::COLUMNS, &self.rows) };
        let (scene, budget) = (scene(&self.estimates), self.budget.as_ref().map(budget).unwrap_or_default());
        let Some(spectra) = &self.spectra else {
            return format!("{numbers}{strips}{figures}{scene}{budget}{text}");
        };
        format!(
            "<figure class=\"wide\">{spectra}</figure>\n{}{}{scene}{}{text}",
            folded("All numbers", &numbers),
            folded("Profiles with their fits", &figures),
            folded("Error budgets of all bands", &budget),
        )
    }
}

fn folded(summary: &str, content: &str) -> String {
    if content.is_empty() {
        return String::new();
    }
    format!("<details><summary>{summary}</summary>\n{content}</details>\n")
}

/// Columns of the estimates.
const SET_UP: [&str; 4] = ["quantity", "of", "estimate", "prior"];

/// Estimates of the scene next to their priors; empty if the scene was taken as exact.
fn scene(rows: &[EstimateRow]) -> String {
    if rows.is_empty() {
        return String::new();
    }
    let row = |row: &EstimateRow| {
        let cells = SET_UP.iter().zip([&row.quantity, &row.of, &row.estimate, &row.prior]);
        let cells: String = cells.map(|(name, cell)| named_cell(name, cell)).collect();
        let doubtful = if row.warning.is_some() { " class=\"doubtful\"" } else { "" };
        format!("<tr{doubtful}>{cells}</tr>\n")
    };
    let warnings: Vec<&str> = rows.iter().filter_map(|row| row.warning.as_deref()).collect();
    format!(
        "<h3>Estimates of the set-up</h3>\n{}<div class=\"wide\"><table class=\"text cards\"><tr>{}</tr>\n{}</table></div>\n\
         <p class=\"faint\">Note: {}.</p>\n",
        warning_list(&warnings),
        SET_UP.map(|name| format!("<th>{name}</th>")).concat(),
        rows.iter().map(row).collect::<String>(),
        escaped(estimates::NOTE),
    )
}

/// The error budget of σ_t of every channel that has one.
fn budget(budget: &ErrorBudget) -> String {
    let row = |channel: &ChannelBudget| {
        let cells = [&channel.about, &channel.sigma_t].map(|cell| format!("<td>{}</td>", escaped(cell)));
        let part = |(name, share): &(String, f64)| {
            format!("<span style=\"width:{:.1}%\" title=\"{}\"></span>", 100.0 * share, escaped(name))
        };
        let bar: String = channel.parts.iter().map(part).collect();
        format!(
            "<tr>{}<td class=\"words\">{}<div class=\"bar\">{bar}</div></td></tr>\n",
            cells.concat(),
            escaped(&channel.shares)
        )
    };
    format!(
        "<h3>Error budget of σ_t</h3>\n<div class=\"wide\"><table class=\"text\"><tr><th>channel</th><th>95 %</th>\
         <th>shares of the variance</th></tr>\n{}</table></div>\n",
        budget.channels.iter().map(row).collect::<String>(),
    )
}

impl Simulated {
    fn next_to(&self, slab: &SlabSection) -> String {
        format!(
            "<figure><div>{}</div><img class=\"strip\" src=\"{}\" alt=\"strip across the edge, simulated\">\
             <figcaption>{}: photograph above, simulation below.</figcaption></figure>\n",
            slab.strip(),
            simulated_uri(&self.values),
            escaped(&self.label)
        )
    }
}

#[cfg(test)]
mod tests {
    use farm_figures::error_budget;
    use farm_figures::estimates::estimate_rows;
    use farm_figures::testing::{channel, scene_estimates};
    use optics_model::fit::MaterialFit;

    use super::*;

    /// The section of media with these estimates and this budget, without slabs.
    fn section(estimates: Vec<EstimateRow>, budget: Option<ErrorBudget>, spectra: Option<&str>) -> String {
        let (verdict, rows, text) = (MeasureVerdict::default(), rows(), "σ_t".to_owned());
        let (spectra, figures, simulated) = (spectra.map(str::to_owned), Vec::new(), Vec::new());
        Media { verdict, rows, text, estimates, budget, spectra, figures, simulated }.section(&[])
    }

    fn rows() -> Vec<Vec<String>> {
        vec![["white R", "3.5", "0.01", "6", "0.99", "0.4", "1"].map(str::to_owned).to_vec()]
    }

    const TEXT: &str = "<details><summary>The answer as text</summary>\n<div class=\"wide\"><pre>σ_t</pre></div>\n\
        </details>\n";

    /// With bands the figure of the media comes first, and the numbers are folded. A scene that was taken as exact has no
    /// table.
    #[test]
    fn spectra_come_before_numbers() {
        let numbers = cards(&Media::COLUMNS, &rows());
        let figure = "<figure class=\"wide\"><svg/></figure>\n<details><summary>All numbers</summary>\n";
        let folded = format!("{figure}{numbers}</details>\n{TEXT}");
        assert_eq!(section(Vec::new(), None, Some("<svg/>")), folded);
        assert_eq!(section(Vec::new(), None, None), numbers + TEXT);
    }

    /// Estimates that contradict a prior, or lie at an end of the responses, are marked and explained.
    #[test]
    fn doubtful_estimates_are_marked() {
        let mut channels = vec![channel("R", 6.0, 1.0)];
        channels[0].refined.as_mut().unwrap().likelihood.scene = scene_estimates();
        let fits = [MaterialFit { material: "<white>".into(), channels }];
        let page = section(estimate_rows(&fits), error_budget(&fits), None);
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
