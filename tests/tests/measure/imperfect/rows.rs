//! The rows of the trial: what is wrong, how much, and whether the fit is told.

use optics_model::fit::{Bounds, FitSettings, Objective};

use super::flaws::SCALE;

/// Something that is wrong with a measurement.
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

/// What is wrong with every measurement, each of another size, and a name to find it by.
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
    /// As in `dust`, `blur x3`, `all x3 told`.
    pub name: String,
    kinds: Vec<Kind>,
    /// In typical sizes.
    size: f64,
    /// The size that the fit reckons with.
    told: f64,
}

impl Row {
    fn new(name: &str, kinds: Vec<Kind>, size: f64, told: f64) -> Self {
        let size_of = if size == 1.0 { String::new() } else { format!(" x{size}") };
        let told_of = if told == 1.0 { "" } else { " told" };
        Self { name: format!("{name}{size_of}{told_of}"), kinds, size, told }
    }

    /// Everything that the trial tries: at typical size, at three times that, and at three times and told so.
    pub(super) fn all() -> Vec<Self> {
        let all: Vec<Kind> = ALONE.iter().map(|(_, kind)| *kind).collect();
        let mut what: Vec<(&str, Vec<Kind>)> =
            ALONE.iter().map(|(name, kind)| (*name, vec![*kind])).collect();
        what.push(("all", all));
        let mut rows = vec![Self::new("none", vec![], 1.0, 1.0)];
        for (size, told) in [(1.0, 1.0), (3.0, 1.0), (3.0, 3.0)] {
            // There is nothing to tell of dust.
            let tellable = |kinds: &[Kind]| told == 1.0 || kinds != [Kind::Dust];
            let these = what.iter().filter(|(_, kinds)| tellable(kinds));
            rows.extend(these.map(|(name, kinds)| Self::new(name, kinds.clone(), size, told)));
        }
        rows.push(Self::new("scale", vec![Kind::Scale], 1.0, 1.0));
        rows
    }

    /// # Panics
    /// If there is no such row.
    pub(super) fn named(name: &str) -> Self {
        let all = Self::all();
        let names: Vec<&str> = all.iter().map(|row| row.name.as_str()).collect();
        all.iter()
            .find(|row| row.name == name)
            .unwrap_or_else(|| panic!("{name} is none of {names:?}"))
            .clone()
    }

    /// Whether the fit reckons with as much as is wrong.
    pub(super) fn is_told(&self) -> bool {
        self.size == self.told
    }

    /// How much of something is wrong, in its typical size.
    pub(super) fn size(&self, kind: Kind) -> f64 {
        if self.kinds.contains(&kind) { self.size } else { 0.0 }
    }

    /// What the fit is told: the defaults, or three times those of what is wrong.
    pub(super) fn settings(&self, objective: Objective, g: Option<f64>) -> FitSettings {
        let d = FitSettings::default();
        let told =
            |kind: Kind, usual: f64| if self.kinds.contains(&kind) { self.told * usual } else { usual };
        FitSettings {
            objective: Some(objective),
            g: g.map_or(Bounds::FREE, Bounds::fixed),
            refine: true,
            thickness_std_error_mm: told(Kind::Thickness, d.thickness_std_error_mm),
            origin_std_error_mm: told(Kind::Origin, d.origin_std_error_mm),
            blur_std_error_mm: told(Kind::Blur, d.blur_std_error_mm),
            gain_std_error: told(Kind::Gain, d.gain_std_error),
            offset_std_error: told(Kind::Zero, d.offset_std_error),
            slope_std_error: told(Kind::Slope, d.slope_std_error),
            mu_std_error: if self.kinds.contains(&Kind::Scale) { SCALE } else { 0.0 },
            ..d
        }
    }
}
