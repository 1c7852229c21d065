//! Which column of a file is what.

use anyhow::{Result, bail};

use super::note::Note;

/// The names of the strict format.
pub const NAMES: [&str; 11] = [
    "material",
    "channel",
    "thickness_mm",
    "x_mm",
    "value",
    "std_error",
    "thickness_std_error_mm",
    "origin_mm",
    "origin_std_error_mm",
    "blur_mm",
    "blur_std_error_mm",
];

/// How many of them must be there.
pub(super) const NEEDED: usize = 5;

/// The names of what is known of a profile's set-up.
pub(super) const SETUP: [&str; 5] = [NAMES[6], NAMES[7], NAMES[8], NAMES[9], NAMES[10]];

/// A column's place in the rows, and the factor that makes its numbers mm or radiance factors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Column {
    pub place: usize,
    pub factor: f64,
    /// Name in the strict format.
    pub name: &'static str,
}

/// The columns of a file.
#[derive(Debug)]
pub(super) struct Columns {
    pub material: Column,
    pub channel: Column,
    pub thickness: Column,
    pub x: Column,
    pub value: Column,
    pub std_error: Option<Column>,
    /// In the order of [`SETUP`].
    pub setup: [Option<Column>; 5],
}

impl Columns {
    /// Refuses names that are not known, that are missing, and two that mean the same.
    pub fn find(header: &csv::StringRecord, notes: &mut Vec<Note>) -> Result<Self> {
        let mut found: [Option<(Meaning, usize)>; NAMES.len()] = [None; NAMES.len()];
        let mut assumed = Vec::new();
        for (place, given) in header.iter().enumerate().filter(|(_, given)| !given.is_empty()) {
            let Some(meaning) = meaning(given) else {
                bail!("column {given:?} is not known; the columns are {}", NAMES.join(", "));
            };
            if meaning.unit == Unit::Pixels {
                bail!(
                    "column {given:?} counts pixels; mm are wanted: multiply by the pixel pitch{}",
                    if meaning.field == 3 { ", with 0 at the edge" } else { "" }
                );
            }
            if let Some((_, earlier)) = found[meaning.field] {
                let (first, name) = (&header[earlier], NAMES[meaning.field]);
                bail!("columns {first:?} and {given:?} could both be {name}: leave one out or rename it");
            }
            found[meaning.field] = Some((meaning, place));
            if given != NAMES[meaning.field] {
                assumed.push(meaning.described(given));
            }
        }
        let missing: Vec<_> = (0..NEEDED).filter(|f| found[*f].is_none()).map(|f| NAMES[f]).collect();
        if !missing.is_empty() {
            let s = if missing.len() == 1 { "" } else { "s" };
            bail!("missing column{s} {}; needed are {}", missing.join(", "), NAMES[..NEEDED].join(", "));
        }
        if let [_, _, _, _, Some((value, _)), Some((error, place)), ..] = found
            && value.unit == Unit::Percent
            && error.unit == Unit::None
        {
            let given = &header[place];
            bail!(
                "column {given:?} has no unit, while the values are in per cent: name it \"{given} (%)\" or give both as radiance factors"
            );
        }
        if !assumed.is_empty() {
            notes.push(Note::new("COLUMNS", format!("columns: {}", assumed.join(", "))));
        }
        let column = |field: usize| {
            found[field].map(|(m, place)| Column { place, factor: m.unit.factor(), name: NAMES[field] })
        };
        match [0, 1, 2, 3, 4].map(column) {
            [Some(material), Some(channel), Some(thickness), Some(x), Some(value)] => {
                let (std_error, setup) = (column(5), [6, 7, 8, 9, 10].map(column));
                Ok(Self { material, channel, thickness, x, value, std_error, setup })
            }
            _ => bail!("needed are {}", NAMES[..NEEDED].join(", ")),
        }
    }

    /// Those that hold numbers.
    pub fn numbers(&self) -> impl Iterator<Item = Column> {
        let optional = [self.std_error].into_iter().chain(self.setup).flatten();
        [self.thickness, self.x, self.value].into_iter().chain(optional)
    }
}

/// How many of these names are understood.
pub(super) fn understood(header: &csv::StringRecord) -> usize {
    header.iter().filter(|name| meaning(name).is_some()).count()
}

