//! The section of media: the fits, and each photograph above its simulation, as in Fig. 2 of the paper.

use super::super::strip::simulated_uri;
use super::escaped;
use super::samples::SlabSection;

/// What `measure` contributes to the page.
#[derive(Debug)]
pub struct Media {
    /// The answer as it is printed.
    pub text: String,
    /// Figures of the fits, as SVG.
    pub figures: Vec<String>,
    pub simulated: Vec<Simulated>,
}

/// Simulated profiles of one slab at its fitted medium, as the photograph would show them.
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
            Some(simulated.beside(slab))
        });
        let strips: String = strips.collect();
        let figures: String =
            self.figures.iter().map(|svg| format!("<figure class=\"wide\">{svg}</figure>\n")).collect();
        format!("<div class=\"wide\"><pre>{}</pre></div>\n{strips}{figures}", escaped(&self.text))
    }
}

impl Simulated {
    fn beside(&self, slab: &SlabSection) -> String {
        format!(
            "<figure><div>{}</div><img class=\"strip\" src=\"{}\" alt=\"strip across the edge, simulated\">\
             <figcaption>{}: photograph above, simulation below.</figcaption></figure>\n",
            slab.strip(),
            simulated_uri(&self.values),
            escaped(&self.label)
        )
    }
}
