//! What is done with bytes from outside, for the fuzz targets (proto/fuzz) and for the run over their corpus in `cargo test`. Nothing here
//! may panic, and what is accepted must be the same when it is written and read again.

use boxline_proto::json::{
    calibration_json, parse_board, parse_calibration, parse_recording, parse_truth, recording_json,
};
use boxline_proto::message::{
    decode_calibration, decode_recording, decode_report, encode_calibration, encode_recording,
};
use std::path::Path;

/// A JSON file, read as each kind.
pub fn json(bytes: &[u8]) {
    let folder = Path::new("folder");
    let text = |read: Result<(), boxline::Error>| {
        if let Err(error) = read {
            assert!(error.to_string().len() < 2000, "{error}");
        }
    };
    if let Ok(calibration) = parse_calibration(bytes, "x") {
        let again = parse_calibration(calibration_json(&calibration).to_string().as_bytes(), "again");
        assert_eq!(again.expect("what was read is valid"), calibration);
    }
    if let Ok(recording) = parse_recording(bytes, "x", folder) {
        let written = recording_json(&recording).expect("its paths are in the folder");
        let again = parse_recording(written.to_string().as_bytes(), "again", folder);
        assert_eq!(again.expect("what was read is valid"), recording);
    }
    text(parse_calibration(bytes, "x").map(drop));
    text(parse_recording(bytes, "x", folder).map(drop));
    text(parse_truth(bytes, "x").map(drop));
    text(parse_board(bytes, "x").map(drop));
}

/// A protobuf message, read as each kind.
pub fn message(bytes: &[u8]) {
    let folder = Path::new("folder");
    drop(decode_report(bytes));
    if let Ok(calibration) = decode_calibration(bytes) {
        let again = decode_calibration(&encode_calibration(&calibration));
        assert_eq!(again.expect("what was read is valid"), calibration);
    }
    if let Ok(recording) = decode_recording(bytes, folder) {
        let again = encode_recording(&recording).and_then(|bytes| decode_recording(&bytes, folder));
        assert_eq!(again.expect("what was read is valid"), recording);
    }
}
