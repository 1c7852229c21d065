//! Implements `farmctl chart`: a chart of printed stacks, as a table and as models for a slicer.

use std::io::{Cursor, Write as _};
use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Args;
use farm_lab::chart::{ChartDesign, PrintedPatch};
use farm_lab::document::Block;
use farm_lab::slabs::parsed;
use serde::Serialize;
use zip::write::SimpleFileOptions;

use crate::output::{Output, write_whole};
use crate::slurm::shell_quoted;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  farmctl chart white cyan magenta yellow -o chart
  farmctl chart white black --layer 0.08,0.2 --base white:0.8 --patches 60 -o greys

The folder has a model in 3MF for each layer height, with one object for each material; chart.csv,
whose columns L, a and b you fill in from a photograph or an instrument; and chart.toml, its
settings for `farmctl measure`.")]
pub(crate) struct ChartArgs {
    /// Names of the materials; the first is that of the base.
    #[arg(required = true)]
    materials: Vec<String>,
    /// Heights of a layer in mm: a plate is made for each. Two heights show how predictions carry over.
    #[arg(long, value_name = "MM,…", value_delimiter = ',', default_value = "0.08")]
    layer: Vec<f64>,
    /// Patches on a plate.
    #[arg(long, value_name = "N", default_value_t = 100)]
    patches: usize,
    /// The slab under all patches, as MATERIAL:MM [default: 0.8 mm of the first material].
    #[arg(long, value_name = "SLAB")]
    base: Option<String>,
    /// Width of a patch in mm.
    #[arg(long, value_name = "MM", default_value_t = 8.0)]
    width: f64,
    /// The folder.
    #[arg(long, short, value_name = "DIR")]
    output: PathBuf,
}

#[derive(Debug, Serialize)]
struct WrittenChart {
    output: PathBuf,
    files: Vec<String>,
    patches: usize,
}

pub(crate) fn run(args: &ChartArgs, output: &Output) -> Result<()> {
    for mm in args.layer.iter().chain([&args.width]) {
        optics_model::medium::check_thickness(*mm)?;
    }
    let is_material = |name: &str| args.materials.iter().any(|material| material == name);
    let base = args.base.clone().unwrap_or_else(|| format!("{}:0.8", args.materials[0]));
    let base = parsed(&base, is_material)?;
    let name = &base.shares[0].0;
    if base.shares.len() > 1 || !is_material(name) {
        anyhow::bail!("--base {name}: one of the materials is needed: {}", args.materials.join(", "));
    }
    let design = ChartDesign {
        materials: args.materials.clone(),
        layers_mm: args.layer.clone(),
        patches: args.patches,
        base,
    };
    let plates = design.plates()?;
    if args.output.join("chart.csv").exists() {
        anyhow::bail!("{} has a chart.csv already: choose another folder", args.output.display());
    }
    std::fs::create_dir_all(&args.output).with_context(|| format!("folder {}", args.output.display()))?;
    let mut files = vec![("chart.csv".to_owned(), design.table(&plates).into_bytes())];
    files.push(("chart.toml".to_owned(), SETTINGS.as_bytes().to_vec()));
    for (plate, layer_mm) in plates.iter().zip(&args.layer) {
        files.push((format!("chart-{layer_mm}.3mf"), model(&design, plate, *layer_mm, args.width)?));
    }
    for (name, bytes) in &files {
        write_whole(&args.output.join(name), bytes).with_context(|| name.clone())?;
    }
    let files: Vec<String> = files.into_iter().map(|(name, _)| name).collect();
    let data = WrittenChart { output: args.output.clone(), files, patches: args.patches * plates.len() };
    output.answer("printed_chart", &data, || {
        let folder = shell_quoted(&args.output.display().to_string());
        vec![
            Block::Paragraph(format!("written to {folder}: {}, {} patches", data.files.join(", "), data.patches)),
            Block::Aside(format!(
                "print it, fill in L, a and b of chart.csv, row 1 being the farthest from you on the plate, then \
                 `farmctl measure {folder}/chart.toml -o media`"
            )),
        ]
    })
}

/// The settings of a chart that is to be measured.
const SETTINGS: &str = r#"# Settings of `farmctl measure`; docs/prints.md explains them.
values = "chart.csv"
# 45:0 for photographs with lamps from the side and most spectrophotometers, d:8 for spheres.
geometry = "45:0"
# 1.46 for polylactide, 1.5 for most resins.
sample_ior = 1.5
sample_ior_std_error = 0.03
# Standard error of all thicknesses together, as a share.
thickness_std_error = 0.03
"#;

/// A box by two corners.
type Corners = [[f64; 3]; 2];

