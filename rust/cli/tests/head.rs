//! The commands for a head on the cable, as far as they go without one: what a wrong argument says, and that nothing is left behind.
#![allow(clippy::unwrap_used)] // the helpers are tests too, which clippy sees only in the functions marked #[test]

mod program;

use program::boxline;
use std::path::Path;
use std::process::Command;

fn fails(arguments: &[&str], needed: &str) {
    let output = boxline(arguments);
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
    assert!(said.contains(needed) && !said.contains("panicked"), "{arguments:?}: {said}");
}

#[test]
fn wrong_arguments_are_explained() {
    fails(&["laser", "5"], "is no laser");
    fails(&["laser", "1,x"], "is no laser");
    fails(&["laser", "all", "--device", "12:xyz"], "hexadecimal");
    fails(&["laser", "all", "--power", "101"], "101");
    fails(&["emulate", "no/such/folder"], "no/such/folder");
    fails(&["emulate"], "required");
    fails(&["head", "calibration", "write", "no/such/file.json"], "no/such/file.json");
}

#[test]
fn a_capture_without_a_head_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("box");
    // A serial number that no head has, in case one is attached.
    fails(&["capture", "--device", "NO-SUCH-HEAD-0000", "-o", output.to_str().unwrap()], "error: ");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    fails(&["capture", "-o", folder.path().to_str().unwrap()], "nothing is overwritten");
}

#[test]
fn a_live_calibration_without_a_head_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (keep, output) = (at("frames"), at("calibration.json"));
    let live = ["calibrate", "--live", "-o", &output, "--keep", &keep];
    fails(&live, "--board");
    let board = ["--board", "12x11:100:50"];
    fails(&[&live[..], &board, &["--device", "NO-SUCH-HEAD-0000"]].concat(), "error: ");
    fails(&[&live[..], &board, &["--frames", "5"]].concat(), "5");
    fails(&["calibrate", "-o", &output], "FOLDER");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    std::fs::create_dir(&keep).unwrap();
    std::fs::write(folder.path().join("frames/recording.json"), "{}").unwrap();
    fails(&[&live[..], &board].concat(), "is a recording");
}

#[test]
fn a_recording_is_offered_to_usbip() {
    let recording = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/b02");
    is_offered(&["emulate", recording.to_str().unwrap()]);
}

#[test]
#[cfg(feature = "render")]
fn a_rendered_box_is_offered_to_usbip() {
    is_offered(&["emulate", "--render", "7"]);
    fails(&["emulate", "some/recording", "--render", "7"], "cannot be used with");
}

fn is_offered(emulate: &[&str]) {
    let mut program = Command::new(env!("CARGO_BIN_EXE_boxline"))
        .args(emulate)
        .args(["--listen", "127.0.0.1:0"])
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    let mut said = String::new();
    let mut reader = std::io::BufReader::new(program.stderr.take().unwrap());
    std::io::BufRead::read_line(&mut reader, &mut said).unwrap();
    let port: u16 = said.split("--tcp-port ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
    let mut stream = std::net::TcpStream::connect(("127.0.0.1", port)).unwrap();
    // OP_REQ_DEVLIST; the answer is a header, a count, one device and its two interfaces.
    std::io::Write::write_all(&mut stream, &[1, 0x11, 0x80, 5, 0, 0, 0, 0]).unwrap();
    let mut answer = Vec::new();
    std::io::Read::read_to_end(&mut stream, &mut answer).unwrap();
    program.kill().unwrap();
    program.wait().unwrap();
    assert_eq!(answer.len(), 8 + 4 + 312 + 8);
    assert_eq!(answer[..12], [1, 0x11, 0, 5, 0, 0, 0, 0, 0, 0, 0, 1]);
    assert_eq!(answer[12 + 300..12 + 304], [0x12, 0x09, 0, 1], "vendor and product");
}
