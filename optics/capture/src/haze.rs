//! Measures the light that slip, gel and camera add to every place, from shots of them over a light trap.

use crate::board::Board;
use crate::calibration::{Calibration, Radiance};
use crate::estimate::Estimate;
use crate::frame::Photo;
use crate::lattice::CropCells;
use crate::refusal::Refusal;

/// Radiance factor above which no light trap lies in the crop; less where the board's dark side is darker.
const NOT_DARK: f64 = 0.015;
/// Standard error of the trap's own light: a box lined with velvet returns about as much, and one that is less black shows
/// as a haze, of which this share is uncertain.
const TRAP: f64 = 5e-4;
const TRAP_OF_HAZE: f64 = 0.2;

/// Accumulates shots of slip and gel over a light trap, in the place of the board.
#[derive(Debug)]
pub struct HazeShots<'a> {
    calibration: &'a Calibration,
    board: &'a Board,
    /// Radiance factors of each shot and channel, with the errors of black level and glare.
    levels: Vec<Estimate>,
}

impl<'a> HazeShots<'a> {
    pub fn new(calibration: &'a Calibration, board: &'a Board) -> Self {
        Self { calibration, board, levels: Vec::new() }
    }

    #[expect(clippy::needless_pass_by_value, reason = "all steps take their photographs; others keep them")]
    pub fn add(&mut self, photo: Photo) -> Result<(), Refusal> {
        let calibration = self.calibration;
        calibration.settings.check(&photo)?;
        let radiance = Radiance::new(calibration, &photo);
        let levels = CropCells::of(&radiance, &self.board.found.edge_frame).levels();
        let means = radiance.means();
        for (colour, level) in photo.frame.columns().iter().copied().zip(levels) {
            let c = colour.index();
            let allowed = NOT_DARK.min(0.6 * self.board.dark[c].value.max(0.01));
            if level.value > allowed {
                let (percent, allowed) = (100.0 * level.value, 100.0 * allowed);
                return Err(Refusal::NoTrap { label: photo.label.clone(), colour, percent, allowed });
            }
            let black = calibration.black().std_error() / calibration.gain[c].value;
            // The stray light of slabs is that of a frame with the board, whose share is as uncertain for all of them.
            let glare = calibration.glare[c].std_error * means[c].max(self.board.frame_mean[c]);
            let errors = [level.std_error, black, glare];
            let std_error = errors.iter().map(|e| e * e).sum::<f64>().sqrt();
            self.levels.push(Estimate::new(level.value, std_error));
        }
        Ok(())
    }

    /// The mean radiance factor. Errors of black level and glare are common to all shots; the scatter between shots and
    /// channels counts as one of the mean.
    pub fn finish(self) -> Result<Estimate, Refusal> {
        let n = self.levels.len() as f64;
        if self.levels.is_empty() {
            return Err(Refusal::Missing { what: "shots of slip and gel over a light trap" });
        }
        let mean = |value: fn(&Estimate) -> f64| self.levels.iter().map(value).sum::<f64>() / n;
        let value = mean(|level| level.value);
        let scatter = self.levels.iter().map(|level| (level.value - value).powi(2)).sum::<f64>() / n;
        let squares =
            mean(|level| level.std_error.powi(2)) + scatter + TRAP * TRAP + (TRAP_OF_HAZE * value).powi(2);
        Ok(Estimate::new(value, squares.sqrt()))
    }
}
