//! Fits linearity, stray light and the white reference to shots of grey patches.
//!
//! (S − D)/f = k ρ + γ M/f: f is the flat, k the numbers per unit of radiance factor, M the frame's mean of S − D, and
//! γ the share of it that lens and camera scatter over the frame. Three patches give all of these; of fewer, exposure times
//! give linearity, and a usual γ is assumed.

use optics_model::Invalid;

use crate::black::Black;
use crate::calibration::{Calibration, frame_means};
use crate::camera_settings::CameraSettings;
use crate::flat::Flat;
use crate::frame::{Area, Colour, Exposure, Photo};
use crate::least_squares::{median, robust_mean};
use crate::noise::Pairs;
use crate::one_colour;
use crate::refusal::{ONE_TURNED, Refusal, Warning};
use crate::saturation::{CLIPPED, Saturation, saturation};
use crate::view::PhotoView;

mod exposures;
mod find;
mod line;

use exposures::ExposedWhite;

/// The grey patches with their certified reflectances.
#[derive(Debug, Clone, PartialEq)]
pub struct Neutral {
    /// Per patch and channel.
    rho: Vec<Vec<f64>>,
    std_error: f64,
    /// None if they have to be found; a single one lies in the frame's middle.
    areas: Option<Vec<Area>>,
}

/// Accumulates shots of the patches.
#[derive(Debug)]
pub struct Patches {
    black: Black,
    flat: Flat,
    neutral: Neutral,
    last: Option<Photo>,
    shots: Vec<PatchShot>,
    exposures: Vec<ExposedWhite>,
    pairs: Pairs,
    warnings: Vec<Warning>,
}

/// The readings of one shot.
#[derive(Debug, Clone)]
struct PatchShot {
    label: String,
    seconds: Option<f64>,
    areas: Vec<Area>,
    /// Per patch and channel: mean number above black, divided by the flat, with its standard error; M/f.
    readings: Vec<Vec<RawReading>>,
    /// Brightness of each site relative to its channel.
    sites: Vec<f64>,
}

/// Each sample of an area divided by the flat, and the mean of each site.
struct AreaSamples {
    light: Vec<f64>,
    per_site: Vec<(usize, f64)>,
}

impl PatchShot {
    /// Light of the patches in green, or in the only channel.
    fn greens(&self) -> impl Iterator<Item = f64> {
        self.readings.iter().map(|reading| reading[reading.len() / 2].light)
    }
}

#[derive(Debug, Clone, Copy)]
struct RawReading {
    light: f64,
    std_error: f64,
    veil: f64,
}

/// Ratio of one patch between two shots, relative to the other patches, above which it must be another patch.
const OTHER_PATCH: f64 = 1.5;

/// Smallest side of an area, in pixels.
const LEAST_PX: f64 = 8.0;
/// Pixels of an area that are read: enough for a white patch to 0.005 %.
const SAMPLES: f64 = 100_000.0;
/// Side of a single panel's area, as a share of the frame's, and the greatest difference between its quarters.
const MIDDLE: f64 = 0.2;
const EVEN: f64 = 0.05;

impl Neutral {
    /// `rho` per patch and channel, `std_error` relative, `areas` in the same order. Without areas, the row of patches
    /// is searched for in every shot, and a single panel is taken to fill the frame's middle.
    pub fn new(rho: Vec<Vec<f64>>, std_error: f64, areas: Option<Vec<Area>>) -> Result<Self, Invalid> {
        if rho.is_empty() {
            return Err(Invalid::new("rho", "no patches", "at least a white panel is needed"));
        }
        if rho.len() == 2 && areas.is_none() {
            return Err(Invalid::new(
                "areas_px",
                "nothing",
                "two patches make no row that can be found: give their places",
            ));
        }
        if let Some((i, wrong)) =
            rho.iter().enumerate().find(|(_, r)| r.iter().any(|v| !(1e-4..=1.2).contains(v)))
        {
            return Err(Invalid::new(format!("rho[{i}]"), format!("{wrong:?}"), "from 0.0001 to 1.2"));
        }
        if !(0.0..=0.5).contains(&std_error) {
            return Err(Invalid::new("std_error", std_error, "relative, from 0 to 0.5"));
        }
        if let Some(areas) = &areas {
            check_areas(areas, rho.len())?;
        }
        Ok(Self { rho, std_error, areas })
    }

