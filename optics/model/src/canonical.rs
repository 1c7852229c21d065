//! Encodes scenes and grids as bytes, for digests alone: the digested bytes must never change, even if the messages that
//! programs exchange do.
//!
//! The bytes are those of the messages `Scene` and `Grid` of package `farm.v1` at its first release, in protobuf's
//! encoding: fields in the order of their numbers, zero numbers and empty texts left out, repeated numbers packed. A test
//! in `proto` compares the bytes with the current messages.

use crate::grid::{Effort, Grid, NoiseLevel, Responses};
use crate::phase::PhaseShape;
use crate::scene::{Channel, DispersionCurve, Layer, LayerMedium, Prior, Scene};

/// Protobuf's wire types.
const VARINT: u32 = 0;
const FIXED_64: u32 = 1;
const LENGTH: u32 = 2;

pub(crate) fn scene(scene: &Scene) -> Vec<u8> {
    let mut bytes = Vec::new();
    for layer in scene.layers() {
        message(&mut bytes, 1, &self::layer(layer, scene.phase()));
    }
    for channel in scene.channels() {
        message(&mut bytes, 2, &self::channel(channel));
    }
    let mut light = Vec::new();
    number(&mut light, 1, scene.light().inner_deg());
    number(&mut light, 2, scene.light().outer_deg());
    message(&mut bytes, 3, &light);
    let mut sensor = Vec::new();
    number(&mut sensor, 1, scene.sensor().width_mm());
    whole(&mut sensor, 2, scene.sensor().pixels() as u64);
    number(&mut sensor, 3, scene.sensor().polar_deg());
    message(&mut bytes, 4, &sensor);
    whole(&mut bytes, 5, u64::from(scene.multiple_scattering()));
    number(&mut bytes, 6, scene.sample_ior_offset());
    number(&mut bytes, 8, scene.base_spread_mm());
    bytes
}

/// Priors and responses, which no record of the axes depends on.
fn responses(scene: &Scene, responses: &Responses) -> Vec<u8> {
    let mut bytes = Vec::new();
    for prior in scene.priors() {
        message(&mut bytes, 1, &self::prior(prior));
    }
    for variant in responses.variants() {
        let mut of_variant = Vec::new();
        whole(&mut of_variant, 1, variant.prior as u64);
        number(&mut of_variant, 2, variant.step);
        for channel in &variant.channels {
            message(&mut of_variant, 3, &self::channel(channel));
        }
        message(&mut bytes, 2, &of_variant);
    }
    if responses.walks_factor() > 1 {
        whole(&mut bytes, 3, u64::from(responses.walks_factor()));
    }
    bytes
}

fn prior(prior: &Prior) -> Vec<u8> {
    let mut bytes = Vec::new();
    whole(&mut bytes, 1, prior.kind() as u64 + 1);
    let layers: Vec<u8> = prior.layers().iter().map(|l| *l as u8).collect();
    message(&mut bytes, 2, &layers);
    number(&mut bytes, 3, prior.std_error());
    whole(&mut bytes, 4, prior.scope() as u64 + 1);
    if let Some(dispersion) = prior.dispersion() {
        message(&mut bytes, 5, &curve(dispersion.curve()));
    }
    bytes
}

fn curve(curve: &DispersionCurve) -> Vec<u8> {
    let mut bytes = Vec::new();
    number(&mut bytes, 1, curve.cauchy_b_um2);
    number(&mut bytes, 2, curve.cauchy_c_um4);
    let lists = [&curve.sellmeier_b, &curve.sellmeier_c_um2, &curve.wavelength_nm, &curve.ior];
    for (field, list) in (3..).zip(lists).filter(|(_, list)| !list.is_empty()) {
        message(&mut bytes, field, &packed(list));
    }
    bytes
}

fn channel(channel: &Channel) -> Vec<u8> {
    let mut bytes = Vec::new();
    text(&mut bytes, 1, channel.name());
    number(&mut bytes, 2, channel.rho_light());
    number(&mut bytes, 3, channel.rho_dark());
    bytes
}

