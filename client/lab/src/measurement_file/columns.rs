//! Recognises the columns of a file by their names.

use anyhow::{Result, bail};
use optics_model::quantities::{self, Quantity};

use super::note::Note;

/// Number of quantities of a profile's set-up.
pub(super) const SET_UP: usize = Quantity::OF_PROFILES.len();

/// A column of the strict format.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ColumnField {
    Material,
    Channel,
    Thickness,
    X,
    Value,
    StdError,
    /// A quantity of the profile's set-up, by its index in [`Quantity::OF_PROFILES`].
    SetUp(usize),
}

impl ColumnField {
    /// The required columns.
    pub(super) const NEEDED: [Self; 5] =
        [Self::Material, Self::Channel, Self::Thickness, Self::X, Self::Value];

    fn all() -> impl Iterator<Item = Self> {
        Self::NEEDED.into_iter().chain([Self::StdError]).chain((0..SET_UP).map(Self::SetUp))
    }

    fn name(self) -> &'static str {
        match self {
            Self::Material => "material",
            Self::Channel => "channel",
            Self::Thickness => "thickness_mm",
            Self::X => "x_mm",
            Self::Value => "value",
            Self::StdError => "std_error",
            Self::SetUp(quantity) => Quantity::OF_PROFILES[quantity].name,
        }
    }

    fn is_length(self) -> bool {
        match self {
            Self::Thickness | Self::X => true,
            Self::SetUp(quantity) => Quantity::OF_PROFILES[quantity].unit == quantities::Unit::Length,
            Self::Material | Self::Channel | Self::Value | Self::StdError => false,
        }
    }

    /// Whether the column's numbers may have a unit. Pixels are recognised so that they can be refused with a reason.
    fn takes(self, unit: ColumnUnit) -> bool {
        match unit {
            ColumnUnit::None => true,
            ColumnUnit::Nanometres => self == Self::Channel,
            ColumnUnit::Percent => matches!(self, Self::Value | Self::StdError),
            ColumnUnit::Pixels => self != Self::Thickness && self.is_length(),
            ColumnUnit::Millimetres
            | ColumnUnit::Micrometres
            | ColumnUnit::Centimetres
            | ColumnUnit::Metres => self.is_length(),
        }
    }

    /// The column with a name, given in lower case without its unit, spaces and punctuation.
    fn of(base: &str) -> Option<Self> {
        Some(match base {
            "material" | "sample" | "specimen" | "resin" => Self::Material,
            "channel" | "colour" | "color" | "band" | "wavelength" => Self::Channel,
            "thickness" | "t" | "slabthickness" | "samplethickness" => Self::Thickness,
            "x" | "position" | "pos" | "xposition" | "distance" => Self::X,
            "value" | "radiance" | "radiancefactor" | "reflectance" | "reflectancefactor" | "intensity"
            | "mean" => Self::Value,
            "stderror" | "standarderror" | "stderr" | "error" | "sigma" | "std" | "stddev" | "stdev"
            | "standarddeviation" | "sd" | "se" | "sem" | "uncertainty" => Self::StdError,
            "x0" => return Self::of("origin"),
            _ => return Self::of_set_up(base),
        })
    }

    fn of_set_up(base: &str) -> Option<Self> {
        let errors = ["standarderror", "stderror", "error", "uncertainty"];
        let error_of = errors.iter().find_map(|error| base.strip_suffix(error));
        let wanted = error_of.map_or_else(|| base.to_owned(), |of| format!("{of}stderror"));
        let is_named =
            |quantity: &Quantity| split_unit(quantity.name).is_some_and(|(n, _)| squeezed(n) == wanted);
        Quantity::OF_PROFILES.iter().position(is_named).map(Self::SetUp)
    }
}

/// The names of the strict format.
pub fn names() -> Vec<&'static str> {
    ColumnField::all().map(ColumnField::name).collect()
}

/// A name without spaces and punctuation.
fn squeezed(name: &str) -> String {
    name.chars().filter(|c| !" _-./".contains(*c)).collect()
}

fn joined(fields: impl IntoIterator<Item = ColumnField>) -> String {
    fields.into_iter().map(ColumnField::name).collect::<Vec<_>>().join(", ")
}

/// A column's index in the rows, and the factor that converts its numbers to mm or radiance factors.
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
    /// In the order of [`Quantity::OF_PROFILES`].
    pub setup: [Option<Column>; SET_UP],
}

