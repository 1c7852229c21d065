//! Checks the shots of a sample, and computes its profiles with their error budget.

use crate::agreement::{self, check_sides};
use crate::bins::{Binning, EdgeProfile, bin_clean};
use crate::blemishes::Blemish;
use crate::board::{Board, check_clipped};
use crate::calibration::{Calibration, Radiance};
use crate::estimate::{Contribution, Estimate, Source};
use crate::frame::{Colour, Photo};
use crate::join::{Joined, Turned, join};
use crate::lattice::{BOARD_SLOPE, CropCells, FreeParts, PatchRadiance, light, movement};
use crate::least_squares::finite_mean;
use crate::light_field::LightChange;
use crate::refusal::{Correction, Refusal, Warning};
use crate::report::ShotReport;

/// Accumulates the shots of one sample, each a mounting of its stack on the board.
#[derive(Debug)]
pub struct Mountings<'a> {
    calibration: &'a Calibration,
    board: &'a Board,
    what: String,
    shots: Vec<ShotReport>,
    /// Radiance factor of the frame's mean, per shot.
    means: Vec<Vec<f64>>,
    /// Refusals of the shots that are left out.
    left_out: Vec<Refusal>,
    warnings: Vec<Warning>,
}

/// Profiles of a sample with their errors.
#[derive(Debug, Clone)]
pub struct SampleProfile {
    /// One for each column. x is 0 at its edge on the bare board; `std_errors` are due to noise alone.
    pub profiles: Vec<EdgeProfile>,
    pub shots: Vec<ShotReport>,
    /// Errors that are common to many bins, by source, and the mean of the noise.
    pub budget: Vec<Contribution>,
    pub warnings: Vec<Warning>,
}

impl<'a> Mountings<'a> {
    /// `what` names the sample in messages.
    pub fn new(calibration: &'a Calibration, board: &'a Board, what: &str) -> Self {
        let what = what.to_owned();
        let (shots, means, left_out, warnings) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        Self { calibration, board, what, shots, means, left_out, warnings }
    }

    #[expect(clippy::needless_pass_by_value, reason = "all steps take their photographs; others keep them")]
    pub fn add(&mut self, photo: Photo) -> Result<(), Refusal> {
        self.calibration.settings.check(&photo)?;
        let label = &photo.label;
        let found = &self.board.found;
        let free = found.seen.free_parts(self.calibration.view(&photo), &found.edge_frame);
        movement::check(label, &free.moved_px)?;
        movement::check_blur(label, &found.seen, &free.blur_px)?;
        let radiance = Radiance::new(self.calibration, &photo);
        let light = self.light(&free, &radiance);
        self.warn(&photo, &free, light.as_deref());
        let light_factor = light.clone();
        let light = light.unwrap_or_else(|| vec![LightChange::default(); photo.frame.columns().len()]);
        light::check(&photo, &light)?;
        let radiance = radiance.under(&light, &self.board.fields, found.edge_frame.plane());
        self.board.cells.check_covered(label, &CropCells::of(&radiance, &found.edge_frame))?;
        let (binnings, blemishes) = bin_clean(&radiance, &found.edge_frame, &self.board.origin_mm);
        check_clipped(&photo, &binnings, radiance.full)?;
        if let Some(refusal) = binnings.iter().find_map(|binning| self.check_thirds(label, binning).err()) {
            self.left_out.push(refusal);
            return Ok(());
        }
        self.warn_of_blemishes(label, &binnings, &blemishes);
        let means = radiance.means();
        let blur_px =
            free.blur_px.iter().flatten().copied().min_by(|a, b| a.std_error.total_cmp(&b.std_error));
        let masked: usize = binnings.iter().map(|b| b.masked).sum();
        let shot = ShotReport::new(label, free.moved_px, light_factor, blur_px, binnings);
        // Masked samples have a warning of their own.
        let single = 1.0 - masked as f64 / shot.rejected_px.len().max(1) as f64;
        if single * shot.rejected_share() > MANY {
            let share = 100.0 * single * shot.rejected_share();
            self.warnings.push(Warning::ManyRejected { label: label.clone(), share });
        }
        match check_sides(&shot, self.board) {
            Ok(()) => {
                self.shots.push(shot);
                self.means.push(means);
            }
            Err(refusal) => self.left_out.push(refusal),
        }
        Ok(())
    }