fn layer(layer: &Layer, phase: &PhaseShape) -> Vec<u8> {
    let mut bytes = Vec::new();
    text(&mut bytes, 1, layer.name());
    number(&mut bytes, 2, layer.roughness());
    let mut medium = Vec::new();
    let field = match layer.medium() {
        LayerMedium::Clear { ior, thickness_mm } => {
            number(&mut medium, 1, ior);
            number(&mut medium, 2, thickness_mm);
            3
        }
        LayerMedium::Sample => {
            medium = self::phase(phase);
            4
        }
    };
    message(&mut bytes, field, &medium);
    bytes
}

pub(crate) fn phase(phase: &PhaseShape) -> Vec<u8> {
    let mut bytes = Vec::new();
    match phase {
        PhaseShape::Lobes(second) => {
            number(&mut bytes, 1, second.weight());
            number(&mut bytes, 2, second.g());
        }
        PhaseShape::Table(table) => {
            let mut of_table = Vec::new();
            message(&mut of_table, 1, &packed(table.angle_deg()));
            message(&mut of_table, 2, &packed(table.value()));
            message(&mut bytes, 3, &of_table);
        }
    }
    bytes
}

fn packed(numbers: &[f64]) -> Vec<u8> {
    numbers.iter().flat_map(|v| v.to_le_bytes()).collect()
}

pub(crate) fn grid(grid: &Grid) -> Vec<u8> {
    let mut bytes = Vec::new();
    message(&mut bytes, 1, &scene(grid.scene()));
    let axes = [grid.sigma_t_per_mm(), grid.albedo(), grid.g(), grid.thickness_mm(), grid.sample_ior()];
    for (field, axis) in (2..).zip(axes) {
        message(&mut bytes, field, &packed(axis));
    }
    let (walks, level) = match grid.effort() {
        Effort::Walks(walks) => (walks.get(), 0),
        Effort::Noise(NoiseLevel::Draft) => (0, 1),
        Effort::Noise(NoiseLevel::Paper) => (0, 2),
        Effort::Noise(NoiseLevel::Fine) => (0, 3),
    };
    whole(&mut bytes, 7, walks);
    whole(&mut bytes, 8, grid.seed());
    whole(&mut bytes, 9, u64::from(grid.derivatives()));
    if let Some(target) = grid.quality() {
        let mut quality = Vec::new();
        number(&mut quality, 1, target.relative_std_error());
        whole(&mut quality, 2, target.max_walks().get());
        message(&mut bytes, 10, &quality);
    }
    whole(&mut bytes, 11, level);
    if let Some(responses) = grid.responses() {
        message(&mut bytes, 12, &self::responses(grid.scene(), responses));
    }
    bytes
}

/// Bytes of a grid, followed by the priors of its scene and their steps.
pub(crate) fn plan(grid: &Grid) -> Vec<u8> {
    let mut bytes = self::grid(grid);
    for prior in grid.scene().priors() {
        message(&mut bytes, 13, &self::prior(prior));
        message(&mut bytes, 14, &packed(&prior.steps(grid.scene())));
    }
    bytes
}

fn message(bytes: &mut Vec<u8>, field: u32, content: &[u8]) {
    key(bytes, field, LENGTH);
    varint(bytes, content.len() as u64);
    bytes.extend_from_slice(content);
}

fn text(bytes: &mut Vec<u8>, field: u32, text: &str) {
    if !text.is_empty() {
        message(bytes, field, text.as_bytes());
    }
}

fn number(bytes: &mut Vec<u8>, field: u32, value: f64) {
    if value != 0.0 {
        key(bytes, field, FIXED_64);
        bytes.extend_from_slice(&value.to_le_bytes());
    }
}

fn whole(bytes: &mut Vec<u8>, field: u32, value: u64) {
    if value != 0 {
        key(bytes, field, VARINT);
        varint(bytes, value);
    }
}

fn key(bytes: &mut Vec<u8>, field: u32, wire_type: u32) {
    varint(bytes, u64::from(field << 3 | wire_type));
}

fn varint(bytes: &mut Vec<u8>, mut value: u64) {
    while value > 0x7f {
        bytes.push(value as u8 | 0x80);
        value >>= 7;
    }
    bytes.push(value as u8);
}
