//! The bands of a session, each photographed through its own filter.

use optics_capture::Colour;
use optics_model::{Invalid, measurement::wavelength_nm};
use serde::Deserialize;

use super::spectrum::Spectrum;

/// Text in file patterns that stands for the name of a band.
pub(super) const PLACE: &str = "{band}";
/// Most bands: the scene of a session has two channels for each.
pub(super) const MOST_BANDS: usize = optics_model::scene::MAX_CHANNELS / 2;
/// Widths of a Gaussian filter in standard deviations over its full width at half maximum.
const FWHM: f64 = 2.354_820_045;
/// Standard deviations over which a Gaussian filter transmits.
const REACH: f64 = 3.0;
/// Step of integrals over a band, in nm, and steps within the full width at half maximum of a Gaussian filter.
const STEP_NM: f64 = 0.5;
const STEPS_IN_FWHM: f64 = 8.0;
/// Share of a band's light at each of its ends that is left out, so that tables need not reach there.
const NEGLIGIBLE: f64 = 2e-4;
/// Transmission over the greatest at which the passband of a filter ends.
const PASSBAND: f64 = 0.03;

/// The pixels of the camera that record a band.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BandPixels {
    /// All pixels of a monochrome camera.
    Mono,
    /// One colour of a mosaic, or of three colours in each pixel.
    Colour(Colour),
}

/// A range of wavelengths that is photographed as one channel.
#[derive(Debug, Clone, PartialEq)]
pub struct Band {
    /// Its name in patterns of files and in messages.
    pub name: String,
    pub wavelength_nm: f64,
    pub pixels: BandPixels,
    filter: Filter,
}

#[derive(Debug, Clone, PartialEq)]
enum Filter {
    Gaussian { fwhm_nm: f64 },
    Table(Spectrum),
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct BandTable {
    name: Option<String>,
    wavelength_nm: f64,
    fwhm_nm: Option<f64>,
    transmission: Option<String>,
    channel: Option<String>,
}

impl Band {
    /// `transmission` reads the table of a filter from its file.
    pub(super) fn new(
        table: BandTable,
        transmission: impl Fn(&str) -> Result<Spectrum, Invalid>,
    ) -> Result<Self, Invalid> {
        let BandTable { name, wavelength_nm: nm, fwhm_nm, transmission: file, channel } = table;
        if wavelength_nm(&nm.to_string()).is_none() {
            return Err(Invalid::new("wavelength_nm", nm, "allowed are 100 to 20000 nm"));
        }
        let filter = match (fwhm_nm, file) {
            (Some(fwhm_nm), None) if (0.1..=0.5 * nm).contains(&fwhm_nm) => Filter::Gaussian { fwhm_nm },
            (Some(fwhm_nm), None) => {
                let allowed = "allowed are 0.1 nm to half of the wavelength";
                return Err(Invalid::new("fwhm_nm", fwhm_nm, allowed));
            }
            (None, Some(file)) => Filter::Table(of_band(transmission(&file)?, &file, nm)?),
            (given, _) => {
                let given = if given.is_some() { "two filters" } else { "no filter" };
                let allowed = "a band needs fwhm_nm, or transmission with a table of its filter";
                return Err(Invalid::new("fwhm_nm", given, allowed));
            }
        };
        let name = name.unwrap_or_else(|| nm.to_string());
        if name.trim().is_empty() || name.contains(['/', '\\', '*', '?']) {
            let allowed = "a name is part of file names: it must not be empty or contain / \\ * ?";
            return Err(Invalid::new("name", format!("{name:?}"), allowed));
        }
        Ok(Self { name, wavelength_nm: nm, pixels: pixels(channel.as_deref())?, filter })
    }

    /// Name of its channel in measurements: the wavelength in nm.
    pub fn channel(&self) -> String {
        self.wavelength_nm.to_string()
    }

    /// Standard deviation of the filter's transmission.
    pub fn std_dev_nm(&self) -> f64 {
        match &self.filter {
            Filter::Gaussian { fwhm_nm } => fwhm_nm / FWHM,
            Filter::Table(table) => table.std_dev(),
        }
    }

    /// Mean of a quantity over the band, weighted by filter and light; `field` names its table in messages.
    ///
    /// ∫ q(λ) T(λ) S(λ) dλ / ∫ T(λ) S(λ) dλ by the trapezoidal rule, all tables being linear between their rows.
    pub(super) fn mean(
        &self,
        field: &str,
        quantity: &Spectrum,
        light: Option<&Spectrum>,
    ) -> Result<f64, Invalid> {
        let weights = self.weights(light)?;
        let whole: f64 = weights.iter().map(|(_, weight)| weight).sum();
        let product = |(nm, weight): &(f64, f64)| Ok(weight * quantity.within(field, *nm)?);
        Ok(weights.iter().map(product).sum::<Result<f64, Invalid>>()? / whole)
    }

