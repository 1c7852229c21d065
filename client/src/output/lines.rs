//! Renders the blocks of documents as lines of text for a terminal of 80 columns.

use comfy_table::{Attribute, Cell, CellAlignment, LineStyle, TableStyle};
use farm_lab::document::{Block, Remark, ValueTable};

use super::{warning, wrapped};

/// Lines for a terminal, with warnings in yellow. Headings follow an empty line, and figures are left out.
pub(crate) fn lines(blocks: &[Block]) -> String {
    let mut text = String::new();
    for block in blocks {
        let part = part(block);
        if !text.is_empty() && !part.is_empty() {
            text += if matches!(block, Block::Heading(..)) { "\n\n" } else { "\n" };
        }
        text += &part;
    }
    text
}

fn part(block: &Block) -> String {
    let named = |(name, text): &(String, String)| wrapped(&format!("{name}: {text}"));
    match block {
        Block::Heading(_, text) | Block::Verdict(text) | Block::Paragraph(text) | Block::Aside(text) => {
            wrapped(text)
        }
        Block::Remarks(all) => joined(all, remark),
        Block::List(texts) => joined(texts, |text| wrapped(text)),
        Block::Entries(entries) => joined(entries, named),
        Block::Files(files) => joined(files, |(names, text)| named(&(names.join(", "), text.clone()))),
        Block::Table(table) if table.rows.is_empty() => String::new(),
        // Shares need the whole width.
        Block::Table(all) if !all.shares.is_empty() => joined(&all.rows, |row| wrapped(&row.join(": "))),
        Block::Table(all) => table(all),
        Block::Preformatted(text) => text.clone(),
        Block::Folded(_, content) => lines(content),
        Block::Figure(_) | Block::Row(_) | Block::SignOff(_) => String::new(),
    }
}

fn joined<T>(all: &[T], line: impl Fn(&T) -> String) -> String {
    all.iter().map(line).collect::<Vec<_>>().join("\n")
}

fn remark(remark: &Remark) -> String {
    let line = wrapped(&remark.sentence());
    if remark.warning { warning(&line) } else { line }
}

/// A horizontal rule above and below the head and at the end.
const RULED: TableStyle = {
    let rule = LineStyle::new('─', '─', '─', '─');
    TableStyle::new().top_border(rule).header_separator(rule).bottom_border(rule)
};

/// A table with a head.
fn table(table: &ValueTable) -> String {
    let mut shown = comfy_table::Table::new();
    shown.load_style(RULED);
    shown.set_header(table.head.iter().map(|c| Cell::new(&c.name).add_attribute(Attribute::Bold)));
    shown.add_rows(&table.rows);
    for (column, known) in shown.column_iter_mut().zip(&table.head) {
        // Two columns of space between cells: tables must fit a terminal of 80 columns.
        column.set_padding((0, 1));
        if known.is_number {
            column.set_cell_alignment(CellAlignment::Right);
        }
    }
    without_margins(&shown.to_string())
}

/// The table without the blank columns at its sides; rules are as wide as the remaining text.
fn without_margins(table: &str) -> String {
    let is_rule = |line: &str| line.starts_with('─');
    let row = |line: &str| line.strip_prefix(' ').unwrap_or(line).trim_end().to_owned();
    let shown = |line: &str| anstream::adapter::strip_str(&row(line)).to_string().chars().count();
    let width = table.lines().filter(|l| !is_rule(l)).map(shown).max().unwrap_or(0);
    let line = |line: &str| if is_rule(line) { "─".repeat(width) } else { row(line) };
    table.lines().map(line).collect::<Vec<_>>().join("\n")
}
