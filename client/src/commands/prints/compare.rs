//! Implements `farmctl compare`: whether two measurements of resins agree, by their intervals and their covariance.

mod library;

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use farm_figures::numbers::short;
use farm_lab::document::{Block, ValueTable};
use farm_lab::media_file::MediaFile;
use serde::Serialize;

use crate::output::Output;
use crate::prints::comparison::{ComparedChannel, ComparedQuantity, Comparison, compared};
use library::LibraryMatches;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  farmctl compare monday/ tuesday/       materials of the same names
  farmctl compare lab-a/media.json lab-b/media.json
  farmctl compare monday/ resins/        the materials of a library that are like those of monday

E_n (ISO 13528) is the difference over the expanded uncertainties of both: 1 and more is a
real difference. Errors that both share, such as those of one white reference, do not count in it.")]
pub(crate) struct CompareArgs {
    /// Measured media: media.json, or the folder that contains it.
    a: PathBuf,
    /// Other measured media, or a library: a folder that contains folders of measured media.
    b: PathBuf,
}

#[derive(Debug, Serialize)]
pub(crate) struct CompareJson {
    #[serde(flatten)]
    compared: Comparison,
    /// Nearest materials of a library; missing if two measurements were compared.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    library: Vec<LibraryMatches>,
    /// Files of the library that cannot be read, with the reason.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    left_out: Vec<String>,
}

pub(crate) fn run(args: &CompareArgs, output: &Output) -> Result<()> {
    let a = MediaFile::read(&args.a)?;
    if library::is_library(&args.b) {
        let (library, left_out) = library::nearest(&a, &args.b)?;
        let data = CompareJson { compared: Comparison::default(), library, left_out };
        return output.answer("compare", &data, || library::blocks(&data.library, &data.left_out));
    }
    let compared = compared(&a, &MediaFile::read(&args.b)?)?;
    let data = CompareJson { compared, library: Vec::new(), left_out: Vec::new() };
    output.answer("compare", &data, || blocks(&data.compared))
}

fn blocks(data: &Comparison) -> Vec<Block> {
    let row = |c: &ComparedChannel, q: &ComparedQuantity| {
        let [a, b, e_n, pooled, interval] = q.texts();
        let mark = if q.differs() { " !" } else { "" };
        vec![short(&c.material), c.channel.clone(), q.quantity.to_owned(), a, b, e_n + mark, pooled, interval]
    };
    // σ_s(1 − g) and σ_a are shared by similar media: they are compared first, the others are in the JSON.
    let rows = data.channels.iter().flat_map(|c| c.quantities.iter().take(2).map(move |q| row(c, q)));
    let mut blocks = vec![
        ValueTable::new("material | ch |  | >A | >B | >E_n | >pooled | 95 %", rows).block(),
        Block::Verdict(data.conclusion()),
    ];
    if !data.unmatched.is_empty() {
        blocks.push(Block::Paragraph(format!("without a counterpart: {}", data.unmatched.join(", "))));
    }
    blocks
}
