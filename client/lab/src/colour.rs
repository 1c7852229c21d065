//! Colours of reflectance spectra: tristimulus values under an illuminant, CIELAB, differences, and sRGB.
//!
//! The tables of the CIE have steps of 5 nm; a spectrum is linear between its wavelengths, and constant beyond them.

use std::sync::LazyLock;

pub use optics_chart::delta_e_2000;
use optics_model::invalid::{Invalid, Result};
use optics_model::measurement::wavelength_nm;
use palette::chromatic_adaptation::AdaptFromUnclamped;
use palette::convert::FromColorUnclamped;
use palette::white_point::{D50, D65};
use palette::{FromColor, Lab, LinSrgb, Srgb, Xyz};
use serde::Serialize;

use crate::media_file::MediaChart;

/// A standard illuminant.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub enum Illuminant {
    D50,
    D65,
}

/// A standard observer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub enum StandardObserver {
    /// CIE 1931.
    #[serde(rename = "2°")]
    TwoDegrees,
    /// CIE 1964.
    #[serde(rename = "10°")]
    TenDegrees,
}

/// Under what a colour is seen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Viewing {
    pub illuminant: Illuminant,
    pub observer: StandardObserver,
}

/// Under what a camera's colours are seen.
const CAMERA_VIEWING: Viewing =
    Viewing { illuminant: Illuminant::D65, observer: StandardObserver::TwoDegrees };

/// Weights of a spectrum's samples in X, Y and Z, white having Y = 1, with the white point.
#[derive(Debug, Clone)]
pub struct Colorimetry {
    viewing: Viewing,
    /// By sample of the spectrum.
    weights: Vec<[f64; 3]>,
    white: [f64; 3],
    /// X, Y and Z of what a camera sees of a perfect black.
    black: [f64; 3],
}

/// A colour: X, Y, Z with Y = 1 of white, and L*, a*, b*.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SeenColour {
    pub xyz: [f64; 3],
    pub lab: [f64; 3],
}

/// A row of the tables: wavelength in nm, colour-matching functions of both observers, power of both illuminants.
struct TableRow([f64; 9]);

static TABLE: LazyLock<Vec<TableRow>> = LazyLock::new(|| {
    let lines = include_str!("colour/cie_5nm.csv").lines().filter(|line| !line.starts_with('#')).skip(1);
    let row = |line: &str| {
        let mut numbers = line.split(',').map(|cell| cell.parse().expect("a number of the table"));
        TableRow(std::array::from_fn(|_| numbers.next().expect("nine columns")))
    };
    lines.map(row).collect()
});

impl TableRow {
    fn matching(&self, observer: StandardObserver) -> [f64; 3] {
        let first = if observer == StandardObserver::TwoDegrees { 1 } else { 4 };
        std::array::from_fn(|i| self.0[first + i])
    }

    fn power(&self, illuminant: Illuminant) -> f64 {
        self.0[if illuminant == Illuminant::D50 { 7 } else { 8 }]
    }
}

/// Widest spectrum in nm that may be missing at an end of the visible range, and between two samples.
const MISSING_NM: f64 = 40.0;
/// Range in nm that holds all but a hundredth of the light that is seen.
const VISIBLE_NM: (f64, f64) = (420.0, 680.0);

impl Colorimetry {
    /// The weights of spectra at these wavelengths, which must rise and cover what is visible.
    pub fn new(wavelengths_nm: &[f64], viewing: Viewing) -> Result<Self> {
        check(wavelengths_nm)?;
        let mut weights = vec![[0.0; 3]; wavelengths_nm.len()];
        let mut white = [0.0; 3];
        for row in TABLE.iter() {
            let matching = row.matching(viewing.observer).map(|v| v * row.power(viewing.illuminant));
            let next =
                wavelengths_nm.partition_point(|nm| *nm <= row.0[0]).clamp(1, wavelengths_nm.len() - 1);
            let [a, b] = [wavelengths_nm[next - 1], wavelengths_nm[next]];
            let share = ((row.0[0] - a) / (b - a)).clamp(0.0, 1.0);
            for i in 0..3 {
                weights[next - 1][i] += (1.0 - share) * matching[i];
                weights[next][i] += share * matching[i];
                white[i] += matching[i];
            }
        }
        let of_white = white[1];
        weights.iter_mut().flatten().chain(&mut white).for_each(|v| *v /= of_white);
        Ok(Self { viewing, weights, white, black: [0.0; 3] })
    }

