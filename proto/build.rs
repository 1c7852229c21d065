//! Compiles `proto/farm/v1/*.proto` with protox, so that no `protoc` is needed on the machine.

const FILES: [&str; 5] = [
    "farm/v1/model.proto",
    "farm/v1/dictionaries.proto",
    "farm/v1/leases.proto",
    "farm/v1/fits.proto",
    "farm/v1/farm.proto",
];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("cargo:rerun-if-changed=proto");
    let descriptors = protox::compile(FILES, ["proto"])?;
    tonic_prost_build::configure().compile_fds(descriptors)?;
    Ok(())
}
