//! Makes the photographs of examples/bands: `cargo run -p farm-tests --example bands -- FOLDER [all|leak]`. White and
//! magenta in slabs of 0.5 and 1 mm, photographed by a monochrome camera through eight band-pass filters; with `all`, five
//! materials through 31; with `leak`, through filters that pass 1 % of the light of 700 nm. Prints the true values.

use std::path::PathBuf;

use farm_tests::photograph::{BandSession, EXAMPLE_NM, SpectralMaterial, spectral_nm};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let folder: PathBuf = args.next().ok_or("name a folder")?.into();
    let option = args.next();
    let [is_all, is_leaking] = ["all", "leak"].map(|name| option.as_deref() == Some(name));
    let (wavelengths, count) = if is_all { (spectral_nm(), 5) } else { (EXAMPLE_NM.to_vec(), 2) };
    let materials = SpectralMaterial::ALL[..count].to_vec();
    let session = BandSession {
        materials,
        leak: is_leaking.then_some((0.01, 700.0)),
        ..BandSession::small(&wavelengths, 1)
    };
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
