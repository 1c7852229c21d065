//! Writes the descriptors of the services that the page calls to standard output, as input of client generators.

use std::io::Write as _;

use prost::Message as _;

const FILES: [&str; 5] = [
    "farm/v1/dictionaries.proto",
    "farm/v1/fits.proto",
    "farm/v1/measurements.proto",
    "farm/v1/farm.proto",
    "farm/v1/admin.proto",
];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let descriptors = protox::compile(FILES, [concat!(env!("CARGO_MANIFEST_DIR"), "/proto")])?;
    std::io::stdout().write_all(&descriptors.encode_to_vec())?;
    Ok(())
}