    /// Share of the light that a filter passes far from its passband, which ends where the table falls below [`PASSBAND`]:
    /// more than twice as far from its wavelength. 0 of a filter without table.
    pub(super) fn stray_share(&self, light: Option<&Spectrum>) -> Result<f64, Invalid> {
        let Filter::Table(table) = &self.filter else { return Ok(0.0) };
        let weights = self.weights(light)?;
        let (least, middle) = (PASSBAND * table.greatest(), self.wavelength_nm);
        let passes = |(nm, _): &&(f64, f64)| table.at(*nm) >= least;
        let (below, above) = weights.split_at(weights.partition_point(|(nm, _)| *nm < middle));
        let low = below.iter().rev().take_while(passes).last().map_or(middle, |(nm, _)| *nm);
        let high = above.iter().take_while(passes).last().map_or(middle, |(nm, _)| *nm);
        let skirts = middle - 2.0 * (middle - low)..=middle + 2.0 * (high - middle);
        let total = |weights: &mut dyn Iterator<Item = &(f64, f64)>| weights.map(|(_, w)| w).sum::<f64>();
        let far = total(&mut weights.iter().filter(|(nm, _)| !skirts.contains(nm)));
        Ok(far / total(&mut weights.iter()))
    }

    /// Wavelengths of the band and their weights by filter and light, without ends that do not count.
    fn weights(&self, light: Option<&Spectrum>) -> Result<Vec<(f64, f64)>, Invalid> {
        let places = self.places_nm(light);
        let width = |i: usize| {
            let [below, above] = [i.saturating_sub(1), (i + 1).min(places.len() - 1)];
            0.5 * (places[above] - places[below])
        };
        let weight = |(i, nm): (usize, &f64)| (*nm, width(i) * self.transmission(*nm));
        let transmitted = places.iter().enumerate().map(weight).collect();
        let Some(light) = light else { return Ok(without_ends(transmitted)) };
        let lit = |(nm, weight)| Ok((nm, weight * light.within("light.spectrum", nm)?));
        let weights: Vec<(f64, f64)> =
            without_ends(transmitted).into_iter().map(lit).collect::<Result<_, Invalid>>()?;
        if weights.iter().any(|(_, weight)| *weight > 0.0) {
            return Ok(without_ends(weights));
        }
        let given = format!("0 in the whole band of {} nm", self.wavelength_nm);
        Err(Invalid::new("light.spectrum", given, "a band needs light"))
    }

    /// Rising wavelengths at which integrals are evaluated: even steps, and the rows of filter and light, between which
    /// narrow lines could lie otherwise.
    fn places_nm(&self, light: Option<&Spectrum>) -> Vec<f64> {
        let (from, to) = self.range_nm();
        let (step, filter) = match &self.filter {
            Filter::Gaussian { fwhm_nm } => (STEP_NM.min(fwhm_nm / STEPS_IN_FWHM), None),
            Filter::Table(table) => (STEP_NM, Some(table)),
        };
        let steps = ((to - from) / step).ceil().max(1.0) as usize;
        let even = (0..=steps).map(|i| from + (to - from) * i as f64 / steps as f64);
        let rows = filter.into_iter().chain(light).flat_map(Spectrum::wavelengths_nm);
        let mut places: Vec<f64> = even.chain(rows.filter(|nm| (from..=to).contains(nm))).collect();
        places.sort_by(f64::total_cmp);
        places.dedup();
        places
    }

    fn range_nm(&self) -> (f64, f64) {
        match &self.filter {
            Filter::Gaussian { fwhm_nm } => {
                let reach = REACH * fwhm_nm / FWHM;
                (self.wavelength_nm - reach, self.wavelength_nm + reach)
            }
            Filter::Table(table) => table.range_nm(),
        }
    }

