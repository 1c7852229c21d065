//! Orders the pixels of a profile, and interpolates those without a value.

use anyhow::{Result, bail};
use optics_model::MeasuredProfile;

use super::note::Note;

/// Largest share of a profile's pixels that may be without a value.
const MOST_MISSING: f64 = 0.1;

/// Standard error of an interpolated value. Radiance factors lie between 0 and about 1, so it has no weight.
const UNKNOWN: f64 = 1.0;

/// One row of a profile.
pub(super) struct FileRow {
    pub line: u64,
    /// `None` in the single row of a patch.
    pub x_mm: Option<f64>,
    /// `None` where a pixel is masked.
    pub value: Option<f64>,
    /// `None` where it is not given.
    pub std_error: Option<f64>,
}

impl FileRow {
    /// Unused for patches.
    pub fn x(&self) -> f64 {
        self.x_mm.unwrap_or_default()
    }
}

/// The pixels of one profile in the order of x.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Pixels {
    pub x_mm: Vec<f64>,
    pub values: Vec<f64>,
    /// `None` if no row has one.
    pub std_errors: Option<Vec<f64>>,
    pub lines: Vec<u64>,
    /// Line of the first pixel without a value, and the number of such pixels.
    pub missing: Option<(u64, usize)>,
}

impl Pixels {
    /// Pixels without a value, masked or absent, are interpolated between their neighbours; at the ends they are left
    /// out.
    pub fn of(rows: &[FileRow]) -> Result<Self> {
        let (Some(first), Some(last)) =
            (rows.iter().position(|r| r.value.is_some()), rows.iter().rposition(|r| r.value.is_some()))
        else {
            bail!("no row has a value");
        };
        let ends = rows.len() - (last + 1 - first);
        let rows = &rows[first..=last];
        let given = with_errors(rows)?;
        let filled = filled(rows);
        let missing = ends + filled.iter().filter(|p| p.value.is_none()).count();
        if missing as f64 > MOST_MISSING * (filled.len() + ends) as f64 {
            let masked = ends + rows.iter().filter(|r| r.value.is_none()).count();
            if masked as f64 > MOST_MISSING * (rows.len() + ends) as f64 {
                bail!(
                    "{masked} of {} rows have no value; a tenth may be without: leave the profile out or measure it again",
                    rows.len() + ends
                );
            }
            // Too many rows are absent to be interpolated: the spacing is uneven, which is refused later.
            return Ok(Self::between(&rows.iter().map(PixelPlace::of).collect::<Vec<_>>(), given, masked));
        }
        Ok(Self::between(&filled, given, missing))
    }

    fn between(places: &[PixelPlace], given: bool, missing: usize) -> Self {
        let first = places.iter().find(|p| p.value.is_none()).or(places.first()).map_or(0, |p| p.line);
        let mut pixels = Self { missing: (missing > 0).then_some((first, missing)), ..Self::default() };
        let mut errors = Vec::new();
        for (i, place) in places.iter().enumerate() {
            pixels.x_mm.push(place.x_mm);
            pixels.lines.push(place.line);
            pixels.values.push(place.value.unwrap_or_else(|| interpolated(places, i)));
            errors.push(if place.value.is_some() { place.std_error } else { UNKNOWN });
        }
        pixels.std_errors = given.then_some(errors);
        pixels
    }
}

/// Assumptions about the pixels of a file's profiles.
#[derive(Debug, Default)]
pub(super) struct AssumedPixels {
    /// Profiles whose x are rounded, with the line and the pitch of the first.
    rounded: usize,
    first_rounded: Option<(u64, f64)>,
    /// Pixels without a value, with the line of the first.
    missing: usize,
    first_missing: Option<u64>,
    /// Profiles with and without standard errors, with the line of the first without.
    with_errors: usize,
    without_errors: usize,
    first_without: Option<u64>,
}

impl AssumedPixels {
    /// Counts a profile that was made of pixels at `x_mm`.
    pub fn add(&mut self, profile: &MeasuredProfile, x_mm: &[f64], missing: Option<(u64, usize)>, line: u64) {
        if profile.x_mm() != x_mm {
            self.rounded += 1;
            self.first_rounded.get_or_insert((line, profile.pitch_mm()));
        }
        if let Some((line, count)) = missing {
            self.missing += count;
            self.first_missing.get_or_insert(line);
        }
        if profile.std_errors().is_some() {
            self.with_errors += 1;
        } else {
            self.without_errors += 1;
            self.first_without.get_or_insert(line);
        }
    }

