//! The expected precision of a planned measurement: question and answer.

use serde::Serialize;

use super::FitOptions;
use crate::invalid::{Invalid, Result, check};
use crate::limits::FitLimits;
use crate::measurement::MIN_PIXELS;
use crate::medium::{Medium, check_ior, check_thickness};

/// Pixels of a camera along x, the edge being at 0.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[expect(clippy::struct_field_names, reason = "names carry their unit")]
pub struct PixelRow {
    from_mm: f64,
    to_mm: f64,
    pitch_mm: f64,
}

impl PixelRow {
    /// From the left end of the first pixel to the right end of the last.
    pub fn new(from_mm: f64, to_mm: f64, pitch_mm: f64) -> Result<Self> {
        check("pixels.from_mm", from_mm, |v| v.abs() <= 1e3, "allowed are -1000 to 1000")?;
        check("pixels.to_mm", to_mm, |v| v > from_mm && v <= 1e3, "allowed is what lies right of from_mm")?;
        check("pixels.pitch_mm", pitch_mm, |v| v > 0.0, "allowed are numbers above 0")?;
        let count = (to_mm - from_mm) / pitch_mm + 1e-6;
        if count < MIN_PIXELS as f64 || count >= (FitLimits::PIXELS + 1) as f64 {
            let given = format_args!("{pitch_mm} over {from_mm} to {to_mm}").to_string();
            let allowed = format!("{MIN_PIXELS} to {} pixels are allowed", FitLimits::PIXELS);
            return Err(Invalid::new("pixels.pitch_mm", given, allowed));
        }
        Ok(Self { from_mm, to_mm, pitch_mm })
    }

    pub fn from_mm(&self) -> f64 {
        self.from_mm
    }

    pub fn to_mm(&self) -> f64 {
        self.to_mm
    }

    pub fn pitch_mm(&self) -> f64 {
        self.pitch_mm
    }

    /// Number of whole pixels that fit.
    pub fn count(&self) -> usize {
        // Rounding of decimals must not cost a pixel.
        ((self.to_mm - self.from_mm) / self.pitch_mm + 1e-6) as usize
    }

    /// Centres of the pixels.
    pub fn x_mm(&self) -> Vec<f64> {
        (0..self.count()).map(|i| self.from_mm + (i as f64 + 0.5) * self.pitch_mm).collect()
    }
}

/// The parts of a [`DesignQuestion`], not yet checked.
#[derive(Debug, Clone, PartialEq)]
pub struct DesignSettings {
    /// None for the dictionary's first.
    pub channel: Option<String>,
    /// Assumed medium, on which the precision depends.
    pub medium: Medium,
    /// One of the dictionary's; none for its first.
    pub sample_ior: Option<f64>,
    /// Thicknesses in mm of the slabs of each set; empty for all sets of one to three of the dictionary's thicknesses.
    pub slab_sets: Vec<Vec<f64>>,
    /// Numbers of photographs of each slab: each number is tried with every set.
    pub shots: Vec<u32>,
    /// Standard error of one pixel of one photograph, as a share of its value.
    pub noise: f64,
    /// Standard error of a dark pixel of one photograph, as a radiance factor; adds to the other in quadrature.
    pub noise_floor: f64,
    /// None for the dictionary's pixels.
    pub pixels: Option<PixelRow>,
    /// The priors of the set-up. Settings of the search are ignored.
    pub set_up: FitOptions,
    /// The factor common to all profiles, μ, has no prior: the measurement has to determine it.
    pub mu_free: bool,
}

impl DesignSettings {
    /// One or two photographs of each slab, 1 % of noise, and the set-up that a fit assumes.
    pub fn of(medium: Medium) -> Self {
        Self {
            channel: None,
            medium,
            sample_ior: None,
            slab_sets: Vec::new(),
            shots: vec![1, 2],
            noise: 0.01,
            noise_floor: 0.0005,
            pixels: None,
            set_up: FitOptions::default(),
            mu_free: false,
        }
    }
}

/// A checked question for the slabs worth photographing and the number of photographs of each.
#[derive(Debug, Clone, PartialEq)]
pub struct DesignQuestion(DesignSettings);

