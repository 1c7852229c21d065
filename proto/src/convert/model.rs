//! Converts scenes, grids, points, profiles and records.

use std::sync::Arc;

use super::mirror::{Numbered, mirror, mirror_enum, required};
use crate::wire;
use optics_model::grid::{Axes, Effort, Grid, NoiseLevel, Quality, Responses, Variant, Walks};
use optics_model::invalid::{Invalid, Result, each};
use optics_model::medium::{Medium, TransportPoint};
use optics_model::phase::{PhaseShape, PhaseTable, SecondLobe};
use optics_model::profile::{Derivatives, Estimate, Profile, Record};
use optics_model::scene::{
    Channel, Dispersion, DispersionCurve, Layer, LayerMedium, Prior, PriorKind, RingLight, Scene, Scope,
    Sensor,
};

impl From<&Scene> for wire::Scene {
    fn from(scene: &Scene) -> Self {
        let layer = |l: &Layer| wire::Layer {
            name: l.name().to_owned(),
            roughness: l.roughness(),
            medium: Some(match l.medium() {
                LayerMedium::Clear { ior, thickness_mm } => {
                    wire::layer::Medium::Clear(wire::ClearMedium { ior, thickness_mm })
                }
                LayerMedium::Sample => wire::layer::Medium::Sample(scene.phase().into()),
            }),
        };
        let (light, sensor) = (scene.light(), scene.sensor());
        Self {
            layers: scene.layers().iter().map(layer).collect(),
            channels: scene.channels().iter().map(Into::into).collect(),
            light: Some(wire::RingLight { inner_deg: light.inner_deg(), outer_deg: light.outer_deg() }),
            sensor: Some(wire::Sensor {
                width_mm: sensor.width_mm(),
                pixels: sensor.pixels() as u32,
                polar_deg: sensor.polar_deg(),
            }),
            multiple_scattering: scene.multiple_scattering(),
            sample_ior_offset: scene.sample_ior_offset(),
            base_spread_mm: scene.base_spread_mm(),
            priors: scene.priors().iter().map(Into::into).collect(),
        }
    }
}

impl From<&PhaseShape> for wire::SampleMedium {
    fn from(phase: &PhaseShape) -> Self {
        let second = phase.second_lobe().unwrap_or_default();
        let table = phase.table().map(|table| wire::PhaseTable {
            angle_deg: table.angle_deg().to_vec(),
            value: table.value().to_vec(),
        });
        Self { second_lobe_weight: second.weight(), second_lobe_g: second.g(), table }
    }
}

impl TryFrom<&wire::SampleMedium> for PhaseShape {
    type Error = Invalid;

    fn try_from(sample: &wire::SampleMedium) -> Result<Self> {
        match &sample.table {
            Some(table) => PhaseTable::new(table.angle_deg.clone(), table.value.clone())
                .map(|table| Self::Table(Arc::new(table))),
            None => SecondLobe::new(sample.second_lobe_weight, sample.second_lobe_g).map(Self::Lobes),
        }
    }
}

impl From<&Channel> for wire::Channel {
    fn from(channel: &Channel) -> Self {
        let name = channel.name().to_owned();
        Self { name, rho_light: channel.rho_light(), rho_dark: channel.rho_dark() }
    }
}

impl TryFrom<wire::Channel> for Channel {
    type Error = Invalid;

    fn try_from(channel: wire::Channel) -> Result<Self> {
        Self::new(channel.name, channel.rho_light, channel.rho_dark)
    }
}

impl From<&Prior> for wire::Prior {
    fn from(prior: &Prior) -> Self {
        Self {
            kind: prior.kind().number(),
            layers: prior.layers().iter().map(|l| *l as u32).collect(),
            std_error: prior.std_error(),
            scope: prior.scope().number(),
            dispersion: prior.dispersion().map(|dispersion| dispersion.curve().into()),
        }
    }
}

impl From<&DispersionCurve> for wire::DispersionCurve {
    fn from(curve: &DispersionCurve) -> Self {
        let DispersionCurve { cauchy_b_um2, cauchy_c_um4, sellmeier_b, sellmeier_c_um2, wavelength_nm, ior } =
            curve.clone();
        Self { cauchy_b_um2, cauchy_c_um4, sellmeier_b, sellmeier_c_um2, wavelength_nm, ior }
    }
}

