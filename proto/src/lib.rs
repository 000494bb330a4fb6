//! Everything that boxline says to the outside: [`json`] files and reports for people, protobuf [`message`]s for programs
//! and for JNI. The schema is `proto/boxline.proto`.
//!
//! Sits on top of `boxline` (core), which knows no files and no formats. Bytes from outside are hostile here: each broken
//! input is a `boxline::Error` whose text names file and field, never a panic.
#![forbid(unsafe_code)]

pub mod json;
pub mod message;
