//! The report of a session: one page that needs nothing else.
//!
//! Places that `farmctl measure` fills later stand between two comments that name them.

mod fits;
mod plot;
mod samples;
mod set_up;
mod shots;

pub use fits::{Simulated, with_fits};
pub use samples::{ends, mean};

use super::stage::Captured;

const STYLE: &str = include_str!("page.css");

/// The page.
pub(super) fn page(captured: &Captured) -> String {
    let samples: String = captured.samples.iter().map(|sample| samples::section(captured, sample)).collect();
    let fits = slot(
        "fits",
        "<p class=\"faint\">Nothing is fitted yet: <code>farmctl measure</code> with this folder does.</p>",
    );
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>{title}</title>\n\
         <style>\n{STYLE}</style>\n</head>\n<body>\n<h1>{title}</h1>\n{summary}\n<h2>Media</h2>\n{fits}\n\
         <h2>Samples</h2>\n{samples}\n{set_up}\n{inputs}\n</body>\n</html>\n",
        title = escaped(&title(captured)),
        summary = samples::summary(captured),
        set_up = set_up::section(captured),
        inputs = inputs(captured),
    )
}

fn title(captured: &Captured) -> String {
    let mut materials: Vec<&str> = captured.samples.iter().map(|s| s.about.material.as_str()).collect();
    materials.dedup();
    format!("Session: {}", materials.join(", "))
}

/// Every photograph with its digest.
fn inputs(captured: &Captured) -> String {
    let rows = captured.inputs.iter().map(|input| {
        format!(
            "<tr><td>{}</td><td class=\"words\"><code>{}</code></td></tr>",
            escaped(&input.label),
            input.digest
        )
    });
    format!(
        "<h2>Photographs</h2>\n<details><summary>{} files and their BLAKE3 digests</summary>\n<div class=\"wide\"><table>{}</table></div>\n</details>",
        captured.inputs.len(),
        rows.collect::<String>()
    )
}

pub(super) fn texts(warnings: &[optics_capture::Warning]) -> Vec<String> {
    warnings.iter().map(ToString::to_string).collect()
}

/// A list of what is doubtful; nothing if nothing is.
fn warnings(warnings: &[optics_capture::Warning]) -> String {
    if warnings.is_empty() {
        return String::new();
    }
    let items = texts(warnings).into_iter().map(|text| format!("<li>{}</li>", escaped(&text)));
    format!("<ul class=\"warnings\">{}</ul>\n", items.collect::<String>())
}

/// A place that is filled again later.
fn slot(name: &str, content: &str) -> String {
    format!("<!--begin {0}-->{content}<!--end {0}-->", escaped(name))
}

/// What a place holds.
fn slot_content<'a>(page: &'a str, name: &str) -> Option<&'a str> {
    let (begin, end) = (format!("<!--begin {}-->", escaped(name)), format!("<!--end {}-->", escaped(name)));
    let from = page.find(&begin)? + begin.len();
    let length = page.get(from..)?.find(&end)?;
    page.get(from..from + length)
}

/// The page with another content in a place; none if it has no such place.
fn with_slot(page: &str, name: &str, content: &str) -> Option<String> {
    let old = slot(name, slot_content(page, name)?);
    Some(page.replacen(&old, &slot(name, content), 1))
}

/// Text that is text in HTML, and in its comments.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
        .replace("--", "-&#45;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_can_be_filled_again_and_again() {
        let page = format!("before {} after", slot("a -- <b>", "old"));
        let filled = with_slot(&page, "a -- <b>", "new").unwrap();
        assert_eq!(slot_content(&filled, "a -- <b>"), Some("new"));
        assert_eq!(with_slot(&filled, "a -- <b>", "old").unwrap(), page);
        assert_eq!(with_slot(&page, "other", "x"), None);
    }
}
