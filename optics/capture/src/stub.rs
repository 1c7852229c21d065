//! Signatures of what is to come; replaced file by file.
#![expect(clippy::todo, missing_debug_implementations, clippy::pedantic)]
use crate::*;
use optics_model::Invalid;

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Target {
    pub square_mm: f64,
    pub square_std_error_mm: f64,
    pub dark_side: Option<Side>,
}
pub struct BareShots<'a>(&'a Calibration);
impl<'a> BareShots<'a> {
    pub fn new(_calibration: &'a Calibration, _target: Target) -> Result<Self, Invalid> {
        todo!()
    }
    pub fn add(&mut self, _photo: Photo) -> Result<(), Refusal> {
        todo!()
    }
    pub fn finish(self) -> Result<Board, Refusal> {
        todo!()
    }
}
/// Where the bare board lies and what it looks like.
#[derive(Debug, Clone)]
pub struct Board {
    pub edge: EdgeLine,
    pub mm_per_px: Estimate,
    /// Pixels of the lattice's corners that lie in the frame.
    pub corners_px: Vec<[f64; 2]>,
    /// The crop's corners in pixels.
    pub crop_px: [[f64; 2]; 4],
    /// Of the bare edge, origin at 0.
    pub profiles: [EdgeProfile; 3],
    /// Standard deviation in mm of the Gaussian between the scene and the profiles, besides their bins.
    pub blur_mm: [Estimate; 3],
    /// Places of the edge in mm per channel, as found on `profiles` against the green line.
    pub origin_mm: [Estimate; 3],
    /// Radiance factors of both sides, away from the edge.
    pub light: [Estimate; 3],
    pub dark: [Estimate; 3],
    pub shots: Vec<ShotReport>,
    pub warnings: Vec<Warning>,
}
impl Board {
    pub fn to_px(&self, _x_mm: f64, _y_mm: f64) -> [f64; 2] {
        todo!()
    }
    pub fn to_mm(&self, _x_px: f64, _y_px: f64) -> [f64; 2] {
        todo!()
    }
    /// ρ of both sides from how the scene shows a board of ρ.
    pub fn rho(&self, _seen: &[Seen; 3]) -> Result<[BoardRho; 3], Refusal> {
        todo!()
    }
}
/// apparent = s + a ρ/(1 − b ρ)
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seen {
    pub s: f64,
    pub a: f64,
    pub b: f64,
}
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoardRho {
    pub light: Estimate,
    pub dark: Estimate,
}
/// The edge in use within the crop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EdgeLine {
    pub from_px: [f64; 2],
    pub to_px: [f64; 2],
    /// Against the frame's columns (or rows, whichever is nearer).
    pub angle_deg: Estimate,
    pub dark_side: Side,
    /// Largest departure from a straight line.
    pub bend_px: Estimate,
}
/// Profile of one channel, x rising from dark to light, 0 at the edge.
#[derive(Debug, Clone, PartialEq)]
pub struct EdgeProfile {
    pub colour: Colour,
    pub x_mm: Vec<f64>,
    pub values: Vec<f64>,
    /// Random part, independent in each bin.
    pub std_errors: Vec<f64>,
    pub counts: Vec<u32>,
    /// Share of samples rejected.
    pub rejected: Vec<f64>,
}
#[derive(Debug, Clone)]
pub struct ShotReport {
    pub label: String,
    /// Pixels of samples that were rejected.
    pub rejected_px: Vec<[u32; 2]>,
    /// Movement against the bare shots where it could be told.
    pub moved_px: [Option<Estimate>; 2],
    pub blur_px: Option<Estimate>,
    /// Relative brightness against the mean of all shots, per channel.
    pub brightness: [f64; 3],
    /// This shot alone.
    pub profiles: [EdgeProfile; 3],
}
pub struct Mountings<'a>(&'a Calibration, &'a Board);
impl<'a> Mountings<'a> {
    pub fn new(_calibration: &'a Calibration, _board: &'a Board, _label: &str) -> Self {
        todo!()
    }
    pub fn add(&mut self, _photo: Photo) -> Result<(), Refusal> {
        todo!()
    }
    pub fn finish(self) -> Result<SampleProfile, Refusal> {
        todo!()
    }
}
#[derive(Debug, Clone)]
pub struct SampleProfile {
    pub profiles: [EdgeProfile; 3],
    pub shots: Vec<ShotReport>,
    pub budget: Vec<Contribution>,
    pub warnings: Vec<Warning>,
}
/// Whether one photograph is usable, alone or against a bare shot.
#[derive(Debug, Clone)]
pub struct ShotCheck {
    pub clipped_share: [f64; 3],
    pub brightness_share: [f64; 3],
    pub edge: Option<EdgeLine>,
    pub blur_px: Option<Estimate>,
    pub warnings: Vec<Warning>,
}
/// For `--check`: a single photo, the files' own black level.
pub fn check_shot(_photo: &Photo) -> Result<ShotCheck, Refusal> {
    todo!()
}
