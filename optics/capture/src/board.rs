//! Measures the bare board: its place in the frame, the camera's blur of its edge, and the brightness of both sides.

use optics_model::Invalid;

use crate::bins::{BINS, Binning, EdgeProfile, bin, fine};
use crate::blur::{self, EdgeBins};
use crate::calibration::{Calibration, Radiance};
use crate::estimate::Estimate;
use crate::frame::Photo;
use crate::lattice::light::{self, LightErrors};
use crate::lattice::movement;
use crate::lattice::{
    CropCells, EdgeFrame, EdgeLine, FreeParts, HALF_CROP_MM, LocatedBoard, PatchRadiance, Target, fields,
    find, own_edge,
};
use crate::least_squares::{FittedParameters, NormalEquations, scatter_of_mean};
use crate::light_field::LightField;
use crate::refusal::{ONE_TURNED, Refusal, Warning};
use crate::report::ShotReport;
use crate::saturation::{CLIPPED, Saturation};
use crate::sfr::EdgeSfr;

/// Accumulates shots of the bare board.
#[derive(Debug)]
pub struct BareShots<'a> {
    calibration: &'a Calibration,
    target: Target,
    found: Option<LocatedBoard>,
    cells: Vec<CropCells>,
    /// Brightness of each shot at the patches of the first.
    readings: Vec<Vec<PatchRadiance>>,
    /// Light over the board, per shot.
    fields: Vec<Vec<LightField>>,
    shots: Vec<ShotReport>,
    /// Radiance factor of the frame's mean, per shot.
    means: Vec<Vec<f64>>,
    /// Profiles in finer bins, per shot.
    fine: Vec<Vec<EdgeProfile>>,
    /// Blur of each shot of another edge.
    blurs: Vec<Vec<Estimate>>,
    warnings: Vec<Warning>,
}

/// Place and appearance of the bare board. Lists have an entry for each of [`Calibration::columns`].
#[derive(Debug, Clone)]
pub struct Board {
    pub edge: EdgeLine,
    pub mm_per_px: Estimate,
    /// Corners of squares within the frame.
    pub corners_px: Vec<[f64; 2]>,
    /// The crop's corners, in order around it.
    pub crop_px: [[f64; 2]; 4],
    /// Profiles of the bare edge; x is 0 at the edge of green, or of the only channel.
    pub profiles: Vec<EdgeProfile>,
    /// Standard deviation of the Gaussian of lens and pixel, without the width of the bins.
    pub blur_mm: Vec<Estimate>,
    /// Spread of light within the board in mm, from all columns together: of a clean board 0 with its error.
    pub spread_mm: Estimate,
    /// Response of lens and pixel to sinusoids; None where bins near the edge are empty.
    pub sfr: Vec<Option<EdgeSfr>>,
    /// Place of the edge in each channel, in x of `profiles`. It is subtracted in profiles of samples.
    pub origin_mm: Vec<Estimate>,
    /// Radiance factors of both sides, away from the edge.
    pub light: Vec<Estimate>,
    pub dark: Vec<Estimate>,
    pub shots: Vec<ShotReport>,
    pub warnings: Vec<Warning>,
    /// Slope of the light side, relative per 10 mm, which is left after all corrections.
    pub slope: Vec<Estimate>,
    pub(crate) found: LocatedBoard,
    pub(crate) cells: CropCells,
    /// Brightness at the patches of `found`.
    pub(crate) readings: Vec<PatchRadiance>,
    /// Light over the board that the flat does not have.
    pub(crate) fields: Vec<LightField>,
    /// Errors of the mean light of the bare shots, by their differences.
    pub(crate) light_errors: Vec<LightErrors>,
    /// Radiance factor of the frame's mean.
    pub(crate) frame_mean: Vec<f64>,
}