    /// The weights of radiance factors of R, G and B that a camera sees by a matrix as linear sRGB, with some light of a
    /// print's faces. Its colours are those of sRGB: D65, 2°.
    pub fn for_camera(matrix: &[[f64; 3]; 3], sheen: f64) -> Self {
        let xyz = |rgb: [f64; 3]| {
            let xyz: Xyz<D65, f64> = Xyz::from_color_unclamped(LinSrgb::new(rgb[0], rgb[1], rgb[2]));
            [xyz.x, xyz.y, xyz.z]
        };
        let column = |i: usize| matrix.map(|row| row[i]);
        let (white, viewing) = (xyz([1.0; 3]), CAMERA_VIEWING);
        Self {
            viewing,
            weights: [0, 1, 2].map(|i| xyz(column(i))).to_vec(),
            black: white.map(|v| sheen * v),
            white,
        }
    }

    /// The colours of some channels of measured media, and the order in which they take these: those of the chart's camera,
    /// if they are from one, or of wavelengths.
    ///
    /// # Errors
    /// If the channels are neither a camera's nor wavelengths that cover what is visible.
    pub fn for_channels(
        channels: &[&str],
        chart: Option<&MediaChart>,
        viewing: Viewing,
    ) -> Result<(Self, Vec<usize>)> {
        let camera = chart.and_then(|chart| Some((chart.matrix.as_ref()?, chart.sheen)));
        let place = |name: &str| channels.iter().position(|channel| *channel == name);
        let rgb: Option<Vec<usize>> = ["R", "G", "B"].into_iter().map(place).collect();
        if let Some(((matrix, sheen), order)) = camera.zip(rgb) {
            return Ok((Self::for_camera(matrix, sheen), order));
        }
        let wavelengths: Option<Vec<f64>> = channels.iter().map(|channel| wavelength_nm(channel)).collect();
        let mut sorted: Vec<(f64, usize)> =
            wavelengths.unwrap_or_default().into_iter().enumerate().map(|(i, nm)| (nm, i)).collect();
        sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (nm, order): (Vec<f64>, Vec<usize>) = sorted.into_iter().unzip();
        Ok((Self::new(&nm, viewing)?, order))
    }

    pub fn viewing(&self) -> Viewing {
        self.viewing
    }

    /// X, Y and Z of a spectrum of radiance factors.
    pub fn xyz(&self, spectrum: &[f64]) -> [f64; 3] {
        let weighted = |i: usize| self.weights.iter().zip(spectrum).map(|(w, v)| w[i] * v).sum::<f64>();
        std::array::from_fn(|i| self.black[i] + weighted(i))
    }

    pub fn colour(&self, spectrum: &[f64]) -> SeenColour {
        let xyz = self.xyz(spectrum);
        SeenColour { xyz, lab: self.lab(xyz) }
    }

    /// L*, a*, b* against the white of this illuminant.
    fn lab(&self, xyz: [f64; 3]) -> [f64; 3] {
        // CIELAB depends on the ratios to the white only.
        let white = [0.95047, 1.0, 1.08883];
        let [x, y, z] = std::array::from_fn(|i| xyz[i] / self.white[i] * white[i]);
        let lab: Lab<D65, f64> = Lab::from_color(Xyz::<D65, f64>::new(x, y, z));
        [lab.l, lab.a, lab.b]
    }

    /// The colour in sRGB, 0 to 255, clipped to its gamut; adapted from D50 by Bradford's method. None for the 10°
    /// observer, for which sRGB is not defined.
    pub fn srgb(&self, colour: &SeenColour) -> Option<[u8; 3]> {
        if self.viewing.observer == StandardObserver::TenDegrees {
            return None;
        }
        let [x, y, z] = colour.xyz;
        let d65 = match self.viewing.illuminant {
            Illuminant::D65 => Xyz::<D65, f64>::new(x, y, z),
            Illuminant::D50 => Xyz::adapt_from_unclamped(Xyz::<D50, f64>::new(x, y, z)),
        };
        let rgb: Srgb<u8> = Srgb::<f64>::from_color(d65).into_format();
        Some([rgb.red, rgb.green, rgb.blue])
    }
}