/// The plate as 3MF: an object for each material, of boxes that touch.
fn model(design: &ChartDesign, plate: &[PrintedPatch], layer_mm: f64, width_mm: f64) -> Result<Vec<u8>> {
    let columns = plate.iter().map(|patch| patch.column + 1).max().unwrap_or(1);
    let rows = plate.iter().map(|patch| patch.row + 1).max().unwrap_or(1);
    let base_mm = design.base.thickness_mm;
    let mut boxes: Vec<Vec<Corners>> = vec![Vec::new(); design.materials.len()];
    let base_material =
        design.materials.iter().position(|name| *name == design.base.shares[0].0).unwrap_or(0);
    boxes[base_material].push([[0.0; 3], [columns as f64 * width_mm, rows as f64 * width_mm, base_mm]]);
    for patch in plate {
        // Rows go downwards, as in a photograph from above.
        let (x, y) = (patch.column as f64 * width_mm, (rows - 1 - patch.row) as f64 * width_mm);
        let mut z = base_mm;
        let mut upwards = patch.layers.clone();
        upwards.reverse();
        for run in upwards.chunk_by(|a, b| a == b) {
            let top = z + run.len() as f64 * layer_mm;
            boxes[run[0]].push([[x, y, z], [x + width_mm, y + width_mm, top]]);
            z = top;
        }
    }
    let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
    let options = SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
    for (name, text) in [
        ("[Content_Types].xml", CONTENT_TYPES.to_owned()),
        ("_rels/.rels", RELATIONS.to_owned()),
        ("3D/3dmodel.model", model_xml(&design.materials, &boxes)),
    ] {
        zip.start_file(name, options)?;
        zip.write_all(text.as_bytes())?;
    }
    Ok(zip.finish()?.into_inner())
}

const CONTENT_TYPES: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types"><Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/><Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/></Types>
"#;
const RELATIONS: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships"><Relationship Target="/3D/3dmodel.model" Id="rel0" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/></Relationships>
"#;

fn model_xml(names: &[String], boxes: &[Vec<Corners>]) -> String {
    let mut text = String::from(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<model unit=\"millimeter\" \
         xmlns=\"http://schemas.microsoft.com/3dmanufacturing/core/2015/02\"><resources>\n",
    );
    for (i, (name, boxes)) in names.iter().zip(boxes).enumerate() {
        text +=
            &format!("<object id=\"{}\" name=\"{}\" type=\"model\"><mesh><vertices>\n", i + 1, escaped(name));
        for corners in boxes {
            for k in 0..8 {
                let [x, y, z] = [0, 1, 2].map(|axis| corners[k >> axis & 1][axis]);
                text += &format!("<vertex x=\"{x:.4}\" y=\"{y:.4}\" z=\"{z:.4}\"/>");
            }
        }
        text += "\n</vertices><triangles>\n";
        for first in (0..boxes.len()).map(|i| 8 * i) {
            for [a, b, c] in TRIANGLES {
                text +=
                    &format!("<triangle v1=\"{}\" v2=\"{}\" v3=\"{}\"/>", first + a, first + b, first + c);
            }
        }
        text += "\n</triangles></mesh></object>\n";
    }
    text += "</resources><build>";
    (1..=names.len()).for_each(|id| text += &format!("<item objectid=\"{id}\"/>"));
    text + "</build></model>\n"
}

#[rustfmt::skip]
/// The faces of a box, seen from outside against the clock; bit k of a corner is its side along axis k.
const TRIANGLES: [[usize; 3]; 12] = [
    [0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4],
    [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5],
];

fn escaped(name: &str) -> String {
    name.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A box is closed and seen from outside: its signed volume is that of its sides.
    #[test]
    fn boxes_are_closed_and_outward() {
        let corner = |k: usize| [0, 1, 2].map(|axis| [[1.0, 2.0, 3.0], [3.0, 5.0, 7.0]][k >> axis & 1][axis]);
        let volume = TRIANGLES.map(|triangle| {
            let [a, b, c] = triangle.map(corner);
            let cross = [b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]];
            (0..3).map(|i| a[i] * cross[i]).sum::<f64>() / 6.0
        });
        assert!((volume.iter().sum::<f64>() - 24.0).abs() < 1e-9, "{volume:?}");
        let mut edges: Vec<[usize; 2]> =
            TRIANGLES.iter().flat_map(|[a, b, c]| [[*a, *b], [*b, *c], [*c, *a]]).collect();
        let turned: Vec<[usize; 2]> = edges.iter().map(|[a, b]| [*b, *a]).collect();
        assert!(turned.iter().all(|edge| edges.contains(edge)));
        edges.sort_unstable();
        edges.dedup();
        assert_eq!(edges.len(), 36, "every edge once in each direction");
    }
}
