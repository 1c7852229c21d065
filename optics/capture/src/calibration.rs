//! Converts sample values to radiance factors, with their errors.

use crate::black::Black;
use crate::camera_settings::CameraSettings;
use crate::estimate::Estimate;
use crate::flat::Flat;
use crate::frame::{Area, Colour, Frame, Photo, Site};
use crate::light_field::{BoardPlane, LightChange, LightField};
use crate::noise::SiteNoise;
use crate::refusal::Warning;
use crate::saturation::{Saturation, saturation};
use crate::view::PhotoView;

/// Converts sample values to radiance factors, with all errors: v = ((S − D) − γ M) / (f k), see [`crate::Patches`]. Lists
/// have an entry for each of [`Self::columns`].
#[derive(Debug, Clone)]
pub struct Calibration {
    pub noise: Vec<SiteNoise>,
    pub patches: Vec<PatchReading>,
    /// γ: share of the frame's mean light that is scattered over the frame.
    pub glare: Vec<Estimate>,
    /// k: numbers per unit of radiance factor, its error without the certificate's.
    pub gain: Vec<Estimate>,
    /// Relative deviation from a line at half the brightness of the white reference.
    pub linearity: Vec<f64>,
    /// Relative standard error of the white reference's certificate.
    pub reference_std_error: f64,
    /// Largest relative change of the light between shots of the patches.
    pub drift: Vec<f64>,
    pub warnings: Vec<Warning>,
    pub(crate) light: LampDrift,
    pub(crate) black: Black,
    pub(crate) flat: Flat,
    /// Brightness of each site relative to its channel.
    pub(crate) site_gain: Vec<f64>,
    pub(crate) settings: CameraSettings,
}

/// One grey patch, measured with the calibration.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PatchReading {
    pub rho: Vec<f64>,
    /// Its area in the first shot.
    pub area: Area,
    pub value: Vec<Estimate>,
    /// Relative deviation from the line through all patches.
    pub deviation: Vec<f64>,
}

/// Brightness of the lamps over time, relative to the mean of all shots of the patches.
#[derive(Debug, Clone, Default)]
pub(crate) struct LampDrift {
    /// Seconds and brightness per channel, rising in time; empty where times are unknown.
    pub at: Vec<(f64, Vec<f64>)>,
    /// Relative standard error of a shot's brightness.
    pub std_error: Vec<f64>,
    /// Shots of the patches.
    pub shots: usize,
}

impl Calibration {
    pub fn black(&self) -> &Black {
        &self.black
    }

    pub fn flat(&self) -> &Flat {
        &self.flat
    }

    /// Its columns: the colours of a camera, or the only channel.
    pub fn columns(&self) -> &'static [Colour] {
        self.settings.pattern.columns()
    }

    /// A value for each column.
    pub(crate) fn each<T>(&self, value: impl FnMut(usize) -> T) -> Vec<T> {
        (0..self.columns().len()).map(value).collect()
    }

    /// Brightness of the brightest of 2 × 2 pixels of a channel over that of the darkest.
    pub fn site_ratio(&self) -> f64 {
        let most = self.site_gain.iter().copied().fold(0.0, f64::max);
        most / self.site_gain.iter().copied().fold(f64::INFINITY, f64::min)
    }

    pub(crate) fn view<'a>(&'a self, photo: &'a Photo) -> PhotoView<'a> {
        PhotoView { photo, black: &self.black, flat: &self.flat }
    }
}

impl LampDrift {
    /// Linear between shots, constant before and after.
    fn relative(&self, seconds: Option<f64>) -> Vec<f64> {
        let (Some(t), Some(first), Some(last)) = (seconds, self.at.first(), self.at.last()) else {
            return vec![1.0; self.std_error.len()];
        };
        if t <= first.0 || t >= last.0 {
            return if t <= first.0 { first.1.clone() } else { last.1.clone() };
        }
        let next = self.at.iter().position(|a| a.0 > t).unwrap_or(self.at.len() - 1);
        let (a, b) = (&self.at[next - 1], &self.at[next]);
        let share = (t - a.0) / (b.0 - a.0);
        a.1.iter().zip(&b.1).map(|(a, b)| a + share * (b - a)).collect()
    }
}