impl TryFrom<wire::DispersionCurve> for Dispersion {
    type Error = Invalid;

    fn try_from(curve: wire::DispersionCurve) -> Result<Self> {
        let wire::DispersionCurve {
            cauchy_b_um2,
            cauchy_c_um4,
            sellmeier_b,
            sellmeier_c_um2,
            wavelength_nm,
            ior,
        } = curve;
        let curve =
            DispersionCurve { cauchy_b_um2, cauchy_c_um4, sellmeier_b, sellmeier_c_um2, wavelength_nm, ior };
        Self::new(curve)
    }
}

impl TryFrom<wire::Prior> for Prior {
    type Error = Invalid;

    fn try_from(prior: wire::Prior) -> Result<Self> {
        let newer =
            |field: &str, number| Invalid::new(field, number, "this version does not have it: upgrade");
        let kind = PriorKind::of_number(prior.kind).ok_or_else(|| newer("kind", prior.kind))?;
        let scope = Scope::of_number(prior.scope).ok_or_else(|| newer("scope", prior.scope))?;
        let layers = prior.layers.into_iter().map(|l| l as usize).collect();
        let found = Self::new(kind, layers, prior.std_error, scope)?;
        match prior.dispersion {
            None => Ok(found),
            Some(curve) => found.with_dispersion(Dispersion::try_from(curve)?),
        }
    }
}

impl From<&Variant> for wire::Variant {
    fn from(variant: &Variant) -> Self {
        let channels = variant.channels.iter().map(Into::into).collect();
        Self { prior: variant.prior as u32, step: variant.step, channels }
    }
}

impl TryFrom<wire::Variant> for Variant {
    type Error = Invalid;

    fn try_from(variant: wire::Variant) -> Result<Self> {
        let channels = each("channels", variant.channels, Channel::try_from)?;
        Ok(Self { prior: variant.prior as usize, step: variant.step, channels })
    }
}

impl TryFrom<wire::Scene> for Scene {
    type Error = Invalid;

    fn try_from(scene: wire::Scene) -> Result<Self> {
        let layer = |l: wire::Layer| match required("medium", l.medium)? {
            wire::layer::Medium::Clear(c) => Layer::clear(l.name, c.ior, c.thickness_mm, l.roughness),
            wire::layer::Medium::Sample(_) => Layer::sample(l.name, l.roughness),
        };
        let phase = |l: &wire::Layer| match &l.medium {
            Some(wire::layer::Medium::Sample(sample)) => Some(PhaseShape::try_from(sample)),
            _ => None,
        };
        let phase = scene.layers.iter().find_map(phase).transpose()?.unwrap_or_default();
        let light = required("light", scene.light)?;
        let sensor = required("sensor", scene.sensor)?;
        if !scene.sample_ior_offset.is_finite() {
            return Err(Invalid::new(
                "sample_ior_offset",
                scene.sample_ior_offset,
                "a finite number is needed",
            ));
        }
        let exact = Scene::new(
            each("layers", scene.layers, layer)?,
            each("channels", scene.channels, Channel::try_from)?,
            RingLight::new(light.inner_deg, light.outer_deg).map_err(|e| e.within("light"))?,
            Sensor::new(sensor.width_mm, sensor.pixels, sensor.polar_deg).map_err(|e| e.within("sensor"))?,
            scene.multiple_scattering,
        )?;
        let exact = exact.with_sample_ior_offset(scene.sample_ior_offset).with_phase(phase);
        let exact = exact.with_base_spread(scene.base_spread_mm)?;
        exact.with_priors(each("priors", scene.priors, Prior::try_from)?)
    }
}

impl From<&Grid> for wire::Grid {
    fn from(grid: &Grid) -> Self {
        Self {
            scene: Some(grid.scene().into()),
            sigma_t_per_mm: grid.sigma_t_per_mm().to_vec(),
            albedo: grid.albedo().to_vec(),
            g: grid.g().to_vec(),
            thickness_mm: grid.thickness_mm().to_vec(),
            sample_ior: grid.sample_ior().to_vec(),
            walks: match grid.effort() {
                Effort::Walks(walks) => walks.get(),
                Effort::Noise(_) => 0,
            },
            seed: grid.seed(),
            derivatives: grid.derivatives(),
            quality: grid.quality().map(|q| wire::Quality {
                relative_std_error: q.relative_std_error(),
                max_walks: q.max_walks().get(),
            }),
            noise: match grid.effort() {
                Effort::Walks(_) => 0,
                Effort::Noise(level) => level.number(),
            },
            responses: grid.responses().into_iter().flat_map(Responses::variants).map(Into::into).collect(),
            response_walks_factor: grid.responses().map_or(0, Responses::walks_factor),
        }
    }
}