    pub fn notes(&self) -> Vec<Note> {
        let mut notes = Vec::new();
        if let Some((line, pitch)) = self.first_rounded {
            let text = format!(
                "x is rounded in {}, the first of them in line {line}: even steps of {pitch:.5} mm are taken there",
                counted(self.rounded, "profile", "profiles")
            );
            notes.push(Note::new("ROUNDED_X", text));
        }
        if let Some(line) = self.first_missing {
            let pixels = counted(self.missing, "pixel without a value is", "pixels without a value are");
            let text = format!(
                "{pixels} interpolated, the first at line {line}; where standard errors are given, they have no weight"
            );
            notes.push(Note::new("MISSING_PIXELS", text));
        }
        if let (Some(line), true) = (self.first_without, self.with_errors > 0) {
            let text = format!(
                "std_error is empty in {}, the first of them in line {line}: their noise is then \
                 estimated from the scatter of neighbouring pixels",
                counted(self.without_errors, "profile", "profiles")
            );
            notes.push(Note::new("STD_ERRORS", text));
        }
        notes
    }
}

fn counted(count: usize, one: &str, many: &str) -> String {
    format!("{count} {}", if count == 1 { one } else { many })
}

/// Whether the rows with a value have standard errors; they must be given in all of them or in none.
fn with_errors(rows: &[FileRow]) -> Result<bool> {
    let mut valued = rows.iter().filter(|r| r.value.is_some());
    let with = valued.clone().find(|r| r.std_error.is_some());
    let without = valued.find(|r| r.std_error.is_none());
    if let (Some(with), Some(without)) = (with, without) {
        bail!(
            "std_error is empty in line {} but given in line {}: give it in all rows of a profile or in none",
            without.line,
            with.line
        );
    }
    Ok(with.is_some())
}

#[derive(Debug, Clone, Copy)]
struct PixelPlace {
    x_mm: f64,
    value: Option<f64>,
    std_error: f64,
    line: u64,
}

impl PixelPlace {
    fn of(row: &FileRow) -> Self {
        Self { x_mm: row.x(), value: row.value, std_error: row.std_error.unwrap_or_default(), line: row.line }
    }
}

/// The rows, with empty pixels inserted where a step is a multiple of the pitch.
fn filled(rows: &[FileRow]) -> Vec<PixelPlace> {
    let step = step(rows);
    let mut places: Vec<PixelPlace> = Vec::with_capacity(rows.len());
    for row in rows {
        let here = PixelPlace::of(row);
        if let Some(before) = places.last().copied() {
            let steps = ((here.x_mm - before.x_mm) / step).round();
            // A long jump is no gap: the number of inserted pixels is limited.
            for j in 1..steps.min(rows.len() as f64) as usize {
                let x_mm = before.x_mm + (here.x_mm - before.x_mm) * j as f64 / steps;
                places.push(PixelPlace { x_mm, value: None, std_error: UNKNOWN, line: here.line });
            }
        }
        places.push(here);
    }
    places
}

/// The pitch: the mean of the single steps, which may be rounded.
fn step(rows: &[FileRow]) -> f64 {
    let mut steps: Vec<f64> = rows.windows(2).map(|w| w[1].x() - w[0].x()).collect();
    if steps.is_empty() {
        return 1.0;
    }
    steps.sort_by(f64::total_cmp);
    let median = steps[steps.len() / 2];
    let single: Vec<f64> = steps.into_iter().filter(|step| *step < 1.5 * median).collect();
    single.iter().sum::<f64>() / single.len() as f64
}

/// Linear interpolation between the nearest neighbours with a value.
fn interpolated(places: &[PixelPlace], i: usize) -> f64 {
    let with_value = |p: &&PixelPlace| p.value.is_some();
    let (before, after) = (places[..i].iter().rev().find(with_value), places[i..].iter().find(with_value));
    match (before, after) {
        (Some(a), Some(b)) => {
            let (from, to) = (a.value.unwrap_or_default(), b.value.unwrap_or_default());
            from + (to - from) * (places[i].x_mm - a.x_mm) / (b.x_mm - a.x_mm)
        }
        (one, other) => one.or(other).and_then(|p| p.value).unwrap_or_default(),
    }
}
