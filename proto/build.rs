//! Generates the message types with a protobuf compiler written in Rust: nothing beyond cargo is needed.

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("cargo:rerun-if-changed=boxline.proto");
    let descriptors = protox::compile(["boxline.proto"], ["."])?;
    prost_build::Config::new().compile_fds(descriptors)?;
    Ok(())
}
