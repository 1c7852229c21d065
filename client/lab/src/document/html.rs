//! Renders a document as one self-contained page. All text is escaped here.

use super::{Block, Document, Figure, PagePicture, Remark, TableColumn, ValueTable};

const STYLE: &str = include_str!("page.css");

/// Symbols with an index, as in sentences.
const SYMBOLS: [(&str, &str); 7] = [
    ("σ_t", "σ<sub>t</sub>"),
    ("σ_s", "σ<sub>s</sub>"),
    ("σ_a", "σ<sub>a</sub>"),
    ("u_c", "u<sub>c</sub>"),
    ("c_i", "c<sub>i</sub>"),
    ("x_i", "x<sub>i</sub>"),
    ("ν_eff", "ν<sub>eff</sub>"),
];

impl Document {
    pub fn page(&self) -> String {
        let title = escaped(&self.title);
        format!(
            "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>{title}</title>\n\
             <style>\n{STYLE}</style>\n</head>\n<body>\n<h1>{title}</h1>\n{}</body>\n</html>\n",
            blocks(&self.blocks)
        )
    }
}

fn blocks(blocks: &[Block]) -> String {
    blocks.iter().map(block).collect()
}

fn block(block: &Block) -> String {
    match block {
        Block::Heading(level, text) => format!("<h{level}>{}</h{level}>\n", escaped(text)),
        Block::Verdict(text) => enclosed("<p><strong>", &prose(text), "</strong></p>\n"),
        Block::Paragraph(text) => enclosed("<p>", &prose(text), "</p>\n"),
        Block::Aside(text) => enclosed("<p class=\"faint\">", &prose(text), "</p>\n"),
        Block::Remarks(all) => {
            let (warnings, notes): (Vec<&Remark>, Vec<&Remark>) = all.iter().partition(|r| r.warning);
            let [warnings, notes] =
                [warnings, notes].map(|some| items(some.into_iter().map(Remark::sentence)));
            enclosed("<ul class=\"warnings\">", &warnings, "</ul>\n") + &enclosed("<ul>", &notes, "</ul>\n")
        }
        Block::List(texts) => enclosed("<ul>", &items(texts.iter().cloned()), "</ul>\n"),
        Block::Table(all) => table(all),
        Block::Entries(entries) => pairs(entries.iter().map(|(name, text)| (prose(name), text))),
        Block::Files(files) => pairs(files.iter().map(|(names, text)| (links(names), text))),
        Block::Figure(one) => figure(one),
        Block::Row(all) => {
            enclosed("<div class=\"row\">", &all.iter().map(figure).collect::<String>(), "</div>\n")
        }
        Block::Preformatted(text) => enclosed("<div class=\"wide\"><pre>", &escaped(text), "</pre></div>\n"),
        Block::Folded(summary, content) => {
            let summary = format!("<details><summary>{}</summary>\n", escaped(summary));
            enclosed(&summary, &blocks(content), "</details>\n")
        }
        Block::SignOff(lines) => {
            let line = |line: &String| format!("<tr><td>{}</td><td class=\"sign\"></td></tr>", escaped(line));
            enclosed("<table>", &lines.iter().map(line).collect::<String>(), "</table>\n")
        }
    }
}

/// Content within a tag; nothing without content.
fn enclosed(before: &str, content: &str, after: &str) -> String {
    if content.is_empty() { String::new() } else { format!("{before}{content}{after}") }
}

fn items(texts: impl Iterator<Item = String>) -> String {
    texts.map(|text| format!("<li>{}</li>", prose(&text))).collect()
}

fn table(table: &ValueTable) -> String {
    let name = |column: &TableColumn| format!("<th{}>{}</th>", class(column, ""), escaped(&column.name));
    let names: String = table.head.iter().map(name).collect();
    let rows: String = (0..table.rows.len()).map(|number| row(table, number)).collect();
    let cards = attribute("class", if table.cards { "cards" } else { "" });
    let before = format!("<div class=\"wide\"><table{cards}><tr>{names}</tr>\n");
    enclosed(&before, &rows, "</table></div>\n")
}

fn row(table: &ValueTable, number: usize) -> String {
    let cell = |(column, text): (&TableColumn, &String)| {
        let name = attribute("data-name", if table.cards { &column.name } else { "" });
        format!("<td{}{name}>{}</td>", class(column, text), escaped(text))
    };
    let mut cells: Vec<String> = table.head.iter().zip(&table.rows[number]).map(cell).collect();
    if let (Some(shares), Some(text)) = (table.shares.get(number), table.rows[number].last()) {
        cells.pop();
        cells.push(format!("<td class=\"words\">{}{}</td>", escaped(text), bar(shares)));
    }
    let doubtful = attribute("class", if table.doubtful.contains(&number) { "doubtful" } else { "" });
    format!("<tr{doubtful}>{}</tr>\n", cells.concat())
}

/// Numbers are aligned to the right, and names of colours are coloured.
fn class(column: &TableColumn, text: &str) -> String {
    let is_colour = ["ch", "channel"].contains(&column.name.as_str()) && ["R", "G", "B"].contains(&text);
    attribute(
        "class",
        if column.is_number {
            "number"
        } else if is_colour {
            text
        } else {
            ""
        },
    )
}

/// An attribute with its value; nothing without a value.
fn attribute(name: &str, value: &str) -> String {
    if value.is_empty() { String::new() } else { format!(" {name}=\"{}\"", escaped(value)) }
}

fn bar(shares: &[(String, f64)]) -> String {
    let part = |(name, share): &(String, f64)| {
        format!("<span style=\"width:{:.1}%\" title=\"{}\"></span>", 100.0 * share, escaped(name))
    };
    format!("<div class=\"bar\">{}</div>", shares.iter().map(part).collect::<String>())
}

fn pairs<'a>(pairs: impl Iterator<Item = (String, &'a String)>) -> String {
    let row = |(name, text): (String, &String)| format!("<tr><td>{name}</td><td>{}</td></tr>\n", prose(text));
    enclosed("<table class=\"wrapped\">", &pairs.map(row).collect::<String>(), "</table>\n")
}

fn links(names: &[String]) -> String {
    names.iter().map(|name| format!("<a href=\"{0}\">{0}</a>", escaped(name))).collect::<Vec<_>>().join(", ")
}

fn figure(figure: &Figure) -> String {
    let is_chart = figure.pictures.iter().any(|picture| matches!(picture, PagePicture::Chart(_)));
    let picture = |picture: &PagePicture| match picture {
        PagePicture::Chart(svg) | PagePicture::Drawing(svg) => svg.clone(),
        PagePicture::Strip { uri, alt } => {
            format!("<img class=\"strip\" src=\"{uri}\" alt=\"{}\">", escaped(alt))
        }
    };
    let caption = enclosed("<figcaption>", &prose(&figure.caption), "</figcaption>");
    format!(
        "<figure{}>{}{caption}</figure>\n",
        attribute("class", if is_chart { "wide" } else { "" }),
        figure.pictures.iter().map(picture).collect::<String>()
    )
}

/// A sentence: commands between backticks are code, and symbols have indices.
fn prose(text: &str) -> String {
    let text = SYMBOLS.iter().fold(escaped(text), |text, (plain, html)| text.replace(plain, html));
    let parts = text.split('`').enumerate();
    parts.map(|(i, part)| if i % 2 == 1 { format!("<code>{part}</code>") } else { part.to_owned() }).collect()
}

/// Text escaped for HTML.
pub(crate) fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
