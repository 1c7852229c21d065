//! Runs the steps of a session in their order.

use std::path::Path;

use anyhow::{Context, Result};
use optics_capture::{
    Appearance, BareShots, Board, BoardRho, Calibration, Colour, Darks, Flats, Mountings, Patches, Photo,
    SampleProfile, Warning,
};
use optics_model::scene::{Channel, LEAST_RHO_DARK};
use optics_model::{Invalid, Scene};
use optics_tracer::{BareBoard, SeenBase};

use super::session_file::{CaptureSession, Sample};
use super::shots::{Input, Shots, turned};
use super::strip::Strip;

/// All results of a session's photographs.
#[derive(Debug)]
pub struct Captured {
    pub session: CaptureSession,
    pub calibration: Calibration,
    pub board: Board,
    pub rho: [BoardRho; 3],
    pub samples: Vec<CapturedSample>,
    /// All photographs, in the order of their use.
    pub inputs: Vec<Input>,
}

#[derive(Debug)]
pub struct CapturedSample {
    pub about: Sample,
    pub profile: SampleProfile,
    pub strip: Strip,
}

/// Runs all steps; `report` is called with the current step and the share of photographs that are read.
pub fn capture(path: &Path, mut report: impl FnMut(&str, f64)) -> Result<Captured> {
    let mut session = CaptureSession::read(path)?;
    let mut run = SessionRun {
        shots: Shots::new(session.pattern, path.parent().unwrap_or(Path::new(""))),
        total: session.shots().count(),
        done: 0,
        report: &mut report,
    };
    let stages = run.stages(&mut session);
    let inputs = run.shots.into_inputs();
    session.doubts.extend(turned(&inputs));
    match stages {
        Ok(Stages { calibration, board, rho, samples }) => {
            Ok(Captured { session, calibration, board, rho, samples, inputs })
        }
        // The doubtful values may be the cause.
        Err(error) if session.doubts.is_empty() => Err(error),
        Err(error) => Err(error.context(format!("doubtful: {}", session.doubts.join("; ")))),
    }
}

/// Results of all steps.
struct Stages {
    calibration: Calibration,
    board: Board,
    rho: [BoardRho; 3],
    samples: Vec<CapturedSample>,
}

struct SessionRun<'a> {
    shots: Shots,
    total: usize,
    done: usize,
    report: &'a mut dyn FnMut(&str, f64),
}

impl SessionRun<'_> {
    fn stages(&mut self, session: &mut CaptureSession) -> Result<Stages> {
        let calibration = self.calibrate(session)?;
        let mut board = self.board(session, &calibration)?;
        let rho = board_rho(&session.scene, &mut board, calibration.reference_std_error)?;
        let slabs = std::mem::take(&mut session.samples);
        let samples =
            slabs.into_iter().map(|slab| self.sample(slab, &calibration, &board)).collect::<Result<_>>()?;
        Ok(Stages { calibration, board, rho, samples })
    }

    fn read(&mut self, path: &Path, what: &str) -> Result<Photo> {
        let name = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy();
        (self.report)(&format!("{what}: {name}"), self.done as f64 / self.total as f64);
        self.done += 1;
        self.shots.read(path, what)
    }

    fn calibrate(&mut self, session: &CaptureSession) -> Result<Calibration> {
        let mut darks = Darks::new();
        for path in &session.dark {
            darks.add(self.read(path, "dark")?)?;
        }
        // Without dark shots, the black level is taken from the file of a photograph with light.
        let (first, others) =
            session.neutral_shots.split_first().context("a session has shots of patches")?;
        let first = self.read(first, "grey patches")?;
        let black = darks.finish(&first)?;
        let mut flats = Flats::new(&black);
        for path in &session.flat {
            flats.add(self.read(path, "flat")?)?;
        }
        let flat = flats.finish()?;
        let mut patches = Patches::new(black, flat, session.neutral.clone());
        patches.add(first)?;
        for path in others {
            patches.add(self.read(path, "grey patches")?)?;
        }
        Ok(patches.finish()?)
    }

    fn board(&mut self, session: &CaptureSession, calibration: &Calibration) -> Result<Board> {
        let mut bare = BareShots::new(calibration, session.target)?;
        for path in &session.bare {
            bare.add(self.read(path, "bare board")?)?;
        }
        Ok(bare.finish()?)
    }

    fn sample(&mut self, slab: Sample, calibration: &Calibration, board: &Board) -> Result<CapturedSample> {
        let label = slab.label();
        let mut mountings = Mountings::new(calibration, board, &label);
        let mut strip = None;
        for path in &slab.shots {
            let photo = self.read(path, &label)?;
            let x_mm = &board.profiles[1].x_mm;
            strip.get_or_insert_with(|| Strip::of(&photo.frame, board, x_mm));
            mountings.add(photo)?;
        }
        let strip = strip.context("a sample has shots")?;
        Ok(CapturedSample { about: slab, profile: mountings.finish()?, strip })
    }
}

/// ρ of the board without the effect of the scene. A dark side below 0 is accepted where the priors of the scene explain
/// it.
fn board_rho(scene: &Scene, board: &mut Board, gain_std_error: f64) -> Result<[BoardRho; 3]> {
    // Light and coat are the same for all channels.
    let seen = BareBoard::of(scene).context("the session's scene")?;
    let shown = Appearance { s: seen.specular, a: seen.gain, b: seen.returned };
    let rho = board.rho(shown, gain_std_error);
    if rho.iter().all(BoardRho::is_plausible) {
        return Ok(rho);
    }
    let found = scene.clone().with_channels(board_channels(&rho)?)?;
    let of_scene = SeenBase::of(&found).std_errors()?;
    for ((colour, rho), of_scene) in Colour::ALL.into_iter().zip(&rho).zip(of_scene) {
        rho.check(colour, of_scene)?;
    }
    let dark = rho.each_ref().map(|rho| rho.dark);
    if dark.iter().any(|dark| dark.value < -3.0 * dark.std_error) {
        board.warnings.push(Warning::DarkerThanBlack { rho: dark.map(|dark| dark.value) });
    }
    Ok(rho)
}

/// Channels with this board; ρ is clamped to the range of a channel.
pub(super) fn board_channels(rho: &[BoardRho; 3]) -> Result<Vec<Channel>, Invalid> {
    let channel = |(colour, rho): (Colour, &BoardRho)| {
        let [light, dark] = within_range([rho.light.value, rho.dark.value]);
        Channel::new(colour.letter(), rounded(light), rounded(dark))
    };
    Colour::ALL.into_iter().zip(rho).map(channel).collect()
}

/// ρ of the light and the dark side, clamped to the ranges of a channel.
pub(super) fn within_range([light, dark]: [f64; 2]) -> [f64; 2] {
    [light.clamp(0.0, 1.0), dark.clamp(LEAST_RHO_DARK, 1.0)]
}

pub(super) fn rounded(rho: f64) -> f64 {
    (1e6 * rho).round() / 1e6
}