    /// The greatest reflectance of all patches.
    pub fn brightest(&self) -> f64 {
        self.rho.iter().flatten().copied().fold(0.0, f64::max)
    }

    /// Index of the brightest patch: the white reference.
    pub(crate) fn white(&self) -> usize {
        let green = self.greens();
        (0..self.rho.len()).max_by(|a, b| green[*a].total_cmp(&green[*b])).unwrap_or(0)
    }

    /// Reflectances in green, or in the only channel.
    fn greens(&self) -> Vec<f64> {
        self.rho.iter().map(|rho| rho[rho.len() / 2]).collect()
    }
}

fn check_areas(areas: &[Area], patches: usize) -> Result<(), Invalid> {
    if areas.len() != patches {
        return Err(Invalid::new("areas_px", areas.len(), format!("{patches}, one for each rho")));
    }
    let fits = |a: &Area| a.x >= 0.0 && a.y >= 0.0 && a.width >= LEAST_PX && a.height >= LEAST_PX;
    if let Some(i) = areas.iter().position(|a| !fits(a) || !(a.x + a.y + a.width + a.height).is_finite()) {
        let (field, given) = (format!("areas_px[{i}]"), format!("{:?}", areas[i]));
        let allowed = format!("at least {LEAST_PX} × {LEAST_PX} pixels within the frame");
        return Err(Invalid::new(field, given, allowed));
    }
    Ok(())
}

impl Patches {
    pub fn new(black: Black, flat: Flat, neutral: Neutral) -> Self {
        Self {
            black,
            flat,
            neutral,
            last: None,
            shots: Vec::new(),
            exposures: Vec::new(),
            pairs: Pairs::default(),
            warnings: Vec::new(),
        }
    }

    pub fn add(&mut self, photo: Photo) -> Result<(), Refusal> {
        let (columns, full) = (photo.frame.columns(), saturation(&photo));
        if let Some(wrong) = self.neutral.rho.iter().find(|rho| rho.len() != columns.len()) {
            let allowed = format!("the photographs have {} channels", columns.len());
            return Err(Invalid::new("rho", format!("{wrong:?}"), allowed).into());
        }
        if let Some(last) = &self.last {
            CameraSettings::of(last).check(&photo)?;
            self.pairs.add(&last.frame, &photo.frame, self.black.levels(), full);
        } else {
            one_colour::check_unmixed(&photo)?;
            one_colour::check_period(&photo)?;
            self.pairs.add_single(&photo.frame, self.black.levels(), full);
            if one_colour::are_one(&photo.frame, self.black.levels(), full) {
                self.warnings.push(Warning::OneColour { label: photo.label.clone() });
            }
        }
        let shot = self.read(&photo, full)?;
        self.shots.push(shot);
        self.last = Some(photo);
        Ok(())
    }

    fn read(&self, photo: &Photo, full: Saturation) -> Result<PatchShot, Refusal> {
        let frame = &photo.frame;
        let sites = frame.sites();
        let means = frame_means(&self.black, frame);
        let areas = match &self.neutral.areas {
            Some(areas) => areas.clone(),
            None if self.neutral.rho.len() == 1 => vec![self.middle(photo)?],
            None => find::find(PhotoView { photo, black: &self.black, flat: &self.flat }, &self.neutral)?,
        };
        let mut readings = Vec::new();
        let mut of_sites = vec![1.0; sites.len()];
        for (i, area) in areas.iter().enumerate() {
            let mut per_channel = Vec::new();
            for (colour, mean) in frame.columns().iter().zip(&means) {
                let AreaSamples { light: samples, per_site } =
                    self.samples(photo, *area, i, *colour, full)?;
                let (light, std_error) = robust_mean(&samples);
                let middle = [area.x + 0.5 * area.width, area.y + 0.5 * area.height];
                let veil = mean / self.flat.at(*colour, middle[0], middle[1]);
                per_channel.push(RawReading { light, std_error, veil });
                if i == self.neutral.white() {
                    for (site, mean) in per_site {
                        of_sites[site] = mean / light;
                    }
                }
            }
            readings.push(per_channel);
        }
        Ok(PatchShot { label: photo.label.clone(), seconds: photo.seconds, areas, readings, sites: of_sites })
    }

