//! The results of a session's photographs, in parts: one for red, green and blue, or one for each band.

use optics_capture::{Board, BoardRho, Calibration, SampleProfile};

use super::bands::Band;
use super::session_file::{CaptureSession, Sample};
use super::shots::Input;
use super::strip::Strip;
use crate::photograph::About;

/// All results of a session's photographs.
#[derive(Debug)]
pub struct Captured {
    pub session: CaptureSession,
    /// One for each band, or one for red, green and blue.
    pub parts: Vec<CapturedPart>,
    /// All photographs, in the order of their use.
    pub inputs: Vec<Input>,
}

/// The results of red, green and blue, or of one band.
#[derive(Debug)]
pub struct CapturedPart {
    /// None for red, green and blue.
    pub band: Option<Band>,
    /// Camera and exposure of its first photograph.
    pub about: About,
    pub calibration: Calibration,
    pub board: Board,
    pub rho: [BoardRho; 3],
    pub samples: Vec<CapturedSample>,
}

#[derive(Debug)]
pub struct CapturedSample {
    pub about: Sample,
    pub profile: SampleProfile,
    /// None of bands.
    pub strip: Option<Strip>,
}
