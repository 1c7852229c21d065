//! A dictionary as a Parquet file: a row for each record and channel, with the pixels as lists.

use std::io::Write;
use std::sync::Arc;

use anyhow::Result;
use farm_proto::status::DictionaryStatus;
use parquet::basic::{Compression, LogicalType, Repetition, Type as Physical};
use parquet::data_type::{ByteArray, ByteArrayType, DoubleType, FloatType, Int32Type};
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::types::{ColumnPath, Type, TypePtr};

use super::Chosen;
use super::arrays::{Array, Complete, about, channels, x_mm};
use crate::connection::Connection;

/// Numbers that name a row, in the order of the columns.
const KEYS: [&str; 5] = ["sample_ior", "sigma_t_per_mm", "g", "thickness_mm", "albedo"];
/// Rows that are in memory at a time: of the paper's grid 12 MB.
const ROWS: usize = 4096;

/// Writes the chosen records, which must all be done.
pub(super) async fn write(
    connection: &Connection,
    status: &DictionaryStatus,
    chosen: &Chosen,
    out: impl Write + Send,
) -> Result<()> {
    let grid = &status.grid;
    let arrays = Array::all(grid);
    let names: Vec<ByteArray> = channels(grid).into_iter().map(ByteArray::from).collect();
    let mut writer = SerializedFileWriter::new(out, schema(arrays)?, Arc::new(properties(status, arrays)?))?;
    let mut records = Complete::ask(connection, status, chosen).await?;
    let mut rows = Rows::new(arrays.len());
    while let Some(record) = records.next().await? {
        let (point, medium) = grid.parameters(record.index);
        let keys =
            [point.sample_ior(), medium.sigma_t_per_mm(), medium.g(), point.thickness_mm(), medium.albedo()];
        for (profile, name) in record.profiles.iter().zip(&names) {
            rows.add(record.index, keys, name, arrays.iter().map(|array| array.numbers(profile)));
        }
        if rows.len() >= ROWS {
            rows.write(writer.next_row_group()?)?;
        }
    }
    if rows.len() > 0 {
        rows.write(writer.next_row_group()?)?;
    }
    writer.close()?;
    Ok(())
}

/// Columns of rows that are written together.
struct Rows {
    records: Vec<i32>,
    keys: [Vec<f64>; KEYS.len()],
    channels: Vec<ByteArray>,
    /// For each array the pixels of all rows.
    pixels: Vec<Vec<f32>>,
    /// 0 where a list begins, 1 where it goes on.
    repetition: Vec<i16>,
}

impl Rows {
    fn new(arrays: usize) -> Self {
        Self {
            records: Vec::new(),
            keys: Default::default(),
            channels: Vec::new(),
            pixels: vec![Vec::new(); arrays],
            repetition: Vec::new(),
        }
    }

    fn len(&self) -> usize {
        self.records.len()
    }

    fn add<'p>(
        &mut self,
        record: usize,
        keys: [f64; KEYS.len()],
        channel: &ByteArray,
        arrays: impl Iterator<Item = &'p [f32]>,
    ) {
        // A grid has at most four million records.
        self.records.push(record as i32);
        for (column, key) in self.keys.iter_mut().zip(keys) {
            column.push(key);
        }
        self.channels.push(channel.clone());
        let mut length = 0;
        for (column, pixels) in self.pixels.iter_mut().zip(arrays) {
            column.extend_from_slice(pixels);
            length = pixels.len();
        }
        self.repetition.extend((0..length).map(|pixel| i16::from(pixel > 0)));
    }

    /// Writes the rows, in the order of the schema's columns, and empties them.
    fn write<W: Write + Send>(&mut self, mut group: SerializedRowGroupWriter<'_, W>) -> Result<()> {
        let mut column = group.next_column()?.expect("the schema has a column for records");
        column.typed::<Int32Type>().write_batch(&self.records, None, None)?;
        column.close()?;
        for keys in &self.keys {
            let mut column = group.next_column()?.expect("the schema has a column for each key");
            column.typed::<DoubleType>().write_batch(keys, None, None)?;
            column.close()?;
        }
        let mut column = group.next_column()?.expect("the schema has a column for channels");
        column.typed::<ByteArrayType>().write_batch(&self.channels, None, None)?;
        column.close()?;
        let definition = vec![1; self.repetition.len()];
        for pixels in &self.pixels {
            let mut column = group.next_column()?.expect("the schema has a column for each array");
            column.typed::<FloatType>().write_batch(pixels, Some(&definition), Some(&self.repetition))?;
            column.close()?;
        }
        group.close()?;
        *self = Self::new(self.pixels.len());
        Ok(())
    }
}

fn schema(arrays: &[Array]) -> Result<TypePtr> {
    let number = |name: &str, kind| {
        Type::primitive_type_builder(name, kind).with_repetition(Repetition::REQUIRED).build().map(Arc::new)
    };
    let mut columns = vec![number("record", Physical::INT32)?];
    for key in KEYS {
        columns.push(number(key, Physical::DOUBLE)?);
    }
    let text = Type::primitive_type_builder("channel", Physical::BYTE_ARRAY)
        .with_logical_type(Some(LogicalType::String));
    columns.push(Arc::new(text.with_repetition(Repetition::REQUIRED).build()?));
    for array in arrays {
        // As the specification has lists: a group of a repeated group of elements.
        let elements = Type::group_type_builder("list")
            .with_repetition(Repetition::REPEATED)
            .with_fields(vec![number("element", Physical::FLOAT)?])
            .build()?;
        let list = Type::group_type_builder(array.name)
            .with_repetition(Repetition::REQUIRED)
            .with_logical_type(Some(LogicalType::List))
            .with_fields(vec![Arc::new(elements)])
            .build()?;
        columns.push(Arc::new(list));
    }
    Ok(Arc::new(Type::group_type_builder("record").with_fields(columns).build()?))
}

/// What there is few of goes into a dictionary; numbers with noise are stored as they are.
fn properties(status: &DictionaryStatus, arrays: &'static [Array]) -> Result<WriterProperties> {
    let told = |key: &str, value: String| KeyValue::new(key.to_owned(), value);
    let pixels = serde_json::to_string(&x_mm(&status.grid))?;
    let mut properties = WriterProperties::builder()
        .set_compression(Compression::UNCOMPRESSED)
        .set_created_by(concat!("farmctl ", env!("CARGO_PKG_VERSION")).to_owned())
        .set_key_value_metadata(Some(vec![
            told("about", about(status, arrays)?.to_string()),
            told("x_mm", pixels),
        ]));
    for array in arrays {
        let path = ColumnPath::new([array.name, "list", "element"].map(str::to_owned).to_vec());
        properties = properties.set_column_dictionary_enabled(path, false);
    }
    Ok(properties.build())
}