    /// A shot of the white at another exposure time.
    #[expect(clippy::needless_pass_by_value, reason = "all steps take their photographs; others keep them")]
    pub fn add_exposure(&mut self, photo: Photo) -> Result<(), Refusal> {
        let Some(exposure) = photo.exposure else {
            let seen = format!("{} states no time", photo.label);
            return Err(Refusal::FewExposures { seen });
        };
        if let Some(last) = &self.last {
            let mut settings = CameraSettings::of(last);
            settings.exposure = settings.exposure.map(|same| Exposure { time_s: exposure.time_s, ..same });
            settings.check(&photo)?;
        }
        let readings = self.read(&photo, saturation(&photo))?.readings.swap_remove(self.neutral.white());
        self.exposures.push(ExposedWhite { label: photo.label.clone(), time_s: exposure.time_s, readings });
        Ok(())
    }

    /// The white at other exposure times and at that of the session, whose numbers they have to reach.
    fn with_own_exposure(&self) -> Result<Vec<ExposedWhite>, Refusal> {
        let mut exposures = self.exposures.clone();
        if let (false, Some(last)) = (exposures.is_empty(), &self.last) {
            let Some(exposure) = last.exposure else {
                let seen = format!("{} states no time", last.label);
                return Err(Refusal::FewExposures { seen });
            };
            let white = self.neutral.white();
            exposures.extend(self.shots.iter().map(|shot| ExposedWhite {
                label: shot.label.clone(),
                time_s: exposure.time_s,
                readings: shot.readings[white].clone(),
            }));
        }
        Ok(exposures)
    }

    /// The frame's middle, which a panel fills.
    fn middle(&self, photo: &Photo) -> Result<Area, Refusal> {
        let [width, height] = [photo.frame.width(), photo.frame.height()].map(|side| side as f64);
        let part = |i: usize, j: usize, share: f64| Area {
            x: (0.5 - share + share * i as f64) * width,
            y: (0.5 - share + share * j as f64) * height,
            width: share * width,
            height: share * height,
        };
        let full = Saturation::all(f64::INFINITY);
        let quarter = |k: usize| -> Result<f64, Refusal> {
            let area = part(k % 2, k / 2, 0.5 * MIDDLE);
            let colour = photo.frame.pattern().sharpest();
            Ok(robust_mean(&self.samples(photo, area, 0, colour, full)?.light).0)
        };
        let quarters = (0..4).map(quarter).collect::<Result<Vec<_>, _>>()?;
        let (least, most) =
            quarters.iter().fold((f64::INFINITY, 0.0_f64), |(least, most), v| (least.min(*v), most.max(*v)));
        if most > (1.0 + EVEN) * least.max(f64::MIN_POSITIVE) {
            let percent = 100.0 * (most / least - 1.0);
            let seen = format!("the frame's middle differs by {percent:.0} %, as no single panel does");
            return Err(Refusal::NoPatches { label: photo.label.clone(), seen });
        }
        Ok(Area { width: MIDDLE * width, height: MIDDLE * height, ..part(0, 0, 0.5 * MIDDLE) })
    }