impl<'a> BareShots<'a> {
    pub fn new(calibration: &'a Calibration, target: Target) -> Result<Self, Invalid> {
        target.check()?;
        let (cells, readings, fields, shots) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        let (means, fine, blurs, warnings) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        Ok(Self {
            calibration,
            target,
            found: None,
            cells,
            readings,
            fields,
            shots,
            means,
            fine,
            blurs,
            warnings,
        })
    }

    #[expect(clippy::needless_pass_by_value, reason = "all steps take their photographs; others keep them")]
    pub fn add(&mut self, photo: Photo) -> Result<(), Refusal> {
        self.calibration.settings.check(&photo)?;
        let found = find(self.calibration.view(&photo), self.target)?;
        let mut seen = FreeParts::default();
        if let Some(first) = &self.found {
            seen = first.seen.compare(&found.seen);
            if seen.moved_px == [None, None] {
                let seen = format!("the board's edges lie elsewhere than in {}", self.shots[0].label);
                return Err(Refusal::Unlike { label: photo.label.clone(), seen, cause: ONE_TURNED });
            }
            movement::check(&photo.label, &seen.moved_px)?;
            movement::check_focus(&photo.label, &first.seen, &found.seen)?;
        }
        movement::check_shake(&photo.label, &found.seen)?;
        let blur_px = found.seen.blur_of(found.edge_frame.run);
        let found = self.found.get_or_insert(found);
        let edge_frame = found.edge_frame;
        let radiance = Radiance::new(self.calibration, &photo);
        let readings: Vec<PatchRadiance> =
            found.seen.patches().map(|p| p.read(&radiance, &edge_frame)).collect();
        let light =
            self.readings.first().and_then(|bare| light::changes(bare, &readings, seen.free.as_deref()?));
        if let Some(light) = &light {
            light::check(&photo, light)?;
        }
        let fields = fields(&readings);
        light::check_field(&photo, &fields, !self.calibration.flat().is_missing())?;
        let radiance = radiance.levelled(fields.clone(), edge_frame.plane());
        let binnings = self.bins(&photo, &radiance, &edge_frame)?;
        self.fields.push(fields);
        self.fine.push(fine_bins(&radiance, &edge_frame));
        self.cells.push(CropCells::of(&radiance, &edge_frame));
        self.means.push(radiance.means());
        self.readings.push(readings);
        self.shots.push(ShotReport::new(&photo.label, seen.moved_px, light, blur_px, binnings));
        Ok(())
    }

    /// A shot of an edge in which no light spreads, in the place of the board's: it shows the camera's blur.
    #[expect(clippy::needless_pass_by_value, reason = "all steps take their photographs; others keep them")]
    pub fn add_edge(&mut self, photo: Photo) -> Result<(), Refusal> {
        self.calibration.settings.check(&photo)?;
        let Some(found) = &self.found else {
            return Err(Refusal::Missing { what: "shots of the bare board" });
        };
        let radiance = Radiance::new(self.calibration, &photo);
        let no_edge = || Refusal::NoOwnEdge { label: photo.label.clone() };
        let edge_frame = own_edge(&radiance, &found.edge_frame).ok_or_else(no_edge)?;
        self.bins(&photo, &radiance, &edge_frame)?;
        let blur = |profile: &EdgeProfile| Some(blur::fit(&edge_bins(profile))?.blur);
        let blurs: Option<Vec<Estimate>> = fine_bins(&radiance, &edge_frame).iter().map(blur).collect();
        self.blurs.push(blurs.ok_or_else(no_edge)?);
        Ok(())
    }

    /// All columns in bins; refused if they are clipped or if bins would be empty.
    fn bins(
        &self,
        photo: &Photo,
        radiance: &Radiance<'_>,
        edge: &EdgeFrame,
    ) -> Result<Vec<Binning>, Refusal> {
        let binnings = photo.frame.each(|colour| bin(radiance, edge, colour, 0.0));
        check_clipped(photo, &binnings, radiance.full)?;
        self.check_slanted(photo, &binnings)?;
        Ok(binnings)
    }

