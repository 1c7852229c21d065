//! Runs the steps of a session in their order.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use optics_capture::{
    Appearance, BareShots, BlueCutShots, Board, BoardRho, Calibration, Darks, Estimate, Flats, HazeShots,
    Mountings, Patches, Photo, Warning,
};
use optics_model::scene::{Channel, LEAST_RHO_DARK};
use optics_model::{Invalid, Scene};
use optics_tracer::{BareBoard, SeenBase};

use super::band_optics::BandOptics;
use super::bands::BandPixels;
use super::captured::{Captured, CapturedPart, CapturedSample};
use super::channels::channel_names;
use super::in_gel::{gloss, light_side};
use super::session_file::{CaptureSession, Sample, SessionPart};
use super::shots::{Shots, turned};
use super::strip::Strip;

/// Runs all steps; `report` is called with the current step and the share of photographs that are read.
pub fn capture(path: &Path, mut report: impl FnMut(&str, f64)) -> Result<Captured> {
    let mut session = CaptureSession::read(path)?;
    let mut run = SessionRun {
        shots: Shots::new(session.pattern, path.parent().unwrap_or(Path::new(""))),
        total: session.shots().count(),
        done: 0,
        report: &mut report,
    };
    let parts = std::mem::take(&mut session.parts);
    let parts = parts.into_iter().map(|part| run.part(&session, part)).collect::<Result<Vec<_>>>();
    let inputs = run.shots.into_inputs();
    session.doubts.extend(turned(&inputs));
    match parts {
        Ok(parts) => {
            session.doubts.extend(BandOptics::of(&parts).iter().filter_map(BandOptics::doubt));
            Ok(Captured { session, parts, inputs })
        }
        // The doubtful values may be the cause.
        Err(error) if session.doubts.is_empty() => Err(error),
        Err(error) => Err(error.context(format!("doubtful: {}", session.doubts.join("; ")))),
    }
}

struct SessionRun<'a> {
    shots: Shots,
    total: usize,
    done: usize,
    report: &'a mut dyn FnMut(&str, f64),
}

impl SessionRun<'_> {
    fn part(&mut self, session: &CaptureSession, part: SessionPart) -> Result<CapturedPart> {
        let Some(band) = part.band.clone() else { return self.steps(session, part) };
        self.shots.of_band(Some(band.pixels));
        self.steps(session, part).with_context(|| format!("band {:?}", band.name))
    }

    /// All steps of a part.
    fn steps(&mut self, session: &CaptureSession, mut part: SessionPart) -> Result<CapturedPart> {
        let first = self.shots.count();
        let calibration = self.calibrate(&part)?;
        if part.band.as_ref().is_some_and(|band| band.pixels == BandPixels::Mono) {
            check_monochrome(&calibration)?;
        }
        let mut board = self.board(session, [&part.bare, &part.edge], "bare board", &calibration)?;
        let names = channel_names(part.band.as_ref(), &calibration);
        let rho = board_rho(&session.scene, &mut board, &calibration, &names)?;
        let haze = self.haze(&part.haze, &calibration, &board)?;
        let mut wet = None;
        if let Some(haze) = haze.filter(|_| !part.in_gel.is_empty()) {
            let seen = self.board(session, [&part.in_gel, &[]], "board in gel", &calibration)?;
            let scene = session.scene.clone().with_channels(board_channels(&names, &rho)?)?;
            let factor = light_side(&scene, &calibration, [&board, &seen], haze)?;
            // The dry board has shown its spread.
            let others = seen.warnings.into_iter().filter(|w| !matches!(w, Warning::SpreadingBoard { .. }));
            board.warnings.extend(others.chain(gloss(factor, &rho)));
            wet = Some(factor);
        }
        let slabs = std::mem::take(&mut part.samples).into_iter();
        let samples = slabs.map(|slab| self.sample(slab, &part, &calibration, &board));
        let samples = samples.collect::<Result<_>>()?;
        let about = self.shots.about(first);
        Ok(CapturedPart { band: part.band, about, calibration, board, rho, haze, light_side: wet, samples })
    }

    fn read(&mut self, path: &Path, what: &str) -> Result<Photo> {
        let name = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy();
        (self.report)(&format!("{what}: {name}"), self.done as f64 / self.total as f64);
        self.done += 1;
        self.shots.read(path, what)
    }

    fn calibrate(&mut self, part: &SessionPart) -> Result<Calibration> {
        let mut darks = Darks::new();
        for path in &part.dark {
            darks.add(self.read(path, "dark")?)?;
        }
        // Without dark shots, the black level is taken from the file of a photograph with light.
        let (first, others) = part.neutral_shots.split_first().context("a session has shots of patches")?;
        let first = self.read(first, "grey patches")?;
        let black = darks.finish(&first)?;
        let mut flats = Flats::new(&black);
        for path in &part.flat {
            flats.add(self.read(path, "flat")?)?;
        }
        let flat = flats.finish()?;
        let mut patches = Patches::new(black, flat, part.neutral.clone());
        patches.add(first)?;
        for path in others {
            patches.add(self.read(path, "grey patches")?)?;
        }
        for path in &part.exposures {
            patches.add_exposure(self.read(path, "exposure")?)?;
        }
        Ok(patches.finish()?)
    }

    fn board(
        &mut self,
        session: &CaptureSession,
        [shots, edges]: [&[PathBuf]; 2],
        what: &str,
        calibration: &Calibration,
    ) -> Result<Board> {
        let mut bare = BareShots::new(calibration, session.target)?;
        for path in shots {
            bare.add(self.read(path, what)?)?;
        }
        for path in edges {
            bare.add_edge(self.read(path, "edge")?)?;
        }
        Ok(bare.finish()?)
    }

    /// None without shots over a light trap.
    fn haze(
        &mut self,
        shots: &[PathBuf],
        calibration: &Calibration,
        board: &Board,
    ) -> Result<Option<Estimate>> {
        let mut haze = HazeShots::new(calibration, board);
        for path in shots {
            haze.add(self.read(path, "haze")?)?;
        }
        if shots.is_empty() { Ok(None) } else { Ok(Some(haze.finish()?)) }
    }

    fn sample(
        &mut self,
        slab: Sample,
        part: &SessionPart,
        calibration: &Calibration,
        board: &Board,
    ) -> Result<CapturedSample> {
        let label = slab.label();
        let mut mountings = Mountings::new(calibration, board, &label);
        let mut strip = None;
        for path in &slab.shots {
            let photo = self.read(path, &label)?;
            let x_mm = &board.profiles[0].x_mm;
            if part.band.is_none() {
                strip.get_or_insert_with(|| Strip::of(&photo.frame, board, x_mm));
            }
            mountings.add(photo)?;
        }
        let profile = mountings.finish()?;
        let mut cut = BlueCutShots::new(calibration, board, &profile);
        for path in &slab.blue_cut {
            cut.add(self.read(path, &format!("{label} without blue"))?)?;
        }
        let fluorescence = if slab.blue_cut.is_empty() { None } else { Some(cut.finish()?) };
        Ok(CapturedSample { about: slab, profile, fluorescence, strip })
    }
}