    /// Light of the free board relative to the bare shots. None if the edge in the crop looks free as well: it lies under
    /// a slab, which may only dim, and so may the other parts of the board.
    fn light(&self, free: &FreeParts, radiance: &Radiance<'_>) -> Option<Vec<LightChange>> {
        let edge = &self.board.found.edge_frame;
        let patches: Vec<PatchRadiance> =
            self.board.found.seen.patches().map(|p| p.read(radiance, edge)).collect();
        let is_free = free.free.as_deref()?;
        let light = light::changes(&self.board.readings, &patches, is_free)?;
        let changed =
            |l: &LightChange| (l.factor.value - 1.0).abs() > NOTED || l.offset.value.abs() > NOTED_OFFSET;
        let in_crop = || patches.iter().zip(is_free).filter(|(patch, _)| patch.is_in_crop());
        let covered = in_crop().filter(|(_, is_free)| !**is_free).count();
        let same = light.iter().any(changed) && 2 * covered < in_crop().count();
        (!same).then_some(light)
    }

    fn warn(&mut self, photo: &Photo, free: &FreeParts, light: Option<&[LightChange]>) {
        let label = photo.label.clone();
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
        let Some(light) = light else {
            if free.moved_px != [None, None] {
                self.warnings.push(Warning::LightUnchecked { label });
            }
            return;
        };
        let factor = |l: &LightChange| Estimate::new(l.factor.value - 1.0, l.factor.std_error);
        for (change, (colour, most), noted) in [
            (Correction::Factor, light::largest(photo, light, factor), NOTED),
            (Correction::Offset, light::largest(photo, light, |l| l.offset), NOTED_OFFSET),
            (Correction::Slope, light::largest(photo, light, LightChange::steepest), NOTED),
        ] {
            if most.value.abs() > noted {
                self.note_change(&label, change, colour, 100.0 * most.value);
            }
        }
    }

    /// One warning for all shots with the same change, with the largest of them.
    fn note_change(&mut self, label: &str, what: Correction, colour: Colour, percent: f64) {
        let same = self.warnings.iter_mut().find_map(|warning| match warning {
            Warning::LightCorrected { labels, change, colour, percent } if *change == what => {
                Some((labels, colour, percent))
            }
            _ => None,
        });
        if let Some((labels, old_colour, old_percent)) = same {
            labels.push_str(&format!(", {label}"));
            if percent.abs() > old_percent.abs() {
                (*old_colour, *old_percent) = (colour, percent);
            }
        } else {
            let labels = label.to_owned();
            self.warnings.push(Warning::LightCorrected { labels, change: what, colour, percent });
        }
    }

    fn warn_of_blemishes(&mut self, label: &str, binnings: &[Binning], blemishes: &[Blemish]) {
        let masked: usize = binnings.iter().map(|b| b.masked).sum();
        let total: u32 = binnings.iter().flat_map(|b| &b.profile.counts).sum();
        let share = masked as f64 / (masked as f64 + f64::from(total)).max(1.0);
        let largest = blemishes.iter().max_by(|a, b| a.area_mm2.total_cmp(&b.area_mm2));
        if let Some(largest) = largest.filter(|_| share > MASKED) {
            let [x_mm, _] = self.board.to_mm(largest.at_px[0], largest.at_px[1]);
            let (label, share, area_mm2) = (label.to_owned(), 100.0 * share, largest.area_mm2);
            self.warnings.push(Warning::Masked { label, count: blemishes.len(), share, area_mm2, x_mm });
        }
    }

    fn check_thirds(&self, label: &str, binning: &Binning) -> Result<(), Refusal> {
        let colour = binning.profile.colour;
        let c = colour.index();
        let bound = THIRDS * (self.board.light[c].value - self.board.dark[c].value);
        let worst = binning.thirds.iter().max_by(|a, b| a.departure.abs().total_cmp(&b.departure.abs()));
        match worst {
            Some(t) if t.departure.abs() > bound && t.departure.abs() > 6.0 * t.std_error => {
                Err(Refusal::ThirdsDisagree {
                    label: label.to_owned(),
                    colour,
                    x_mm: t.x_mm,
                    deviation: t.departure,
                    z: (t.departure / t.std_error).abs(),
                    advice: if self.calibration.flat().is_missing() {
                        "uneven light is a likely cause, since there are no flat shots: add them; or look"
                    } else {
                        "look"
                    },
                })
            }
            _ => Ok(()),
        }
    }

