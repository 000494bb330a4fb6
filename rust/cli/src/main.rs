//! The `boxline` program.
fn main() {}