impl Columns {
    /// Refuses unknown and missing names, and two with the same meaning.
    pub fn find(header: &csv::StringRecord, notes: &mut Vec<Note>) -> Result<Self> {
        let mut found: Vec<(Meaning, usize)> = Vec::new();
        let mut assumed = Vec::new();
        for (place, given) in header.iter().enumerate().filter(|(_, given)| !given.is_empty()) {
            let Some(meaning) = meaning(given) else {
                bail!("column {given:?} is not known; the columns are {}", names().join(", "));
            };
            let (field, name) = (meaning.field, meaning.field.name());
            if meaning.unit == ColumnUnit::Pixels {
                bail!(
                    "column {given:?} counts pixels: multiply by the pixel pitch to get mm{}",
                    if field == ColumnField::X { ", with 0 at the edge" } else { "" }
                );
            }
            if let Some((_, earlier)) = found.iter().find(|(other, _)| other.field == field) {
                let first = &header[*earlier];
                bail!("columns {first:?} and {given:?} could both be {name}: leave one out or rename it");
            }
            found.push((meaning, place));
            if given != name {
                assumed.push(meaning.described(given));
            }
        }
        let entry = |field: ColumnField| found.iter().find(|(meaning, _)| meaning.field == field).copied();
        let missing: Vec<_> =
            ColumnField::NEEDED.into_iter().filter(|field| entry(*field).is_none()).collect();
        if !missing.is_empty() {
            let s = if missing.len() == 1 { "" } else { "s" };
            bail!("missing column{s} {}; needed are {}", joined(missing), joined(ColumnField::NEEDED));
        }
        if let (Some((value, _)), Some((error, place))) =
            (entry(ColumnField::Value), entry(ColumnField::StdError))
            && value.unit == ColumnUnit::Percent
            && error.unit == ColumnUnit::None
        {
            let given = &header[place];
            bail!(
                "column {given:?} has no unit, while the values are in per cent: name it \"{given} (%)\" or give both as radiance factors"
            );
        }
        if !assumed.is_empty() {
            notes.push(Note::new("COLUMNS", format!("columns: {}", assumed.join(", "))));
        }
        let column = |field: ColumnField| {
            entry(field).map(|(m, place)| Column { place, factor: m.unit.factor(), name: field.name() })
        };
        match ColumnField::NEEDED.map(column) {
            [Some(material), Some(channel), Some(thickness), Some(x), Some(value)] => {
                let setup = std::array::from_fn(|quantity| column(ColumnField::SetUp(quantity)));
                let std_error = column(ColumnField::StdError);
                Ok(Self { material, channel, thickness, x, value, std_error, setup })
            }
            _ => bail!("needed are {}", joined(ColumnField::NEEDED)),
        }
    }

    /// The columns that hold numbers.
    pub fn numbers(&self) -> impl Iterator<Item = Column> {
        let optional = [self.std_error].into_iter().chain(self.setup).flatten();
        [self.thickness, self.x, self.value].into_iter().chain(optional)
    }
}

/// Number of names that are recognised.
pub(super) fn understood(header: &csv::StringRecord) -> usize {
    header.iter().filter(|name| meaning(name).is_some()).count()
}