    pub fn finish(mut self) -> Result<SampleProfile, Refusal> {
        for (index, refusal) in agreement::leave_out(&mut self.shots, self.board)? {
            self.means.remove(index);
            self.left_out.push(refusal);
        }
        if self.shots.len() < agreement::LEAST && !self.left_out.is_empty() {
            return Err(self.left_out.swap_remove(0));
        }
        if self.shots.is_empty() {
            return Err(Refusal::Missing { what: "shots of the sample" });
        }
        let left_out = self.left_out.drain(..).map(|why| Warning::LeftOut { why: Box::new(why) });
        self.warnings.extend(left_out);
        if self.shots.len() < 2 {
            let count = self.shots.len();
            self.warnings.push(Warning::FewShots { what: self.what.clone(), count });
        }
        let joined = self.joined();
        let budget = self.budget(&joined);
        let profiles = joined.into_iter().map(|j| j.profile).collect();
        Ok(SampleProfile { profiles, shots: self.shots, budget, warnings: self.warnings })
    }

    /// The mean of all shots, or of those of a wedge on one side and turned by 180°.
    fn joined(&mut self) -> Vec<Joined> {
        let shot_profiles =
            |c: usize| self.shots.iter().map(|s| &s.profiles[c]).collect::<Vec<&EdgeProfile>>();
        let each = self.calibration.each(shot_profiles);
        let joined: Vec<Joined> = each.iter().map(|profiles| join(profiles)).collect();
        // A slab has one wedge: the mean of the channels.
        let slope = |shot: usize| {
            let slopes = joined.iter().map(|j| &j.slopes[shot]);
            let mean = |f: fn(&Estimate) -> f64| slopes.clone().map(f).sum::<f64>() / joined.len() as f64;
            Estimate::new(mean(|s| s.value), mean(|s| s.std_error))
        };
        let Some(turned) = Turned::find(&(0..self.shots.len()).map(slope).collect::<Vec<_>>()) else {
            return joined;
        };
        let joined = each.iter().map(|profiles| turned.join(profiles)).collect();
        let rising = self.shots.iter().zip(&turned.rises).filter(|(_, rises)| **rises);
        let labels = rising.map(|(shot, _)| shot.label.clone()).collect::<Vec<_>>().join(", ");
        self.warnings.push(Warning::Turned { labels, percent: 100.0 * turned.slope });
        joined
    }

    fn budget(&self, joined: &[Joined]) -> Vec<Contribution> {
        let (calibration, board) = (self.calibration, self.board);
        let shots = self.shots.len() as f64;
        let mean = |c: usize| self.means.iter().map(|m| m[c]).sum::<f64>() / shots;
        let between = |c: usize, i: usize| joined[c].between[i] / shots.sqrt();
        let moved = self.unseen_movement_mm();
        let per_channel = |f: &dyn Fn(usize) -> f64| calibration.each(f);
        [
            (Source::Noise, per_channel(&|c| finite_mean(&joined[c].profile.std_errors))),
            (Source::WhiteReference, per_channel(&|_| calibration.reference_std_error)),
            (Source::Drift, per_channel(&|c| self.drift(c))),
            (Source::Mounting, per_channel(&|c| between(c, 0))),
            (Source::Linearity, calibration.linearity.clone()),
            (Source::Black, per_channel(&|c| self.offset(c, between(c, 1)))),
            (Source::Glare, per_channel(&|c| calibration.glare[c].std_error * mean(c))),
            (Source::Slope, per_channel(&|c| self.slope(c, between(c, 2)))),
            (
                Source::Origin,
                per_channel(&|c| {
                    libm::hypot(libm::hypot(board.origin_mm[c].std_error, between(c, 3)), moved)
                }),
            ),
            (Source::Scale, per_channel(&|_| board.mm_per_px.std_error / board.mm_per_px.value)),
            (Source::Blur, per_channel(&|c| board.blur_mm[c].std_error)),
        ]
        .map(|(source, std_error)| Contribution { source, std_error })
        .to_vec()
    }

