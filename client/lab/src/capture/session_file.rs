//! Reads session files in TOML: the photographs, and the known values of patches, board and slabs.

mod doubts;
mod neutral;
mod thickness;

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use optics_capture::{Colour, Neutral, Side, Target};
use optics_model::Invalid;
use serde::Deserialize;

use super::bands::{self, Band, BandTable, PLACE};
use super::globs::files_of;
use super::spectrum::Spectrum;
use crate::grid_file::{from_toml, in_file, read_scene_in, read_text};
use crate::measurement_file::normal;
use crate::record::SessionRecord;
use neutral::NeutralTable;
use thickness::Thickness;

const WHAT: &str = "session file";
/// The place of a value that a person fills in.
pub const BLANK: &str = "?";
/// The field of dark shots.
const DARK: &str = "camera.dark";

/// A session whose files exist and whose numbers are valid.
#[derive(Debug)]
pub struct CaptureSession {
    /// The pattern of mosaics whose files do not state one.
    pub pattern: Option<[Colour; 4]>,
    /// One for each band, or one for red, green and blue.
    pub parts: Vec<SessionPart>,
    pub target: Target,
    pub scene: optics_model::Scene,
    /// Mean wavelength and standard deviation in nm of red, green and blue, by the camera's sensitivities.
    pub colours: Option<[(f64, f64); 3]>,
    /// Values that are valid but implausible.
    pub doubts: Vec<String>,
    pub record: SessionRecord,
    /// The text of the file.
    pub text: String,
}

/// The first field with [`BLANK`] in the place of its value.
fn blank_field(table: &toml::Table) -> Option<String> {
    table.iter().find_map(|(key, value)| match value {
        toml::Value::String(text) if text == BLANK => Some(key.clone()),
        toml::Value::Table(table) => Some(format!("{key}.{}", blank_field(table)?)),
        toml::Value::Array(tables) => {
            let tables = tables.iter().enumerate().filter_map(|(i, value)| Some((i, value.as_table()?)));
            let mut fields =
                tables.filter_map(|(i, table)| Some(format!("{key}[{i}].{}", blank_field(table)?)));
            fields.next()
        }
        _ => None,
    })
}

/// The photographs of red, green and blue, or of one band.
#[derive(Debug)]
pub struct SessionPart {
    /// None for red, green and blue.
    pub band: Option<Band>,
    pub dark: Vec<PathBuf>,
    pub flat: Vec<PathBuf>,
    pub neutral_shots: Vec<PathBuf>,
    pub neutral: Neutral,
    /// Shots of the white at other exposure times.
    pub exposures: Vec<PathBuf>,
    pub bare: Vec<PathBuf>,
    /// An edge in which no light spreads.
    pub edge: Vec<PathBuf>,
    /// Slip and gel over a light trap.
    pub haze: Vec<PathBuf>,
    /// The board under slip and gel.
    pub in_gel: Vec<PathBuf>,
    pub samples: Vec<Sample>,
}

/// A slab and its photographs.
#[derive(Debug, Clone)]
pub struct Sample {
    pub material: String,
    pub thickness_mm: f64,
    pub thickness_std_error_mm: f64,
    pub shots: Vec<PathBuf>,
    /// Shots under lamps without blue.
    pub blue_cut: Vec<PathBuf>,
}

impl Sample {
    /// The name in reports.
    pub fn label(&self) -> String {
        format!("{} {} mm", self.material, self.thickness_mm)
    }
}

impl CaptureSession {
    pub fn read(path: &Path) -> Result<Self> {
        let text = read_text(path, WHAT)?;
        let table: toml::Table = from_toml(&text, path, WHAT)?;
        if let Some(field) = blank_field(&table) {
            let lines = text.lines().enumerate().filter(|(_, line)| line.contains(&format!("= {BLANK:?}")));
            let lines: Vec<String> = lines.map(|(i, _)| (i + 1).to_string()).collect();
            let allowed = format!("to be filled in, as on each of the lines {}", lines.join(", "));
            return Err(in_file(Invalid::new(field, format!("{BLANK:?}"), allowed), &text, path, WHAT));
        }
        let file: SessionFile = from_toml(&text, path, WHAT)?;
        let folder = path.parent().unwrap_or(Path::new("."));
        let scene = match &file.scene {
            None => optics_model::Scene::lab(),
            Some(name) => {
                read_scene_in(name, folder).with_context(|| format!("{WHAT} {}", path.display()))?
            }
        };
        let session = file.checked(folder, scene, text.clone());
        session.map_err(|wrong| in_file(wrong, &text, path, WHAT))
    }

