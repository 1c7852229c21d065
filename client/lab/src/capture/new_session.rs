//! Makes a session file from a folder of photographs: sorts them by what they show and when they were taken, and leaves
//! blank what only a person knows.

mod texts;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};
use optics_capture::{BoardGlance, Colour, Darks, FrameNumbers, ShotContent, board_subjects, content};
use serde::Serialize;

use super::picture::Thumbnail;
use super::shots::Shots;
use crate::document::ValueTable;
use crate::whole_file::write_whole;

/// Files that are written into the folder.
pub const SESSION: &str = "session.toml";
const CONTACT: &str = "contact.html";

/// Endings of files that lie next to photographs, and of incomplete ones.
const OTHERS: [&str; 12] =
    ["csv", "crdownload", "html", "json", "md", "part", "pdf", "svg", "tmp", "toml", "txt", "xmp"];

/// Endings of cameras' own formats, which [`CONVERTER`] converts to DNG.
const CAMERAS_OWN: [&str; 11] = ["3fr", "arw", "cr2", "cr3", "crw", "iiq", "nef", "orf", "pef", "raf", "rw2"];
const CONVERTER: &str = "dnglab";

/// Fewest names without numbers from which on names say what photographs show: cameras count under one or two.
const LEAST_STEMS: usize = 4;
/// Largest difference of the levels of dark shots, as a share of the sensor's range.
const SAME_BLACK: f64 = 0.001;
/// Dark shots whose mean is used.
const MOST_DARKS: usize = 4;

/// The use of a photograph in a session.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Purpose {
    Dark,
    Flat,
    Neutral,
    Bare,
    Haze,
    InGel,
    /// Slabs are numbered from 1 on.
    Slab {
        slab: usize,
    },
    Unused {
        reason: String,
    },
}

/// A photograph and its use.
#[derive(Debug, Serialize)]
pub struct SortedShot {
    pub name: String,
    pub purpose: Purpose,
    #[serde(skip)]
    taken_s: Option<f64>,
    #[serde(skip)]
    thumbnail: Option<Thumbnail>,
}

/// The photographs of a folder in the order in which a session lists them.
#[derive(Debug)]
pub struct SortedFolder {
    pub shots: Vec<SortedShot>,
    pattern: Option<String>,
    /// Patches in a row, where a chart was found.
    patches: Option<usize>,
    /// Whether the names of files name what they show.
    is_named: bool,
}

/// Whether a file may be a photograph. Formats that cannot be read count too, since their refusal has the remedy.
pub fn is_photograph(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let ending = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    !name.starts_with('.') && !name.ends_with('~') && !OTHERS.contains(&ending.as_str())
}

/// Whether a folder holds raw photographs.
pub fn holds_photographs(folder: &Path) -> bool {
    let is_raw = |path: &PathBuf| {
        let ending = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
        CAMERAS_OWN.contains(&ending.as_str()) || ["dng", "tif", "tiff", "pgm"].contains(&ending.as_str())
    };
    photographs(folder).is_ok_and(|files| files.iter().any(is_raw))
}