    fn transmission(&self, nm: f64) -> f64 {
        match &self.filter {
            Filter::Gaussian { fwhm_nm } => {
                libm::exp(-0.5 * ((nm - self.wavelength_nm) * FWHM / fwhm_nm).powi(2))
            }
            Filter::Table(table) => table.at(nm),
        }
    }
}

/// Weights by wavelength, without the ends that have less than [`NEGLIGIBLE`] of the whole each.
fn without_ends(mut weights: Vec<(f64, f64)>) -> Vec<(f64, f64)> {
    let least = NEGLIGIBLE * weights.iter().map(|(_, weight)| weight).sum::<f64>();
    let end = |weights: &mut dyn Iterator<Item = &(f64, f64)>| {
        let mut sum = 0.0;
        weights
            .take_while(|(_, weight)| {
                sum += weight;
                sum <= least
            })
            .count()
    };
    let [low, high] = [end(&mut weights.iter()), end(&mut weights.iter().rev())];
    weights.truncate(weights.len() - high);
    weights.drain(..low);
    weights
}

/// The transmission of a filter; refused if the band's wavelength does not lie where it is half of its maximum or more.
fn of_band(table: Spectrum, file: &str, nm: f64) -> Result<Spectrum, Invalid> {
    if table.greatest() > 0.0 && table.at(nm) >= 0.5 * table.greatest() {
        return Ok(table);
    }
    let given = format!("{file:?} with {} of its greatest {} at {nm} nm", table.at(nm), table.greatest());
    Err(Invalid::new("transmission", given, "the filter of a band transmits at its wavelength_nm"))
}

fn pixels(channel: Option<&str>) -> Result<BandPixels, Invalid> {
    match channel {
        None | Some("mono") => Ok(BandPixels::Mono),
        Some(other) => {
            let colour = Colour::ALL.into_iter().find(|colour| colour.letter() == other);
            let allowed = "allowed are \"mono\" (the default, a monochrome camera), \"R\", \"G\" and \"B\"";
            let refused = || Invalid::new("channel", format!("{other:?}"), allowed);
            colour.map(BandPixels::Colour).ok_or_else(refused)
        }
    }
}

/// Refuses too many bands, and two with the same name or wavelength.
pub(super) fn check(bands: &[Band]) -> Result<(), Invalid> {
    if bands.len() > MOST_BANDS {
        return Err(Invalid::new("band", format!("{} bands", bands.len()), format!("at most {MOST_BANDS}")));
    }
    for (i, band) in bands.iter().enumerate() {
        let twin = |field: &str, given: &str| {
            Invalid::new(format!("band[{i}].{field}"), given, "each band needs another one")
        };
        if bands[..i].iter().any(|other| other.name == band.name) {
            return Err(twin("name", &band.name));
        }
        if bands[..i].iter().any(|other| other.wavelength_nm == band.wavelength_nm) {
            return Err(twin("wavelength_nm", &band.channel()));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(fwhm_nm: Option<f64>, transmission: Option<&str>) -> BandTable {
        let transmission = transmission.map(str::to_owned);
        BandTable { name: None, wavelength_nm: 550.0, fwhm_nm, transmission, channel: None }
    }

    fn gaussian() -> Band {
        Band::new(table(Some(10.0), None), |_| unreachable!()).unwrap()
    }

    /// The mean of a linear quantity is its value in the middle; that of a parabola is larger by the filter's variance.
    #[test]
    fn means_over_a_gaussian_band_are_exact() {
        let mean = |table: &str| gaussian().mean("rho", &spectrum_of(table), None).unwrap();
        assert!((mean("500,0.4 600,0.6") - 0.5).abs() < 1e-12);
        let parabola =
            (0..=600).map(|i| 520.0 + 0.1 * f64::from(i)).map(|nm| format!("{nm},{}", (nm - 550.0).powi(2)));
        let found = mean(&parabola.collect::<Vec<_>>().join(" "));
        let variance = (10.0 / FWHM).powi(2);
        // The filter ends at three standard deviations, where its weight is 1 %.
        assert!((found / variance - 0.973).abs() < 0.003, "{found} for {variance}");
    }

    /// Light that is stronger on one side moves the mean there: by the variance times the slope of its logarithm.
    #[test]
    fn light_moves_the_mean_of_a_band() {
        let shift =
            gaussian().mean("rho", &spectrum_of("500,0 600,100"), Some(&spectrum_of("500,1 600,3"))).unwrap()
                - 50.0;
        let expected = 0.973 * (10.0 / FWHM).powi(2) * 0.02 / 2.0;
        assert!((shift / expected - 1.0).abs() < 0.01, "{shift} for {expected}");
    }

    /// The table of a filter, or of a lamp, as pairs of wavelength and value.
    fn spectrum_of(pairs: &str) -> Spectrum {
        Spectrum::parse(&format!("wavelength_nm,value\n{}\n", pairs.replace(' ', "\n"))).unwrap().remove(0)
    }

    fn filter(pairs: &str) -> Band {
        Band::new(table(None, Some("filter.csv")), |_| Ok(spectrum_of(pairs))).unwrap()
    }

    /// A filter that leaks far away mixes in what is there.
    #[test]
    fn leaks_of_a_filter_count() {
        let band = filter("400,0.01 544.9,0.01 545,1 555,1 555.1,0.01 700,0.01");
        let step = spectrum_of("400,1 500,1 500.1,0 700,0");
        // The box of 10 nm has a standard deviation of 2.9 nm; 22 % of the light leaks.
        let stray = band.stray_share(None).unwrap();
        assert!((stray / (2.9 / 12.9) - 1.0).abs() < 0.05, "{stray}");
        assert_eq!(gaussian().stray_share(None).unwrap(), 0.0);
        // Neither do the skirts of a table of the same Gaussian.
        let value = |nm: i32| libm::exp(-0.5 * (f64::from(nm - 550) * FWHM / 10.0).powi(2));
        let pairs: Vec<String> = (500..=600).map(|nm| format!("{nm},{:.6}", value(nm))).collect();
        assert!(filter(&pairs.join(" ")).stray_share(None).unwrap() < 1e-4);
        assert!((40.0..60.0).contains(&band.std_dev_nm()), "{}", band.std_dev_nm());
        let leaked = 1.0 / (10.0 + 2.9);
        let found = band.mean("rho", &step, None).unwrap();
        assert!((found / leaked - 1.0).abs() < 0.05, "{found} for {leaked}");
    }

    /// A filter and a lamp's line that are narrower than the steps of integrals count with their areas.
    #[test]
    fn narrow_filters_and_lines_count() {
        let check_line = |nm: f64, width: f64, pairs: &str| {
            let file = Some("filter.csv".to_owned());
            let table = BandTable { wavelength_nm: nm, transmission: file, ..table(None, None) };
            let band = Band::new(table, |_| Ok(spectrum_of(pairs))).unwrap();
            let found = band.mean("rho", &spectrum_of("300,0 800,500"), None).unwrap();
            assert!((found - (nm - 300.0)).abs() < width, "{found}");
        };
        check_line(550.25, 0.1, "400,0 550.1,0 550.25,1 550.4,0 700,0");
        check_line(632.8, 1e-3, "632.79,0 632.8,1 632.81,0");
        // Half of the light is in a line of 0.1 nm.
        let box_of_100 = filter("500,1 600,1");
        let lamp = spectrum_of("400,0.001 520.1,0.001 520.15,2 520.2,0.001 700,0.001");
        let found = box_of_100.mean("rho", &spectrum_of("500,0 600,1"), Some(&lamp)).unwrap();
        assert!((found - (0.5 * 0.2015 + 0.5 * 0.5)).abs() < 0.001, "{found}");
        for fwhm in [0.1, 0.5, 2.0] {
            let band = Band::new(table(Some(fwhm), None), |_| unreachable!()).unwrap();
            let squares: Vec<String> = (0..=800)
                .map(|i| 546.0 + 0.01 * f64::from(i))
                .map(|nm| format!("{nm},{}", (nm - 550.0).powi(2)))
                .collect();
            let variance = band.mean("rho", &spectrum_of(&squares.join(" ")), None).unwrap();
            assert!((variance / (fwhm / FWHM).powi(2) - 0.973).abs() < 0.02, "{fwhm}: {variance}");
        }
    }

    /// Tables must cover the band.
    #[test]
    fn short_tables_are_refused() {
        let refused = gaussian().mean("neutral.rho", &spectrum_of("500,0.5 548,0.5"), None).unwrap_err();
        assert_eq!(refused.to_string(), "neutral.rho = 548.25 nm is not valid: the table has 500 to 548 nm");
        for (fwhm, file, message) in [
            (None, None, "fwhm_nm = no filter is not valid"),
            (Some(5.0), Some("x"), "fwhm_nm = two filters is not valid"),
            (Some(400.0), None, "fwhm_nm = 400 is not valid: allowed are 0.1 nm to half of the wavelength"),
            (None, Some("450.csv"), "transmission = \"450.csv\" with 0 of its greatest 0.8 at 550 nm"),
        ] {
            let blue = |_: &str| Ok(spectrum_of("440,0 450,0.8 460,0"));
            let refused = Band::new(table(fwhm, file), blue).unwrap_err().to_string();
            assert!(refused.starts_with(message), "{refused}");
        }
    }

    /// A lamp's table need not reach where the filter transmits nothing.
    #[test]
    fn lamps_are_needed_within_the_filter_only() {
        let band = filter("300,0 545,0 546,1 554,1 555,0 900,0");
        let line = spectrum_of("500,0 600,1");
        let mean = |lamp: &str| band.mean("rho", &line, Some(&spectrum_of(lamp)));
        assert!((mean("500,1 600,1").unwrap() - 0.5).abs() < 1e-9);
        for (lamp, message) in [
            ("500,1 550,1", "light.spectrum = 550.5 nm is not valid"),
            ("500,0 600,0", "light.spectrum = 0 in the whole band of 550 nm"),
        ] {
            let refused = mean(lamp).unwrap_err().to_string();
            assert!(refused.starts_with(message), "{refused}");
        }
    }
}
