//! Compiles the service of `farmctl web` for its page. The messages that it shares with the farm's services are in
//! `farm-proto`.

fn main() -> Result<(), Box<dyn std::error::Error>> {
    const PROTO: &str = "../proto/proto";
    println!("cargo:rerun-if-changed={PROTO}");
    let descriptors = protox::compile(["desk/v1/desk.proto"], [PROTO])?;
    tonic_prost_build::configure()
        .build_client(false)
        .extern_path(".farm.v1", "::farm_proto::wire")
        .compile_fds(descriptors)?;
    Ok(())
}
