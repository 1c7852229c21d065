//! Makes the photographs of examples/bands: `cargo run -p farm-tests --example bands -- FOLDER [WAVELENGTHS]`. White and
//! magenta in slabs of 0.5 and 1 mm, photographed by a monochrome camera through band-pass filters. Prints the true
//! values.

use std::path::PathBuf;

use farm_tests::photograph::{BandSession, EXAMPLE_NM};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let folder: PathBuf = args.next().ok_or("name a folder")?.into();
    let given = args.next().map(|list| list.split(',').map(str::parse).collect::<Result<Vec<f64>, _>>());
    let wavelengths = given.transpose()?.unwrap_or_else(|| EXAMPLE_NM.to_vec());
    let session = BandSession::small(&wavelengths, 1);
    session.write(&folder)?;
    for material in &session.materials {
        for nm in &wavelengths {
            let medium = material.at(*nm);
            let (sigma_t, albedo, g) = (medium.sigma_t_per_mm(), medium.albedo(), medium.g());
            println!("{} {nm}: sigma_t {sigma_t:.4} /mm, albedo {albedo:.5}, g {g:.3}", material.name);
        }
    }
    Ok(())
}