/// Sorts the photographs of a folder; `report` is called with the share that is done. The pattern is that of mosaics whose
/// files state none.
pub fn sort_folder(
    folder: &Path,
    pattern: Option<&str>,
    mut report: impl FnMut(f64),
) -> Result<SortedFolder> {
    let files = converted(photographs(folder)?, CONVERTER)?;
    let colours = pattern.map(super::pattern).transpose().map_err(|e| e.renamed("pattern"))?;
    let looks = 2 * files.len();
    let (darks, most) = dark_shots(&files, colours, |done| report(done as f64 / looks as f64))?;
    let mut shots = Shots::new(colours, folder);
    let mut seen: Vec<(String, Result<ShotContent>)> = Vec::new();
    let mut first_size: Option<((usize, usize), String)> = None;
    for (i, file) in files.iter().enumerate() {
        report((files.len() + i) as f64 / looks as f64);
        let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let read = shots.read(file, "").and_then(|photo| {
            let size = (photo.frame.width(), photo.frame.height());
            let (first, of) = first_size.get_or_insert_with(|| (size, name.clone()));
            if *first != size {
                bail!("it has {} × {} pixels, {of} has {} × {}", size.0, size.1, first.0, first.1);
            }
            Ok(content(&photo, darks.clone(), most)?)
        });
        seen.push((name, read));
    }
    if let [(name, Err(error)), others @ ..] = seen.as_slice()
        && others.iter().all(|(_, seen)| seen.is_err())
    {
        bail!(
            "none of {} photographs of {} can be used, such as {name}: {error:#}",
            files.len(),
            folder.display()
        );
    }
    let patches = seen.iter().find_map(|(_, seen)| match seen {
        Ok(ShotContent::Patches(count)) => Some(*count),
        _ => None,
    });
    let words = seen.iter().map(|(name, _)| stem(name)).filter(|stem| stem.contains(char::is_alphabetic));
    let stems: BTreeSet<&str> = words.collect();
    let is_named = stems.len() >= LEAST_STEMS;
    let purposes = purposes(&seen, is_named);
    let mut about: BTreeMap<String, _> =
        shots.into_inputs().into_iter().map(|input| (input.label.clone(), input)).collect();
    let shot = |((name, _), purpose): ((String, _), Purpose)| {
        let input = about.remove(&name);
        let taken_s = input.as_ref().and_then(|input| input.about.taken_s);
        SortedShot { purpose, taken_s, thumbnail: input.and_then(|input| input.thumbnail), name }
    };
    let mut shots: Vec<SortedShot> = seen.into_iter().zip(purposes).map(shot).collect();
    let at = |shot: &SortedShot| shot.taken_s.unwrap_or(0.0);
    shots.sort_by(|a, b| a.purpose.cmp(&b.purpose).then(at(a).total_cmp(&at(b))));
    Ok(SortedFolder { shots, pattern: pattern.map(ToOwned::to_owned), patches, is_named })
}

fn photographs(folder: &Path) -> Result<Vec<PathBuf>> {
    let place = || format!("photographs of {}", folder.display());
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).with_context(place)? {
        let path = entry.with_context(place)?.path();
        if path.is_file() && is_photograph(&path) {
            files.push(path);
        }
    }
    if files.is_empty() {
        bail!("no photographs are in {}", folder.display());
    }
    files.sort();
    Ok(files)
}

/// The photographs with DNG files in the place of cameras' own, converted by a program if it is installed.
fn converted(files: Vec<PathBuf>, converter: &str) -> Result<Vec<PathBuf>> {
    let convert = |file: PathBuf| {
        let ending = file.extension().unwrap_or_default().to_string_lossy().to_lowercase();
        if !CAMERAS_OWN.contains(&ending.as_str()) {
            return Ok(file);
        }
        let dng = file.with_extension("dng");
        if dng.exists() {
            return Ok(dng);
        }
        match Command::new(converter).arg("convert").args([&file, &dng]).output() {
            Ok(_) if dng.exists() => Ok(dng),
            Ok(ended) => {
                let said = String::from_utf8_lossy(&ended.stderr);
                bail!("{converter} does not convert {}: {}", file.display(), said.trim())
            }
            // It is refused when it is read, with the remedy.
            Err(_) => Ok(file),
        }
    };
    let mut files = files.into_iter().map(convert).collect::<Result<Vec<_>>>()?;
    files.sort();
    files.dedup();
    Ok(files)
}

/// The dark shots among photographs, which are the dimmest ones, and the number at which the sensor saturates. Those that
/// cannot be read are no dark shots.
fn dark_shots(
    files: &[PathBuf],
    colours: Option<[Colour; 4]>,
    mut report: impl FnMut(usize),
) -> Result<(Darks, f64)> {
    let mut shots = Shots::new(colours, Path::new(""));
    let mut all: Vec<(FrameNumbers, &PathBuf)> = Vec::new();
    for (i, file) in files.iter().enumerate() {
        report(i);
        all.extend(shots.read(file, "").ok().map(|photo| (FrameNumbers::of(&photo), file)));
    }
    let most = all.iter().map(|(numbers, _)| numbers.most()).fold(1.0, f64::max);
    all.retain(|(numbers, _)| numbers.may_be_dark(most));
    let least = all.iter().map(|(numbers, _)| numbers.mean).fold(f64::INFINITY, f64::min);
    let mut darks = Darks::new();
    for (_, file) in all.iter().filter(|(n, _)| n.mean < least + SAME_BLACK * most).take(MOST_DARKS) {
        // One with other settings than the first is listed as unused.
        darks.add(shots.read(file, "")?).ok();
    }
    Ok((darks, most))
}

