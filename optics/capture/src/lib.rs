//! Computes profiles from photographs, on plain arrays, without files, network or clock. A session is processed in steps
//! that take photographs one at a time, so that at most two are in memory: [`Darks`] → [`Flats`] → [`Patches`] →
//! [`BareShots`] → [`HazeShots`], [`Mountings`], one per sample. Each step has `add(photo)`, which checks and may refuse,
//! and `finish()`, whose result the next one uses.
//!
//! `docs/glossary.md` explains the terms.

mod agreement;
mod bins;
mod black;
mod blemishes;
mod blue_cut;
mod blur;
mod board;
mod calibration;
mod camera_settings;
mod check;
mod content;
mod estimate;
mod flat;
mod frame;
mod haze;
mod join;
mod lattice;
mod least_squares;
mod light_field;
mod mountings;
mod noise;
mod one_colour;
mod patches;
mod refusal;
mod report;
mod rho;
mod saturation;
mod sfr;
#[cfg(test)]
mod testing;
mod tiles;
mod view;

pub use bins::{BIN_MM, BINS, EdgeProfile};
pub use black::{Black, Darks};
pub use blue_cut::BlueCutShots;
pub use board::{BareShots, Board};
pub use calibration::{Calibration, PatchReading};
pub use check::{ShotCheck, check_shot, find_edges};
pub use content::{BoardGlance, FrameNumbers, ShotContent, board_subjects, content};
pub use estimate::{Contribution, Estimate, Source};
pub use flat::{Flat, Flats};
pub use frame::{Area, Colour, Exposure, Frame, Levels, Pattern, Photo, Site};
pub use haze::HazeShots;
pub use lattice::{EdgeLine, FreeEdge, Target};
pub use light_field::LightChange;
pub use mountings::{Mountings, SampleProfile};
pub use noise::SiteNoise;
pub use patches::{Neutral, Patches};
pub use refusal::{Correction, Refusal, Side, Warning};
pub use report::ShotReport;
pub use rho::{Appearance, BoardRho};
pub use sfr::EdgeSfr;