    /// Whether a file is meant as a session: TOML with the tables that every session has.
    pub fn is_at(path: &Path) -> bool {
        let table = read_text(path, WHAT).ok().and_then(|text| text.parse::<toml::Table>().ok());
        table.is_some_and(|table| ["neutral", "target", "sample"].iter().all(|key| table.contains_key(*key)))
    }

    /// All photographs, in the order of their use; those that bands share, once for each.
    pub fn shots(&self) -> impl Iterator<Item = &PathBuf> {
        self.parts.iter().flat_map(SessionPart::shots)
    }
}

impl SessionPart {
    fn shots(&self) -> impl Iterator<Item = &PathBuf> {
        let samples = self.samples.iter().flat_map(|sample| sample.shots.iter().chain(&sample.blue_cut));
        let set_up = [&self.dark, &self.flat, &self.neutral_shots, &self.exposures];
        let board = [&self.bare, &self.edge, &self.haze, &self.in_gel];
        set_up.into_iter().chain(board).flatten().chain(samples)
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct SessionFile {
    /// "lab" (the default), "paper", "smooth" or a scene file.
    scene: Option<String>,
    #[serde(default)]
    camera: CameraTable,
    neutral: NeutralTable,
    target: TargetTable,
    #[serde(default)]
    light: LampTable,
    #[serde(default)]
    record: SessionRecord,
    #[serde(default, rename = "band")]
    bands: Vec<BandTable>,
    #[serde(rename = "sample")]
    samples: Vec<SampleTable>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct LampTable {
    /// A table of the lamps' power over wavelength, in any unit.
    spectrum: Option<String>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct CameraTable {
    #[serde(default)]
    dark: Vec<String>,
    #[serde(default)]
    flat: Vec<String>,
    pattern: Option<String>,
    /// A table of the sensitivities of red, green and blue over wavelength.
    sensitivity: Option<String>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct TargetTable {
    bare: Vec<String>,
    #[serde(default)]
    edge: Vec<String>,
    #[serde(default)]
    haze: Vec<String>,
    #[serde(default)]
    in_gel: Vec<String>,
    square_mm: Option<f64>,
    square_std_error_mm: Option<f64>,
    dark_side: Option<String>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct SampleTable {
    material: String,
    thickness_mm: Thickness,
    thickness_std_error_mm: Option<f64>,
    /// Width and height of the slab.
    slab_mm: Option<[f64; 2]>,
    shots: Vec<String>,
    #[serde(default)]
    blue_cut: Vec<String>,
}

/// The squares and patches of the paper: defaults of fields that a session omits.
const SQUARE_MM: f64 = 20.0;
const SQUARE_STD_ERROR_MM: f64 = 0.01;
const THICKNESS_STD_ERROR_MM: f64 = 0.005;

impl SessionFile {
    fn checked(
        self,
        folder: &Path,
        scene: optics_model::Scene,
        text: String,
    ) -> Result<CaptureSession, Invalid> {
        let mut doubts = doubts::of(&self);
        let pattern = self.camera.pattern.as_deref().map(pattern).transpose()?;
        let target = target(&self.target)?;
        if self.samples.is_empty() {
            return Err(Invalid::new("sample", "none", "at least one [[sample]] is needed"));
        }
        let bands = self.read_bands(folder)?;
        let light = self.light.spectrum.as_deref();
        let light = light.map(|file| Spectrum::only_in(folder, "light.spectrum", file)).transpose()?;
        for band in &bands {
            doubts.extend(doubts::stray(band, light.as_ref())?);
        }
        let colours = self.colours(folder, light.as_ref())?;
        let part = |band| self.part(folder, band, light.as_ref(), &scene);
        let parts = if bands.is_empty() {
            vec![part(None)?]
        } else {
            bands.into_iter().map(|band| part(Some(band))).collect::<Result<_, _>>()?
        };
        doubts.extend(self.neutral.doubt(&parts[0].neutral));
        check_once(&parts)?;
        check_slabs(&parts[0].samples)?;
        let record = self.record.checked()?;
        Ok(CaptureSession { pattern, parts, target, scene, colours, doubts, record, text })
    }

    /// Mean wavelength and standard deviation in nm of red, green and blue.
    fn colours(&self, folder: &Path, light: Option<&Spectrum>) -> Result<Option<[(f64, f64); 3]>, Invalid> {
        const FIELD: &str = "camera.sensitivity";
        let Some(file) = &self.camera.sensitivity else { return Ok(None) };
        let refused = |given: String, allowed: &str| Err(Invalid::new(FIELD, given, allowed));
        if !self.bands.is_empty() {
            return refused(
                format!("{file:?}"),
                "it is for red, green and blue: a [[band]] has a filter of its own",
            );
        }
        let columns = Spectrum::read_in(folder, FIELD, file)?;
        let lit =
            |column: Spectrum| light.map_or(Ok(column.clone()), |light| column.lit("light.spectrum", light));
        let columns = columns.into_iter().map(lit).collect::<Result<Vec<_>, _>>()?;
        let colours: Option<Vec<_>> = columns.iter().map(Spectrum::mean_and_std_dev).collect();
        match colours.as_deref() {
            Some([red, green, blue]) if red.0 > green.0 && green.0 > blue.0 => {
                Ok(Some([*red, *green, *blue]))
            }
            _ => refused(
                format!("{file:?} with {} columns of values", columns.len()),
                "the columns wavelength_nm, R, G and B are needed, red at the longest wavelengths",
            ),
        }
    }

    fn read_bands(&self, folder: &Path) -> Result<Vec<Band>, Invalid> {
        let band = |(i, table): (usize, &BandTable)| {
            let read = |file: &str| Spectrum::only_in(folder, "transmission", file);
            Band::new(table.clone(), read).map_err(|e| e.within(format_args!("band[{i}]")))
        };
        let bands = self.bands.iter().enumerate().map(band).collect::<Result<Vec<_>, _>>()?;
        bands::check(&bands)?;
        Ok(bands)
    }

    /// The photographs of a band, or those of red, green and blue.
    fn part(
        &self,
        folder: &Path,
        band: Option<Band>,
        light: Option<&Spectrum>,
        scene: &optics_model::Scene,
    ) -> Result<SessionPart, Invalid> {
        let files = |field: &str, globs: &[String]| files_of_band(folder, field, globs, band.as_ref());
        let sample = |(i, table): (usize, &SampleTable)| {
            sample(folder, table, band.as_ref()).map_err(|e| e.within(format_args!("sample[{i}]")))
        };
        let haze = files("target.haze", &self.target.haze)?;
        let in_gel = files("target.in_gel", &self.target.in_gel)?;
        if haze.is_empty() && !in_gel.is_empty() {
            let allowed =
                "without `haze`, shots of slip and gel over a light trap, haze and gloss cannot be separated";
            return Err(Invalid::new("target.in_gel", in_gel.len(), allowed));
        }
        Ok(SessionPart {
            edge: files("target.edge", &self.target.edge)?,
            haze,
            in_gel,
            dark: files(DARK, &self.camera.dark)?,
            flat: files("camera.flat", &self.camera.flat)?,
            neutral_shots: needed("neutral.shots", files("neutral.shots", &self.neutral.shots)?)?,
            exposures: files("neutral.exposures", &self.neutral.exposures)?,
            neutral: self.neutral.read(folder, band.as_ref(), light, scene)?,
            bare: needed("target.bare", files("target.bare", &self.target.bare)?)?,
            samples: self.samples.iter().enumerate().map(sample).collect::<Result<_, _>>()?,
            band,
        })
    }
}

/// The files that match patterns, with the name of a band in its place.
fn files_of_band(
    folder: &Path,
    field: &str,
    globs: &[String],
    band: Option<&Band>,
) -> Result<Vec<PathBuf>, Invalid> {
    let Some(band) = band else {
        if let Some((i, glob)) = globs.iter().enumerate().find(|(_, glob)| glob.contains(PLACE)) {
            let allowed = format!("{PLACE} stands for the name of a band: add a [[band]] for each");
            return Err(Invalid::new(format!("{field}[{i}]"), format!("{glob:?}"), allowed));
        }
        return files_of(folder, field, globs);
    };
    let globs: Vec<String> = globs.iter().map(|glob| glob.replace(PLACE, &band.name)).collect();
    files_of(folder, field, &globs)
}

fn sample(folder: &Path, table: &SampleTable, band: Option<&Band>) -> Result<Sample, Invalid> {
    let SampleTable { material, thickness_mm, thickness_std_error_mm, slab_mm, shots, blue_cut } = table;
    if band.is_some() && !blue_cut.is_empty() {
        let allowed = "red, green and blue are compared: in bands, compare a filter before the lamps with one before the camera";
        return Err(Invalid::new("blue_cut", format_args!("{blue_cut:?}"), allowed));
    }
    let within = |field: &str, value: f64, from: f64, to: f64| {
        let allowed = format!("allowed are {from} to {to}");
        if (from..=to).contains(&value) { Ok(value) } else { Err(Invalid::new(field, value, allowed)) }
    };
    let named = !material.is_empty() && material.trim() == *material && !material.contains(char::is_control);
    if !named {
        let allowed = "a name must not be empty, begin or end with a space, or contain a line break";
        return Err(Invalid::new("material", format_args!("{material:?}"), allowed));
    }
    if thickness_mm.readings().is_empty() {
        return Err(Invalid::new("thickness_mm", "[]", "at least one reading is needed"));
    }
    for reading in thickness_mm.readings() {
        within("thickness_mm", *reading, 0.01, 100.0)?;
    }
    for side in slab_mm.iter().flatten() {
        within("slab_mm", *side, 1.0, 1000.0)?;
    }
    let of_instrument = thickness_std_error_mm.unwrap_or(THICKNESS_STD_ERROR_MM);
    Ok(Sample {
        material: normal(material).into_owned(),
        thickness_mm: thickness_mm.mean_mm(),
        thickness_std_error_mm: libm::hypot(
            within("thickness_std_error_mm", of_instrument, 0.0, 1.0)?,
            thickness_mm.scatter_mm(),
        ),
        shots: needed("shots", files_of_band(folder, "shots", shots, band)?)?,
        blue_cut: files_of(folder, "blue_cut", blue_cut)?,
    })
}

fn needed(field: &str, files: Vec<PathBuf>) -> Result<Vec<PathBuf>, Invalid> {
    if files.is_empty() {
        Err(Invalid::new(field, "[]", "at least one photograph is needed"))
    } else {
        Ok(files)
    }
}

/// Checks that each photograph is used once: a repeated one would agree with itself. Bands may share dark shots.
fn check_once(parts: &[SessionPart]) -> Result<(), Invalid> {
    let mut places: HashMap<PathBuf, String> = HashMap::new();
    for part in parts {
        let lists = [
            (DARK.to_owned(), &part.dark),
            ("camera.flat".to_owned(), &part.flat),
            ("neutral.shots".to_owned(), &part.neutral_shots),
            ("neutral.exposures".to_owned(), &part.exposures),
            ("target.bare".to_owned(), &part.bare),
            ("target.edge".to_owned(), &part.edge),
            ("target.haze".to_owned(), &part.haze),
            ("target.in_gel".to_owned(), &part.in_gel),
        ];
        let samples = part.samples.iter().enumerate().flat_map(|(i, sample)| {
            [("shots", &sample.shots), ("blue_cut", &sample.blue_cut)]
                .map(|(field, files)| (format!("sample[{i}].{field}"), files))
        });
        let mut own: HashSet<PathBuf> = HashSet::new();
        for (field, files) in lists.into_iter().chain(samples) {
            for file in files {
                let real = std::fs::canonicalize(file).unwrap_or_else(|_| file.clone());
                let is_repeated = !own.insert(real.clone());
                let Some(before) = places.insert(real, field.clone()) else { continue };
                if field == DARK && before == DARK && !is_repeated {
                    continue;
                }
                let remedy = if is_repeated || part.band.is_none() {
                    String::new()
                } else {
                    format!(", and {PLACE} in a pattern stands for the name of the band")
                };
                let allowed = format!("the photograph is also in {before}; each may be used once{remedy}");
                return Err(Invalid::new(field, file.display(), allowed));
            }
        }
    }
    Ok(())
}

/// Checks that each slab has one entry, so that all its shots make one profile.
fn check_slabs(samples: &[Sample]) -> Result<(), Invalid> {
    for (i, sample) in samples.iter().enumerate() {
        let same = |s: &&Sample| s.material == sample.material && s.thickness_mm == sample.thickness_mm;
        if samples[..i].iter().any(|s| same(&s)) {
            let allowed =
                "a slab has one [[sample]] with all its shots; another slab needs another thickness or name";
            return Err(Invalid::new(format!("sample[{i}].thickness_mm"), sample.label(), allowed));
        }
    }
    Ok(())
}

fn target(table: &TargetTable) -> Result<Target, Invalid> {
    let dark_side = match table.dark_side.as_deref() {
        None => None,
        Some("left") => Some(Side::Left),
        Some("right") => Some(Side::Right),
        Some("top") => Some(Side::Top),
        Some("bottom") => Some(Side::Bottom),
        Some(other) => {
            let allowed = "allowed are \"left\", \"right\", \"top\" and \"bottom\"";
            return Err(Invalid::new("target.dark_side", format_args!("{other:?}"), allowed));
        }
    };
    let square_mm = table.square_mm.unwrap_or(SQUARE_MM);
    if !(0.1..=1000.0).contains(&square_mm) {
        return Err(Invalid::new("target.square_mm", square_mm, "allowed are 0.1 to 1000"));
    }
    let square_std_error_mm = table.square_std_error_mm.unwrap_or(SQUARE_STD_ERROR_MM);
    if !(0.0..=0.1 * square_mm).contains(&square_std_error_mm) {
        let allowed = "allowed are 0 to a tenth of square_mm";
        return Err(Invalid::new("target.square_std_error_mm", square_std_error_mm, allowed));
    }
    Ok(Target { square_mm, square_std_error_mm, dark_side })
}

/// Parses "RGGB", row by row. "mono" distributes the pixels of a monochrome camera over three equal channels.
pub fn pattern(text: &str) -> Result<[Colour; 4], Invalid> {
    if text.eq_ignore_ascii_case("mono") {
        return pattern("RGGB");
    }
    let colour = |c: char| Colour::ALL.into_iter().find(|colour| colour.letter().starts_with(c));
    let colours: Option<Vec<Colour>> = text.to_uppercase().chars().map(colour).collect();
    let refused = || {
        let allowed = "allowed are \"RGGB\", \"BGGR\", \"GRBG\" and \"GBRG\", the \
                       colours of 2 × 2 pixels, row by row, and \"mono\"";
        Invalid::new("camera.pattern", format_args!("{text:?}"), allowed)
    };
    let colours: [Colour; 4] = colours.and_then(|c| c.try_into().ok()).ok_or_else(refused)?;
    let greens = colours.iter().filter(|c| **c == Colour::Green).count();
    let diagonal = colours[0] == colours[3] || colours[1] == colours[2];
    let whole = Colour::ALL.iter().all(|c| colours.contains(c));
    if greens == 2 && diagonal && whole { Ok(colours) } else { Err(refused()) }
}

#[cfg(test)]
mod tests;