    /// The camera's blur of a colour by another edge; None without one.
    fn known_blur(&self, c: usize) -> Option<Estimate> {
        let n = self.blurs.len() as f64;
        let mean =
            |value: fn(&Estimate) -> f64| self.blurs.iter().map(|blur| value(&blur[c])).sum::<f64>() / n;
        let scatter = scatter_of_mean(&self.blurs.iter().map(|blur| blur[c].value).collect::<Vec<_>>());
        let estimate = || {
            let value = mean(|e| e.value);
            let errors = [mean(|e| e.std_error), scatter, OWN_EDGE * value];
            Estimate::new(value, errors.iter().map(|e| e * e).sum::<f64>().sqrt())
        };
        (!self.blurs.is_empty()).then(estimate)
    }

    /// Samples of a colour must fall into all bins, so the edge has to cross at least one of their steps within the
    /// crop.
    fn check_slanted(&self, photo: &Photo, binnings: &[Binning]) -> Result<(), Refusal> {
        let Some(found) = &self.found else { return Ok(()) };
        let fewest = binnings.iter().flat_map(|b| &b.profile.counts).min().copied().unwrap_or(0);
        let mean = binnings[0].profile.counts.iter().sum::<u32>() / BINS as u32;
        if 4 * fewest >= mean {
            return Ok(());
        }
        let step = photo.frame.sites()[0].step as f64;
        let length_px = 2.0 * HALF_CROP_MM / found.edge_frame.mm_per_px();
        Err(Refusal::NotSlanted {
            label: photo.label.clone(),
            angle_deg: found.edge.angle_deg.value,
            needed_deg: 1.2 * libm::atan2(step, length_px).to_degrees(),
        })
    }

