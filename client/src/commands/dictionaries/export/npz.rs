//! Writes a dictionary as arrays for NumPy, which `numpy.load` reads.
//!
//! An npz file is an archive of npy files, which have a short head before the numbers (NumPy Enhancement Proposal 1).
//! Each array is written in a separate pass over the records, so that none has to fit into memory.

use std::io::{Seek, Write};

use anyhow::Result;
use farm_proto::status::DictionaryStatus;
use optics_model::Grid;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

use super::arrays::{Array, Complete, about, channels, numeric_axes, variants};
use super::chosen::ChosenAxes;
use crate::connection::Connection;

/// Writes the chosen records, which must all be done.
pub(super) async fn write(
    connection: &Connection,
    status: &DictionaryStatus,
    chosen: &ChosenAxes,
    out: impl Write + Seek,
) -> Result<()> {
    let grid = &status.grid;
    let arrays = Array::all(grid);
    let mut archive = ZipWriter::new(out);
    for array in arrays {
        archive.start_file(format!("{}.npy", array.name), stored())?;
        write_records(connection, status, chosen, array, &mut archive).await?;
    }
    write_axes(grid, chosen, &mut archive)?;
    archive.start_file("about.json", stored())?;
    let about = serde_json::to_string_pretty(&about(status, chosen, arrays)?)? + "\n";
    archive.write_all(about.as_bytes())?;
    archive.finish()?;
    Ok(())
}

/// Uncompressed: noisy numbers hardly shrink, and stored arrays can be mapped into memory.
fn stored() -> SimpleFileOptions {
    SimpleFileOptions::default().compression_method(CompressionMethod::Stored).large_file(true)
}

async fn write_records(
    connection: &Connection,
    status: &DictionaryStatus,
    chosen: &ChosenAxes,
    array: &Array,
    out: &mut impl Write,
) -> Result<()> {
    let grid = &status.grid;
    let (channels, pixels) = (grid.scene().channels().len(), grid.scene().sensor().pixels());
    out.write_all(&head("<f4", &[chosen.shape(), vec![channels, pixels]].concat()))?;
    let mut records = Complete::ask(connection, status, chosen).await?;
    let mut bytes = Vec::with_capacity(4 * channels * pixels);
    while let Some(record) = records.next().await? {
        bytes.clear();
        for profile in &record.profiles {
            bytes.extend(array.numbers(profile).iter().flat_map(|number| number.to_le_bytes()));
        }
        out.write_all(&bytes)?;
    }
    Ok(())
}

/// Writes the values along each axis, and the variants, as arrays with their names.
fn write_axes(grid: &Grid, chosen: &ChosenAxes, archive: &mut ZipWriter<impl Write + Seek>) -> Result<()> {
    for (name, values) in numeric_axes(grid, chosen) {
        write_numbers(name, &values, archive)?;
    }
    let variants = variants(grid, chosen);
    if !variants.is_empty() {
        write_numbers("variant", &(0..variants.len()).map(|i| i as f64).collect::<Vec<_>>(), archive)?;
        write_texts("quantity", variants.iter().map(|v| v.quantity.as_str()), archive)?;
        write_numbers("step", &variants.iter().map(|v| v.step).collect::<Vec<_>>(), archive)?;
        write_texts("unit", variants.iter().map(|v| v.unit), archive)?;
    }
    write_texts("channel", channels(grid).into_iter(), archive)
}

fn write_numbers(name: &str, values: &[f64], archive: &mut ZipWriter<impl Write + Seek>) -> Result<()> {
    archive.start_file(format!("{name}.npy"), stored())?;
    archive.write_all(&head("<f8", &[values.len()]))?;
    archive.write_all(&values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>())?;
    Ok(())
}

/// Writes texts padded to one length in UTF-32, NumPy's format.
fn write_texts<'a>(
    name: &str,
    texts: impl ExactSizeIterator<Item = &'a str> + Clone,
    archive: &mut ZipWriter<impl Write + Seek>,
) -> Result<()> {
    let longest = texts.clone().map(|text| text.chars().count()).max().unwrap_or(0).max(1);
    archive.start_file(format!("{name}.npy"), stored())?;
    archive.write_all(&head(&format!("<U{longest}"), &[texts.len()]))?;
    for text in texts {
        let padded = text.chars().map(u32::from).chain(std::iter::repeat(0)).take(longest);
        archive.write_all(&padded.flat_map(u32::to_le_bytes).collect::<Vec<u8>>())?;
    }
    Ok(())
}

/// Bytes before the text of a head: magic bytes, a version, and the text's length.
const BEFORE_HEAD: usize = 10;

/// The head of an npy file, version 1.0, for numbers in C order. It ends at a multiple of 64 bytes.
fn head(kind: &str, shape: &[usize]) -> Vec<u8> {
    let sides: Vec<String> = shape.iter().map(usize::to_string).collect();
    // A Python tuple of one element has a comma.
    let comma = if shape.len() == 1 { "," } else { "" };
    let sides = sides.join(", ");
    let mut text = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({sides}{comma}), }}");
    let whole = (BEFORE_HEAD + text.len() + 1).next_multiple_of(64);
    text.extend(std::iter::repeat_n(' ', whole - BEFORE_HEAD - 1 - text.len()));
    text.push('\n');
    // The text of eight axes takes a few hundred bytes.
    let length = (text.len() as u16).to_le_bytes();
    [b"\x93NUMPY\x01\x00", &length[..], text.as_bytes()].concat()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The headers of arrays equal those that NumPy writes.
    #[test]
    fn npy_headers_equal_those_of_numpy() {
        // numpy.save of an array of float32 with the shape (2, 3).
        let expected = format!("{:<117}\n", "{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3), }");
        let written = head("<f4", &[2, 3]);
        assert_eq!(&written[..10], b"\x93NUMPY\x01\x00v\x00");
        assert_eq!(std::str::from_utf8(&written[10..]).unwrap(), expected);
        assert_eq!(head("<f8", &[5]).len() % 64, 0);
        assert!(String::from_utf8_lossy(&head("<U1", &[1])).contains("'shape': (1,)"));
    }
}
