//! Formats media for MaterialX and USD: an OpenPBR surface for each medium.
//!
//! Source: OpenPBR 1.1.1, "Translucent base": μ_t = −ln T/λ, μ_s = S/λ. In the draft of OpenPBR 1.2 S is the albedo
//! instead, so files name the version. Tried with MaterialX 1.39.5 and usd-core 26.11.

use optics_model::fit::MaterialFit;

use super::blocks;
use super::mitsuba::xml_comment;
use super::rgb::{OpenPbr, RgbMedium, triple};

/// A MaterialX document.
pub(crate) fn materialx(fits: &[MaterialFit]) -> String {
    let mut text = "<?xml version=\"1.0\"?>\n<materialx version=\"1.39\" colorspace=\"lin_rec709\">\n  \
        <!-- Measured media for OpenPBR 1.1, where transmission_scatter is a coefficient times transmission_depth.\n       \
        Lengths are in mm: for another unit divide transmission_depth by its mm. -->\n"
        .to_owned();
    for block in &blocks(fits) {
        let medium = RgbMedium::of(block);
        let OpenPbr { depth, colour, scatter } = medium.open_pbr();
        let name = medium.name;
        text += &medium.notes.iter().map(|note| xml_comment(note, "  ")).collect::<String>();
        text += &format!("  <open_pbr_surface name=\"{name}__shader\" type=\"surfaceshader\">\n");
        let inputs = [
            ("specular_roughness", "float", "0".to_owned()),
            ("specular_ior", "float", format!("{:?}", medium.ior)),
            ("transmission_weight", "float", "1".to_owned()),
            ("transmission_color", "color3", triple(colour)),
            ("transmission_depth", "float", format!("{depth:.9}")),
            ("transmission_scatter", "color3", triple(scatter)),
            ("transmission_scatter_anisotropy", "float", format!("{:?}", medium.g)),
        ];
        for (input, kind, value) in inputs {
            text += &format!("    <input name=\"{input}\" type=\"{kind}\" value=\"{value}\" />\n");
        }
        text += &format!(
            "  </open_pbr_surface>\n  <surfacematerial name=\"{name}\" type=\"material\">\n    \
             <input name=\"surfaceshader\" type=\"surfaceshader\" nodename=\"{name}__shader\" />\n  </surfacematerial>\n"
        );
    }
    text + "</materialx>\n"
}

/// A USD layer with a material for each medium.
pub(crate) fn usd(fits: &[MaterialFit]) -> String {
    let mut text = "#usda 1.0\n(\n    defaultPrim = \"Resins\"\n    metersPerUnit = 0.001\n    upAxis = \"Z\"\n)\n\n\
        # Measured media as OpenPBR 1.1 surfaces of MaterialX; transmission_depth is in mm, as the stage is.\n\
        def Scope \"Resins\"\n{\n"
        .to_owned();
    for block in &blocks(fits) {
        let medium = RgbMedium::of(block);
        let OpenPbr { depth, colour, scatter } = medium.open_pbr();
        let name = medium.name;
        text += &medium.notes.iter().map(|note| format!("    # {note}\n")).collect::<String>();
        text += &format!(
            "    def Material \"{name}\"
    {{
        token outputs:mtlx:surface.connect = </Resins/{name}/shader.outputs:out>

        def Shader \"shader\"
        {{
            uniform token info:id = \"ND_open_pbr_surface_surfaceshader\"
            float inputs:specular_roughness = 0
            float inputs:specular_ior = {ior:?}
            float inputs:transmission_weight = 1
            color3f inputs:transmission_color = ({})
            float inputs:transmission_depth = {depth:.9}
            color3f inputs:transmission_scatter = ({})
            float inputs:transmission_scatter_anisotropy = {g:?}
            token outputs:out
        }}
    }}
",
            triple(colour),
            triple(scatter),
            ior = medium.ior,
            g = medium.g
        );
    }
    text + "}\n"
}