impl TryFrom<wire::Grid> for Grid {
    type Error = Invalid;

    fn try_from(grid: wire::Grid) -> Result<Self> {
        let effort = effort(grid.walks, grid.noise)?;
        let scene = Scene::try_from(required("scene", grid.scene)?).map_err(|e| e.within("scene"))?;
        let axes = Axes {
            sigma_t_per_mm: grid.sigma_t_per_mm,
            albedo: grid.albedo,
            g: grid.g,
            thickness_mm: grid.thickness_mm,
            sample_ior: grid.sample_ior,
        };
        let quality = grid.quality.map(|q| {
            let max_walks = Walks::new(q.max_walks).map_err(|e| e.renamed("quality.max_walks"))?;
            Quality::new(q.relative_std_error, max_walks).map_err(|e| e.within("quality"))
        });
        let quality = quality.transpose()?;
        let variants = each("responses", grid.responses, Variant::try_from)?;
        let walks_factor = grid.response_walks_factor.max(1);
        let grid = Grid::new(scene, axes, effort, grid.seed, grid.derivatives)?;
        let grid = if variants.is_empty() {
            grid
        } else {
            let responses = Responses::new(grid.scene(), grid.axes(), variants, walks_factor)?;
            grid.with_responses(responses)?
        };
        quality.map_or(Ok(grid.clone()), |q| grid.with_quality(q))
    }
}

fn effort(walks: u64, noise: i32) -> Result<Effort> {
    if noise == 0 {
        return Ok(Walks::new(walks)?.into());
    }
    let level = NoiseLevel::of_number(noise)
        .ok_or_else(|| Invalid::new("noise", noise, "allowed are the levels 1 to 3"))?;
    if walks != 0 {
        return Err(Invalid::new("walks", walks, "a level of noise says how many already"));
    }
    Ok(level.into())
}

mirror!(TransportPoint::new(sigma_t_per_mm, g, thickness_mm, sample_ior));
mirror!(Medium::new(sigma_t_per_mm, albedo, g));
mirror!(SecondLobe::new(weight, g));
mirror_enum!(NoiseLevel { Draft, Paper, Fine });
mirror_enum!(PriorKind {
    Roughness,
    Index,
    Thickness,
    RingAngle,
    SensorAngle,
    SecondLobeWeight,
    SecondLobeG,
    BaseSpread,
    LightSide,
    DarkSide,
    Haze
});
mirror_enum!(Scope { Session, Slab, Material, Channel });

impl From<Estimate> for wire::Estimate {
    fn from(estimate: Estimate) -> Self {
        let (values, std_errors) = estimate.into_parts();
        Self { values, std_errors }
    }
}

impl TryFrom<wire::Estimate> for Estimate {
    type Error = Invalid;

    fn try_from(estimate: wire::Estimate) -> Result<Self> {
        Self::new(estimate.values, estimate.std_errors)
    }
}

impl From<Record> for wire::Record {
    fn from(record: Record) -> Self {
        let profile = |p: Profile| {
            let (d_albedo, d_sigma_t) = p.derivatives.map(|d| (d.albedo.into(), d.sigma_t.into())).unzip();
            wire::Profile { radiance_factor: Some(p.radiance_factor.into()), d_albedo, d_sigma_t }
        };
        Self { index: record.index as u32, profiles: record.profiles.into_iter().map(profile).collect() }
    }
}

impl TryFrom<wire::Record> for Record {
    type Error = Invalid;

    fn try_from(record: wire::Record) -> Result<Self> {
        let place = format!("record {}", record.index);
        let profiles = each("profiles", record.profiles, profile).map_err(|e| e.within(place))?;
        Ok(Self { index: record.index as usize, profiles })
    }
}

