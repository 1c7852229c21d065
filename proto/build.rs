//! Compiles `proto/farm/v1/*.proto` with protox, so that no `protoc` is needed on the machine.

const FILES: [&str; 7] = [
    "farm/v1/model.proto",
    "farm/v1/dictionaries.proto",
    "farm/v1/leases.proto",
    "farm/v1/fits.proto",
    "farm/v1/measurements.proto",
    "farm/v1/farm.proto",
    "farm/v1/admin.proto",
];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("cargo:rerun-if-changed=proto/farm");
    let descriptors = protox::compile(FILES, ["proto"])?;
    let out = std::path::PathBuf::from(std::env::var("OUT_DIR")?);
    std::fs::write(out.join("descriptors.bin"), prost::Message::encode_to_vec(&descriptors))?;
    let services = descriptors.file.iter().flat_map(|file| &file.service);
    let methods = services.flat_map(|service| {
        service.method.iter().map(|m| format!("/farm.v1.{}/{}", service.name(), m.name()))
    });
    std::fs::write(out.join("methods.rs"), format!("&{:?}", methods.collect::<Vec<_>>()))?;
    // The codec finds the fields of a message by its name.
    let mut config = tonic_prost_build::Config::new();
    config.enable_type_names();
    // Results are large, so unnecessary copies are avoided.
    tonic_prost_build::configure()
        .bytes(".farm.v1.CompleteRequest")
        .codec_path("crate::codec::BoundedCodec")
        .compile_fds_with_config(descriptors, config)?;
    Ok(())
}
