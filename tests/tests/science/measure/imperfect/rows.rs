//! Defines the rows of the test: the imperfections of a measurement, their size, and whether the priors match them.

use optics_model::fit::{Bounds, FitSettings};

use super::flaws::SCALE;

/// An imperfection of a measurement.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Thickness,
    Origin,
    Blur,
    Gain,
    Zero,
    Slope,
    Dust,
    /// The factor μ on all profiles of a medium.
    Scale,
}

/// The imperfections that are tested alone, by name.
const ALONE: [(&str, Kind); 7] = [
    ("thickness", Kind::Thickness),
    ("origin", Kind::Origin),
    ("blur", Kind::Blur),
    ("gain", Kind::Gain),
    ("zero", Kind::Zero),
    ("slope", Kind::Slope),
    ("dust", Kind::Dust),
];

#[derive(Debug, Clone)]
pub(super) struct Row {
    /// The name, such as `dust`, `blur x3`, `all x3 prior`.
    pub name: String,
    kinds: Vec<Kind>,
    /// Size of the imperfections, in typical sizes.
    size: f64,
    /// Size that the fit's priors assume.
    prior: f64,
}

impl Row {
    fn new(name: &str, kinds: Vec<Kind>, size: f64, prior: f64) -> Self {
        let size_suffix = if size == 1.0 { String::new() } else { format!(" x{size}") };
        let prior_suffix = if prior == 1.0 { "" } else { " prior" };
        Self { name: format!("{name}{size_suffix}{prior_suffix}"), kinds, size, prior }
    }

    /// All rows: at typical size, at three times that size, and at three times with matching priors.
    pub(super) fn all() -> Vec<Self> {
        let mut what: Vec<_> = ALONE.iter().map(|(name, kind)| (*name, vec![*kind])).collect();
        what.push(("all", ALONE.map(|(_, kind)| kind).to_vec()));
        let mut rows = vec![Self::new("none", vec![], 1.0, 1.0)];
        for (size, prior) in [(1.0, 1.0), (3.0, 1.0), (3.0, 3.0)] {
            // Dust has no prior.
            let has_prior = |kinds: &[Kind]| prior == 1.0 || kinds != [Kind::Dust];
            let these = what.iter().filter(|(_, kinds)| has_prior(kinds));
            rows.extend(these.map(|(name, kinds)| Self::new(name, kinds.clone(), size, prior)));
        }
        rows.push(Self::new("scale", vec![Kind::Scale], 1.0, 1.0));
        rows
    }

    /// # Panics
    /// If there is no such row.
    pub(super) fn named(name: &str) -> Self {
        let row = Self::all().into_iter().find(|row| row.name == name);
        row.unwrap_or_else(|| panic!("{name} is not a row"))
    }

    /// Whether the priors match the imperfections.
    pub(super) fn has_matching_prior(&self) -> bool {
        self.size == self.prior
    }

    /// Size of an imperfection, in its typical size.
    pub(super) fn size(&self, kind: Kind) -> f64 {
        if self.kinds.contains(&kind) { self.size } else { 0.0 }
    }

    /// Settings of the fit: the default priors, scaled for the row's imperfections.
    pub(super) fn settings(&self, g: Option<f64>) -> FitSettings {
        let d = FitSettings::default();
        let prior =
            |kind: Kind, usual: f64| if self.kinds.contains(&kind) { self.prior * usual } else { usual };
        FitSettings {
            g: g.map_or(Bounds::FREE, Bounds::fixed),
            refine: true,
            thickness_std_error_mm: prior(Kind::Thickness, d.thickness_std_error_mm),
            origin_std_error_mm: prior(Kind::Origin, d.origin_std_error_mm),
            blur_std_error_mm: prior(Kind::Blur, d.blur_std_error_mm),
            gain_std_error: prior(Kind::Gain, d.gain_std_error),
            offset_std_error: prior(Kind::Zero, d.offset_std_error),
            slope_std_error: prior(Kind::Slope, d.slope_std_error),
            mu_std_error: if self.kinds.contains(&Kind::Scale) { SCALE } else { 0.0 },
            ..d
        }
    }
}
