//! Implements `farmctl capture`: turns the photographs of a session into edge profiles. It also checks single photographs,
//! and writes a board to print.

mod check;

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use clap::Args;
use farm_lab::capture::{self, Captured, CapturedPart, FILES, SessionErrors, captured_rows, captured_table};
use farm_lab::document::Block;
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::json;

use crate::cli::Global;
use crate::commands::fits::measure::{self, MeasureArgs};
use crate::output::{Output, write_whole};
use crate::progress::has_bars;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  farmctl capture examples/session/session.toml -o white    profiles, set-up and a report
  farmctl measure white                                     media from them
  farmctl capture session.toml --measure                    both
  farmctl capture --check IMG_0815.dng                      is this photograph usable?
  farmctl capture --watch shots                             check each one while shooting
  farmctl capture --new shots                               a session file from a folder of photographs
  farmctl capture --board board.pdf                         a board to print")]
pub(crate) struct CaptureArgs {
    /// Session file in TOML: the photographs, and the known values of patches, board and slabs.
    #[arg(required_unless_present_any = ["check", "board", "watch", "new"],
          conflicts_with_all = ["check", "board", "watch", "new"])]
    session: Option<PathBuf>,
    /// Folder to write: measurements.csv, session.json, scene.toml, grid.toml, report.html, report.json [default: the
    /// session file's name without its ending, with -capture if the photographs lie there].
    #[arg(long, short, value_name = "DIR", requires = "session")]
    output: Option<PathBuf>,
    /// Then measure the media, as `farmctl measure DIR` does.
    #[arg(long, requires = "session")]
    measure: bool,
    /// Check whether single photographs are usable; the exit code is 1 if one is not.
    #[arg(long, value_name = "SHOT", num_args = 1.., conflicts_with = "board")]
    check: Vec<PathBuf>,
    /// Check every photograph that arrives in a folder, until Ctrl-C: for shooting tethered.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["board", "check"])]
    watch: Option<PathBuf>,
    /// Sort the photographs of a folder by what they show: writes session.toml, with "?" for what only you know, and
    /// contact.html.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["board", "check", "watch", "darks"])]
    new: Option<PathBuf>,
    /// Colours of 2 × 2 pixels, row by row, for --check, --new and --watch of mosaics whose files do not contain them.
    #[arg(long, value_name = "RGGB", conflicts_with_all = ["session", "board"])]
    pattern: Option<String>,
    /// Dark shots for --check and --watch, of photographs whose files do not contain the black level (TIFF, PNG, PGM).
    #[arg(long, value_name = "SHOT", num_args = 1.., conflicts_with_all = ["session", "board"])]
    darks: Vec<PathBuf>,
    /// Write a board to print: FILE.svg or FILE.pdf.
    #[arg(long, value_name = "FILE")]
    board: Option<PathBuf>,
}

pub(crate) async fn run(global: &Global, args: CaptureArgs, output: &Output) -> Result<ExitCode> {
    if let Some(path) = &args.board {
        return board(path, output).map(|()| ExitCode::SUCCESS);
    }
    if !args.check.is_empty() {
        return check::run(&args, output);
    }
    if let Some(folder) = &args.watch {
        return check::watch(&args, folder, output).await;
    }
    if let Some(folder) = &args.new {
        return new_session(global, folder, args.pattern.as_deref(), output).map(|()| ExitCode::SUCCESS);
    }
    let session = args.session.as_deref().context("name a session file")?;
    if session.is_dir() {
        let folder = session.display();
        bail!(
            "{folder} is a folder: name the session file in it, such as session.toml, which `farmctl capture --new {folder}` makes"
        );
    }
    let folder = match &args.output {
        Some(folder) => folder.clone(),
        None => default_folder(session).context("the session file has no name: add --output")?,
    };
    let bar = bar(global.quiet);
    let captured = capture::capture(session, |what, share| {
        bar.set_position((share * STEPS as f64) as u64);
        bar.set_message(what.to_owned());
    });
    bar.finish_and_clear();
    let captured = captured?;
    let notes = capture::write_folder(&folder, &captured)?;
    let warnings = captured.warnings(&folder.join(FILES[0]), &notes);
    // Standard output has one object: with --measure, that of the media.
    if !(args.measure && output.is_json()) {
        let rows = captured_rows(&captured);
        let data = json!({
            "output": folder.display().to_string(),
            "files": FILES,
            "profiles": rows,
            "errors": SessionErrors::of(&captured),
            "warnings": warnings,
        });
        output.answer("capture", &data, || {
            let mut blocks = vec![captured_table(&rows).block()];
            blocks.extend(set_up(&captured).map(Block::Paragraph));
            let (findings, masked) = captured.findings(&folder.join(FILES[0]), &notes);
            blocks.push(Block::warnings(&findings));
            if masked > 0 {
                let plural = if masked > 1 { "s" } else { "" };
                let text = "specks and scratches are masked, as report.html shows, in";
                blocks.push(Block::Aside(format!("{text} {masked} photograph{plural}")));
            }
            let written = format!("written to {}: {}", folder.display(), FILES.join(", "));
            blocks.push(Block::Preformatted(written));
            blocks
        })?;
    }
    if args.measure {
        measure::run(global, measure::Inputs::of(MeasureArgs::new(folder))?, output).await?;
    }
    Ok(ExitCode::SUCCESS)
}

