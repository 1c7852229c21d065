//! The frame and the tables of self-contained pages.

const STYLE: &str = include_str!("page.css");

/// A page with a body in HTML.
pub(crate) fn page(title: &str, body: &str) -> String {
    let title = escaped(title);
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>{title}</title>\n\
         <style>\n{STYLE}</style>\n</head>\n<body>\n{body}</body>\n</html>\n",
    )
}

/// A table of text, which scrolls where it is too wide.
pub(crate) fn table(class: &str, head: &[&str], rows: &[Vec<String>]) -> String {
    let cells = |tag: &str, cells: &mut dyn Iterator<Item = &str>| {
        let all: String = cells.map(|cell| format!("<{tag}>{}</{tag}>", escaped(cell))).collect();
        format!("<tr>{all}</tr>\n")
    };
    let head = if head.is_empty() { String::new() } else { cells("th", &mut head.iter().copied()) };
    let rows: String = rows.iter().map(|row| cells("td", &mut row.iter().map(String::as_str))).collect();
    format!("<div class=\"wide\"><table class=\"{class}\">{head}{rows}</table></div>\n")
}

/// A table whose rows become cards on narrow screens: each cell with its column's name.
pub(crate) fn cards(head: &[&str], rows: &[Vec<String>]) -> String {
    let names: String = head.iter().map(|name| format!("<th>{}</th>", escaped(name))).collect();
    let row = |row: &Vec<String>| {
        let cells = head.iter().zip(row).map(|(name, cell)| named_cell(name, cell));
        format!("<tr>{}</tr>\n", cells.collect::<String>())
    };
    let rows: String = rows.iter().map(row).collect();
    format!("<div class=\"wide\"><table class=\"text cards\"><tr>{names}</tr>\n{rows}</table></div>\n")
}

/// A cell of a table whose rows become cards.
pub(crate) fn named_cell(name: &str, cell: &str) -> String {
    format!("<td data-name=\"{}\">{}</td>", escaped(name), escaped(cell))
}

/// Text escaped for HTML.
pub(crate) fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
