//! Renders the section of media: the fits with the estimates of the scene and the error budget, and each photograph
//! above its simulation, as in Fig. 2 of the paper.

use farm_figures::estimates::{self, EstimateRow};
use farm_figures::{ChannelBudget, ErrorBudget};

use super::samples::SlabSection;
use super::warning_list;
use crate::capture::strip::simulated_uri;
use crate::page::escaped;

/// The parts of the page from `measure`.
#[derive(Debug)]
pub struct Media {
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
    pub(super) fn section(&self, slabs: &[SlabSection]) -> String {
        let strips = self.simulated.iter().filter_map(|simulated| {
            let slab = slabs.iter().find(|slab| slab.label == simulated.label)?;
            Some(simulated.next_to(slab))
        });
        let strips: String = strips.collect();
        let figures: String =
            self.figures.iter().map(|svg| format!("<figure class=\"wide\">{svg}</figure>\n")).collect();
        let text = format!("<div class=\"wide\"><pre>{}</pre></div>\n", escaped(&self.text));
        let (scene, budget) = (scene(&self.estimates), self.budget.as_ref().map(budget).unwrap_or_default());
        let Some(spectra) = &self.spectra else {
            return format!("{text}{scene}{budget}{strips}{figures}");
        };
        format!(
            "<figure class=\"wide\">{spectra}</figure>\n{}{scene}{}{}",
            folded("All numbers", &text),
            folded("Error budgets of all bands", &budget),
            folded("Profiles with their fits", &figures)
        )
    }
}

fn folded(summary: &str, content: &str) -> String {
    if content.is_empty() {
        return String::new();
    }
    format!("<details><summary>{summary}</summary>\n{content}</details>\n")
}

/// Estimates of the scene next to their priors; empty if the scene was taken as exact.
fn scene(rows: &[EstimateRow]) -> String {
    if rows.is_empty() {
        return String::new();
    }
    let row = |row: &EstimateRow| {
        let cells = [&row.quantity, &row.of, &row.estimate, &row.prior];
        let cells = cells.map(|cell| format!("<td>{}</td>", escaped(cell))).concat();
        let doubtful = if row.warning.is_some() { " class=\"doubtful\"" } else { "" };
        format!("<tr{doubtful}>{cells}</tr>\n")
    };
    let warnings: Vec<&str> = rows.iter().filter_map(|row| row.warning.as_deref()).collect();
    format!(
        "<h3>Estimates of the set-up</h3>\n{}<div class=\"wide\"><table class=\"text\"><tr><th>quantity</th><th>of</th>\
         <th>estimate</th><th>prior</th></tr>\n{}</table></div>\n<p class=\"faint\">Note: {}.</p>\n",
        warning_list(&warnings),
        rows.iter().map(row).collect::<String>(),
        escaped(estimates::NOTE),
    )
}

/// The error budget of σ_t of every channel that has one.
fn budget(budget: &ErrorBudget) -> String {
    let row = |channel: &ChannelBudget| {
        let cells = [&channel.about, &channel.sigma_t].map(|cell| format!("<td>{}</td>", escaped(cell)));
        format!("<tr>{}<td class=\"words\">{}</td></tr>\n", cells.concat(), escaped(&channel.shares))
    };
    format!(
        "<h3>Error budget of σ_t</h3>\n<div class=\"wide\"><table class=\"text\"><tr><th>channel</th><th>95 %</th>\
         <th>shares of the variance</th></tr>\n{}</table></div>\n<p>To improve first: {}.</p>\n",
        budget.channels.iter().map(row).collect::<String>(),
        escaped(&budget.first),
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

    fn page(estimates: Vec<EstimateRow>, budget: Option<ErrorBudget>) -> String {
        media(estimates, budget).section(&[])
    }

    fn media(estimates: Vec<EstimateRow>, budget: Option<ErrorBudget>) -> Media {
        let (figures, simulated) = (Vec::new(), Vec::new());
        Media { text: "σ_t".to_owned(), estimates, budget, spectra: None, figures, simulated }
    }

    /// With bands the figure of the media comes first, and the numbers are folded.
    #[test]
    fn spectra_come_before_numbers() {
        let page = Media { spectra: Some("<svg/>".to_owned()), ..media(Vec::new(), None) }.section(&[]);
        assert_eq!(
            page,
            "<figure class=\"wide\"><svg/></figure>\n<details><summary>All numbers</summary>\n<div class=\"wide\">\
             <pre>σ_t</pre></div>\n</details>\n"
        );
    }

    /// Estimates that contradict a prior, or lie at an end of the responses, are marked and explained.
    #[test]
    fn doubtful_estimates_are_marked() {
        let mut channels = vec![channel("R", 6.0, 1.0)];
        channels[0].refined.as_mut().unwrap().likelihood.scene = scene_estimates();
        let fits = [MaterialFit { material: "<white>".into(), channels }];
        let page = page(estimate_rows(&fits), error_budget(&fits));
        let doubtful = "<tr class=\"doubtful\"><td>gel thickness</td><td>&lt;white&gt; 0.5 mm</td>\
                        <td>0.097 ± 0.003 mm</td><td>0.02 ± 0.02 mm</td></tr>";
        assert!(page.contains(doubtful), "{page}");
        assert!(
            page.contains("<tr><td>ring angle</td><td>all</td><td>45.2 ± 0.9 °</td><td>45 ± 1 °</td></tr>")
        );
        for warning in
            ["is 3.9 standard deviations from its prior", "lies where the dictionary's responses end"]
        {
            assert!(page.contains(warning), "{warning}: {page}");
        }
        assert!(page.contains("<td>&lt;white&gt; R</td><td>5.4…6.6 / mm</td>"), "{page}");
        assert!(page.contains("<p>To improve first: g, 80 % of the variance on average"), "{page}");
    }

    /// A scene that was taken as exact has no table.
    #[test]
    fn exact_scene_has_no_table() {
        assert_eq!(page(Vec::new(), None), "<div class=\"wide\"><pre>σ_t</pre></div>\n");
    }
}