/// Largest ratio of the brightness of two of a monochrome sensor's 2 × 2 pixels.
const SAME_PIXELS: f64 = 1.03;

/// Refuses a mosaic that is read as a monochrome camera's photograph: its pixels differ in brightness.
fn check_monochrome(calibration: &Calibration) -> Result<()> {
    let ratio = calibration.site_ratio();
    if ratio <= SAME_PIXELS {
        return Ok(());
    }
    bail!(
        "pixels side by side differ in brightness by {:.0} %: this looks like a mosaic of colours; set `pattern` under \
         [camera], and `channel` of the band to \"R\", \"G\" or \"B\"",
        100.0 * (ratio - 1.0)
    )
}

/// ρ of the board without the effect of the scene. A dark side below 0 is accepted where the priors of the scene explain
/// it.
fn board_rho(
    scene: &Scene,
    board: &mut Board,
    calibration: &Calibration,
    names: &[String],
) -> Result<Vec<BoardRho>> {
    // Light and coat are the same for all channels.
    let seen = BareBoard::of(scene).context("the session's scene")?;
    let shown = Appearance { s: seen.specular, a: seen.gain, b: seen.returned };
    let rho = board.rho(shown, calibration.reference_std_error);
    if rho.iter().all(BoardRho::is_plausible) {
        return Ok(rho);
    }
    let found = scene.clone().with_channels(board_channels(names, &rho)?)?;
    let of_scene = SeenBase::of(&found).std_errors()?;
    let columns = || calibration.columns().iter().copied().zip(&rho);
    for ((colour, rho), of_scene) in columns().zip(of_scene) {
        rho.check(colour, of_scene)?;
    }
    if rho.iter().any(|rho| rho.dark.value < -3.0 * rho.dark.std_error) {
        let rho = columns().map(|(colour, rho)| (colour, rho.dark.value)).collect();
        board.warnings.push(Warning::DarkerThanBlack { rho });
    }
    Ok(rho)
}

/// Channels with this board.
fn board_channels(names: &[String], rho: &[BoardRho]) -> Result<Vec<Channel>, Invalid> {
    names.iter().zip(rho).map(|(name, rho)| board_channel(name, rho)).collect()
}

/// A channel with this board; ρ is clamped to its range.
pub(super) fn board_channel(name: &str, rho: &BoardRho) -> Result<Channel, Invalid> {
    let [light, dark] = within_range([rho.light.value, rho.dark.value]);
    Channel::new(name, rounded(light), rounded(dark))
}

/// ρ of the light and the dark side, clamped to the ranges of a channel.
pub(super) fn within_range([light, dark]: [f64; 2]) -> [f64; 2] {
    [light.clamp(0.0, 1.0), dark.clamp(LEAST_RHO_DARK, 1.0)]
}

pub(super) fn rounded(rho: f64) -> f64 {
    (1e6 * rho).round() / 1e6
}