fn profile(p: wire::Profile) -> Result<Profile> {
    let estimate = |field: &str, e: Option<wire::Estimate>| {
        e.map(|e| Estimate::try_from(e).map_err(|e| e.within(field))).transpose()
    };
    let radiance_factor = required("radiance_factor", estimate("radiance_factor", p.radiance_factor)?)?;
    let derivatives = match (estimate("d_albedo", p.d_albedo)?, estimate("d_sigma_t", p.d_sigma_t)?) {
        (Some(albedo), Some(sigma_t)) => Some(Derivatives { albedo, sigma_t }),
        (None, None) => None,
        _ => return Err(Invalid::new("d_albedo", "one derivative", "both or none are needed")),
    };
    Ok(Profile { radiance_factor, derivatives })
}

#[cfg(test)]
mod tests {
    use optics_model::{Digest, PHYSICS_VERSION};
    use prost::Message;

    use super::*;

    /// The paper's grid with another phase function and g.
    fn with_phase(phase: PhaseShape, g: f64) -> Grid {
        let axes = Axes { g: vec![g], ..Grid::paper().axes().clone() };
        Grid::new(Scene::paper().with_phase(phase), axes, NoiseLevel::Draft, 1, false).unwrap()
    }

    fn tabulated() -> Grid {
        let table = PhaseTable::new(vec![0.0, 60.0, 180.0], vec![5.0, 0.5, 1.0]).unwrap();
        let g = table.mean_cosine();
        with_phase(PhaseShape::Table(Arc::new(table)), g)
    }

    /// Grids are the same on the other side, those with responses of an earlier version among them, which have other steps.
    #[test]
    fn grid_survives_the_wire() {
        let paper = Grid::paper();
        let (scene, axes) = (Scene::lab(), paper.axes().clone());
        let responses = Responses::of(&scene, &axes, |varied| Ok(varied.channels().to_vec())).unwrap();
        let lab = Grid::new(scene, axes, NoiseLevel::Draft, 1, false).unwrap();
        let responses = responses.unwrap();
        let (slip, mut earlier) = (2, responses.variants().to_vec());
        earlier.retain(|v| v.prior != slip || v.step > 0.0);
        earlier.iter_mut().filter(|v| v.prior == slip).for_each(|v| v.step = 0.04);
        let earlier = Responses::new(lab.scene(), lab.axes(), earlier, 3).unwrap();
        let [lab, earlier] = [responses, earlier].map(|with| lab.clone().with_responses(with).unwrap());
        assert_eq!(earlier.responses().unwrap().steps_of(slip), [0.04]);
        for grid in [paper, tabulated(), lab, earlier] {
            assert_eq!(Grid::try_from(wire::Grid::from(&grid)).unwrap(), grid);
        }
    }

    /// The canonical bytes that grids and scenes are digested by are those of the messages.
    #[test]
    fn digests_cover_the_message_bytes() {
        let quality = Quality::new(0.01, Walks::new(1_000_000).unwrap()).unwrap();
        let (sigma_t_per_mm, albedo, g) = (vec![1.0, 300.0], vec![0.0, 0.5], vec![-0.5, 0.0]);
        let axes = Axes { sigma_t_per_mm, albedo, g, thickness_mm: vec![1.0], sample_ior: vec![1.5] };
        let smooth = Grid::new(Scene::smooth(), axes, Walks::new(5000).unwrap(), u64::MAX, true).unwrap();
        let lobes = with_phase(PhaseShape::Lobes(SecondLobe::new(0.1, -0.5).unwrap()), 0.4);
        let exact = smooth.clone().with_quality(quality).unwrap();
        for grid in [Grid::paper(), smooth, exact, lobes, tabulated()] {
            let mut hasher = blake3::Hasher::new_derive_key("farm.v1 grid");
            hasher.update(&PHYSICS_VERSION.to_le_bytes());
            hasher.update(&wire::Grid::from(&grid).encode_to_vec());
            assert_eq!(Digest::of_grid(&grid).as_bytes(), hasher.finalize().as_bytes());
        }
    }

    #[test]
    fn broken_wire_scene_names_its_field() {
        let mut grid = wire::Grid::from(&Grid::paper());
        let scene = grid.scene.as_mut().unwrap();
        scene.layers[1].medium =
            Some(wire::layer::Medium::Clear(wire::ClearMedium { ior: f64::NAN, thickness_mm: 1.0 }));
        assert_eq!(Grid::try_from(grid).unwrap_err().field(), "scene.layers[1].ior");
    }
}