/// The uses of photographs; where names say more, slabs are those of their names.
fn purposes(seen: &[(String, Result<ShotContent>)], is_named: bool) -> Vec<Purpose> {
    let mut boards: Vec<(usize, &BoardGlance)> = Vec::new();
    for (i, (_, content)) in seen.iter().enumerate() {
        if let Ok(ShotContent::Board(glance)) = content {
            boards.push((i, glance));
        }
    }
    let glances: Vec<BoardGlance> = boards.iter().map(|(_, glance)| (*glance).clone()).collect();
    let (subjects, transparent) = board_subjects(&glances);
    let haze = seen.iter().any(|(_, content)| matches!(content, Ok(ShotContent::Dim)));
    let board = |i: usize| {
        let place = boards.iter().position(|(at, _)| *at == i).unwrap_or_default();
        match subjects[place] {
            0 => Purpose::Bare,
            // Gel over the board is measured together with the haze of the gel.
            subject if haze && transparent.first() == Some(&subject) => Purpose::InGel,
            _ if is_named => {
                let same = boards.iter().position(|(at, _)| stem(&seen[*at].0) == stem(&seen[i].0));
                Purpose::Slab { slab: same.unwrap_or(place) }
            }
            slab => Purpose::Slab { slab },
        }
    };
    let unused = |reason| Purpose::Unused { reason };
    let purpose = |(i, (_, content)): (usize, &(String, Result<ShotContent>))| match content {
        Ok(ShotContent::Dark) => Purpose::Dark,
        Ok(ShotContent::Dim) => Purpose::Haze,
        Ok(ShotContent::Even) => Purpose::Flat,
        Ok(ShotContent::Patches(_)) => Purpose::Neutral,
        Ok(ShotContent::Board(_)) => board(i),
        Ok(ShotContent::Other) => unused("neither even nor a row of patches, and without a board".to_owned()),
        Err(error) => unused(format!("{error:#}")),
    };
    let mut purposes: Vec<Purpose> = seen.iter().enumerate().map(purpose).collect();
    let mut slabs: Vec<usize> = Vec::new();
    for purpose in &mut purposes {
        if let Purpose::Slab { slab } = purpose {
            let known = slabs.iter().position(|known| known == slab);
            *slab = 1 + known.unwrap_or_else(|| {
                slabs.push(*slab);
                slabs.len() - 1
            });
        }
    }
    purposes
}

impl SortedFolder {
    fn names(&self, purpose: &Purpose) -> Vec<&str> {
        let shots = self.shots.iter().filter(|shot| shot.purpose == *purpose);
        shots.map(|shot| shot.name.as_str()).collect()
    }

    /// The slabs, each with the names of its shots.
    pub fn slabs(&self) -> Vec<Vec<&str>> {
        let mut slabs: Vec<&Purpose> = self.shots.iter().map(|shot| &shot.purpose).collect();
        slabs.retain(|purpose| matches!(purpose, Purpose::Slab { .. }));
        slabs.dedup();
        slabs.into_iter().map(|purpose| self.names(purpose)).collect()
    }

    /// The photographs of each purpose.
    pub fn table(&self) -> ValueTable {
        let groups = self.shots.chunk_by(|a, b| a.purpose.title() == b.purpose.title());
        let row = |shots: &[SortedShot]| {
            let names: Vec<&str> = shots.iter().map(|shot| shot.name.as_str()).collect();
            vec![shots[0].purpose.title(), shots.len().to_string(), names.join(", ")]
        };
        ValueTable::new("purpose | >shots | photographs", groups.map(row))
    }

