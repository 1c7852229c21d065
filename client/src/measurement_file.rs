//! Measurements as tidy CSV: `material,channel,thickness_mm,x_mm,value[,std_error]`, lines beginning with # being
//! comments.

use std::path::Path;

use anyhow::{Context, Result, bail};
use farm_proto::{MeasuredProfile, Measurement};

/// Most rows of one file.
const MOST_ROWS: usize = 5_000_000;

/// Position of each column in the file.
struct Columns {
    material: usize,
    channel: usize,
    thickness_mm: usize,
    x_mm: usize,
    value: usize,
    std_error: Option<usize>,
}

impl Columns {
    fn find(header: &csv::StringRecord) -> Result<Self> {
        let names = ["material", "channel", "thickness_mm", "x_mm", "value", "std_error"];
        if let Some(unknown) = header.iter().find(|h| !names.contains(h)) {
            bail!("column {unknown:?} is not known; the columns are {}", names.join(", "));
        }
        let find = |name: &str| header.iter().position(|h| h == name);
        let missing: Vec<_> = names[..5].iter().copied().filter(|n| find(n).is_none()).collect();
        if !missing.is_empty() {
            let all = names[..5].join(", ");
            bail!("missing column{} {}; needed are {all}", plural(missing.len()), missing.join(", "));
        }
        let need = |name| find(name).context("every needed column was looked for");
        Ok(Self {
            material: need("material")?,
            channel: need("channel")?,
            thickness_mm: need("thickness_mm")?,
            x_mm: need("x_mm")?,
            value: need("value")?,
            std_error: find("std_error"),
        })
    }
}

fn plural(n: usize) -> &'static str {
    if n == 1 { "" } else { "s" }
}

/// One profile while its rows are being read.
struct Draft {
    material: String,
    channel: String,
    thickness_mm: f64,
    x_mm: Vec<f64>,
    values: Vec<f64>,
    std_errors: Vec<f64>,
}

/// The measurements of a file, one per material, in the order of their first rows.
pub fn read_measurements(path: &Path) -> Result<Vec<Measurement>> {
    let place = || format!("measurement {}", path.display());
    let file = std::fs::File::open(path).with_context(place)?;
    read(file).with_context(place)
}

fn read(source: impl std::io::Read) -> Result<Vec<Measurement>> {
    let mut reader = csv::ReaderBuilder::new().comment(Some(b'#')).trim(csv::Trim::All).from_reader(source);
    let columns = Columns::find(reader.headers()?)?;
    let mut drafts: Vec<Draft> = Vec::new();
    for (count, row) in reader.records().enumerate() {
        let row = row?;
        if count == MOST_ROWS {
            bail!("more than {MOST_ROWS} rows");
        }
        let line = row.position().map_or(0, csv::Position::line);
        add(&mut drafts, &row, &columns).with_context(|| format!("line {line}"))?;
    }
    if drafts.is_empty() {
        bail!("no rows");
    }
    let mut materials: Vec<(String, Vec<MeasuredProfile>)> = Vec::new();
    for draft in drafts {
        let place =
            format!("material {}, channel {}, {} mm", draft.material, draft.channel, draft.thickness_mm);
        let errors = columns.std_error.is_some().then_some(draft.std_errors);
        let profile =
            MeasuredProfile::new(draft.channel, draft.thickness_mm, draft.x_mm, draft.values, errors)
                .context(place)?;
        match materials.iter_mut().find(|(name, _)| *name == draft.material) {
            Some((_, profiles)) => profiles.push(profile),
            None => materials.push((draft.material, vec![profile])),
        }
    }
    let measurement = |(material, profiles)| Ok(Measurement::new(material, profiles)?);
    materials.into_iter().map(measurement).collect()
}

fn add(drafts: &mut Vec<Draft>, row: &csv::StringRecord, columns: &Columns) -> Result<()> {
    let number = |column: usize, name: &str| -> Result<f64> {
        let value: f64 = row[column]
            .parse()
            .ok()
            .with_context(|| format!("{name} = {:?} is not a number", &row[column]))?;
        if !value.is_finite() {
            bail!("{name} = {value} is not a finite number");
        }
        Ok(value)
    };
    let (material, channel) = (&row[columns.material], &row[columns.channel]);
    let thickness_mm = number(columns.thickness_mm, "thickness_mm")?;
    let same = |d: &Draft| d.material == material && d.channel == channel && d.thickness_mm == thickness_mm;
    // Rows of a profile are mostly neighbours: the last is tried first.
    let place = if let Some(place) = drafts.iter().rposition(same) {
        place
    } else {
        drafts.push(Draft {
            material: material.to_owned(),
            channel: channel.to_owned(),
            thickness_mm,
            x_mm: Vec::new(),
            values: Vec::new(),
            std_errors: Vec::new(),
        });
        drafts.len() - 1
    };
    let draft = &mut drafts[place];
    draft.x_mm.push(number(columns.x_mm, "x_mm")?);
    draft.values.push(number(columns.value, "value")?);
    if let Some(column) = columns.std_error {
        draft.std_errors.push(number(column, "std_error")?);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(n: usize, material: &str, thickness: f64) -> String {
        (0..n).map(|i| format!("{material},R,{thickness},{},{},0.01\n", i as f64 * 0.1, i)).collect()
    }

    fn text(body: &str) -> String {
        format!("# a comment\nmaterial,channel,thickness_mm,x_mm,value,std_error\n{body}")
    }

    #[test]
    fn materials_and_profiles_are_told_apart() {
        let body = rows(9, "white", 0.5) + &rows(9, "black", 0.5) + &rows(9, "white", 1.0);
        let read = read(text(&body).as_bytes()).unwrap();
        assert_eq!(read.iter().map(Measurement::material).collect::<Vec<_>>(), ["white", "black"]);
        assert_eq!(read[0].profiles().len(), 2);
        assert_eq!(read[0].profiles()[1].std_errors().unwrap(), [0.01; 9]);
    }

    fn error(text: &str) -> String {
        format!("{:#}", read(text.as_bytes()).unwrap_err())
    }

    #[test]
    fn bad_files_are_refused_with_line_and_column() {
        let missing = error("material,channel,x_mm\nw,R,0\n");
        assert!(missing.contains("missing columns thickness_mm, value; needed are"), "{missing}");
        assert!(error("material,colour\n").contains("column \"colour\" is not known"));
        let word = text(&(rows(2, "w", 0.5) + "w,R,0.5,zero,1,0\n"));
        assert_eq!(error(&word), "line 5: x_mm = \"zero\" is not a number");
        let nan = text(&(rows(2, "w", 0.5) + "w,R,0.5,0.2,NaN,0\n"));
        assert_eq!(error(&nan), "line 5: value = NaN is not a finite number");
        assert!(error(&text("")).contains("no rows"));
        assert!(error("").contains("missing columns"));
        let short = error(&text(&rows(3, "w", 0.5)));
        assert!(short.contains("material w, channel R, 0.5 mm: x_mm = 3 pixels is not valid"), "{short}");
    }
}