/// Whether cells hold units, or nothing, where numbers are expected.
pub(super) fn are_units(cells: &[&str]) -> bool {
    let unit =
        |cell: &str| ColumnUnit::of(&cell.trim_matches(['(', ')', '[', ']']).trim().to_lowercase()).is_some();
    let none = |cell: &str| ["", "-", "1", "a.u."].contains(&cell);
    cells.iter().any(|cell| unit(cell)) && cells.iter().all(|cell| unit(cell) || none(cell))
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ColumnUnit {
    None,
    Millimetres,
    Micrometres,
    Centimetres,
    Metres,
    Nanometres,
    Pixels,
    Percent,
}

impl ColumnUnit {
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
    field: ColumnField,
    unit: ColumnUnit,
}

impl Meaning {
    fn described(self, given: &str) -> String {
        let name = self.field.name();
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
    let field = ColumnField::of(&squeezed(words))?;
    field.takes(unit).then_some(Meaning { field, unit })
}

/// Splits `thickness (mm)`, `thickness [mm]`, `thickness_mm`, `thickness mm` or `thickness/mm`; `None` if the text in
/// brackets is no unit.
fn split_unit(name: &str) -> Option<(&str, ColumnUnit)> {
    if let Some((words, rest)) = name.split_once(['(', '[']) {
        let unit = rest.trim_end().strip_suffix([')', ']'])?;
        return Some((words.trim(), ColumnUnit::of(unit.trim())?));
    }
    if let Some((words, unit)) = name.rsplit_once(['_', ' ', '/'])
        && let Some(unit) = ColumnUnit::of(unit.trim())
    {
        return Some((words.trim(), unit));
    }
    Some((name, ColumnUnit::None))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn find(header: &str) -> Result<(Columns, Vec<Note>)> {
        let mut notes = Vec::new();
        let columns = Columns::find(&header.split(',').collect::<csv::StringRecord>(), &mut notes)?;
        Ok((columns, notes))
    }

    /// Strict names are read in any order without a note, synonyms and units with one.
    #[test]
    fn synonyms_and_units_cause_one_note() {
        for (header, expected) in [
            ("value,x_mm,std_error,material,channel,thickness_mm", [3, 4, 5, 1, 0, 2]),
            ("Sample,Channel,thickness (mm),Position,Radiance,sigma", [0, 1, 2, 3, 4, 5]),
            ("material,colour,t_mm,x,reflectance,std", [0, 1, 2, 3, 4, 5]),
            (
                "RESIN,Wavelength (nm),Thickness [mm],x / mm,Radiance Factor,Standard deviation",
                [0, 1, 2, 3, 4, 5],
            ),
        ] {
            let (columns, notes) = find(header).unwrap();
            assert_eq!(notes.len(), usize::from(!header.starts_with("value")), "{header}");
            let own = [columns.material, columns.channel, columns.thickness, columns.x, columns.value];
            let places = own.into_iter().chain(columns.std_error).map(|c| c.place);
            assert_eq!(places.collect::<Vec<_>>(), expected, "{header}");
            assert!(columns.numbers().all(|c| c.factor == 1.0));
        }
        let (columns, notes) = find("material,channel,thickness (\u{b5}m),x_cm,value (%),error (%)").unwrap();
        let factors: Vec<f64> = columns.numbers().map(|c| c.factor).collect();
        assert_eq!(factors, [0.001, 10.0, 0.01, 0.01]);
        assert!(notes[0].text.contains("\"x_cm\" is multiplied by 10 and read as x_mm"), "{}", notes[0].text);
        assert!(notes[0].text.contains("\"thickness (\u{b5}m)\" is divided by 1000"), "{}", notes[0].text);
    }

    /// Columns of the set-up have any unit of length; pixels and percentages are refused.
    #[test]
    fn set_up_columns_take_any_length_unit() {
        let all = "material,channel,thickness_mm,x_mm,value";
        let (columns, notes) = find(&format!("{all},{}", names()[6..].join(","))).unwrap();
        assert!(notes.is_empty(), "{notes:?}");
        assert_eq!(columns.setup.map(|c| c.unwrap().place), std::array::from_fn(|i| 5 + i));
        let (columns, notes) = find(&format!("{all},Blur (\u{b5}m),Thickness error [um]")).unwrap();
        let found: Vec<_> = columns.setup.iter().flatten().map(|c| (c.name, c.factor)).collect();
        assert_eq!(found, [("thickness_std_error_mm", 1e-3), ("blur_mm", 1e-3)]);
        assert!(notes[0].text.contains("is divided by 1000 and read as blur_mm"), "{}", notes[0].text);
    }

    /// Columns that are ambiguous or unknown are refused, and so are pixels and percentages as lengths.
    #[test]
    fn ambiguous_columns_are_refused() {
        for (header, message) in [
            (
                "material,channel,thickness_mm,x_mm,radiance,reflectance",
                "columns \"radiance\" and \"reflectance\" could both be value: leave one out or rename it",
            ),
            ("material,channel,t,x_px,value", "counts pixels"),
            ("material,channel,t,x,value (%),std", "\"std\" has no unit"),
            ("material,channel,t,x,value,blur_px", "column \"blur_px\" counts pixels"),
            ("material,channel,t,x,value,blur (%)", "is not known"),
        ] {
            let error = find(header).unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
        }
        for unknown in ["sigma_t", "value (mm)", "x (%)", "value (a.u.)", "hue"] {
            let error = find(&format!("material,channel,{unknown}")).unwrap_err().to_string();
            assert!(error.contains(&format!("column {unknown:?} is not known; the columns are")), "{error}");
        }
    }
}