    fn samples(
        &self,
        photo: &Photo,
        area: Area,
        index: usize,
        colour: Colour,
        full: Saturation,
    ) -> Result<AreaSamples, Refusal> {
        let frame = &photo.frame;
        let (right, bottom) = (area.x + area.width, area.y + area.height);
        if right > frame.width() as f64 || bottom > frame.height() as f64 {
            let allowed = format!("within the frame of {} × {} pixels", frame.width(), frame.height());
            return Err(Invalid::new(format!("areas_px[{index}]"), format!("{area:?}"), allowed).into());
        }
        let skip = ((area.width * area.height / SAMPLES).sqrt() as usize).max(1);
        let mut samples = Vec::new();
        let mut per_site = Vec::new();
        let mut clipped = 0_usize;
        for site in frame.sites_of(colour) {
            let mut own = Vec::new();
            let columns = area.x.ceil() as usize..right as usize;
            for (x, y) in site.pixels(columns, area.y.ceil() as usize..bottom as usize, skip) {
                clipped += usize::from(full.is_at(frame, site, x, y));
                let light = self.flat.at(colour, x as f64 + 0.5, y as f64 + 0.5);
                own.push(self.black.signal(frame, site, x, y) / light);
            }
            per_site.push((site.index, robust_mean(&own).0));
            samples.append(&mut own);
        }
        let share = clipped as f64 / samples.len().max(1) as f64;
        if share > CLIPPED {
            let share = 100.0 * share;
            let place = format!("patch {}", index + 1);
            let level = full.of_colour(frame, colour);
            return Err(Refusal::Clipped { label: photo.label.clone(), colour, place, share, level });
        }
        Ok(AreaSamples { light: samples, per_site })
    }

    /// Refuses shots that differ by more than a common factor of all patches.
    fn check_alike(&self) -> Result<(), Refusal> {
        let Some((first, others)) = self.shots.split_first() else { return Ok(()) };
        for shot in others {
            let ratio = |(a, b): (f64, f64)| b / a.max(f64::MIN_POSITIVE);
            let ratios: Vec<f64> = first.greens().zip(shot.greens()).map(ratio).collect();
            let common = median(&mut ratios.clone());
            let is_other = |ratio: &f64| !(1.0 / OTHER_PATCH..=OTHER_PATCH).contains(&(ratio / common));
            if let Some(i) = ratios.iter().position(is_other) {
                let (patch, times) = (i + 1, ratios[i]);
                let seen = format!("patch {patch} is {times:.2} times as bright as in {}", first.label);
                return Err(Refusal::Unlike { label: shot.label.clone(), seen, cause: ONE_TURNED });
            }
        }
        Ok(())
    }

    pub fn finish(self) -> Result<Calibration, Refusal> {
        let Some(last) = &self.last else { return Err(Refusal::Missing { what: "shots of the patches" }) };
        let sites = last.frame.sites();
        self.check_alike()?;
        let columns = last.frame.columns();
        let fitted = line::fit(&self.neutral, &self.shots, &self.with_own_exposure()?, columns)?;
        // Pairs of patch shots show one subject, flats a moved sheet; these are used only if there are no better pairs.
        let mut pairs = self.black.pairs.clone();
        pairs.extend(&self.pairs);
        if self.shots.len() < 2 {
            pairs.extend(&self.flat.pairs);
        }
        let noise = pairs
            .fit(&sites)
            .ok_or(Refusal::Missing { what: "shots from which the noise can be estimated" })?;
        let mean =
            |s: usize| self.shots.iter().map(|shot| shot.sites[s]).sum::<f64>() / self.shots.len() as f64;
        let site_gain = (0..sites.len()).map(mean).collect();
        let parts = [&self.black.warnings, &self.flat.warnings, &fitted.warnings, &self.warnings];
        let mut warnings = parts.map(Vec::as_slice).concat();
        if !pairs.has_pairs() {
            warnings.push(Warning::NoPairs);
        }
        if last.frame.pattern() == crate::Pattern::Rgb {
            warnings.push(Warning::Demosaiced);
        }
        let settings = CameraSettings::of(last);
        Ok(Calibration {
            noise,
            patches: fitted.patches,
            glare: fitted.glare,
            gain: fitted.gain,
            linearity: fitted.linearity,
            reference_std_error: self.neutral.std_error,
            drift: fitted.drift,
            light: fitted.light,
            warnings,
            black: self.black,
            flat: self.flat,
            site_gain,
            settings,
        })
    }
}
