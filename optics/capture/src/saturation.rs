//! Finds the numbers at which a sensor saturates.

use rayon::prelude::*;

use crate::frame::{Colour, Frame, Photo, Site};

/// Share of clipped samples above which a shot is refused: a sensor has fewer defective pixels.
pub(crate) const CLIPPED: f64 = 1e-3;

/// Numbers at and above which samples of each site are clipped.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Saturation([f64; 4]);

impl Saturation {
    pub fn all(level: f64) -> Self {
        Self([level; 4])
    }

    pub fn is_at(self, frame: &Frame, site: Site, x: usize, y: usize) -> bool {
        self.holds(site, f64::from(frame.at(site, x, y)))
    }

    pub fn holds(self, site: Site, number: f64) -> bool {
        number >= self.of(site)
    }

    pub fn of(self, site: Site) -> f64 {
        self.0[site.position]
    }

    /// The lowest of a colour's sites.
    pub fn of_colour(self, frame: &Frame, colour: Colour) -> f64 {
        frame.sites_of(colour).into_iter().map(|site| self.of(site)).fold(f64::INFINITY, f64::min)
    }
}

/// The lower one of the file's white level and the level at which samples pile up. A saturated sensor piles samples up
/// at the highest numbers that occur; raw converters may scale the colours, so that each has its own level.
pub(crate) fn saturation(photo: &Photo) -> Saturation {
    let white = photo.levels.white.unwrap_or([f64::from(u16::MAX); 4]);
    let mut full = Saturation(white);
    let sites = photo.frame.sites();
    let found: Vec<f64> = sites.par_iter().map(|site| shown(&counts(&photo.frame, *site))).collect();
    for (site, shown) in sites.iter().zip(found) {
        full.0[site.position] = full.0[site.position].min(shown);
    }
    full
}

fn counts(frame: &Frame, site: Site) -> Vec<u32> {
    let mut counts = vec![0; 1 << 16];
    for (x, y) in site.pixels(0..frame.width(), 0..frame.height(), 1) {
        counts[usize::from(frame.at(site, x, y))] += 1;
    }
    counts
}

/// Widths of a pile: of a single number with the rounding of a scale, and of saturated pixels that differ a little.
const WIDTHS: [f64; 2] = [0.002, 0.005];

/// Least number at which a camera can saturate: those of 8 bits end at 255. Tails of the noise of dark frames lie below.
const LEAST: usize = 200;

/// Number at which samples pile up; infinite if they do not.
fn shown(counts: &[u32]) -> f64 {
    let total: u32 = counts.iter().sum();
    let few = 20.max(total / 20_000);
    let highest = counts.iter().rposition(|n| *n > 0).unwrap_or(0);
    // One number throughout is no photograph.
    if counts[highest] == total {
        return highest as f64;
    }
    // A few defective pixels may lie above.
    let mut above = 0;
    let most = counts.iter().rposition(|n| {
        above += n;
        above > few
    });
    let between = |from: f64, to: f64| {
        let end = (to.ceil() as usize).min(counts.len());
        counts[from.ceil() as usize..end].iter().sum::<u32>()
    };
    let pile = |(top, width): (usize, f64)| {
        let [far, near, over] = [-7.5, -1.0, 1.0].map(|widths| (1.0 + widths * width) * top as f64);
        // Defective pixels have numbers that differ.
        let (piled, below) = (between(near, over + 1.0), between(far, near));
        // There are fewer samples above any brightness than below, except where they pile up.
        (piled > few && piled > 2 * below).then_some(near)
    };
    let tops = [Some(highest), most].into_iter().flatten().filter(|top| *top >= LEAST);
    let piles = tops.flat_map(|top| WIDTHS.map(|width| (top, width)));
    piles.filter_map(pile).fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::{Levels, Pattern};
    use crate::testing::normal;

    /// Light that rises to the right; red saturates at `red`, with a relative scatter.
    fn photo(white: Option<[f64; 4]>, red: f64, scatter: f64) -> Photo {
        let mut state = 3;
        let samples = (0..200 * 150 * 3).map(|i| {
            let light = 2000.0 + 200.0 * f64::from(i / 3 % 200);
            let seen = light + light.sqrt() * normal(&mut state);
            let full = if i % 3 == 0 { red * (1.0 + scatter * normal(&mut state)) } else { f64::INFINITY };
            seen.min(full).round() as u16
        });
        let frame = Frame::new(200, 150, Pattern::Rgb, samples.collect()).unwrap();
        let levels = Levels { black: Some([0.0; 4]), white };
        Photo { label: "it".to_owned(), frame, levels, seconds: None, exposure: None }
    }

    /// Each colour is saturated where its samples pile up.
    #[test]
    fn saturation_is_where_samples_pile_up() {
        let full = |photo: &Photo| saturation(photo).0;
        assert_eq!(full(&photo(None, f64::INFINITY, 0.0)), [65_535.0; 4]);
        // A plateau of one number, and plateaus with scatter, the widest of which lie below the file's level.
        for scatter in [0.0, 2e-4, 6e-4] {
            let [red, green, blue, _] = full(&photo(None, 30_000.0, scatter));
            let lowest = 30_000.0 * (1.0 - 3.0 * scatter);
            assert!(red > 29_700.0 && red <= lowest, "{scatter}: {red}");
            assert_eq!([green, blue], [65_535.0; 2], "{scatter}");
        }
        // Defective pixels above the plateau.
        let mut odd = photo(None, 30_000.0, 6e-4);
        let mut samples = odd.frame.samples().to_vec();
        samples[3 * 777] = 65_000;
        odd.frame = Frame::new(200, 150, Pattern::Rgb, samples).unwrap();
        assert!(full(&odd)[0] < 30_000.0);
    }

    /// Numbers of a dark frame whose black level is subtracted are no pile.
    #[test]
    fn dark_frames_are_not_saturated() {
        for spread in [0.4, 2.0, 8.0, 25.0, 40.0] {
            let mut state = 5;
            let samples = (0..200 * 150).map(|_| (spread * normal(&mut state)).max(0.0).round() as u16);
            let frame = Frame::new(200, 150, Pattern::One([true; 4]), samples.collect()).unwrap();
            let levels = Levels { black: Some([0.0; 4]), white: None };
            let photo = Photo { label: "dark".to_owned(), frame, levels, seconds: None, exposure: None };
            assert_eq!(saturation(&photo).0, [65_535.0; 4], "{spread}");
        }
    }

    /// If the file gives a saturation level for each colour, that level is used.
    #[test]
    fn saturation_follows_the_file() {
        let white = [50_000.0, 40_000.0, 20_000.0, 40_000.0];
        assert_eq!(saturation(&photo(Some(white), f64::INFINITY, 0.0)).0, white);
    }
}
