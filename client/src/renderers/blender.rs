//! Formats media for Blender 4.5 and later: a Python script that makes a material of each medium.
//!
//! `Volume Coefficients` takes coefficients per unit of length in world space, which the unit scale of a scene does not
//! change. Cycles takes one anisotropy for all colours. Its light paths end after few bounces by default, and `Filter
//! Glossy` loses light in volumes, so the script sets both. Source: Blender manual, "Volume Coefficients"; tried with
//! Blender 4.5, 5.0 and 5.3.

use optics_model::fit::MaterialFit;

use super::blocks;
use super::rgb::{RgbMedium, triple};

const HEAD: &str = "\
# Measured media for Blender 4.5 or later: blender --background --python FILE, or Run Script in its text editor.
# Coefficients are per mm; they are multiplied by the millimetres of one Blender unit.
import bpy

MM_PER_UNIT = 1.0  # 1000 if a unit is a metre


def resin(name, absorption, scattering, g, ior):
    material = bpy.data.materials.new(name)
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    output = tree.nodes.new(\"ShaderNodeOutputMaterial\")
    surface = tree.nodes.new(\"ShaderNodeBsdfGlass\")
    surface.inputs[\"Color\"].default_value = (1, 1, 1, 1)
    surface.inputs[\"Roughness\"].default_value = 0.0
    surface.inputs[\"IOR\"].default_value = ior
    volume = tree.nodes.new(\"ShaderNodeVolumeCoefficients\")
    volume.phase = \"HENYEY_GREENSTEIN\"
    volume.inputs[\"Absorption Coefficients\"].default_value = [v * MM_PER_UNIT for v in absorption]
    volume.inputs[\"Scatter Coefficients\"].default_value = [v * MM_PER_UNIT for v in scattering]
    volume.inputs[\"Anisotropy\"].default_value = g
    tree.links.new(surface.outputs[\"BSDF\"], output.inputs[\"Surface\"])
    tree.links.new(volume.outputs[\"Volume\"], output.inputs[\"Volume\"])
    material.use_fake_user = True
    return material


# Light is scattered hundreds of times: without these settings it is lost.
bpy.context.scene.render.engine = \"CYCLES\"
cycles = bpy.context.scene.cycles
cycles.blur_glossy = 0.0
cycles.sample_clamp_indirect = 0.0
cycles.max_bounces = cycles.transmission_bounces = cycles.volume_bounces = 1024
cycles.glossy_bounces = cycles.diffuse_bounces = 1024  # total reflection in the resin, and the base below it
";

pub(crate) fn blender(fits: &[MaterialFit]) -> String {
    let mut text = HEAD.to_owned();
    for block in &blocks(fits) {
        let medium = RgbMedium::of(block);
        text += "\n";
        text += &medium.notes.iter().map(|note| format!("# {note}\n")).collect::<String>();
        text += &format!(
            "resin(\n    {:?},\n    absorption=({}),\n    scattering=({}),\n    g={:?},\n    ior={:?},\n)\n",
            medium.name,
            triple(medium.absorption),
            triple(medium.scattering),
            medium.g,
            medium.ior
        );
    }
    text
}