/// Whether cells hold units, or nothing, where numbers are wanted.
pub(super) fn are_units(cells: &[&str]) -> bool {
    let unit =
        |cell: &str| Unit::of(&cell.trim_matches(['(', ')', '[', ']']).trim().to_lowercase()).is_some();
    let none = |cell: &str| ["", "-", "1", "a.u."].contains(&cell);
    cells.iter().any(|cell| unit(cell)) && cells.iter().all(|cell| unit(cell) || none(cell))
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Unit {
    None,
    Millimetres,
    Micrometres,
    Centimetres,
    Metres,
    Nanometres,
    Pixels,
    Percent,
}

impl Unit {
    fn of(text: &str) -> Option<Self> {
        Some(match text {
            "mm" => Self::Millimetres,
            // The micro sign and the Greek letter.
            "um" | "\u{b5}m" | "\u{3bc}m" | "micron" | "microns" => Self::Micrometres,
            "cm" => Self::Centimetres,
            "m" => Self::Metres,
            "nm" => Self::Nanometres,
            "px" | "pixel" | "pixels" => Self::Pixels,
            "%" | "percent" | "pct" => Self::Percent,
            _ => return None,
        })
    }

    fn factor(self) -> f64 {
        match self {
            Self::Micrometres => 1e-3,
            Self::Centimetres => 10.0,
            Self::Metres => 1e3,
            Self::Percent => 0.01,
            Self::None | Self::Millimetres | Self::Nanometres | Self::Pixels => 1.0,
        }
    }
}

/// The meaning of a column's name.
#[derive(Debug, Clone, Copy)]
struct Meaning {
    /// Index into [`NAMES`].
    field: usize,
    unit: Unit,
}

impl Meaning {
    fn described(self, given: &str) -> String {
        let name = NAMES[self.field];
        match self.unit.factor() {
            1.0 => format!("{given:?} is read as {name}"),
            factor if factor < 1.0 => {
                format!("{given:?} is divided by {} and read as {name}", (1.0 / factor).round())
            }
            factor => format!("{given:?} is multiplied by {factor} and read as {name}"),
        }
    }
}

fn meaning(name: &str) -> Option<Meaning> {
    let name = name.to_lowercase();
    let (words, unit) = split_unit(name.trim())?;
    let base: String = words.chars().filter(|c| !" _-./".contains(*c)).collect();
    let field = match base.as_str() {
        "material" | "sample" | "specimen" | "resin" => 0,
        "channel" | "colour" | "color" | "band" | "wavelength" => 1,
        "thickness" | "t" | "slabthickness" | "samplethickness" => 2,
        "x" | "position" | "pos" | "xposition" | "distance" => 3,
        "value" | "radiance" | "radiancefactor" | "reflectance" | "reflectancefactor" | "intensity"
        | "mean" => 4,
        "stderror" | "standarderror" | "stderr" | "error" | "sigma" | "std" | "stddev" | "stdev"
        | "standarddeviation" | "sd" | "se" | "sem" | "uncertainty" => 5,
        "thicknessstderror" | "thicknessstandarderror" | "thicknesserror" | "thicknessuncertainty" => 6,
        "origin" | "x0" => 7,
        "originstderror" | "originstandarderror" | "originerror" | "originuncertainty" => 8,
        "blur" => 9,
        "blurstderror" | "blurstandarderror" | "blurerror" | "bluruncertainty" => 10,
        _ => return None,
    };
    let fits = match unit {
        Unit::None => true,
        Unit::Nanometres => field == 1,
        Unit::Percent => field == 4 || field == 5,
        Unit::Pixels => field == 3 || field >= 7,
        _ => field == 2 || field == 3 || field >= 6,
    };
    fits.then_some(Meaning { field, unit })
}

/// `thickness (mm)`, `thickness [mm]`, `thickness_mm`, `thickness mm`, `thickness/mm`; None if what stands in brackets
/// is no unit.
fn split_unit(name: &str) -> Option<(&str, Unit)> {
    if let Some((words, rest)) = name.split_once(['(', '[']) {
        let unit = rest.trim_end().strip_suffix([')', ']'])?;
        return Some((words.trim(), Unit::of(unit.trim())?));
    }
    if let Some((words, unit)) = name.rsplit_once(['_', ' ', '/'])
        && let Some(unit) = Unit::of(unit.trim())
    {
        return Some((words.trim(), unit));
    }
    Some((name, Unit::None))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn find(header: &str) -> Result<(Columns, Vec<Note>)> {
        let mut notes = Vec::new();
        let columns = Columns::find(&header.split(',').collect::<csv::StringRecord>(), &mut notes)?;
        Ok((columns, notes))
    }

    #[test]
    fn strict_names_in_any_order_are_read_without_a_note() {
        let (columns, notes) = find("value,x_mm,std_error,material,channel,thickness_mm").unwrap();
        assert!(notes.is_empty());
        assert_eq!((columns.value.place, columns.thickness.place), (0, 5));
        assert!(columns.numbers().all(|c| c.factor == 1.0));
    }

    #[test]
    fn synonyms_and_units_are_read_with_one_note() {
        for header in [
            "Sample,Channel,thickness (mm),Position,Radiance,sigma",
            "material,colour,t_mm,x,reflectance,std",
            "RESIN,Wavelength (nm),Thickness [mm],x / mm,Radiance Factor,Standard deviation",
        ] {
            let (columns, notes) = find(header).unwrap();
            assert_eq!(notes.len(), 1, "{header}");
            let places = [columns.material, columns.channel, columns.thickness, columns.x, columns.value];
            assert_eq!(places.map(|c| c.place), [0, 1, 2, 3, 4], "{header}");
            assert_eq!(columns.std_error.unwrap().place, 5, "{header}");
        }
        let (columns, notes) = find("material,channel,thickness (\u{b5}m),x_cm,value (%),error (%)").unwrap();
        let factors: Vec<f64> = columns.numbers().map(|c| c.factor).collect();
        assert_eq!(factors, [0.001, 10.0, 0.01, 0.01]);
        assert!(notes[0].text.contains("\"x_cm\" is multiplied by 10 and read as x_mm"), "{}", notes[0].text);
        assert!(notes[0].text.contains("\"thickness (\u{b5}m)\" is divided by 1000"), "{}", notes[0].text);
    }

    /// Pixels and percentages are refused.
    #[test]
    fn set_up_columns_take_any_unit_of_length() {
        let all = "material,channel,thickness_mm,x_mm,value";
        let (columns, notes) = find(&format!("{all},{}", SETUP.join(","))).unwrap();
        assert!(notes.is_empty(), "{notes:?}");
        assert_eq!(columns.setup.map(|c| c.unwrap().place), [5, 6, 7, 8, 9]);
        let (columns, notes) = find(&format!("{all},Blur (\u{b5}m),Thickness error [um]")).unwrap();
        let factors = columns.setup.map(|c| c.map(|c| c.factor));
        assert_eq!(factors, [Some(1e-3), None, None, Some(1e-3), None]);
        assert!(notes[0].text.contains("is divided by 1000 and read as blur_mm"), "{}", notes[0].text);
        let pixels = find(&format!("{all},blur_px")).unwrap_err().to_string();
        assert!(pixels.starts_with("column \"blur_px\" counts pixels"), "{pixels}");
        let percent = find(&format!("{all},blur (%)")).unwrap_err().to_string();
        assert!(percent.contains("is not known"), "{percent}");
    }

    #[test]
    fn what_is_ambiguous_or_unknown_is_refused() {
        let refused = |header: &str| find(header).unwrap_err().to_string();
        let twice = refused("material,channel,thickness_mm,x_mm,radiance,reflectance");
        assert_eq!(
            twice,
            "columns \"radiance\" and \"reflectance\" could both be value: leave one out or rename it"
        );
        assert!(refused("material,channel,t,x_px,value").contains("counts pixels"));
        assert!(refused("material,channel,t,x,value (%),std").contains("\"std\" has no unit"));
        for unknown in ["sigma_t", "value (mm)", "x (%)", "value (a.u.)", "hue"] {
            let message = refused(&format!("material,channel,{unknown}"));
            assert!(
                message.contains(&format!("column {unknown:?} is not known; the columns are")),
                "{message}"
            );
        }
    }
}