/// The session file's name without its ending; with "-capture" if that is the folder in which the file lies.
fn default_folder(session: &Path) -> Option<PathBuf> {
    let stem = session.file_stem()?;
    let own = session.parent().and_then(|parent| parent.canonicalize().ok());
    if own.is_some() && Path::new(stem).canonicalize().ok() == own {
        let mut name = stem.to_owned();
        name.push("-capture");
        return Some(name.into());
    }
    Some(stem.into())
}

/// Most channels whose ρ are printed.
const MOST_SHOWN: usize = 6;

/// Resolution of the progress bar.
const STEPS: u64 = 1000;

fn bar(quiet: bool) -> ProgressBar {
    if quiet || !has_bars() {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::new(STEPS);
    let style = ProgressStyle::with_template("[{wide_bar}] {msg}");
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()).progress_chars("=> "));
    bar.enable_steady_tick(Duration::from_millis(200));
    bar
}

/// Board, further results, and errors of all profiles.
fn set_up(captured: &Captured) -> impl Iterator<Item = String> {
    let errors = SessionErrors::of(captured);
    let percent = |share: f64| format!("{:.2} %", 100.0 * share);
    let rho = captured.channels().into_iter().map(|channel| channel.rho());
    let mut rho: Vec<String> =
        rho.map(|rho| format!("{:.3}/{:.4}", rho.light.value, rho.dark.value)).collect();
    if rho.len() > MOST_SHOWN {
        // Those between are in session.json.
        rho.splice(1..rho.len() - 1, ["…".to_owned()]);
    }
    let first = &captured.parts[0].board;
    let board = format!(
        "board: {:.3} px/mm, turned by {:.2}°, ρ {}",
        1.0 / first.mm_per_px.value,
        first.edge.angle_deg.value,
        rho.join(", "),
    );
    let errors = format!(
        "errors: gain {}, white reference {}, zero {:.5}, slope {} per 10 mm",
        percent(errors.gain_std_error),
        percent(errors.mu_std_error),
        errors.offset_std_error,
        percent(errors.slope_std_error),
    );
    let further: Vec<String> = captured.parts.iter().flat_map(CapturedPart::further).collect();
    [board, further.join("; "), errors].into_iter().filter(|text| !text.is_empty())
}

/// Makes a session file for the photographs of a folder.
fn new_session(global: &Global, folder: &Path, pattern: Option<&str>, output: &Output) -> Result<()> {
    let bar = bar(global.quiet);
    let sorted = capture::sort_folder(folder, pattern, |share| {
        bar.set_position((share * STEPS as f64) as u64);
        bar.set_message("looking at photographs");
    });
    bar.finish_and_clear();
    let sorted = sorted?;
    let [session, contact] = sorted.write(folder)?.map(|path| path.display().to_string());
    let data =
        json!({"session": session, "contact": contact, "shots": sorted.shots, "missing": sorted.missing()});
    output.answer("new_session", &data, || {
        vec![
            sorted.table().block(),
            Block::warnings(&sorted.missing()),
            Block::Paragraph(format!("Written: {session}, and {contact} with all pictures.")),
            Block::Paragraph(format!(
                "Fill in each \"?\" of {session}, then: `farmctl capture {session} --measure`"
            )),
        ]
    })
}

fn board(path: &Path, output: &Output) -> Result<()> {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_lowercase();
    let Some(bytes) = capture::board_sheet(&extension) else {
        bail!("board {}: the file's name must end with .svg or .pdf", path.display());
    };
    write_whole(path, &bytes).with_context(|| format!("board {}", path.display()))?;
    output.print("board", &json!({"board": path.display().to_string()}), || {
        format!("written: {}; print it at 100 % and measure its scale", path.display())
    })
}