/// A frame whose samples are read as radiance factors.
#[derive(Debug)]
pub(crate) struct Radiance<'a> {
    pub frame: &'a Frame,
    calibration: &'a Calibration,
    pub full: Saturation,
    /// M per channel.
    means: Vec<f64>,
    /// γ M per channel, and what the shot has more of it than the bare shots.
    veil: Vec<f64>,
    gain: Vec<f64>,
    /// Light over the board that the flat does not have; None where there is none.
    fields: Option<(BoardPlane, Vec<LightField>)>,
}

/// One sample as a radiance factor.
#[derive(Debug, Clone, Copy)]
pub(crate) struct RadianceSample {
    pub value: f64,
    pub variance: f64,
    /// Radiance factor of an offset of 1 over even light.
    pub of_offset: f64,
    pub clipped: bool,
}

impl<'a> Radiance<'a> {
    pub fn new(calibration: &'a Calibration, photo: &'a Photo) -> Self {
        let light = calibration.light.relative(photo.seconds);
        let means = frame_means(&calibration.black, &photo.frame);
        let veil = calibration.glare.iter().zip(&means).map(|(glare, mean)| glare.value * mean).collect();
        let gain = calibration.gain.iter().zip(&light).map(|(gain, light)| gain.value * light).collect();
        Self { frame: &photo.frame, calibration, full: saturation(photo), means, veil, gain, fields: None }
    }

    /// These radiances corrected for light that differs from the bare shots', whose fields are given.
    pub fn under(mut self, light: &[LightChange], fields: &[LightField], plane: BoardPlane) -> Self {
        for ((gain, veil), light) in self.gain.iter_mut().zip(&mut self.veil).zip(light) {
            *veil += light.offset.value * *gain;
            *gain *= light.factor.value;
        }
        self.levelled(fields.iter().zip(light).map(|(field, light)| field.under(light)).collect(), plane)
    }

    /// These radiances corrected for uneven light over the board.
    pub fn levelled(mut self, fields: Vec<LightField>, plane: BoardPlane) -> Self {
        self.fields = (!fields.iter().all(LightField::is_even)).then_some((plane, fields));
        self
    }

    /// Radiance factor of the frame's mean in each column, which scales the error of the glare.
    pub fn means(&self) -> Vec<f64> {
        self.means.iter().zip(&self.gain).map(|(mean, gain)| mean / gain).collect()
    }

    pub fn sample(&self, site: Site, x: usize, y: usize) -> RadianceSample {
        let c = site.colour.index();
        let signal = self.calibration.black.signal(self.frame, site, x, y);
        let flat = self.calibration.flat.at(site.colour, x as f64 + 0.5, y as f64 + 0.5);
        let field = self
            .fields
            .as_ref()
            .map_or(1.0, |(plane, fields)| fields[c].at(plane.place([x as f64 + 0.5, y as f64 + 0.5])));
        let per_unit = flat * field * self.gain[c] * self.calibration.site_gain[site.index];
        RadianceSample {
            value: (signal - self.veil[c]) / per_unit,
            variance: self.calibration.noise[site.index].variance(signal) / (per_unit * per_unit),
            of_offset: self.gain[c] / per_unit,
            clipped: self.full.is_at(self.frame, site, x, y),
        }
    }
}

/// Mean value above black of each channel over the frame, from a share of its samples.
pub(crate) fn frame_means(black: &Black, frame: &Frame) -> Vec<f64> {
    let mut sums = vec![(0.0, 0.0); frame.columns().len()];
    let skip = (frame.width() * frame.height() / 400_000).isqrt().max(1);
    for site in frame.sites() {
        let (sum, count) = &mut sums[site.colour.index()];
        for (x, y) in site.pixels(0..frame.width(), 0..frame.height(), skip) {
            *sum += black.signal(frame, site, x, y);
            *count += 1.0;
        }
    }
    sums.into_iter().map(|(sum, count)| sum / f64::max(count, 1.0)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The light is interpolated between references, and constant beyond them.
    #[test]
    fn light_is_interpolated_between_references() {
        let at = vec![(10.0, vec![1.002; 3]), (20.0, vec![0.998; 3])];
        let light = LampDrift { at, std_error: vec![0.0; 3], shots: 2 };
        let at = |t: f64| light.relative(Some(t))[1];
        assert_eq!((at(0.0), at(30.0)), (1.002, 0.998));
        assert!((at(15.0) - 1.0).abs() < 1e-12 && (at(12.5) - 1.001).abs() < 1e-12);
        assert_eq!(light.relative(None), [1.0; 3]);
    }
}
