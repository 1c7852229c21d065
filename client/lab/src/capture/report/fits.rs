//! What the fit adds to a report: media, and photographs beside simulations (Fig. 2 of the paper).

use super::super::strip::simulated_uri;
use super::{escaped, slot_content, with_slot};

/// Simulated profiles of one slab at its fitted medium, as the photograph would show them.
#[derive(Debug)]
pub struct Simulated {
    /// The sample's label.
    pub label: String,
    /// Radiance factors of red, green and blue.
    pub values: [Vec<f64>; 3],
}

/// The page with the fits: `media` is their table as HTML, `figures` are plots as SVG.
pub fn with_fits(page: &str, text: &str, figures: &[String], simulated: &[Simulated]) -> Option<String> {
    let strips = simulated.iter().filter_map(|s| {
        let photograph = slot_content(page, &format!("strip {}", s.label))?;
        Some(format!(
            "<figure><div>{photograph}</div><img class=\"strip\" src=\"{}\" alt=\"strip across the edge, simulated\">\
             <figcaption>{}: photograph above, simulation below.</figcaption></figure>\n",
            simulated_uri(&s.values),
            escaped(&s.label)
        ))
    });
    let strips: String = strips.collect();
    let figures: String =
        figures.iter().map(|svg| format!("<figure class=\"wide\">{svg}</figure>\n")).collect();
    let content = format!("<div class=\"wide\"><pre>{}</pre></div>\n{strips}{figures}", escaped(text));
    with_slot(page, "fits", &content)
}
