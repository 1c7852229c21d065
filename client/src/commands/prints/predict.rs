//! Implements `farmctl predict`: the reflectance and the colour of slabs of measured media over bases.

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Args;
use farm_figures::numbers::{significant, with_error};
use farm_lab::colour::{StandardObserver, Viewing};
use farm_lab::document::{Block, ValueTable};
use farm_lab::media_file::MediaFile;
use farm_lab::whole_file::write_whole;

use super::view_args::ViewArgs;
use crate::output::Output;
use crate::prints::prediction::{
    ColourJson, ColoursJson, PredictJson, PredictedChannelJson, ReflectanceJson, predicted,
};

/// Most characters of a material's name in an OpenPrintTag.
const TAG_NAME: usize = 31;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  farmctl predict media white:1                         over black and white, in the measured set-up
  farmctl predict media cyan:0.2 white:2 --over 0.5     a layer on a thick one
  farmctl predict media white=0.9,cyan=0.1:1 --geometry d:8

The media are those that `farmctl measure` wrote to media.json, in the folder of -o or of a session.
Set-up and index of the print are those that the measurement found; intervals contain the errors of
the media and of the set-up.")]
pub(crate) struct PredictArgs {
    /// Measured media: media.json, or the folder that contains it.
    media: PathBuf,
    /// Slabs from top to bottom: MATERIAL:MM, or a mixture by volume, MATERIAL=SHARE,MATERIAL=SHARE:MM.
    #[arg(value_name = "SLAB", required = true)]
    slabs: Vec<String>,
    /// Lambertian bases under the print: reflectances; black (0.03) and white (0.9); light and dark, the sides of the
    /// measured board.
    #[arg(long, value_name = "LIST", value_delimiter = ',', default_value = "black,white")]
    over: Vec<String>,
    /// Write name and colour of the print, over the last base, as data of an OpenPrintTag (YAML).
    #[arg(long, value_name = "FILE")]
    tag: Option<PathBuf>,
    #[command(flatten)]
    view: ViewArgs,
}

pub(crate) fn run(args: &PredictArgs, output: &Output) -> Result<()> {
    let data = predicted(&MediaFile::read(&args.media)?, &args.slabs, &args.over, &args.view.options())?;
    if let Some(path) = &args.tag {
        let text = tag(&data)?;
        write_whole(path, text.as_bytes()).with_context(|| format!("tag {}", path.display()))?;
    }
    let written = args.tag.as_ref().map(|path| format!("written: {} (OpenPrintTag)", path.display()));
    output.answer("predict", &data, || {
        blocks(&data).into_iter().chain(written.map(Block::Preformatted)).collect()
    })
}

/// Input of OpenPrintTag's `rec_update.py`. L*a*b* is a comment: `primary_color_lab` must be measured (specification of
/// June 2026). A transmission distance is left out: its unit, HueForge TD, has no public definition.
fn tag(data: &PredictJson) -> Result<String> {
    let reason = || data.no_colours.clone().unwrap_or_default();
    let colours = data.colours.as_ref().with_context(|| format!("tag: no colour: {}", reason()))?;
    let colour = colours.bases.last().context("tag: no base")?;
    let hex = colour.hex().context("tag: no sRGB colour: give --observer 2")?;
    let labels: Vec<&str> = data.slabs.iter().map(|slab| slab.label.as_str()).collect();
    let one =
        data.slabs[0].shares.first().filter(|_| data.slabs.len() == 1 && data.slabs[0].shares.len() == 1);
    let name = one.map_or_else(|| labels.join(" on "), |share| share.material.clone());
    let lab = colour.colour.lab.map(|v| format!("{v:.2}")).join(", ");
    let name: String = name.chars().filter(|c| !c.is_control()).take(TAG_NAME).collect();
    Ok(format!(
        "# {:?} over {}, {}: predicted from measured media\ndata:\n  main:\n    material_class: SLA\n    \
         material_name: {}\n    primary_color: {hex:?}\n    \
         # predicted, {:?}, 2°, {}; the standard allows it for D65 and 2° if it is measured\n    \
         # primary_color_lab: [{lab}]\n",
        labels.join(" on "),
        colour.base.name,
        data.seen(),
        // A string of JSON is one of YAML.
        serde_json::to_string(&name)?,
        colours.viewing.illuminant,
        data.seen(),
    ))
}

fn blocks(data: &PredictJson) -> Vec<Block> {
    let bases: Vec<&str> = data.channels[0].bases.iter().map(|b| b.base.name.as_str()).collect();
    let head: String = bases.iter().map(|base| format!(" | >over {base} | 95 %")).collect();
    let row = |channel: &PredictedChannelJson| {
        let cells = channel.bases.iter().flat_map(ReflectanceJson::texts);
        std::iter::once(channel.channel.clone()).chain(cells).collect()
    };
    let slabs: Vec<&str> = data.slabs.iter().map(|slab| slab.label.as_str()).collect();
    let mut blocks = vec![
        Block::Heading(3, format!("radiance factor of {}, {}", slabs.join(" on "), data.seen())),
        ValueTable::new(&format!("ch{head}"), data.channels.iter().map(row)).block(),
    ];
    blocks.extend(data.colours.as_ref().map(colours).unwrap_or_default());
    blocks.extend(data.remarks().into_iter().map(Block::Paragraph));
    blocks
}

fn colours(colours: &ColoursJson) -> Vec<Block> {
    let row = |c: &ColourJson| {
        let mut cells = vec![format!("over {}", c.base.name)];
        cells.extend((0..3).map(|k| with_error(c.colour.lab[k], c.lab_std_errors[k])));
        cells.push(significant(c.colour.xyz[1], 3));
        cells.push(c.hex().unwrap_or_else(|| "–".to_owned()));
        cells
    };
    let Viewing { illuminant, observer } = colours.viewing;
    let observer = if observer == StandardObserver::TwoDegrees { "2°" } else { "10°" };
    let ratio =
        colours.contrast_ratio.map(|[v, error]| format!("contrast ratio Y/Y {}", with_error(v, error)));
    let difference = colours.delta_e_2000;
    let difference =
        difference.map(|[v, error]| format!("CIEDE2000 between the bases {}", with_error(v, error)));
    let both: Vec<String> = ratio.into_iter().chain(difference).collect();
    vec![
        Block::Heading(3, format!("colour, {illuminant:?}, {observer}")),
        ValueTable::new(" | >L* | >a* | >b* | >Y | sRGB", colours.bases.iter().map(row)).block(),
        Block::Paragraph(both.join(", ")),
    ]
}
