//! The JSON formats, in one place: calibrations, recordings, boards, truth files (read and written) and reports (written).
//!
//! All lengths are mm, pixel positions are (u, v) with (0, 0) at the centre of the top-left pixel. Readers ignore keys
//! that they do not know; an unknown `format`, a missing key, a wrong type, a number that is not finite and a list of the
//! wrong length are errors of the form `file: field: found, needed`. Files over 64 MB are refused unread.

mod calibration;
mod file;
mod recording;
mod report;
mod syntax;
mod truth;
mod wrong;

pub(crate) use calibration::covariance_size;
pub use calibration::{
    CAMERA_FORMAT, calibration_json, camera_json, parse_calibration, read_calibration, read_camera,
};
pub use file::{open_plain_file, write_json};
pub(crate) use recording::resolved_path;
pub use recording::{Laser, RecordedFrame, Recording, Role, parse_recording, read_recording, recording_json};
pub use report::{face_json, report_json};
pub use syntax::parse_json;
pub use truth::{
    BOARD_CIRCLES_IN_ROW, BOARD_SIZES_MM, Board, EndClass, MOST_BOARD_CIRCLES, Truth, TruthEnd, TruthFace,
    TruthHidden, TruthLine, TruthMotion, TruthNotes, parse_board, parse_truth, read_board, read_truth,
};
pub use wrong::{corner_orders, is_wrong_box, is_wrong_side};
