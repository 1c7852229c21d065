//! Checks for mistakes in measured profiles: units, encodings, places, swapped names.
//!
//! Each check works on plain arrays of numbers. It refuses only profiles that no medium can show, whatever its σ_t, α, g
//! and thickness; a merely likely mistake is a warning. `tests/tests/science/physics/measurement_checks.rs` verifies the
//! checks on traced media.

mod edge;
mod errors;
mod pairs;
mod position;
mod trace;
mod values;

use super::{MeasuredProfile, Measurement};
use trace::Trace;

/// The kind of a finding.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Kind {
    /// Most of the light side is above 1.5.
    ValuesTooLarge,
    /// Single pixels are above 1.5.
    BrightPixels,
    /// All values are multiples of 1/255.
    EightBit,
    /// All values have one decimal.
    FewDigits,
    /// x counts pixels.
    PixelNumbers,
    /// x is in a unit other than mm.
    UnitOfX,
    /// The thickness is in a unit other than mm.
    UnitOfThickness,
    /// Dark and light side are swapped.
    Falling,
    /// The rise is not at x = 0.
    EdgeElsewhere,
    /// The sum of both sides is larger or smaller around x = 0 than a linear profile's.
    Uneven,
    /// A thicker slab blurs the edge less.
    ThicknessOrder,
    /// Two profiles have the same values.
    SameValues,
    /// Standard errors are of another size than the scatter of neighbouring pixels.
    ErrorScale,
}

impl Kind {
    /// The name that programs read; never changed.
    pub fn code(self) -> &'static str {
        match self {
            Self::ValuesTooLarge => "VALUES_TOO_LARGE",
            Self::BrightPixels => "BRIGHT_PIXELS",
            Self::EightBit => "EIGHT_BIT",
            Self::FewDigits => "FEW_DIGITS",
            Self::PixelNumbers => "PIXEL_NUMBERS",
            Self::UnitOfX => "UNIT_OF_X",
            Self::UnitOfThickness => "UNIT_OF_THICKNESS",
            Self::Falling => "FALLING",
            Self::EdgeElsewhere => "EDGE_ELSEWHERE",
            Self::Uneven => "UNEVEN",
            Self::ThicknessOrder => "THICKNESS_ORDER",
            Self::SameValues => "SAME_VALUES",
            Self::ErrorScale => "ERROR_SCALE",
        }
    }
}

/// One mistake, certain or likely.
#[derive(Debug, Clone, PartialEq)]
pub struct Finding {
    pub kind: Kind,
    /// No true profile looks like this: it must not be fitted. Otherwise a warning.
    pub certain: bool,
    /// Index of the material.
    pub material: usize,
    /// Index of the profile among the material's.
    pub profile: usize,
    /// The pixel that shows it best.
    pub pixel: Option<usize>,
    /// The observation, its likely cause and the remedy.
    pub text: String,
}

/// A finding without its material and profile.
#[derive(Debug, Clone, PartialEq)]
struct Seen {
    kind: Kind,
    certain: bool,
    pixel: Option<usize>,
    text: String,
}

impl Seen {
    fn refusal(kind: Kind, text: String) -> Self {
        Self { kind, certain: true, pixel: None, text }
    }

    fn warning(kind: Kind, text: String) -> Self {
        Self { kind, certain: false, pixel: None, text }
    }

    fn at(self, pixel: usize) -> Self {
        Self { pixel: Some(pixel), ..self }
    }

    fn of(self, material: usize, profile: usize) -> Finding {
        let Self { kind, certain, pixel, text } = self;
        Finding { kind, certain, material, profile, pixel, text }
    }
}

/// Checks measurements; findings are in the order of the profiles, those about pairs of profiles last.
pub fn check(materials: &[Measurement]) -> Vec<Finding> {
    let mut findings = Vec::new();
    for (m, material) in materials.iter().enumerate() {
        for (p, profile) in material.profiles().iter().enumerate() {
            findings.extend(alone(profile).into_iter().map(|seen| seen.of(m, p)));
        }
    }
    for (m, material) in materials.iter().enumerate() {
        // A profile that is wrong by itself explains the findings of its pairs.
        let sound = |p: usize| !findings.iter().any(|f| f.material == m && f.profile == p);
        let sound: Vec<bool> = (0..material.profiles().len()).map(sound).collect();
        findings.extend(pairs::of_material(m, material.profiles(), &sound));
    }
    findings.extend(pairs::across(materials));
    findings
}

/// The checks of one profile. The checks of its shape need sound numbers.
fn alone(profile: &MeasuredProfile) -> Vec<Seen> {
    let (x, values) = (profile.x_mm(), profile.values());
    let mut seen: Vec<Seen> = [
        values::too_large(values),
        values::too_coarse(values),
        position::of_x(x),
        position::of_thickness(profile.thickness_mm()),
    ]
    .into_iter()
    .flatten()
    .collect();
    if seen.iter().any(|s| s.certain) {
        return seen;
    }
    let trace = Trace::of(profile);
    let eight_bit = values::eight_bit(values, &trace);
    match edge::misplaced(&trace) {
        Some(found) => seen.push(found),
        // Gamma is one reason for an uneven profile: it is reported once.
        None if eight_bit.as_ref().is_none_or(|s| !s.certain) => seen.extend(edge::uneven(&trace)),
        None => {}
    }
    seen.extend(eight_bit);
    seen.extend(errors::far_from_scatter(profile));
    seen
}
