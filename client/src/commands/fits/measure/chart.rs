//! `farmctl measure` of a chart: media from printed stacks, without a farm or a dictionary.

use std::path::Path;

use anyhow::{Context, Result, bail};
use farm_figures::{ChartPoint, chart_figure};
use farm_lab::chart::{ChartAnswer, ChartFile, measured};
use farm_lab::document::Block;
use farm_lab::media_file::MEDIA_FILE;
use farm_lab::research_object::ANSWER_FILE;
use farm_lab::slabs::NamedSlab;
use farm_link::logs::to_stderr;

use super::MeasureArgs;
use crate::answers::media_files;
use crate::figure_files::{self, drawn};
use crate::output::{Output, envelope, grouped, write_whole};
use crate::prints::view::materials_of;
use crate::slurm::shell_quoted;

/// Files of media from a chart, with their purpose.
const WRITTEN: &str = "media.json, table.csv, answer.json, media for renderers";
/// Patches, and materials, from which on a fit takes so long that it is announced.
const MANY: [usize; 2] = [400, 6];

pub(super) fn run(args: &MeasureArgs, is_quiet: bool, output: &Output) -> Result<()> {
    refuse_edges(args)?;
    args.figure.check(args.plot.as_deref())?;
    let mut file = ChartFile::read(&args.measurements)?;
    if let Some(g) = &args.options.g {
        let held = g.held().context("a chart does not determine g: give one value, as --g 0.4")?;
        if !(-0.9..=0.9).contains(&held) {
            bail!("--g {held}: allowed are -0.9 to 0.9");
        }
        if file.settings.media.is_some() {
            bail!("--g {held}: the media of the settings have their own g; leave one of both out");
        }
        (file.settings.g, file.settings.g_std_error) = (held, 0.0);
    }
    let slabs: Vec<NamedSlab> = file.patches.iter().flat_map(|patch| patch.slabs.clone()).collect();
    let [patches, materials] = [file.patches.len(), materials_of(&slabs).len()];
    if (patches >= MANY[0] || materials >= MANY[1]) && !is_quiet {
        let patches = grouped(patches as u64);
        to_stderr(format_args!("fitting {patches} patches of {materials} materials, for up to a minute"));
    }
    let answer = measured(&file)?;
    let pictures = match &args.plot {
        Some(path) => draw(&file, &answer, path, args)?,
        None => None,
    };
    if let Some(folder) = &args.output {
        write(folder, &answer).with_context(|| format!("writing {}", folder.display()))?;
    }
    output.answer("chart", &answer.data, || {
        let mut blocks = answer.blocks(args.verbose);
        blocks.extend(drawn(&pictures));
        blocks.push(Block::Aside(match &args.output {
            Some(folder) => {
                let shown = shell_quoted(&folder.display().to_string());
                let print = shell_quoted(&format!("{}:1", answer.fits[0].material));
                format!(
                    "written to {shown}: {WRITTEN}; how 1 mm of it looks: `farmctl predict {shown} {print}`"
                )
            }
            None => "-o DIR writes media.json for `farmctl predict`, and media for renderers".to_owned(),
        }));
        if !args.verbose {
            blocks.push(Block::Aside(
                "`measure -v` shows camera, base and light, and the worst patches".to_owned(),
            ));
        }
        blocks
    })
}

/// Refuses options that belong to profiles over an edge.
fn refuse_edges(args: &MeasureArgs) -> Result<()> {
    let given = [
        ("--dictionary", args.options.dictionary.is_some()),
        ("--mu", args.mu.is_some()),
        ("--mixtures", args.mixtures.is_some()),
        ("--free-g", args.free_g),
        ("--g-spread", args.g_spread.is_some()),
        ("--g-change", args.g_change.is_some()),
        ("--objective", args.options.objective.is_some()),
        ("--sigma-t", args.options.sigma_t.is_some()),
        ("--albedo", args.options.albedo.is_some()),
        ("--bound", args.bound),
        ("--keep", args.keep.is_some()),
    ];
    match given.into_iter().find(|(_, is_given)| *is_given) {
        Some((option, _)) => {
            bail!("{option} belongs to profiles over an edge: leave it out for a chart of stacks")
        }
        None => Ok(()),
    }
}

/// Draws patches against what the others predict of them.
fn draw(
    file: &ChartFile,
    answer: &ChartAnswer,
    path: &Path,
    args: &MeasureArgs,
) -> Result<Option<std::path::PathBuf>> {
    let points: Vec<ChartPoint> = answer
        .predictions(file)
        .map(|(measured, predicted, std_error)| ChartPoint { predicted, measured, std_error })
        .collect();
    let Some(picture) = chart_figure(&points) else { return Ok(None) };
    figure_files::write(&picture, path, args.figure.size()?)?;
    Ok(Some(path.to_owned()))
}

fn write(folder: &Path, answer: &ChartAnswer) -> Result<()> {
    std::fs::create_dir_all(folder)?;
    for (name, text) in media_files(&answer.fits)? {
        write_whole(&folder.join(name), text.as_bytes()).context(name)?;
    }
    write_whole(&folder.join(MEDIA_FILE), answer.media.text()?.as_bytes()).context(MEDIA_FILE)?;
    let text = envelope("chart", &answer.data)? + "\n";
    write_whole(&folder.join(ANSWER_FILE), text.as_bytes()).context(ANSWER_FILE)
}