    /// Shots that a session needs and the folder lacks.
    pub fn missing(&self) -> Vec<String> {
        let needed = [
            (
                Purpose::Dark,
                2,
                "dark shots (lens cap on): without them, the black level is that of the files",
            ),
            (Purpose::Flat, 2, "shots of an even sheet: without them, light is taken as even"),
            (
                Purpose::Neutral,
                2,
                "shots of a row of grey patches, before and after the slabs; for one certified panel, \
              move its shots from `flat` to `neutral`",
            ),
            (Purpose::Bare, 2, "shots of the bare board"),
        ];
        let lacks = needed.into_iter().filter(|(purpose, least, _)| self.names(purpose).len() < *least);
        let mut missing: Vec<String> = lacks
            .map(|(purpose, least, what)| format!("{} of {least} {what}", self.names(&purpose).len()))
            .collect();
        if self.slabs().is_empty() {
            missing.push("0 of 3 shots of a slab".to_owned());
        }
        missing
    }

    /// Writes session file and contact sheet into the folder; an existing session file is kept.
    pub fn write(&self, folder: &Path) -> Result<[PathBuf; 2]> {
        let here = folder == Path::new(".");
        let [session, contact] =
            [SESSION, CONTACT].map(|name| if here { PathBuf::from(name) } else { folder.join(name) });
        if session.exists() {
            bail!("{} is not replaced: delete or rename it first", session.display());
        }
        write_whole(&session, self.session_file().as_bytes())
            .with_context(|| session.display().to_string())?;
        write_whole(&contact, self.contact_sheet().as_bytes())
            .with_context(|| contact.display().to_string())?;
        Ok([session, contact])
    }
}

impl Purpose {
    /// The field of a session file that lists such shots.
    pub fn title(&self) -> String {
        match self {
            Self::Dark => "camera.dark: no light".to_owned(),
            Self::Flat => "camera.flat: an even sheet".to_owned(),
            Self::Neutral => "neutral.shots: grey patches".to_owned(),
            Self::Bare => "target.bare: the board".to_owned(),
            Self::Haze => "target.haze: slip and gel over a light trap".to_owned(),
            Self::InGel => "target.in_gel: the board under slip and gel".to_owned(),
            Self::Slab { slab } => format!("sample {slab}: a slab"),
            Self::Unused { .. } => "not used".to_owned(),
        }
    }
}

/// A name without its ending and the number of the shot.
fn stem(name: &str) -> &str {
    let name = name.rsplit_once('.').map_or(name, |(stem, _)| stem);
    name.trim_end_matches(|c: char| c.is_ascii_digit()).trim_end_matches(['_', '-', ' ', '.'])
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt as _;

    use super::texts::material;
    use super::*;

    /// The number of the shot is no part of a name, and the thickness none of the material.
    #[test]
    fn names_give_slabs_and_materials() {
        assert_eq!(["white_05_1.dng", "IMG_0812.DNG", "12.dng"].map(stem), ["white_05", "IMG", ""]);
        let materials = ["white_05_1.dng", "clear blue 0.5mm-2.tif", "07.dng"].map(material);
        assert_eq!(materials, [Some("white"), Some("clear blue"), None]);
    }

    /// A camera's own file is converted once if the program is there, and kept otherwise; a failure names the file and what
    /// the program said.
    #[test]
    fn cameras_own_files_are_converted() {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str| folder.path().join(name);
        let program = |text: &str| {
            let path = file("converter");
            std::fs::write(&path, format!("#!/bin/sh\n{text}\n")).unwrap();
            std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
            path.to_str().unwrap().to_owned()
        };
        std::fs::write(file("a.CR3"), "raw").unwrap();
        let files = || vec![file("a.CR3"), file("b.dng")];
        assert_eq!(converted(files(), "/no/such/program").unwrap(), files());
        let failed = converted(files(), &program("echo unknown camera >&2; exit 1")).unwrap_err().to_string();
        assert!(failed.contains("a.CR3: unknown camera"), "{failed}");
        let copies = program("[ \"$1\" = convert ] && cp \"$2\" \"$3\"");
        for _ in 0..2 {
            assert_eq!(converted(files(), &copies).unwrap(), [file("a.dng"), file("b.dng")]);
        }
        let both = vec![file("a.CR3"), file("a.dng")];
        assert_eq!(converted(both, "/no/such/program").unwrap(), [file("a.dng")]);
    }
}
