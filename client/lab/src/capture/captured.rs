//! The results of a session's photographs, in parts: one for red, green and blue, or one for each band.

use std::path::Path;

use farm_figures::numbers::with_error;
use optics_capture::{Board, BoardRho, Calibration, Estimate, SampleProfile, Warning};

use super::bands::Band;
use super::session_file::{CaptureSession, Sample};
use super::shots::Input;
use super::strip::Strip;
use crate::measurement_file::Note;
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
    pub rho: Vec<BoardRho>,
    /// Radiance factor that slip, gel and camera add everywhere; None without shots over a light trap.
    pub haze: Option<Estimate>,
    /// Factor on ρ of the light side; None without shots of the board under slip and gel.
    pub light_side: Option<Estimate>,
    pub samples: Vec<CapturedSample>,
}

#[derive(Debug)]
pub struct CapturedSample {
    pub about: Sample,
    pub profile: SampleProfile,
    /// Share of red and of green light that blue excites; None without shots of it.
    pub fluorescence: Option<[Option<Estimate>; 2]>,
    /// None of bands.
    pub strip: Option<Strip>,
}

impl Captured {
    /// All warnings: about the session's numbers, the set-up, the samples, and the profiles as they are read back from their
    /// file.
    pub fn warnings(&self, file: &Path, notes: &[Note]) -> Vec<String> {
        self.texts(file, notes, |_| true)
    }

    /// Warnings after which something may have to be done, and the number of photographs with masked specks.
    pub fn findings(&self, file: &Path, notes: &[Note]) -> (Vec<String>, usize) {
        let samples = self.parts.iter().flat_map(|part| &part.samples);
        let masked = samples.flat_map(|sample| &sample.profile.warnings).filter(|w| w.is_note()).count();
        (self.texts(file, notes, |warning| !warning.is_note()), masked)
    }

    fn texts(&self, file: &Path, notes: &[Note], is_shown: impl Fn(&Warning) -> bool) -> Vec<String> {
        let parts = self.parts.iter().flat_map(|part| part.warnings(&is_shown));
        let notes = notes.iter().map(|note| format!("{}: {}", file.display(), note.text));
        self.session.doubts.iter().cloned().chain(parts).chain(notes).collect()
    }
}

impl CapturedPart {
    /// The results of further shots of the session.
    pub fn further(&self) -> Vec<String> {
        let percent = |e: Estimate| format!("{} %", with_error(100.0 * e.value, 100.0 * e.std_error));
        let haze = self.haze.map(|haze| format!("haze {} of white", percent(haze)));
        let light =
            self.light_side.map(|factor| format!("light side in gel {} of its dry ρ", percent(factor)));
        let samples = self.samples.iter().filter_map(|sample| {
            let [red, green] = sample.fluorescence?.map(|e| e.map_or("too dark".to_owned(), percent));
            Some(format!("excited by blue in {}: red {red}, green {green}", sample.about.label()))
        });
        haze.into_iter().chain(light).chain(samples).collect()
    }

    /// Warnings about a part: those of a band begin with its name.
    fn warnings(&self, is_shown: impl Fn(&Warning) -> bool) -> Vec<String> {
        let set_up = self.calibration.warnings.iter().chain(&self.board.warnings).map(ToString::to_string);
        let samples = self.samples.iter().flat_map(|sample| {
            sample.profile.warnings.iter().filter(|w| is_shown(w)).map(|w| {
                let (text, label) = (w.to_string(), sample.about.label());
                if text.starts_with(&label) { text } else { format!("{label}: {text}") }
            })
        });
        let band_text = |text: String| match &self.band {
            Some(band) => format!("band {}: {text}", band.name),
            None => text,
        };
        set_up.chain(samples).map(band_text).collect()
    }
}
