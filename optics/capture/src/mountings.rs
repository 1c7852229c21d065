//! Shots of a sample: checks, profiles, and the budget of their errors.

use crate::bins::{Binning, EdgeProfile, bin};
use crate::board::{Board, Cells, check_blur, check_clipped, check_moved};
use crate::calibration::{Calibration, Radiance};
use crate::estimate::{Contribution, Source};
use crate::frame::{Colour, Photo};
use crate::join::{Joined, join};
use crate::refusal::{Refusal, Warning};
use crate::report::ShotReport;

/// Shots of one sample, each a mounting of its stack on the board.
#[derive(Debug)]
pub struct Mountings<'a> {
    calibration: &'a Calibration,
    board: &'a Board,
    what: String,
    shots: Vec<ShotReport>,
    /// Radiance factor of the frame's mean, per shot.
    means: Vec<[f64; 3]>,
    warnings: Vec<Warning>,
}

/// Profiles of a sample with their errors.
#[derive(Debug, Clone)]
pub struct SampleProfile {
    /// x is 0 where the bare board has the channel's edge; `std_errors` are of noise alone.
    pub profiles: [EdgeProfile; 3],
    pub shots: Vec<ShotReport>,
    /// Errors that are common to many bins, by source, and the mean of the noise.
    pub budget: Vec<Contribution>,
    pub warnings: Vec<Warning>,
}

impl<'a> Mountings<'a> {
    /// `what` names the sample in messages.
    pub fn new(calibration: &'a Calibration, board: &'a Board, what: &str) -> Self {
        let what = what.to_owned();
        Self { calibration, board, what, shots: Vec::new(), means: Vec::new(), warnings: Vec::new() }
    }

    #[expect(clippy::needless_pass_by_value, reason = "all steps take their photographs; others keep them")]
    pub fn add(&mut self, photo: Photo) -> Result<(), Refusal> {
        self.calibration.kind.check(&photo)?;
        let label = &photo.label;
        let found = &self.board.found;
        let free = found.seen.free_parts(self.calibration.view(&photo));
        check_moved(label, &free.moved_px)?;
        check_blur(label, &found.seen, &free.blur_px)?;
        match free.moved_px {
            [None, None] => self.warnings.push(Warning::Unchecked { label: label.clone() }),
            [None, _] => {
                self.warnings.push(Warning::HalfChecked { label: label.clone(), direction: "sideways" });
            }
            [_, None] => {
                self.warnings.push(Warning::HalfChecked { label: label.clone(), direction: "up and down" });
            }
            _ => {}
        }
        let radiance = Radiance::new(self.calibration, &photo);
        self.board.cells.check_covered(label, &Cells::of(&radiance, &found.edge_frame))?;
        let binnings =
            Colour::ALL.map(|c| bin(&radiance, &found.edge_frame, c, self.board.origin_mm[c.index()].value));
        check_clipped(&photo, &binnings, radiance.full)?;
        for binning in &binnings {
            check_thirds(label, binning, self.board)?;
        }
        self.means.push(Colour::ALL.map(|c| radiance.mean(c)));
        let blur_px =
            free.blur_px.iter().flatten().copied().min_by(|a, b| a.std_error.total_cmp(&b.std_error));
        let shot = ShotReport::new(label, free.moved_px, blur_px, binnings);
        if shot.rejected_share() > MANY {
            let share = 100.0 * shot.rejected_share();
            self.warnings.push(Warning::ManyRejected { label: label.clone(), share });
        }
        self.shots.push(shot);
        Ok(())
    }

    pub fn finish(mut self) -> Result<SampleProfile, Refusal> {
        if self.shots.is_empty() {
            return Err(Refusal::Missing { what: "shots of the sample" });
        }
        if self.shots.len() < 2 {
            let count = self.shots.len();
            self.warnings.push(Warning::FewShots { what: self.what.clone(), count });
        }
        let joined = Colour::ALL.map(|c| {
            let each: Vec<&EdgeProfile> = self.shots.iter().map(|s| &s.profiles[c.index()]).collect();
            join(&each)
        });
        let budget = self.budget(&joined);
        let profiles = joined.map(|j| j.profile);
        Ok(SampleProfile { profiles, shots: self.shots, budget, warnings: self.warnings })
    }