    pub fn finish(mut self) -> Result<Board, Refusal> {
        let calibration = self.calibration;
        let known = calibration.each(|c| self.known_blur(c));
        let Some(found) = self.found else {
            return Err(Refusal::Missing { what: "shots of the bare board" });
        };
        if self.shots.len() < 2 {
            let (what, count) = ("the bare board".to_owned(), self.shots.len());
            self.warnings.push(Warning::FewShots { what, count });
        }
        let label = &self.shots[0].label;
        let shot_profiles = |c: usize| self.shots.iter().map(|s| &s.profiles[c]).collect::<Vec<_>>();
        let profiles = calibration.each(|c| crate::join::mean(&shot_profiles(c)));
        let fine_shots = |c: usize| self.fine.iter().map(|f| &f[c]).collect::<Vec<_>>();
        let fine = calibration.each(|c| crate::join::mean(&fine_shots(c)));
        for (colour, known) in calibration.columns().iter().copied().zip(&known) {
            let bare = blur::fit(&edge_bins(&fine[colour.index()])).map(|fit| fit.blur);
            let Some((known, bare)) = known.as_ref().zip(bare) else { continue };
            if known.value - bare.value > 3.0 * libm::hypot(known.std_error, bare.std_error) {
                return Err(Refusal::EdgeOutOfFocus { colour, known_mm: known.value, board_mm: bare.value });
            }
        }
        let fits = fine.iter().zip(known).map(|(profile, known)| fit_edge(profile, known, label));
        let fits: Vec<blur::EdgeFit> = fits.collect::<Result<_, _>>()?;
        let ends = fits.iter().map(|fit| (fit.end, "the edge's blur"));
        let unended = ends.chain([(found.end, "the board's pose")]).find(|(end, _)| !end.is_minimum());
        self.warnings.extend(unended.map(|(_, what)| Warning::NotConverged { what }));
        let spread = |f: fn(&blur::EdgeFit) -> f64, c: usize| -> f64 {
            let each: Vec<f64> =
                fine_shots(c).into_iter().filter_map(|p| blur::fit(&edge_bins(p))).map(|e| f(&e)).collect();
            scatter_of_mean(&each)
        };
        let with = |e: Estimate, spread: f64| Estimate::new(e.value, e.std_error.max(spread));
        let alone = |c: usize| libm::hypot(spread(|e| e.blur.value, c), BLUR_OF_FORM * fits[c].spread.value);
        let blur_spread = |c: usize| if self.blurs.is_empty() { alone(c) } else { 0.0 };
        let spread_mm = whole_spread(&fits.iter().map(|fit| fit.spread).collect::<Vec<_>>());
        if spread_mm.value > 2.0 * spread_mm.std_error {
            let Estimate { value: mm, std_error: std_error_mm } = spread_mm;
            self.warnings.push(Warning::SpreadingBoard { mm, std_error_mm });
        }
        let fields = LightField::mean(&self.fields);
        let turned = calibration.columns().iter().zip(&fields).filter(|(_, field)| !field.is_even());
        let steepest = turned.map(|(colour, field)| (*colour, 100.0 * field.steepest()));
        if let Some((colour, percent)) = steepest.max_by(|a, b| a.1.abs().total_cmp(&b.1.abs())) {
            self.warnings.push(Warning::UnevenBoard { colour, percent });
        }
        let edge_frame = found.edge_frame;
        let scale = edge_frame.mm_per_px();
        let sfr = |c: usize| EdgeSfr::of(&fine[c], fits[c].origin.value, fits[c].blur.value, scale);
        let frame_mean = |c: usize| self.means.iter().map(|m| m[c]).sum::<f64>() / self.means.len() as f64;
        let of_square = self.target.square_std_error_mm / self.target.square_mm;
        Ok(Board {
            edge: found.edge,
            mm_per_px: Estimate::new(scale, scale * libm::hypot(of_square, found.scale_std_error)),
            corners_px: found.corners_px.clone(),
            crop_px: edge_frame.crop_px(),
            sfr: calibration.each(sfr),
            blur_mm: calibration.each(|c| with(fits[c].blur, blur_spread(c))),
            spread_mm,
            origin_mm: calibration.each(|c| with(fits[c].origin, spread(|e| e.origin.value, c))),
            light: calibration.each(|c| level(&profiles[c], 1.0)),
            dark: calibration.each(|c| level(&profiles[c], -1.0)),
            slope: calibration.each(|c| slope(&profiles[c])),
            cells: CropCells::mean(&self.cells),
            light_errors: light::spread_of(&self.readings, profiles.len()),
            frame_mean: calibration.each(frame_mean),
            profiles,
            readings: PatchRadiance::mean(&self.readings),
            fields,
            shots: self.shots,
            warnings: self.warnings,
            found,
        })
    }
}

impl Board {
    /// Whether its crop looks like that of another board.
    pub fn looks_like(&self, other: &Self) -> bool {
        self.cells.is_bare(&other.cells)
    }

    /// Relative error of the light of its shots, against those of the patches.
    pub fn light_error(&self, calibration: &Calibration, c: usize) -> f64 {
        libm::hypot(self.light_errors[c].factor, calibration.light.std_error[c])
    }

    /// The pixel at a distance from the edge, positive on its light side, and a place along it.
    pub fn to_px(&self, x_mm: f64, y_mm: f64) -> [f64; 2] {
        self.found.edge_frame.px([x_mm, y_mm])
    }

    /// Distance from the edge, positive on its light side, and place along it.
    pub fn to_mm(&self, x_px: f64, y_px: f64) -> [f64; 2] {
        self.found.edge_frame.mm([x_px, y_px])
    }
}

pub(crate) fn check_clipped(photo: &Photo, binnings: &[Binning], full: Saturation) -> Result<(), Refusal> {
    match binnings.iter().find(|b| b.clipped_share > CLIPPED) {
        None => Ok(()),
        Some(b) => Err(Refusal::Clipped {
            label: photo.label.clone(),
            colour: b.profile.colour,
            place: "the crop".to_owned(),
            share: 100.0 * b.clipped_share,
            level: full.of_colour(&photo.frame, b.profile.colour),
        }),
    }
}