fn check(wavelengths_nm: &[f64]) -> Result<()> {
    let refused = |given: String, allowed: String| Err(Invalid::new("wavelengths", given, allowed));
    let (Some(first), Some(last)) = (wavelengths_nm.first(), wavelengths_nm.last()) else {
        return refused(
            "none".to_owned(),
            "a colour needs channels that are wavelengths, or those of a chart's camera".to_owned(),
        );
    };
    if *first > VISIBLE_NM.0 + MISSING_NM || *last < VISIBLE_NM.1 - MISSING_NM {
        let allowed = format!(
            "a colour needs channels from {} nm or less to {} nm or more",
            VISIBLE_NM.0 + MISSING_NM,
            VISIBLE_NM.1 - MISSING_NM
        );
        return refused(format!("{first} to {last} nm"), allowed);
    }
    if let Some(i) = (1..wavelengths_nm.len()).find(|i| wavelengths_nm[*i] <= wavelengths_nm[i - 1]) {
        let given = format!("{} and {} nm", wavelengths_nm[i - 1], wavelengths_nm[i]);
        return refused(given, "wavelengths must differ, and rise".to_owned());
    }
    match wavelengths_nm.windows(2).find(|pair| pair[1] - pair[0] > MISSING_NM + 1e-9) {
        Some(pair) => refused(
            format!("{} and {} nm with nothing between them", pair[0], pair[1]),
            format!("a colour needs channels at most {MISSING_NM} nm apart"),
        ),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: [(Illuminant, StandardObserver, [f64; 2]); 4] = [
        (Illuminant::D65, StandardObserver::TwoDegrees, [0.9505, 1.0888]),
        (Illuminant::D50, StandardObserver::TwoDegrees, [0.9642, 0.8251]),
        (Illuminant::D65, StandardObserver::TenDegrees, [0.9481, 1.0732]),
        (Illuminant::D50, StandardObserver::TenDegrees, [0.9672, 0.8143]),
    ];

    fn bands(step: f64) -> Vec<f64> {
        (0..=30).map(|i| 400.0 + step * f64::from(i)).take_while(|nm| *nm <= 700.0).collect()
    }

    /// White points are those of CIE 015, and white and grey are neutral, whatever the wavelengths.
    #[test]
    fn white_points_are_those_of_the_cie() {
        for (illuminant, observer, [x, z]) in ALL {
            for step in [5.0, 10.0, 30.0, 40.0] {
                let colorimetry = Colorimetry::new(&bands(step), Viewing { illuminant, observer });
                // Thirty-one steps of 5 nm end in the green.
                let Ok(colorimetry) = colorimetry else { continue };
                let [found_x, y, found_z] = colorimetry.xyz(&vec![1.0; 31][..bands(step).len()]);
                assert!((y - 1.0).abs() < 1e-12);
                assert!((found_x - x).abs() < 1e-4 && (found_z - z).abs() < 3e-4, "{found_x} {found_z}");
                let grey = colorimetry.colour(&vec![0.18; bands(step).len()]);
                assert!((grey.lab[0] - 49.496).abs() < 2e-3, "{grey:?}");
                assert!(grey.lab[1].abs() < 1e-3 && grey.lab[2].abs() < 1e-3, "{grey:?}");
            }
        }
    }

    /// sRGB's white and its middle grey; another observer has no sRGB.
    #[test]
    fn greys_are_srgb_greys() {
        for (illuminant, observer, _) in ALL {
            let colorimetry = Colorimetry::new(&bands(10.0), Viewing { illuminant, observer }).unwrap();
            let srgb = |grey: f64| colorimetry.srgb(&colorimetry.colour(&[grey; 31]));
            let expected = |code| (observer == StandardObserver::TwoDegrees).then_some([code; 3]);
            assert_eq!([srgb(1.0), srgb(0.215_861)], [expected(255), expected(128)]);
        }
    }

    #[test]
    fn spectra_with_gaps_have_no_colour() {
        let viewing = Viewing { illuminant: Illuminant::D50, observer: StandardObserver::TwoDegrees };
        let refused = |nm: &[f64]| Colorimetry::new(nm, viewing).unwrap_err().to_string();
        assert!(refused(&[]).contains("none is not valid: a colour needs channels that are wavelengths"));
        assert!(
            refused(&[460.0, 460.0, 500.0, 640.0])
                .contains("460 and 460 nm is not valid: wavelengths must differ")
        );
        assert!(refused(&[470.0, 640.0]).contains("470 to 640 nm is not valid"));
        assert!(refused(&[450.0, 500.0, 540.0, 640.0]).contains("450 and 500 nm with nothing between them"));
    }
}