    fn budget(&self, joined: &[Joined; 3]) -> Vec<Contribution> {
        let (calibration, board) = (self.calibration, self.board);
        let shots = self.shots.len() as f64;
        let mean = |c: usize| self.means.iter().map(|m| m[c]).sum::<f64>() / shots;
        let between = |c: usize, i: usize| joined[c].between[i] / shots.sqrt();
        let black = |c: usize| {
            let levels = calibration.black().levels().iter();
            levels.map(|l| l.std_error).fold(0.0, f64::max) / calibration.gain[c].value
        };
        let moved = self.unseen_movement_mm();
        let per_channel = |f: &dyn Fn(usize) -> f64| [f(0), f(1), f(2)];
        [
            (Source::Noise, per_channel(&|c| noise(&joined[c].profile))),
            (Source::WhiteReference, [calibration.reference_std_error; 3]),
            (Source::Drift, per_channel(&|c| self.drift(c))),
            (Source::Mounting, per_channel(&|c| between(c, 0))),
            (Source::Linearity, calibration.linearity),
            (Source::Black, per_channel(&|c| black(c).hypot(between(c, 1)))),
            (Source::Glare, per_channel(&|c| calibration.glare[c].std_error * mean(c))),
            (Source::Slope, per_channel(&|c| self.slope(c).hypot(between(c, 2)))),
            (
                Source::Origin,
                per_channel(&|c| board.origin_mm[c].std_error.hypot(between(c, 3)).hypot(moved)),
            ),
            (Source::Scale, [board.mm_per_px.std_error / board.mm_per_px.value; 3]),
            (Source::Blur, per_channel(&|c| board.blur_mm[c].std_error)),
        ]
        .map(|(source, std_error)| Contribution { source, std_error })
        .to_vec()
    }

    /// Of the reference's shots, and of a single shot against them: several tell that by themselves.
    fn drift(&self, c: usize) -> f64 {
        let gain = self.calibration.gain[c];
        let one = self.calibration.light.std_error[c];
        let of_reference = one / (self.calibration.light.shots.max(1) as f64).sqrt();
        let of_shot = if self.shots.len() < 2 { one } else { 0.0 };
        of_reference.hypot(of_shot).hypot(gain.std_error / gain.value)
    }

    /// Of the light across the crop, per 10 mm: what shots of the flat leave open, and what the bare board tells that is
    /// itself even to [`BOARD_SLOPE`].
    fn slope(&self, c: usize) -> f64 {
        let width_mm = self.calibration.kind.width as f64 * self.board.mm_per_px.value;
        let of_flat = self.calibration.flat().slope_std_error()[c] * 10.0 / width_mm;
        let seen = self.board.slope[c];
        let of_board = seen.value.hypot(seen.std_error).hypot(BOARD_SLOPE);
        1.0 / (1.0 / of_flat).hypot(1.0 / of_board)
    }

    /// What may have moved across the edge without being noticed.
    fn unseen_movement_mm(&self) -> f64 {
        let axis = self.board.found.across();
        let of = |s: &ShotReport| s.moved_px[axis].map_or(UNSEEN_PX, |m| m.value.hypot(m.std_error));
        let n = self.shots.len() as f64;
        let mean = (self.shots.iter().map(|s| of(s).powi(2)).sum::<f64>() / n).sqrt();
        mean * self.board.mm_per_px.value
    }
}

/// Relative slope per 10 mm that a printed square may have itself.
const BOARD_SLOPE: f64 = 0.001;

/// Where a movement across the edge cannot be seen, one of this many pixels is allowed for: half of what would refuse.
const UNSEEN_PX: f64 = 0.05;

/// Share of rejected samples that is told.
const MANY: f64 = 0.05;

/// Departure of a third that refuses, as a share of the bare board's contrast; what borders of squares 5 mm away
/// send through a slab stays below.
const THIRDS: f64 = 0.02;

fn noise(profile: &EdgeProfile) -> f64 {
    let known: Vec<f64> = profile.std_errors.iter().copied().filter(|e| e.is_finite()).collect();
    known.iter().sum::<f64>() / known.len().max(1) as f64
}

fn check_thirds(label: &str, binning: &Binning, board: &Board) -> Result<(), Refusal> {
    let colour = binning.profile.colour;
    let c = colour.index();
    let bound = THIRDS * (board.light[c].value - board.dark[c].value);
    let worst = binning.thirds.iter().max_by(|a, b| a.departure.abs().total_cmp(&b.departure.abs()));
    match worst {
        Some(t) if t.departure.abs() > bound && t.departure.abs() > 6.0 * t.std_error => {
            Err(Refusal::ThirdsDisagree {
                label: label.to_owned(),
                colour,
                x_mm: t.x_mm,
                deviation: t.departure,
                z: (t.departure / t.std_error).abs(),
            })
        }
        _ => Ok(()),
    }
}
