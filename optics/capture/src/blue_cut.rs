//! Measures fluorescence: the red and green light of a slab that ends where no blue light falls on it.

use crate::bins::{EdgeProfile, bin_clean};
use crate::board::Board;
use crate::calibration::{Calibration, Radiance};
use crate::estimate::Estimate;
use crate::frame::Photo;
use crate::lattice::{PatchRadiance, light, movement};
use crate::least_squares::robust_mean;
use crate::mountings::SampleProfile;
use crate::refusal::Refusal;

/// Least value of which a share is taken.
const LEAST: f64 = 0.02;
/// Part of the blue light that may be left.
const LEFT: f64 = 0.2;
/// Standard error of red and of green by the filter, which changes the spectrum within their bands.
const FILTER: [f64; 2] = [0.002, 0.01];

/// Accumulates shots of a slab whose lamps have a filter that blocks blue.
#[derive(Debug)]
pub struct BlueCutShots<'a> {
    calibration: &'a Calibration,
    board: &'a Board,
    whole: &'a SampleProfile,
    /// Share of the light that blue has excited, of each shot in red and green.
    shares: Vec<[Estimate; 2]>,
}

impl<'a> BlueCutShots<'a> {
    /// `whole` is the slab under all the light.
    pub fn new(calibration: &'a Calibration, board: &'a Board, whole: &'a SampleProfile) -> Self {
        Self { calibration, board, whole, shares: Vec::new() }
    }

    /// The free board in the same shot shows the lamps' light in each colour.
    #[expect(clippy::needless_pass_by_value, reason = "all steps take their photographs; others keep them")]
    pub fn add(&mut self, photo: Photo) -> Result<(), Refusal> {
        self.calibration.settings.check(&photo)?;
        let label = &photo.label;
        let found = &self.board.found;
        let free = found.seen.free_parts(self.calibration.view(&photo));
        movement::check(label, &free.moved_px)?;
        let radiance = Radiance::new(self.calibration, &photo);
        let patches: Vec<PatchRadiance> = found.seen.patches().map(|p| p.read(&radiance)).collect();
        let lamps = free.free.as_deref().and_then(|free| light::factor(&self.board.readings, &patches, free));
        let refused = |seen: String| Refusal::NoBlueCut { label: label.clone(), seen };
        let lamps = lamps.ok_or_else(|| refused("no part of the board is free of the slab".to_owned()))?;
        let [red, green, blue] = lamps;
        if blue.value > LEFT * green.value {
            let percent = 100.0 * blue.value / green.value;
            return Err(refused(format!("{percent:.0} % of the blue light are left, against green")));
        }
        // The rest of blue is not used.
        let radiance = radiance.under(&[red, green, Estimate::new(1.0, 0.0)]);
        let (binnings, _) = bin_clean(&radiance, &found.edge_frame, self.board.origin_mm.map(|o| o.value));
        let share = |c: usize| {
            let Estimate { value, std_error } = excited(&self.whole.profiles[c], &binnings[c].profile);
            Estimate::new(value, libm::hypot(std_error, lamps[c].std_error / lamps[c].value))
        };
        self.shares.push([share(0), share(1)]);
        Ok(())
    }

    /// Share of red and of green light that blue has excited; shots under all the light scatter by their mountings.
    pub fn finish(self) -> Result<[Estimate; 2], Refusal> {
        if self.shares.is_empty() {
            return Err(Refusal::Missing { what: "shots of the slab without blue light" });
        }
        let n = self.shares.len() as f64;
        Ok([0, 1].map(|c| {
            let mean = |value: &dyn Fn(&Estimate) -> f64| {
                self.shares.iter().map(|share| value(&share[c])).sum::<f64>() / n
            };
            let value = mean(&|share| share.value);
            let noise = mean(&|share| share.std_error.powi(2)) / n;
            let scatter = mean(&|share| (share.value - value).powi(2)) / n;
            let own: Vec<Estimate> =
                self.whole.shots.iter().map(|s| excited(&self.whole.profiles[c], &s.profiles[c])).collect();
            let of_mounting =
                own.iter().map(|share| share.value.powi(2)).sum::<f64>() / own.len().max(1) as f64;
            Estimate::new(value, (noise + scatter + of_mounting + FILTER[c].powi(2)).sqrt())
        }))
    }
}

/// The share of a profile's light that another lacks, with the error of the mean over bins.
fn excited(whole: &EdgeProfile, cut: &EdgeProfile) -> Estimate {
    let pairs = whole.values.iter().zip(&cut.values).filter(|(v, cut)| **v > LEAST && cut.is_finite());
    let shares: Vec<f64> = pairs.map(|(whole, cut)| 1.0 - cut / whole).collect();
    let (value, std_error) = robust_mean(&shares);
    Estimate::new(value, std_error)
}
