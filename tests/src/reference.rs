//! Reads the reference values in `tests/data`, whose sources are in `tests/data/README.md`.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result};
use optics_model::phase::{PhaseShape, PhaseTable, SecondLobe};

pub fn data_file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("data").join(name)
}

/// The project's root folder.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the crate lies in the workspace").to_owned()
}

/// An exact radiance factor over a uniform base in the scene `smooth`.
#[derive(Debug, Clone)]
pub struct UniformRow {
    pub sigma_t_per_mm: f64,
    pub albedo: f64,
    pub g: f64,
    pub phase: PhaseShape,
    pub thickness_mm: f64,
    pub sample_ior: f64,
    pub rho: f64,
    pub radiance_factor: f64,
}

/// The rows of `uniform.csv`, whose phase function is Henyey–Greenstein.
pub fn uniform() -> Result<Vec<UniformRow>> {
    uniform_rows("uniform.csv", |_| Ok(PhaseShape::default()))
}

/// The rows of `two_lobes.csv`.
pub fn two_lobes() -> Result<Vec<UniformRow>> {
    uniform_rows("two_lobes.csv", |cell| {
        let [weight, g] = [cell("second_lobe_weight"), cell("second_lobe_g")];
        Ok(PhaseShape::Lobes(SecondLobe::new(weight?.parse()?, g?.parse()?)?))
    })
}

/// The rows of `tabulated.csv`.
pub fn tabulated() -> Result<Vec<UniformRow>> {
    uniform_rows("tabulated.csv", |cell| {
        let name = cell("table")?.trim_end_matches(".csv").to_owned();
        Ok(PhaseShape::Table(Arc::new(phase_table(&name)?)))
    })
}

type Cell<'a> = dyn Fn(&str) -> Result<&'a str> + 'a;

fn uniform_rows(file: &str, phase: impl Fn(&Cell) -> Result<PhaseShape>) -> Result<Vec<UniformRow>> {
    let mut reader = csv::Reader::from_path(data_file(file))?;
    let columns = reader.headers()?.clone();
    let row = |row: csv::Result<csv::StringRecord>| {
        let row = row?;
        let cell = |name: &str| {
            let column = columns.iter().position(|column| column == name);
            column.and_then(|i| row.get(i)).with_context(|| format!("no column {name}"))
        };
        let number = |name: &str| -> Result<f64> { Ok(cell(name)?.parse()?) };
        let phase = phase(&cell)?;
        Ok(UniformRow {
            sigma_t_per_mm: number("sigma_t_per_mm")?,
            albedo: number("albedo")?,
            g: phase.table().map_or_else(|| number("g"), |table| Ok(table.mean_cosine()))?,
            phase,
            thickness_mm: number("thickness_mm")?,
            sample_ior: number("sample_ior")?,
            rho: number("rho")?,
            radiance_factor: number("radiance_factor")?,
        })
    };
    reader.records().map(row).collect()
}

/// A phase function of Mie spheres: `rutile` or `carbon`.
pub fn phase_table(name: &str) -> Result<PhaseTable> {
    let mut reader =
        csv::ReaderBuilder::new().comment(Some(b'#')).from_path(data_file(&format!("phase/{name}.csv")))?;
    let rows: Vec<(f64, f64)> = reader.deserialize().collect::<Result<_, _>>()?;
    let (angle_deg, value) = rows.into_iter().unzip();
    Ok(PhaseTable::new(angle_deg, value)?)
}

/// An edge profile path-traced by Mitsuba in the scene `paper`.
#[derive(Debug, Clone)]
pub struct MitsubaProfile {
    pub name: String,
    pub sigma_t_per_mm: f64,
    pub albedo: f64,
    pub g: f64,
    pub phase: PhaseShape,
    pub thickness_mm: f64,
    pub sample_ior: f64,
    pub rho_light: f64,
    pub rho_dark: f64,
    pub width_mm: f64,
    /// Samples per pixel.
    pub samples: f64,
    pub values: Vec<f64>,
    pub std_errors: Vec<f64>,
}

pub fn mitsuba() -> Result<Vec<MitsubaProfile>> {
    let mut files: Vec<PathBuf> =
        std::fs::read_dir(data_file("mitsuba"))?.map(|e| Ok(e?.path())).collect::<Result<_>>()?;
    files.sort();
    files.iter().map(|file| read_mitsuba(file).with_context(|| file.display().to_string())).collect()
}

fn read_mitsuba(file: &Path) -> Result<MitsubaProfile> {
    let text = std::fs::read_to_string(file)?;
    let header = |key: &str| -> Result<f64> {
        let line = text.lines().find_map(|l| l.strip_prefix(&format!("# {key} = ")));
        Ok(line.with_context(|| format!("no {key}"))?.parse()?)
    };
    let mut reader = csv::ReaderBuilder::new().comment(Some(b'#')).from_reader(text.as_bytes());
    let (mut values, mut std_errors) = (Vec::new(), Vec::new());
    for row in reader.records() {
        let row = row?;
        values.push(row[1].parse()?);
        std_errors.push(row[2].parse()?);
    }
    Ok(MitsubaProfile {
        name: file.file_stem().context("no name")?.to_string_lossy().into_owned(),
        sigma_t_per_mm: header("sigma_t")?,
        albedo: header("albedo")?,
        g: header("g")?,
        phase: match header("second_lobe_weight") {
            Ok(weight) => PhaseShape::Lobes(SecondLobe::new(weight, header("second_lobe_g")?)?),
            Err(_) => PhaseShape::default(),
        },
        thickness_mm: header("thickness_mm")?,
        sample_ior: header("sample_ior")?,
        rho_light: header("rho_light")?,
        rho_dark: header("rho_dark")?,
        width_mm: header("width_mm")?,
        samples: header("spp")?,
        values,
        std_errors,
    })
}
