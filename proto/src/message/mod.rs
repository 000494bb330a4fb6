//! Protobuf messages from core types and back.
//!
//! Encoding is deterministic: the same report gives the same bytes. The thinned stripe and edge points of a face are for
//! local overlays and are not sent. Decoding checks that everything is there and every number finite.

mod decode;
mod encode;

use boxline::{BoxReport, Calibration, Error, ErrorKind, LiveFace};
use prost::Message;
use std::path::Path;

/// The generated types of `boxline.proto`.
pub mod v1 {
    // Documented in the schema, whose comments are not all markdown.
    #![allow(missing_docs, clippy::all, rustdoc::all)]
    include!(concat!(env!("OUT_DIR"), "/boxline.v1.rs"));
}

/// A report as bytes of `boxline.v1.BoxReport`, without its times; `frame_ids` name the frames.
#[must_use]
pub fn encode_report(report: &BoxReport, frame_ids: &[&str]) -> Vec<u8> {
    encode::report(report, frame_ids).encode_to_vec()
}

/// What a head sees, as bytes of `boxline.v1.LiveView`.
#[must_use]
pub fn encode_live_view(seen: &LiveFace, steady: bool, frame: u64) -> Vec<u8> {
    let (face, followed) = match seen {
        LiveFace::Looked(report) => (encode::face(&report.outcome, report.hint.as_ref(), ""), false),
        LiveFace::Followed(face) => (encode::followed_face(face), true),
    };
    v1::LiveView { face: Some(face), steady, frame, followed }.encode_to_vec()
}

/// What [`encode_report`] was given.
#[derive(Debug, PartialEq)]
pub struct DecodedReport {
    /// The report.
    pub report: BoxReport,
    /// The names of the frames.
    pub frame_ids: Vec<String>,
}

/// A report from bytes of `boxline.v1.BoxReport`.
///
/// # Errors
/// [`ErrorKind::InvalidFile`], naming the field.
pub fn decode_report(bytes: &[u8]) -> Result<DecodedReport, Error> {
    decode::report(parse(bytes, "BoxReport", ErrorKind::InvalidFile)?)
}

/// A calibration as bytes of `boxline.v1.Calibration`.
#[must_use]
pub fn encode_calibration(calibration: &Calibration) -> Vec<u8> {
    encode::calibration(calibration).encode_to_vec()
}

/// A calibration from bytes of `boxline.v1.Calibration`.
///
/// # Errors
/// [`ErrorKind::InvalidCalibration`], naming the field.
pub fn decode_calibration(bytes: &[u8]) -> Result<Calibration, Error> {
    decode::calibration(parse(bytes, "Calibration", ErrorKind::InvalidCalibration)?)
}

/// A recording as bytes of `boxline.v1.Recording`.
///
/// # Errors
/// As [`recording_json`](crate::json::recording_json).
pub fn encode_recording(recording: &crate::json::Recording) -> Result<Vec<u8>, Error> {
    Ok(encode::recording(recording)?.encode_to_vec())
}

/// A recording from bytes of `boxline.v1.Recording`; `folder` goes in front of its paths.
///
/// # Errors
/// [`ErrorKind::InvalidFile`], naming the field.
pub fn decode_recording(bytes: &[u8], folder: &Path) -> Result<crate::json::Recording, Error> {
    decode::recording(parse(bytes, "Recording", ErrorKind::InvalidFile)?, folder)
}

fn parse<M: Message + Default>(bytes: &[u8], name: &str, kind: ErrorKind) -> Result<M, Error> {
    M::decode(bytes)
        .map_err(|e| Error::new(kind, format!("not a boxline.v1.{name} message: {e}")).with_source(e))
}