/// Relative standard error of a blur by another edge: of simulated ones, up to 1.1 % off.
const OWN_EDGE: f64 = 0.01;
/// Distance from the edge within which blur and spread are fitted, in mm.
const REACH_MM: f64 = 1.2;
/// Standard error of a spread whose distribution is not exponential, as a share, and the least one in mm.
const OTHER_FORM: f64 = 0.1;
/// Error of the blur by that form, as a share of the spread: by a half that spreads far less and one that spreads far more,
/// 0.06.
const BLUR_OF_FORM: f64 = 0.08;
const LEAST_STD_ERROR_MM: f64 = 0.002;

/// All columns in fine bins.
fn fine_bins(radiance: &Radiance<'_>, edge: &EdgeFrame) -> Vec<EdgeProfile> {
    radiance.frame.each(|colour| fine(radiance, edge, colour))
}

/// The spread of a board: the mean over the columns, by their errors, with their scatter.
fn whole_spread(of_columns: &[Estimate]) -> Estimate {
    let weights: Vec<f64> = of_columns.iter().map(|e| e.std_error.powi(-2)).collect();
    let whole: f64 = weights.iter().sum();
    let value = weights.iter().zip(of_columns).map(|(w, e)| w * e.value).sum::<f64>() / whole;
    if !value.is_finite() {
        return Estimate::new(0.0, REACH_MM);
    }
    let scatter =
        weights.iter().zip(of_columns).map(|(w, e)| w * (e.value - value).powi(2)).sum::<f64>() / whole;
    let errors = [whole.sqrt().recip(), scatter.sqrt(), OTHER_FORM * value, LEAST_STD_ERROR_MM];
    Estimate::new(value, errors.iter().map(|e| e * e).sum::<f64>().sqrt())
}

fn edge_bins(profile: &EdgeProfile) -> EdgeBins {
    let points = (profile.x_mm.iter().zip(&profile.values).zip(&profile.std_errors))
        .map(|((x, v), e)| [*x, *v, *e])
        .collect();
    EdgeBins { width: profile.x_mm[1] - profile.x_mm[0], reach: REACH_MM, points }
}

fn fit_edge(profile: &EdgeProfile, known: Option<Estimate>, label: &str) -> Result<blur::EdgeFit, Refusal> {
    let no_edge = || Refusal::NoBoard {
        label: label.to_owned(),
        seen: format!("the {} profile is not that of an edge between two even sides", profile.colour),
    };
    blur::fit_spread(&edge_bins(profile), known).ok_or_else(no_edge)
}

/// Brightness of one side, at least 1 mm from the edge; unevenness counts as error.
fn level(profile: &EdgeProfile, sign: f64) -> Estimate {
    let far = |x: &f64| sign * x > 1.0;
    let values: Vec<f64> =
        profile.x_mm.iter().zip(&profile.values).filter(|(x, _)| far(x)).map(|(_, v)| *v).collect();
    let values: Vec<f64> = values.into_iter().filter(|v| v.is_finite()).collect();
    let (value, noise) = crate::least_squares::robust_mean(&values);
    let half = values.len() / 2;
    let [near, far] = [&values[..half], &values[half..]].map(|v| crate::least_squares::robust_mean(v).0);
    Estimate::new(value, libm::hypot(noise, 0.25 * (near - far)))
}

/// Relative slope of the light side per 10 mm, at least 1 mm from the edge.
fn slope(profile: &EdgeProfile) -> Estimate {
    let mut normal = NormalEquations::new(2);
    for ((x, v), e) in profile.x_mm.iter().zip(&profile.values).zip(&profile.std_errors) {
        if *x > 1.0 && v.is_finite() {
            normal.add(&[1.0, x - 3.0], *v, 1.0 / (e * e));
        }
    }
    let per_10_mm =
        |s: FittedParameters| Estimate::new(10.0 * s.x[1] / s.x[0], 10.0 * s.std_error(1) / s.x[0]);
    normal.solve().map_or(Estimate::new(0.0, f64::INFINITY), per_10_mm)
}
