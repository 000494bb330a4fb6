//! Packs the networks that ship: `src/halves.rs`.

#[path = "src/halves.rs"]
mod halves;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("cargo::rerun-if-changed=src/halves.rs");
    let folder = std::path::PathBuf::from(std::env::var("OUT_DIR")?);
    for name in ["boxnet", "lines", "sides"] {
        let file = format!("models/{name}.onnx");
        println!("cargo::rerun-if-changed={file}");
        let packed = halves::packed(&std::fs::read(&file)?);
        let packed =
            packed.ok_or_else(|| format!("{file} is no ONNX file whose weights fit into 16 bits"))?;
        std::fs::write(folder.join(name), packed)?;
    }
    Ok(())
}
