//! Converts questions about the slabs that are worth photographing, and their answers.

use super::mirror::{known_ones, list, mirror, mirror_enum, number, optional, required};
use crate::wire;
use optics_model::fit::{
    Design, DesignQuestion, DesignSettings, FitOptions, HalfWidths, Improvement, Limitation, PixelRow,
    SlabSet,
};
use optics_model::invalid::{Invalid, Result};
use optics_model::medium::Medium;

impl TryFrom<wire::DesignRequest> for DesignQuestion {
    type Error = Invalid;

    fn try_from(request: wire::DesignRequest) -> Result<Self> {
        let medium = Medium::try_from(required("medium", request.medium)?).map_err(|e| e.within("medium"))?;
        let default = DesignSettings::of(medium);
        let set_up = FitOptions::try_from(request.set_up.unwrap_or_default());
        Self::new(DesignSettings {
            channel: request.channel,
            sample_ior: request.sample_ior,
            slab_sets: request.slab_sets.into_iter().map(|set| set.thickness_mm).collect(),
            shots: if request.shots.is_empty() { default.shots } else { request.shots },
            noise: request.noise.unwrap_or(default.noise),
            noise_floor: request.noise_floor.unwrap_or(default.noise_floor),
            pixels: request.pixels.map(PixelRow::try_from).transpose()?,
            set_up: set_up.map_err(|e| e.within("set_up"))?,
            mu_free: request.mu_free,
            medium,
        })
    }
}

impl From<&DesignQuestion> for wire::DesignRequest {
    /// The dictionary is not part of the question.
    fn from(question: &DesignQuestion) -> Self {
        let s = question.settings();
        let slabs = |set: &Vec<f64>| wire::SlabThicknesses { thickness_mm: set.clone() };
        Self {
            dictionary: String::new(),
            channel: s.channel.clone(),
            medium: Some(s.medium.into()),
            sample_ior: s.sample_ior,
            slab_sets: s.slab_sets.iter().map(slabs).collect(),
            shots: s.shots.clone(),
            noise: Some(s.noise),
            noise_floor: Some(s.noise_floor),
            pixels: s.pixels.map(Into::into),
            set_up: Some((&s.set_up).into()),
            mu_free: s.mu_free,
        }
    }
}

mirror!(PixelRow::new(from_mm, to_mm, pitch_mm));
mirror!(Design as DesignResponse { channel, medium: required, sample_ior, pixels: required, sets: list });
mirror!(SlabSet {
    slabs_mm,
    shots,
    g_held: required,
    g_free: optional,
    best_of_its_effort,
    best,
    improvements: known_ones,
});
mirror!(HalfWidths { sigma_t_per_mm, albedo, g, reduced_scattering_per_mm, absorption_per_mm });
mirror!(Improvement {
    limitation: number,
    quantity,
    unit,
    std_error,
    halved: optional,
    removed: optional,
    estimated,
    estimated_g_free,
});
mirror_enum!(Limitation { Noise, Thickness, Origin, Blur, Gain, Zero, Slope, Scale, Scene, Wedge });

#[cfg(test)]
mod tests {
    use super::*;
    use crate::convert::mirror::Numbered;
    use optics_model::fit::FitSettings;

    fn medium() -> Medium {
        Medium::new(6.0, 0.9991, 0.4).unwrap()
    }

    /// No value is the default, so that a forgotten field is detected.
    #[test]
    fn design_questions_round_trip() {
        let set_up = FitSettings { thickness_std_error_mm: 0.002, mu: 0.9, ..FitSettings::default() };
        let settings = DesignSettings {
            channel: Some("R".to_owned()),
            medium: medium(),
            sample_ior: Some(1.53),
            slab_sets: vec![vec![0.5], vec![0.25, 0.5, 0.5]],
            shots: vec![3, 4],
            noise: 0.02,
            noise_floor: 0.001,
            pixels: Some(PixelRow::new(-2.0, 3.0, 0.05).unwrap()),
            set_up: FitOptions::new(set_up).unwrap(),
            mu_free: true,
        };
        let question = DesignQuestion::new(settings).unwrap();
        assert_eq!(DesignQuestion::try_from(wire::DesignRequest::from(&question)).unwrap(), question);
    }

    /// Absent fields of a design are the defaults, and invalid ones are refused.
    #[test]
    fn absent_design_fields_are_defaults() {
        let asked = || wire::DesignRequest { medium: Some(medium().into()), ..Default::default() };
        let question = DesignQuestion::try_from(asked()).unwrap();
        assert_eq!(*question.settings(), DesignSettings::of(medium()));
        let set_up = Some(wire::FitOptions { blur_mm: Some(-1.0), ..Default::default() });
        for (request, field) in [
            (wire::DesignRequest::default(), "medium"),
            (wire::DesignRequest { noise: Some(-1.0), ..asked() }, "noise"),
            (wire::DesignRequest { set_up, ..asked() }, "set_up.blur_mm"),
        ] {
            assert_eq!(DesignQuestion::try_from(request).unwrap_err().field(), field);
        }
    }

    /// A newer coordinator may send limitations that this version does not know: they are left out.
    #[test]
    fn unknown_limitations_are_ignored() {
        let improvement = |limitation| wire::Improvement { limitation, ..Default::default() };
        let improvements = (1..=9).chain([99, 0]).map(improvement).collect();
        let held = Some(wire::HalfWidths::default());
        let set = wire::SlabSet { g_held: held, improvements, ..Default::default() };
        let set = SlabSet::try_from(set).unwrap();
        assert!(set.improvements.iter().map(|i| i.limitation.number()).eq(1..=9));
    }
}
