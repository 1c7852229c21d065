//! Measured edge profiles.

pub mod checks;
mod colour;
mod spacing;

pub use colour::{colour, wavelength_nm};

use crate::invalid::{Invalid, Result};
use crate::limits::FitLimits;
use crate::medium::check_thickness;
use crate::quantities::Quantity;
use crate::with_quantities;

/// Fewest pixels of a measured profile: fewer do not distinguish an edge from a slope.
pub const MIN_PIXELS: usize = 8;

/// A profile that begins this far from the edge, on either side, does not contain it.
const BESIDE_MM: f64 = 1.0;
/// First pixel and pitch of the profile that represents a patch.
const PATCH_MM: (f64, f64) = (4.6, 0.025);
const PATCH_PIXELS: usize = 16;

macro_rules! profile_setup {
    ($($name:ident { $unit:ident, $default:expr, $range:tt, $form:ident, $label:literal, $help:literal })+) => {
        /// The priors of the set-up of a profile. Values that are none are taken from the options of a fit.
        #[derive(Debug, Clone, Copy, PartialEq, Default)]
        pub struct ProfileSetup {
            $(#[doc = $help] pub $name: Option<f64>,)+
        }

        impl ProfileSetup {
            /// The quantities, in the order of their table.
            pub fn values(&self) -> impl Iterator<Item = (&'static Quantity, Option<f64>)> {
                Quantity::OF_PROFILES.iter().zip([$(self.$name),+])
            }

            pub fn values_mut(&mut self) -> impl Iterator<Item = (&'static Quantity, &mut Option<f64>)> {
                Quantity::OF_PROFILES.iter().zip([$(&mut self.$name),+])
            }
        }
    };
}

with_quantities!(profiles profile_setup);

impl ProfileSetup {
    /// The profile's own value; None if the options' value applies.
    pub fn value_of(&self, quantity: &Quantity) -> Option<f64> {
        self.values().find(|(own, _)| own.name == quantity.name).and_then(|(_, value)| value)
    }

    fn check(self) -> Result<Self> {
        for (quantity, value) in self.values() {
            value.map(|value| quantity.check(value)).transpose()?;
        }
        Ok(self)
    }
}

/// The edge profile of one channel at one thickness, at equally spaced pixels.
#[derive(Debug, Clone, PartialEq)]
pub struct MeasuredProfile {
    channel: String,
    thickness_mm: f64,
    x_mm: Vec<f64>,
    values: Vec<f64>,
    std_errors: Option<Vec<f64>>,
    setup: ProfileSetup,
}

impl MeasuredProfile {
    /// `x_mm` are pixel centres at a constant pitch, rising from the dark side to the light side with
    /// the edge at 0; rounded centres are replaced by evenly spaced ones. `values` are linear radiance factors.
    pub fn new(
        channel: impl Into<String>,
        thickness_mm: f64,
        x_mm: Vec<f64>,
        values: Vec<f64>,
        std_errors: Option<Vec<f64>>,
    ) -> Result<Self> {
        check_thickness(thickness_mm)?;
        let n = x_mm.len();
        if !(MIN_PIXELS..=FitLimits::PIXELS).contains(&n) {
            let allowed = format!("{MIN_PIXELS} to {} are allowed", FitLimits::PIXELS);
            return Err(Invalid::new("x_mm", format_args!("{n} pixels"), allowed));
        }
        let x_mm = spacing::even(x_mm)?;
        check_numbers("values", n, &values, |v| v.abs() <= 1e6, "numbers of size up to 1e6 are allowed")?;
        if let Some(errors) = &std_errors {
            let allowed = "0, and numbers from 1e-9 to 1e6 are allowed";
            check_numbers("std_errors", n, errors, |v| v == 0.0 || (1e-9..=1e6).contains(&v), allowed)?;
        }
        // Away from the edge a profile may be flat, as a patch of a chart is, if it has standard errors: they cannot be
        // estimated from its scatter.
        let certain = std_errors.as_ref().is_some_and(|errors| errors.iter().all(|e| *e > 0.0));
        let may_be_flat = is_off_edge(&x_mm) && certain;
        if !may_be_flat && values.iter().all(|v| *v == values[0]) {
            let allowed = "a constant profile says nothing about the medium";
            return Err(Invalid::new("values", format_args!("{} everywhere", values[0]), allowed));
        }
        let setup = ProfileSetup::default();
        Ok(Self { channel: channel.into(), thickness_mm, x_mm, values, std_errors, setup })
    }

    /// A patch of a chart: a slab on the light side of the base, so wide that no edge is near. Its value is that of a
    /// profile over an edge as far from the edge as the paper's profiles reach, 4.6 to 5 mm.
    pub fn patch(channel: impl Into<String>, thickness_mm: f64, value: f64, std_error: f64) -> Result<Self> {
        if !(std_error > 0.0 && std_error.is_finite()) {
            return Err(Invalid::new("std_error", std_error, "a patch needs one above 0"));
        }
        let (from_mm, pitch_mm) = PATCH_MM;
        let x_mm = (0..PATCH_PIXELS).map(|i| from_mm + i as f64 * pitch_mm).collect();
        // All pixels together are as certain as the value.
        let of_pixel = vec![std_error * (PATCH_PIXELS as f64).sqrt(); PATCH_PIXELS];
        let setup = ProfileSetup { origin_std_error_mm: Some(0.0), ..ProfileSetup::default() };
        Self::new(channel, thickness_mm, x_mm, vec![value; PATCH_PIXELS], Some(of_pixel))?.with_setup(setup)
    }

    /// This profile with the priors of its set-up.
    pub fn with_setup(self, setup: ProfileSetup) -> Result<Self> {
        Ok(Self { setup: setup.check()?, ..self })
    }

    pub fn setup(&self) -> &ProfileSetup {
        &self.setup
    }

    pub fn channel(&self) -> &str {
        &self.channel
    }

    pub fn thickness_mm(&self) -> f64 {
        self.thickness_mm
    }

    pub fn x_mm(&self) -> &[f64] {
        &self.x_mm
    }

    pub fn values(&self) -> &[f64] {
        &self.values
    }

    pub fn std_errors(&self) -> Option<&[f64]> {
        self.std_errors.as_deref()
    }

    pub fn pitch_mm(&self) -> f64 {
        pitch(&self.x_mm)
    }
}

fn is_off_edge(x_mm: &[f64]) -> bool {
    x_mm[0] >= BESIDE_MM || x_mm[x_mm.len() - 1] <= -BESIDE_MM
}

fn pitch(x: &[f64]) -> f64 {
    (x[x.len() - 1] - x[0]) / (x.len() - 1) as f64
}

fn check_numbers(field: &str, n: usize, v: &[f64], ok: impl Fn(f64) -> bool, allowed: &str) -> Result<()> {
    if v.len() != n {
        return Err(Invalid::new(
            field,
            format_args!("{} numbers", v.len()),
            format!("{n} are needed, one per pixel"),
        ));
    }
    match v.iter().position(|v| !(v.is_finite() && ok(*v))) {
        Some(i) => Err(Invalid::new(format!("{field}[{i}]"), v[i], allowed)),
        None => Ok(()),
    }
}

/// All profiles of one material: any channels, any thicknesses, each pair once.
#[derive(Debug, Clone, PartialEq)]
pub struct Measurement {
    material: String,
    profiles: Vec<MeasuredProfile>,
}

impl Measurement {
    pub fn new(material: impl Into<String>, profiles: Vec<MeasuredProfile>) -> Result<Self> {
        let n = profiles.len();
        if !(1..=FitLimits::PROFILES).contains(&n) {
            let allowed = format!("1 to {} are allowed", FitLimits::PROFILES);
            return Err(Invalid::new("profiles", n, allowed));
        }
        for (i, p) in profiles.iter().enumerate() {
            let same = |q: &MeasuredProfile| q.channel == p.channel && q.thickness_mm == p.thickness_mm;
            if profiles[..i].iter().any(same) {
                let given = format!("channel {} at {} mm", p.channel, p.thickness_mm);
                return Err(Invalid::new(format!("profiles[{i}]"), given, "each may be given once"));
            }
        }
        Ok(Self { material: material.into(), profiles })
    }

    pub fn material(&self) -> &str {
        &self.material
    }

    pub fn profiles(&self) -> &[MeasuredProfile] {
        &self.profiles
    }

    /// Channel names in the order of their first profile.
    pub fn channels(&self) -> Vec<&str> {
        let mut names: Vec<&str> = Vec::new();
        for p in &self.profiles {
            if !names.contains(&p.channel.as_str()) {
                names.push(&p.channel);
            }
        }
        names
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn profile(x: Vec<f64>, v: Vec<f64>) -> Result<MeasuredProfile> {
        MeasuredProfile::new("R", 0.5, x, v, None)
    }

    fn ramp(n: usize) -> Vec<f64> {
        (0..n).map(|i| i as f64 * 0.1).collect()
    }

    /// Values must be finite and not constant, and x rising and evenly spaced.
    #[test]
    fn malformed_profiles_are_refused() {
        assert!(profile(ramp(10), ramp(10)).is_ok());
        let mut nan = ramp(10);
        nan[3] = f64::NAN;
        assert_eq!(profile(ramp(10), nan).unwrap_err().field(), "values[3]");
        let mut falling = ramp(10);
        falling.swap(4, 5);
        assert_eq!(profile(falling, ramp(10)).unwrap_err().field(), "x_mm[5]");
        let mut uneven = ramp(10);
        uneven[9] = 1.5;
        assert!(profile(uneven, ramp(10)).unwrap_err().to_string().contains("equally spaced"));
        assert!(profile(ramp(10), vec![0.5; 10]).unwrap_err().to_string().contains("constant"));
        assert!(profile(vec![], vec![]).unwrap_err().to_string().contains("0 pixels"));
    }

    /// Values of the set-up that are out of range are refused with the field.
    #[test]
    fn set_up_out_of_range_is_refused() {
        let with = |setup| profile(ramp(10), ramp(10)).unwrap().with_setup(setup);
        let default = ProfileSetup::default;
        for (setup, field) in [
            (ProfileSetup { thickness_std_error_mm: Some(-0.1), ..default() }, "thickness_std_error_mm"),
            (ProfileSetup { origin_mm: Some(f64::NAN), ..default() }, "origin_mm"),
            (ProfileSetup { origin_std_error_mm: Some(3.0), ..default() }, "origin_std_error_mm"),
            (ProfileSetup { blur_mm: Some(f64::INFINITY), ..default() }, "blur_mm"),
            (ProfileSetup { blur_std_error_mm: Some(-1.0), ..default() }, "blur_std_error_mm"),
        ] {
            assert_eq!(with(setup).unwrap_err().field(), field);
        }
        let setup = ProfileSetup { origin_mm: Some(-0.2), ..default() };
        assert_eq!(with(setup).unwrap().setup().origin_mm, Some(-0.2));
    }

    #[test]
    fn same_profile_twice_is_refused() {
        let p = profile(ramp(10), ramp(10)).unwrap();
        assert_eq!(Measurement::new("white", vec![p.clone(), p]).unwrap_err().field(), "profiles[1]");
    }
}
