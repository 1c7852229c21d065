//! Grey patches: linearity, stray light and the white reference.
//!
//! (S − D)/f = k ρ + γ M/f: f is the flat, k the numbers per unit of radiance factor, M the frame's mean of S − D, and γ
//! the share of it that lens and camera scatter over the frame.

use optics_model::Invalid;

use crate::black::Black;
use crate::calibration::{Calibration, frame_means};
use crate::flat::Flat;
use crate::frame::{Area, Colour, Photo};
use crate::kind::Kind;
use crate::least_squares::{median, robust_mean};
use crate::noise::Pairs;
use crate::one_colour;
use crate::refusal::{ONE_TURNED, Refusal, Warning};
use crate::saturation::{Full, saturation};
use crate::view::View;

mod find;
mod line;

/// The grey patches and what is certified of them.
#[derive(Debug, Clone, PartialEq)]
pub struct Neutral {
    rho: Vec<[f64; 3]>,
    std_error: f64,
    /// None if they are to be found.
    areas: Option<Vec<Area>>,
}

/// Shots of the patches, one after the other.
#[derive(Debug)]
pub struct Patches {
    black: Black,
    flat: Flat,
    neutral: Neutral,
    last: Option<Photo>,
    shots: Vec<Shot>,
    pairs: Pairs,
    warnings: Vec<Warning>,
}

/// What one shot shows.
#[derive(Debug, Clone)]
struct Shot {
    label: String,
    seconds: Option<f64>,
    areas: Vec<Area>,
    /// Per patch and channel: mean number above black, over the flat, with its standard error; M/f.
    readings: Vec<[Reading; 3]>,
    /// Brightness of each site against its channel.
    sites: Vec<f64>,
}

/// Light of each sample of an area over the flat, and the mean of each site.
struct Samples {
    light: Vec<f64>,
    per_site: Vec<(usize, f64)>,
}

#[derive(Debug, Clone, Copy)]
struct Reading {
    light: f64,
    std_error: f64,
    veil: f64,
}

/// Ratio of one patch in two shots against the other patches' that is no noise: another patch lies there.
const OTHER_PATCH: f64 = 1.5;

/// Least side of an area, in pixels.
const LEAST_PX: f64 = 8.0;
/// Pixels of an area that are read: a white patch is then known to 0.005 %.
const SAMPLES: f64 = 100_000.0;

impl Neutral {
    /// `rho` per patch and channel, `std_error` relative, `areas` in the same order. Without areas, a row of patches is
    /// looked for in every shot.
    pub fn new(rho: Vec<[f64; 3]>, std_error: f64, areas: Option<Vec<Area>>) -> Result<Self, Invalid> {
        if rho.len() < 3 {
            return Err(Invalid::new("rho", format!("{} patches", rho.len()), "at least 3 tell a line"));
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

    /// Index of the brightest patch: the white reference.
    pub(crate) fn white(&self) -> usize {
        let green = |i: &usize| self.rho[*i][1];
        (0..self.rho.len()).max_by(|a, b| green(a).total_cmp(&green(b))).unwrap_or(0)
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
            pairs: Pairs::default(),
            warnings: Vec::new(),
        }
    }

    pub fn add(&mut self, photo: Photo) -> Result<(), Refusal> {
        let full = saturation(&photo);
        if let Some(last) = &self.last {
            Kind::of(last).check(&photo)?;
            self.pairs.add(&last.frame, &photo.frame, self.black.levels(), full);
        } else {
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

    fn read(&self, photo: &Photo, full: Full) -> Result<Shot, Refusal> {
        let frame = &photo.frame;
        let sites = frame.sites();
        let means = frame_means(&self.black, frame);
        let areas = match &self.neutral.areas {
            Some(areas) => areas.clone(),
            None => find::find(View { photo, black: &self.black, flat: &self.flat }, &self.neutral)?,
        };
        let mut readings = Vec::new();
        let mut of_sites = vec![1.0; sites.len()];
        for (i, area) in areas.iter().enumerate() {
            let mut per_channel = [Reading { light: 0.0, std_error: 0.0, veil: 0.0 }; 3];
            for colour in Colour::ALL {
                let Samples { light: samples, per_site } = self.samples(photo, *area, i, colour, full)?;
                let (light, std_error) = robust_mean(&samples);
                let middle = [area.x + 0.5 * area.width, area.y + 0.5 * area.height];
                let veil = means[colour.index()] / self.flat.at(colour, middle[0], middle[1]);
                per_channel[colour.index()] = Reading { light, std_error, veil };
                if i == self.neutral.white() {
                    for (site, mean) in per_site {
                        of_sites[site] = mean / light;
                    }
                }
            }
            readings.push(per_channel);
        }
        Ok(Shot { label: photo.label.clone(), seconds: photo.seconds, areas, readings, sites: of_sites })
    }

    fn samples(
        &self,
        photo: &Photo,
        area: Area,
        index: usize,
        colour: Colour,
        full: Full,
    ) -> Result<Samples, Refusal> {
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
        for site in frame.sites().into_iter().filter(|s| s.colour == colour) {
            let step = site.step * skip;
            let mut own = Vec::new();
            for y in (site.row_from(area.y.ceil() as usize)..bottom as usize).step_by(step) {
                for x in (site.column_from(area.x.ceil() as usize)..right as usize).step_by(step) {
                    clipped += usize::from(full.is_at(frame, site, x, y));
                    let light = self.flat.at(colour, x as f64 + 0.5, y as f64 + 0.5);
                    own.push(self.black.signal(frame, site, x, y) / light);
                }
            }
            per_site.push((site.index, robust_mean(&own).0));
            samples.append(&mut own);
        }
        if clipped * 1000 > samples.len() {
            let share = 100.0 * clipped as f64 / samples.len() as f64;
            let place = format!("patch {}", index + 1);
            let level = full.of_colour(frame, colour);
            return Err(Refusal::Clipped { label: photo.label.clone(), colour, place, share, level });
        }
        Ok(Samples { light: samples, per_site })
    }

    /// Refuses shots that differ by more than one factor of the light for all patches.
    fn check_alike(&self) -> Result<(), Refusal> {
        let Some((first, others)) = self.shots.split_first() else { return Ok(()) };
        for shot in others {
            let ratio =
                |(a, b): (&[Reading; 3], &[Reading; 3])| b[1].light / a[1].light.max(f64::MIN_POSITIVE);
            let ratios: Vec<f64> = first.readings.iter().zip(&shot.readings).map(ratio).collect();
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
        let fitted = line::fit(&self.neutral, &self.shots)?;
        // Shots of the patches are alike; flats show moved paper. Those serve where nothing better was taken twice.
        let mut pairs = self.black.pairs.clone();
        pairs.extend(&self.pairs);
        if self.shots.len() < 2 {
            pairs.extend(&self.flat.pairs);
        }
        let noise = pairs.fit(&sites).ok_or(Refusal::Missing { what: "shots that tell the noise" })?;
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
        let kind = Kind::of(last);
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
            kind,
        })
    }
}