impl DesignQuestion {
    pub fn new(settings: DesignSettings) -> Result<Self> {
        let s = &settings;
        check("noise", s.noise, |v| (0.0..=1.0).contains(&v), "allowed are 0 to 1")?;
        check("noise_floor", s.noise_floor, |v| (0.0..=1.0).contains(&v), "allowed are 0 to 1")?;
        if libm::hypot(s.noise, s.noise_floor) < 1e-9 {
            let given = format!("{} with noise_floor = {}", s.noise, s.noise_floor);
            return Err(Invalid::new(
                "noise",
                given,
                "at least one must be above 0: pixels without noise determine every medium exactly",
            ));
        }
        if let Some(ior) = s.sample_ior {
            check_ior("sample_ior", ior)?;
        }
        if s.slab_sets.len() > FitLimits::SLAB_SETS {
            let allowed = format!("at most {} are allowed", FitLimits::SLAB_SETS);
            return Err(Invalid::new("slab_sets", s.slab_sets.len(), allowed));
        }
        for (i, slabs) in s.slab_sets.iter().enumerate() {
            let field = || format!("slab_sets[{i}]");
            if !(1..=FitLimits::SLABS).contains(&slabs.len()) {
                let allowed = format!("1 to {} are allowed", FitLimits::SLABS);
                return Err(Invalid::new(field(), format_args!("{} slabs", slabs.len()), allowed));
            }
            for (k, slab) in slabs.iter().enumerate() {
                check_thickness(*slab).map_err(|e| e.renamed(format!("slab_sets[{i}][{k}]")))?;
            }
        }
        if !(1..=FitLimits::SHOTS_TRIED).contains(&s.shots.len()) {
            let allowed = format!("1 to {} numbers are allowed", FitLimits::SHOTS_TRIED);
            return Err(Invalid::new("shots", format_args!("{} numbers", s.shots.len()), allowed));
        }
        if let Some(i) = s.shots.iter().position(|n| !(1..=1_000_000).contains(n)) {
            return Err(Invalid::new(format!("shots[{i}]"), s.shots[i], "allowed are 1 to 1000000"));
        }
        if s.mu_free && s.set_up.settings().mu_std_error > 0.0 {
            let allowed = "a factor of which nothing is known (mu_free) has no standard error";
            return Err(Invalid::new("mu_std_error", s.set_up.settings().mu_std_error, allowed));
        }
        Ok(Self(settings))
    }

    pub fn settings(&self) -> &DesignSettings {
        &self.0
    }
}

/// Half-widths of 95 % confidence intervals. They are infinite, and null in JSON, for quantities that the pixels do not
/// determine, and 0 for quantities of which the dictionary has one value only.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct HalfWidths {
    pub sigma_t_per_mm: f64,
    pub albedo: f64,
    pub g: f64,
    pub reduced_scattering_per_mm: f64,
    pub absorption_per_mm: f64,
}

impl HalfWidths {
    pub const UNKNOWN: Self = Self {
        sigma_t_per_mm: f64::INFINITY,
        albedo: f64::INFINITY,
        g: f64::INFINITY,
        reduced_scattering_per_mm: f64::INFINITY,
        absorption_per_mm: f64::INFINITY,
    };

    /// Half-width of σ_t relative to σ_t.
    pub fn of_sigma_t(&self, medium: &Medium) -> f64 {
        self.sigma_t_per_mm / medium.sigma_t_per_mm()
    }

    /// Half-width of 1 − α relative to it; infinite where nothing absorbs.
    pub fn of_co_albedo(&self, medium: &Medium) -> f64 {
        share(self.albedo, 1.0 - medium.albedo())
    }

    /// Half-width of σ_s (1 − g) relative to it.
    pub fn of_reduced_scattering(&self, medium: &Medium) -> f64 {
        share(self.reduced_scattering_per_mm, medium.reduced_scattering_per_mm())
    }

    /// Half-width of σ_a relative to σ_a.
    pub fn of_absorption(&self, medium: &Medium) -> f64 {
        share(self.absorption_per_mm, medium.absorption_per_mm())
    }
}

fn share(half_width: f64, value: f64) -> f64 {
    if half_width == 0.0 { 0.0 } else { half_width / value }
}

/// A limitation of the precision of a measurement.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Limitation {
    /// Noise of the pixels.
    Noise,
    /// Thickness of each slab, in mm.
    #[serde(rename = "thickness_mm")]
    Thickness,
    /// Place of the edge in each profile, in mm.
    #[serde(rename = "origin_mm")]
    Origin,
    /// Blur of the camera, in mm.
    #[serde(rename = "blur_mm")]
    Blur,
    /// Scale of each profile, as a share.
    Gain,
    /// Zero of each profile, as a radiance factor.
    Zero,
    /// Rise of the light across each profile, as a share per 10 mm.
    Slope,
    /// Slope of the thickness across each slab, as a share per 10 mm.
    Wedge,
    /// Factor common to all profiles, μ.
    Scale,
    /// An uncertain quantity of the scene.
    Scene,
}

/// The precision of the same slabs, g held, with one limitation reduced.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Improvement {
    pub limitation: Limitation,
    /// Which quantity of the scene it is, and its unit: `mm`, `°`, or nothing for pure numbers.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub quantity: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unit: Option<String>,
    /// The present one: the noise of one photograph's pixels as a share, or the prior of the set-up. None if nothing is
    /// known.
    pub std_error: Option<f64>,
    /// With half the standard error (for noise: with four times the shots); none if nothing is known.
    pub halved: Option<HalfWidths>,
    /// With the quantity known exactly; none for noise, which cannot be removed.
    pub removed: Option<HalfWidths>,
    /// Standard error of a quantity of the scene after the measurement, from its prior and the pixels: with g held, and
    /// with g free.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub estimated: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub estimated_g_free: Option<f64>,
}

