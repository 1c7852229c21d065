//! Measures fluorescence: the red and green light of a slab that ends where no blue light falls on it.

use crate::bins::{EdgeProfile, bin_clean};
use crate::board::{Board, check_clipped};
use crate::calibration::{Calibration, Radiance};
use crate::estimate::Estimate;
use crate::frame::Photo;
use crate::lattice::{PatchRadiance, light, movement};
use crate::least_squares::robust_mean;
use crate::light_field::LightChange;
use crate::mountings::SampleProfile;
use crate::refusal::Refusal;

/// Least value of which a share is taken, and least number of bins that have it.
const LEAST: f64 = 0.02;
const FEWEST: usize = 20;
/// Part of the blue light that may be left.
const LEFT: f64 = 0.4;
/// Standard error of red and of green by the filter, which changes the spectrum within their bands; that of green has this
/// share of the difference between the slab's blue and green.
const FILTER: [f64; 2] = [0.002, 0.01];
const FILTER_BY_SLOPE: f64 = 0.15;
/// Standard errors by which red may be brighter without blue.
const BRIGHTER: f64 = 4.0;

/// Accumulates shots of a slab whose lamps have a filter that blocks blue.
#[derive(Debug)]
pub struct BlueCutShots<'a> {
    calibration: &'a Calibration,
    board: &'a Board,
    whole: &'a SampleProfile,
    /// Share of the light that blue has excited, of each shot in red and green; None where the slab is too dark.
    shares: Vec<[Option<Estimate>; 2]>,
    label: String,
}

impl<'a> BlueCutShots<'a> {
    /// `whole` is the slab under all the light.
    pub fn new(calibration: &'a Calibration, board: &'a Board, whole: &'a SampleProfile) -> Self {
        Self { calibration, board, whole, shares: Vec::new(), label: String::new() }
    }

    /// The free board in the same shot shows the lamps' light in each colour.
    #[expect(clippy::needless_pass_by_value, reason = "all steps take their photographs; others keep them")]
    pub fn add(&mut self, photo: Photo) -> Result<(), Refusal> {
        self.calibration.settings.check(&photo)?;
        let label = &photo.label;
        let found = &self.board.found;
        let free = found.seen.free_parts(self.calibration.view(&photo), &found.edge_frame);
        movement::check(label, &free.moved_px)?;
        let radiance = Radiance::new(self.calibration, &photo);
        let patches: Vec<PatchRadiance> =
            found.seen.patches().map(|p| p.read(&radiance, &found.edge_frame)).collect();
        let refused = |seen: String| Refusal::NoBlueCut { label: label.clone(), seen };
        let no_board = || refused("no part of the board is free of the slab".to_owned());
        let free = free.free.as_deref().ok_or_else(no_board)?;
        // Where no blue is left, its factor cannot be measured.
        let change = |c: usize| light::change(&self.board.readings, &patches, free, c);
        let (red, green) = change(0).zip(change(1)).ok_or_else(no_board)?;
        let (blue, whole) = (change(2).map_or(0.0, |blue| blue.factor.value), green.factor.value);
        if blue > LEFT * whole {
            let (percent, allowed) = (100.0 * blue / whole, 100.0 * LEFT);
            let seen =
                format!("{percent:.0} % of the blue light are left, against green, {allowed} % are allowed");
            return Err(refused(seen));
        }
        // The rest of blue is not used.
        let lamps = [red, green, LightChange::default()];
        let radiance = radiance.under(&lamps, &self.board.fields, found.edge_frame.plane());
        let (binnings, _) = bin_clean(&radiance, &found.edge_frame, &self.board.origin_mm);
        check_clipped(&photo, &binnings[..2], radiance.full)?;
        let share = |c: usize| {
            let Estimate { value, std_error } = excited(&self.whole.profiles[c], &binnings[c].profile)?;
            Some(Estimate::new(
                value,
                libm::hypot(std_error, lamps[c].factor.std_error / lamps[c].factor.value),
            ))
        };
        self.shares.push([share(0), share(1)]);
        self.label.clone_from(label);
        Ok(())
    }

    /// Share of red and of green light that blue has excited, None where the slab is too dark. Shots under all the light
    /// scatter by their mountings.
    pub fn finish(self) -> Result<[Option<Estimate>; 2], Refusal> {
        if self.shares.is_empty() {
            return Err(Refusal::Missing { what: "shots of the slab without blue light" });
        }
        let found = [0, 1].map(|c| self.share(c));
        if let Some(red) = found[0].filter(|red| red.value < -BRIGHTER * red.std_error) {
            return Err(Refusal::BrighterWithoutBlue { label: self.label, percent: -100.0 * red.value });
        }
        Ok(found)
    }

    fn share(&self, c: usize) -> Option<Estimate> {
        let shares: Vec<Estimate> = self.shares.iter().map(|shares| shares[c]).collect::<Option<_>>()?;
        let n = shares.len() as f64;
        let mean = |value: &dyn Fn(&Estimate) -> f64| shares.iter().map(value).sum::<f64>() / n;
        let value = mean(&|share| share.value);
        let noise = mean(&|share| share.std_error.powi(2)) / n;
        let scatter = mean(&|share| (share.value - value).powi(2)) / n;
        let own = self.whole.shots.iter().filter_map(|s| excited(&self.whole.profiles[c], &s.profiles[c]));
        let own: Vec<f64> = own.map(|share| share.value.powi(2)).collect();
        let of_mounting = own.iter().sum::<f64>() / own.len().max(1) as f64;
        let level = |c: usize| robust_mean(&self.whole.profiles[c].values).0;
        let slope = if c == 1 { FILTER_BY_SLOPE * (1.0 - level(2) / level(1)) } else { 0.0 };
        let of_filter = FILTER[c].powi(2) + slope * slope;
        Some(Estimate::new(value, (noise + scatter + of_mounting + of_filter).sqrt()))
    }
}

/// The share of a profile's light that another lacks, with the error of the mean over bins; None of a dark one.
fn excited(whole: &EdgeProfile, cut: &EdgeProfile) -> Option<Estimate> {
    let pairs = whole.values.iter().zip(&cut.values).filter(|(v, cut)| **v > LEAST && cut.is_finite());
    let shares: Vec<f64> = pairs.map(|(whole, cut)| 1.0 - cut / whole).collect();
    let (value, std_error) = robust_mean(&shares);
    (shares.len() >= FEWEST).then(|| Estimate::new(value, std_error))
}