    /// Drift error of the reference's shots, and of the sample's shots against them. With several shots, the drift of a
    /// shot whose light was not measured is contained in their scatter.
    fn drift(&self, c: usize) -> f64 {
        let gain = self.calibration.gain[c];
        let one = self.calibration.light.std_error[c];
        let light = &self.calibration.light;
        // Without times every shot may have the light of any.
        let averaged = if light.at.is_empty() { 1.0 } else { light.shots.max(1) as f64 };
        let reference_error = one / averaged.sqrt();
        let shots_error = self.shots.iter().map(|shot| match &shot.light {
            Some(light) => light[c].factor.std_error / light[c].factor.value,
            None if self.shots.len() < 2 => one,
            None => 0.0,
        });
        let shots_error = shots_error.fold(0.0, libm::hypot) / self.shots.len() as f64;
        let compared = self.shots.iter().any(|shot| shot.light.is_some());
        let bare_error = if compared { self.board.light_errors[c].factor } else { 0.0 };
        libm::hypot(
            libm::hypot(libm::hypot(reference_error, shots_error), bare_error),
            gain.std_error / gain.value,
        )
    }

    /// Error of the mean of all shots by an error of the light of each; of a single shot whose light is not known, the one
    /// given. Several such shots show it by their scatter.
    fn mean_error(&self, c: usize, error: impl Fn(&LightChange) -> f64, unknown: f64) -> f64 {
        let squares = self.shots.iter().map(|shot| match &shot.light {
            Some(light) => error(&light[c]).powi(2),
            None if self.shots.len() < 2 => unknown * unknown,
            None => 0.0,
        });
        squares.sum::<f64>().sqrt() / self.shots.len() as f64
    }

    /// Error of an offset: of black level and shots, and of the bare shots.
    fn offset(&self, c: usize, between: f64) -> f64 {
        let black = self.calibration.black().std_error() / self.calibration.gain[c].value;
        let shots_error = self.mean_error(c, |light| light.offset.std_error, NOTED_OFFSET);
        [black, between, shots_error, self.board.light_errors[c].offset].into_iter().fold(0.0, libm::hypot)
    }

    /// Error of the slope of the light across the crop, per 10 mm: that of the flat and of lamps that turn after it,
    /// together with that of the bare board, whose own reflectance is even to [`BOARD_SLOPE`]; where these contradict
    /// each other, that of the board alone.
    fn slope(&self, c: usize, between: f64) -> f64 {
        let width_mm = self.calibration.settings.width as f64 * self.board.mm_per_px.value;
        let flat_error =
            libm::hypot(self.calibration.flat().slope_std_error(c) * 10.0 / width_mm, light::SLOPE);
        let (seen, field) = (self.board.slope[c], self.board.fields[c]);
        let error = libm::hypot(seen.std_error, BOARD_SLOPE);
        let departs_from = |other: f64| seen.value.abs() > 3.0 * libm::hypot(error, other);
        let crop_error = libm::hypot(seen.value, error);
        let field_error = field.slope_std_error;
        let board_error = if departs_from(field_error) { crop_error } else { crop_error.min(field_error) };
        let contradict = !field.is_even() || departs_from(flat_error);
        let common =
            if contradict { board_error } else { 1.0 / libm::hypot(1.0 / flat_error, 1.0 / board_error) };
        let shots_error = self.mean_error(c, |light| light.slope[0].std_error, light::SLOPE);
        [common, between, shots_error, self.board.light_errors[c].slope].into_iter().fold(0.0, libm::hypot)
    }

    /// Movement across the edge that may have remained undetected.
    fn unseen_movement_mm(&self) -> f64 {
        let axis = self.board.found.across();
        let movement_px =
            |s: &ShotReport| s.moved_px[axis].map_or(UNSEEN_PX, |m| libm::hypot(m.value, m.std_error));
        let n = self.shots.len() as f64;
        let mean = (self.shots.iter().map(|s| movement_px(s).powi(2)).sum::<f64>() / n).sqrt();
        mean * self.board.mm_per_px.value
    }
}

/// Standard error of a movement across the edge that cannot be measured, in pixels: half the bound for refusal.
const UNSEEN_PX: f64 = 0.05;

/// Relative change of the light, and its slope per 10 mm, above which a warning reports that it is divided out; and the
/// offset above which one reports that it is subtracted.
const NOTED: f64 = 0.005;
const NOTED_OFFSET: f64 = 0.001;

/// Share of masked samples above which a warning is given.
const MASKED: f64 = 1e-3;

/// Share of rejected samples above which a warning is given.
const MANY: f64 = 0.05;

/// Deviation of a third above which a shot is refused, as a share of the bare board's contrast. Light that borders of
/// squares 5 mm away send through a slab stays below it.
const THIRDS: f64 = 0.02;