impl Improvement {
    /// The best precision that can be achieved.
    pub fn best(&self) -> HalfWidths {
        self.removed.or(self.halved).unwrap_or(HalfWidths::UNKNOWN)
    }
}

/// A set of slabs, and the precision that photographs of it would have.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SlabSet {
    pub slabs_mm: Vec<f64>,
    /// Photographs of each slab.
    pub shots: u32,
    /// With a known anisotropy.
    pub g_held: HalfWidths,
    /// With g fitted to the same pixels; none if the dictionary has one only.
    pub g_free: Option<HalfWidths>,
    /// No other set of at most as many photographs determines σ_t and 1 − α together better, g held.
    pub best_of_its_effort: bool,
    /// No other set, of any number of photographs, determines them better.
    pub best: bool,
    pub improvements: Vec<Improvement>,
}

impl SlabSet {
    pub fn photographs(&self) -> u64 {
        self.slabs_mm.len() as u64 * u64::from(self.shots)
    }
}

/// The precision with which sets of slabs would determine a medium: Cramér–Rao bounds, the lower limit for unbiased
/// estimators.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Design {
    pub channel: String,
    #[serde(flatten)]
    pub medium: Medium,
    pub sample_ior: f64,
    pub pixels: PixelRow,
    pub sets: Vec<SlabSet>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::FitSettings;

    fn settings() -> DesignSettings {
        DesignSettings::of(Medium::new(6.0, 0.999, 0.4).unwrap())
    }

    /// Settings of a design that make no sense are refused with the field.
    #[test]
    fn invalid_settings_are_refused_with_field() {
        let unsure = FitOptions::new(FitSettings { mu_std_error: 0.02, ..FitSettings::default() }).unwrap();
        for (settings, field) in [
            (DesignSettings { noise: -0.01, ..settings() }, "noise"),
            (DesignSettings { noise: f64::NAN, ..settings() }, "noise"),
            (DesignSettings { noise_floor: -1e-4, ..settings() }, "noise_floor"),
            (DesignSettings { noise: 0.0, noise_floor: 0.0, ..settings() }, "noise"),
            (DesignSettings { sample_ior: Some(0.5), ..settings() }, "sample_ior"),
            (DesignSettings { slab_sets: vec![vec![0.5], vec![]], ..settings() }, "slab_sets[1]"),
            (DesignSettings { slab_sets: vec![vec![0.5, -1.0]], ..settings() }, "slab_sets[0][1]"),
            (DesignSettings { slab_sets: vec![vec![0.5]; 1000], ..settings() }, "slab_sets"),
            (DesignSettings { shots: vec![], ..settings() }, "shots"),
            (DesignSettings { shots: vec![1, 0], ..settings() }, "shots[1]"),
            (DesignSettings { set_up: unsure, mu_free: true, ..settings() }, "mu_std_error"),
        ] {
            assert_eq!(DesignQuestion::new(settings).unwrap_err().field(), field);
        }
        assert!(DesignQuestion::new(settings()).is_ok());
    }

    #[test]
    fn pixels_fill_their_row() {
        let row = PixelRow::new(-2.0, 3.0, 0.1).unwrap();
        let x = row.x_mm();
        assert_eq!((row.count(), x.len()), (50, 50));
        assert!((x[0] + 1.95).abs() < 1e-12 && (x[49] - 2.95).abs() < 1e-12);
        assert_eq!(PixelRow::new(1.0, -1.0, 0.1).unwrap_err().field(), "pixels.to_mm");
        assert_eq!(PixelRow::new(-1.0, 1.0, 0.5).unwrap_err().field(), "pixels.pitch_mm");
        assert_eq!(PixelRow::new(-1.0, 1.0, 0.0).unwrap_err().field(), "pixels.pitch_mm");
        assert_eq!(PixelRow::new(-1.0, 1.0, f64::NAN).unwrap_err().field(), "pixels.pitch_mm");
    }

    /// Relative half widths are relative to the quantities of the medium.
    #[test]
    fn relative_widths_refer_to_the_medium() {
        let medium = Medium::new(6.0, 0.9, 0.4).unwrap();
        let widths = HalfWidths { sigma_t_per_mm: 0.06, albedo: 0.02, ..HalfWidths::UNKNOWN };
        assert!((widths.of_sigma_t(&medium) - 0.01).abs() < 1e-12);
        assert!((widths.of_co_albedo(&medium) - 0.2).abs() < 1e-12);
        assert!(widths.of_absorption(&medium).is_infinite());
        let white = Medium::new(6.0, 1.0, 0.4).unwrap();
        assert!(widths.of_co_albedo(&white).is_infinite());
    }
}
