//! `boxline calibrate`, `verify` and `convert` from outside: a good set, every kind of bad set, exit codes, and that a refusal
//! or an error leaves no file behind. Bad sets are recorded board frames, changed, at half size: a quarter of the time.
#![allow(clippy::unwrap_used)] // the helpers are tests too, which clippy sees only in the functions marked #[test]

mod program;

use boxline::{CameraModel, Px};
use image::codecs::jpeg::JpegEncoder;
use image::imageops::{FilterType, fast_blur, interpolate_bilinear, resize};
use image::{Rgb, RgbImage};
use program::{boxline, data, json_of, stderr, stdout, text};
use serde_json::{Value, json};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Output;
use std::sync::OnceLock;
use tempfile::TempDir;

const NAMES: [&str; 8] = ["c01", "c03", "c05", "c09", "c13", "c19", "c21", "c25"];

fn read(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

/// The eight recorded frames at half size.
fn halves() -> &'static [RgbImage] {
    static HALVES: OnceLock<Vec<RgbImage>> = OnceLock::new();
    HALVES.get_or_init(|| {
        let load = |name: &&str| {
            let full = image::open(data(&format!("board/{name}.jpg"))).unwrap().into_rgb8();
            resize(&full, full.width() / 2, full.height() / 2, FilterType::Triangle)
        };
        NAMES.iter().map(load).collect()
    })
}

fn jpeg(image: &RgbImage) -> Vec<u8> {
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, 95).encode_image(image).unwrap();
    bytes
}

/// A folder with frames, a recording and the board; outputs go to `out/`.
struct Set {
    folder: TempDir,
    frames: Vec<Value>,
}

impl Set {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("out")).unwrap();
        let set = Self { folder, frames: Vec::new() };
        set.write("board.json", &std::fs::read(data("board/board.json")).unwrap());
        set
    }

    /// The recorded frames at half size, each changed.
    fn of(count: usize, change: impl Fn(usize, &RgbImage) -> Vec<u8>) -> Self {
        let mut set = Self::new();
        for (i, half) in halves().iter().enumerate().take(count) {
            set.add(NAMES[i], &change(i, half));
        }
        set
    }

    fn write(&self, name: &str, bytes: &[u8]) {
        std::fs::write(self.folder.path().join(name), bytes).unwrap();
    }

    fn add(&mut self, name: &str, bytes: &[u8]) {
        let file = format!("{name}.jpg");
        self.write(&file, bytes);
        self.frames.push(json!({"id": name, "file": file, "role": "board", "laser": "on"}));
        let recording = json!({"format": "boxline-recording/1", "device": {"serial": "T-1"},
            "calibration": "none.json", "frames": self.frames});
        self.write("recording.json", recording.to_string().as_bytes());
    }

    fn board(&self, key: &str, value: Value) {
        let mut board = read(&data("board/board.json"));
        board[key] = value;
        self.write("board.json", board.to_string().as_bytes());
    }

    fn output(&self) -> PathBuf {
        self.folder.path().join("out/calibration.json")
    }

    fn run(&self) -> Output {
        let report = self.folder.path().join("out/report.html");
        self.run_with(&["--report", text(&report)])
    }

    fn run_with(&self, more: &[&str]) -> Output {
        let output = self.output();
        let words = ["calibrate", text(self.folder.path()), "-o", text(&output), "--json"];
        let output = boxline(&[&words, more].concat());
        assert!(!stderr(&output).contains("panicked"), "{}", stderr(&output));
        output
    }

    fn left_behind(&self) -> usize {
        std::fs::read_dir(self.folder.path().join("out")).unwrap().count()
    }

    /// Runs it; it must be refused for this reason and write nothing.
    fn refused(&self, reason: &str) -> Value {
        let output = self.run();
        let object = json_of(&output);
        assert_eq!(output.status.code(), Some(3), "{object}");
        assert_eq!(object["outcome"], "rejected");
        assert_eq!(object["reject"]["reason"], reason, "{object}");
        assert_eq!(self.left_behind(), 0, "something was left behind");
        object
    }

    /// Runs it; it must be solved, without the frames of these names.
    fn solved_without(&self, names: &[&str]) -> Value {
        let output = self.run();
        let object = json_of(&output);
        assert_eq!(output.status.code(), Some(0), "{object}");
        let left_out = object["left_out"].as_array().unwrap();
        let found: Vec<&str> = left_out.iter().map(|f| f["frame"].as_str().unwrap()).collect();
        assert_eq!(found, names, "{object}");
        assert_eq!(self.left_behind(), 2);
        object
    }

    fn fails(&self, kind: &str, word: &str) {
        let output = self.run();
        assert_eq!(output.status.code(), Some(2), "{}", stdout(&output));
        assert!(stderr(&output).contains(word), "{}", stderr(&output));
        assert_eq!(json_of(&output)["error"]["kind"], kind, "{}", stderr(&output));
        assert_eq!(self.left_behind(), 0, "something was left behind");
    }
}

fn why(object: &Value, i: usize) -> &str {
    object["left_out"][i]["why"].as_str().unwrap()
}

/// Focal length at half size against the truth, px of the half-size frame.
fn fx_error(object: &Value) -> f64 {
    let truth = read(&data("calibration_set/calibration.json"))["camera"]["fx"].as_f64().unwrap();
    object["calibration"]["camera"]["fx"].as_f64().unwrap() - 0.5 * truth
}

#[test]
fn a_good_set_gives_calibration_report_and_provenance() {
    let folder = tempfile::tempdir().unwrap();
    let (file, report) = (folder.path().join("calibration.json"), folder.path().join("report.html"));
    let output = boxline(&["calibrate", text(&data("board")), "-o", text(&file), "--report", text(&report)]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert_eq!(stderr(&output), "", "progress is for terminals");
    let said = stdout(&output);
    for word in ["8 frames of 8", "fx  ", "laser 4", "side 1800", "next  ", "written", "report"] {
        assert!(said.contains(word), "{word} is missing in\n{said}");
    }
    let page = std::fs::read_to_string(&report).unwrap();
    assert!(page.trim_end().ends_with("</html>") && page.matches("<svg").count() >= 7);
    assert!(!page.contains("http://") || page.matches("http://").all(|_| page.contains("www.w3.org")));

    let (found, truth) = (read(&file), read(&data("calibration_set/calibration.json")));
    for key in ["fx", "fy", "cx", "cy"] {
        let off = found["camera"][key].as_f64().unwrap() - truth["camera"][key].as_f64().unwrap();
        assert!(off.abs() < 0.5, "{key} is off by {off} px");
    }
    // Also of p1, p2, k3, which the frames did not choose: they may be something else than 0.
    assert_eq!(found["covariance"].as_array().unwrap().len(), 21);
    let provenance = &found["provenance"];
    assert!(provenance["program"].as_str().unwrap().starts_with("boxline "));
    assert_eq!(provenance["date"].as_str().unwrap().len(), "2026-01-01T00:00:00Z".len());
    let inputs = provenance["inputs"].as_array().unwrap();
    assert_eq!(inputs.len(), 10, "eight frames, the recording and the board");
    // `sha256sum tests/data/board/board.json`
    let board = inputs.iter().find(|i| i["file"] == "board.json").unwrap();
    assert_eq!(board["sha256"], "b93f077a82ca5022e131b5e8c33e803882a8f319582e3ef12c2829b4810793f1");

    // The calibration serves: one known side of a recorded box is in, a wrong length is out.
    let verify = |length: &str| {
        boxline(&["verify", text(&data("b03")), "--calibration", text(&file), "--length", length, "--json"])
    };
    let good = verify("800");
    assert_eq!((good.status.code(), json_of(&good)["outcome"].as_str().unwrap()), (Some(0), "in"));
    let bad = verify("815");
    assert_eq!((bad.status.code(), json_of(&bad)["outcome"].as_str().unwrap()), (Some(3), "out"));
    assert!(json_of(&bad)["calibration_sigma_mm"].as_f64().unwrap() > 0.0);
}

#[test]
fn frames_without_a_board_are_named() {
    let mut set = Set::new();
    for name in ["b01", "b02", "b03", "b04", "b05", "b06"] {
        set.add(name, &std::fs::read(data(&format!("{name}/a.jpg"))).unwrap());
    }
    let object = set.refused("too_few_frames");
    assert_eq!(object["left_out"].as_array().unwrap().len(), 6);
    assert!((0..6).all(|i| why(&object, i).contains("no board")), "{object}");
}

#[test]
fn five_frames_are_too_few() {
    let object = Set::of(5, |_, half| jpeg(half)).refused("too_few_frames");
    assert_eq!(object["reject"]["text"], "5 frames show the board, 6 are needed");
}

#[test]
fn a_refusal_names_the_copies_that_make_it_one() {
    let mut set = Set::of(5, |_, half| jpeg(half));
    for name in ["c91", "c92", "c93"] {
        set.add(name, &jpeg(&halves()[1]));
    }
    let object = set.refused("too_few_frames");
    assert_eq!(object["reject"]["text"], "5 frames show the board, 6 are needed");
    let left_out = object["left_out"].as_array().unwrap();
    assert_eq!(
        left_out.iter().map(|f| f["frame"].as_str().unwrap()).collect::<Vec<_>>(),
        ["c91", "c92", "c93"]
    );
    assert!((0..3).all(|i| why(&object, i).starts_with("a copy of")), "{object}");
}

#[test]
fn eight_times_one_picture_is_one_frame() {
    let object = Set::of(8, |_, _| jpeg(&halves()[1])).refused("too_few_frames");
    assert_eq!(object["reject"]["text"], "1 frame shows the board, 6 are needed");
    assert_eq!(object["left_out"].as_array().unwrap().len(), 7);
}

/// At half size the way to the camera is longer.
#[test]
fn any_seven_frames_at_half_size_are_all_used() {
    for missing in 0..8 {
        let mut set = Set::new();
        for i in (0..8).filter(|i| *i != missing) {
            set.add(NAMES[i], &jpeg(&halves()[i]));
        }
        let object = json_of(&set.run_with(&["--camera-only"]));
        assert_eq!((&object["outcome"], &object["left_out"]), (&json!("calibrated"), &json!([])), "{object}");
    }
}

/// A frame of which only the left and upper part, of these shares, is in view.
fn hidden(half: &RgbImage, right: f64, bottom: f64) -> Vec<u8> {
    let mut half = half.clone();
    let (w, h) = (f64::from(half.width()), f64::from(half.height()));
    for (x, y, p) in half.enumerate_pixels_mut() {
        if f64::from(x) > right * w || f64::from(y) > bottom * h {
            *p = Rgb([120, 118, 115]);
        }
    }
    jpeg(&half)
}

#[test]
fn a_board_half_hidden_in_every_frame_is_solved_with_a_warning() {
    let output = Set::of(8, |_, half| hidden(half, 0.5, 1.0)).run();
    let object = json_of(&output);
    assert_eq!(output.status.code(), Some(0), "{object}");
    assert!(fx_error(&object).abs() < 0.5, "{object}");
    for corner in ["top right", "bottom right"] {
        let names_corner = |w: &Value| w.as_str().unwrap().contains(corner);
        assert!(object["warnings"].as_array().unwrap().iter().any(names_corner), "{object}");
    }
}

#[test]
fn a_board_mostly_hidden_in_every_frame_is_refused() {
    let object = Set::of(8, |_, half| hidden(half, 0.33, 0.33)).refused("too_few_frames");
    assert!(object["left_out"].as_array().unwrap().len() >= 3, "{object}");
}

#[test]
fn blurred_frames_are_named() {
    let object = Set::of(8, |_, half| jpeg(&fast_blur(half, 11.0))).refused("too_few_frames");
    assert_eq!(object["left_out"].as_array().unwrap().len(), 8);
    assert!((0..8).any(|i| why(&object, i).contains("blurred")), "{object}");
}

#[test]
fn single_bad_frames_are_left_out_by_name() {
    let object = Set::of(8, |i, half| match i {
        0 => jpeg(&resize(half, half.width() / 2, half.height() / 2, FilterType::Triangle)),
        1 => jpeg(half)[..20_000].to_vec(),
        _ => jpeg(half),
    })
    .solved_without(&["c01", "c03"]);
    assert!(why(&object, 0).contains("648 x 486 px, the others have 1296 x 972 px"), "{object}");
    assert!(why(&object, 1).contains("c03.jpg"), "{object}");
    assert!(fx_error(&object).abs() < 0.5, "{object}");
}

#[test]
fn a_board_file_that_does_not_fit_is_refused() {
    let set = Set::of(8, |_, half| jpeg(half));
    set.board("pitch_mm", json!(110));
    set.refused("other_ratio");
    set.board("columns", json!(9));
    set.refused("more_circles_than_board");
    set.board("pitch_mm", json!(-1));
    set.fails("invalid_file", "pitch_mm");
}

#[test]
fn broken_commands_write_nothing() {
    let mut set = Set::new();
    set.fails("io", "recording.json");
    set.add("c01", b"");
    std::fs::remove_file(set.folder.path().join("board.json")).unwrap();
    set.fails("io", "board.json");

    // An output that is an input is refused before anything is read.
    let set = Set::of(1, |_, half| jpeg(half));
    let frame = set.folder.path().join("c01.jpg");
    let before = std::fs::read(&frame).unwrap();
    let output = boxline(&["calibrate", text(set.folder.path()), "-o", text(&frame)]);
    assert_eq!((output.status.code(), stdout(&output).as_str()), (Some(2), ""));
    assert!(stderr(&output).contains("would overwrite an input"), "{}", stderr(&output));
    assert_eq!(std::fs::read(&frame).unwrap(), before);

    // A folder that is not there is told at once, not after the work.
    let nowhere = set.folder.path().join("nowhere/calibration.json");
    let output = boxline(&["calibrate", text(set.folder.path()), "-o", text(&nowhere)]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("nowhere"), "{}", stderr(&output));
}

#[test]
fn verify_says_what_it_cannot_check() {
    let calibration = data("calibration_set/calibration.json");
    let run = |length: &str| {
        boxline(&["verify", text(&data("b02")), "--calibration", text(&calibration), "--length", length])
    };
    let good = run("550.6");
    assert_eq!(good.status.code(), Some(0), "{}", stderr(&good));
    assert!(
        stdout(&good).starts_with("in: ") && stdout(&good).contains("no covariance"),
        "{}",
        stdout(&good)
    );
    assert_eq!(run("400").status.code(), Some(3));
    for length in ["0", "-3", "nan", "long"] {
        assert_eq!(run(length).status.code(), Some(2), "{length}");
    }
    let object = json_of(&boxline(&[
        "verify",
        "nowhere",
        "--calibration",
        text(&calibration),
        "--length",
        "5",
        "--json",
    ]));
    assert_eq!(object["error"]["kind"], "io");
}

/// The recorded head at half size, and behind a lens that is not centred.
fn half_cameras() -> [CameraModel; 2] {
    let truth = &read(&data("calibration_set/calibration.json"))["camera"];
    let number = |key: &str| truth[key].as_f64().unwrap();
    let middle = |key: &str| (number(key) + 0.5) / 2.0 - 0.5;
    let camera = CameraModel {
        fx: 0.5 * number("fx"),
        fy: 0.5 * number("fy"),
        skew: 0.0,
        cx: middle("cx"),
        cy: middle("cy"),
        k1: number("k1"),
        k2: number("k2"),
        ..CameraModel::PINHOLE
    };
    [camera, CameraModel { p1: 0.0078, p2: -0.003, ..camera }]
}

/// What the second camera sees where the first saw the picture.
fn seen_by([from, to]: &[CameraModel; 2], picture: &RgbImage) -> RgbImage {
    RgbImage::from_fn(picture.width(), picture.height(), |x, y| {
        let ray = to.ray_from_px(Px::new(f64::from(x), f64::from(y)));
        let at =
            from.px_from_ray(&ray).and_then(|px| interpolate_bilinear(picture, px.u as f32, px.v as f32));
        at.unwrap_or(Rgb([128, 128, 128]))
    })
}

/// A lens that is not centred gets the terms that it has; with the paper's alone it is told that they do not fit.
#[test]
fn a_decentred_lens_is_found_and_is_told_where_it_may_not_be() {
    let cameras = half_cameras();
    let set = Set::of(8, |_, half| jpeg(&seen_by(&cameras, half)));
    let found = json_of(&set.run_with(&[]));
    let camera = &found["calibration"]["camera"];
    assert_eq!(found["calibration"]["residuals"]["lens"]["terms"], "k1, k2, p1, p2", "{found}");
    let off = |key: &str, truth: f64| camera[key].as_f64().unwrap() - truth;
    let [_, truth] = cameras;
    println!("{camera}; {}", found["calibration"]["residuals"]["circles_rms_px"]);
    for (key, truth, most) in [
        ("fx", truth.fx, 0.3),
        ("fy", truth.fy, 0.3),
        ("cx", truth.cx, 0.5),
        ("cy", truth.cy, 0.5),
        ("p1", truth.p1, 2e-4),
        ("p2", truth.p2, 2e-4),
    ] {
        assert!(off(key, truth).abs() < most, "{key} is off by {}", off(key, truth));
    }
    assert_eq!(found["misfits"], json!([]), "{found}");
    assert_eq!(found["calibration"]["covariance"].as_array().unwrap().len(), 21);
    let paper = json_of(&set.run_with(&["--lens", "paper"]));
    println!(
        "{}; {}; {}",
        paper["calibration"]["camera"], paper["calibration"]["residuals"]["circles_rms_px"], paper["misfits"]
    );
    assert_eq!(paper["misfits"][0]["kind"], "lens", "{paper}");
    assert!(paper["warnings"][0].as_str().unwrap().starts_with("the lens does not fit"), "{paper}");
    let paper_fx = paper["calibration"]["camera"]["fx"].as_f64().unwrap();
    assert!((paper_fx - truth.fx).abs() > 1.0, "the warning has a reason: {paper_fx} for {}", truth.fx);
}

/// Rendered sets: of a head with a real lens, of a bowed board, of a lens that breathes.
#[cfg(feature = "render")]
#[test]
fn rendered_sets_are_calibrated_and_their_faults_named() {
    let place = tempfile::tempdir().unwrap();
    let calibrated = |name: &str, more: &[&str]| {
        let out = place.path().join(name);
        let words = ["render", "--kind", "board", "--frames", "10", "--seed", "7", "--out", text(&out)];
        let rendered = boxline(&[&words, more].concat());
        assert_eq!(rendered.status.code(), Some(0), "{}", stderr(&rendered));
        let (set, found) = (out.join("007"), place.path().join(format!("{name}.json")));
        let output = boxline(&["calibrate", text(&set), "-o", text(&found), "--json"]);
        assert_eq!(output.status.code(), Some(0), "{}", stdout(&output));
        (read(&set.join("calibration.json")), json_of(&output))
    };
    let (truth, found) = calibrated("real", &["--head", "real"]);
    let off = |key: &str| {
        let number = |value: &Value| value["camera"][key].as_f64().unwrap();
        number(&found["calibration"]) - number(&truth)
    };
    for (key, most) in [("fx", 0.5), ("fy", 0.5), ("cx", 0.5), ("cy", 0.5), ("p1", 5e-5), ("p2", 5e-5)] {
        assert!(off(key).abs() < most, "{key} is off by {}", off(key));
    }
    assert_eq!(found["misfits"], json!([]), "{found}");
    for (fault, kind, size) in
        [("bow=2", "board_bowed", 1.2..2.6), ("focus=0.004", "focus_changes", 0.001..0.008)]
    {
        let (_, found) = calibrated(kind, &["--head", "nominal", "--faults", fault]);
        let misfit = &found["misfits"][0];
        assert_eq!(misfit["kind"], kind, "{fault}: {}", found["misfits"]);
        assert!(size.contains(&misfit["size"].as_f64().unwrap()), "{misfit}");
    }
}

/// A folder without recording and board file; copies count once; the camera alone.
#[test]
fn any_folder_of_pictures_will_do() {
    let mut set = Set::of(8, |_, half| jpeg(half));
    let usual = json_of(&set.run_with(&[]));
    set.add("c90_bytes", &jpeg(&halves()[0]));
    // Decoded and encoded once more, as a program that turns pictures does.
    let first = image::load_from_memory(&jpeg(&halves()[0])).unwrap().into_rgb8();
    set.add("c91_again", &jpeg(&first));
    for file in ["recording.json", "board.json"] {
        std::fs::remove_file(set.folder.path().join(file)).unwrap();
    }
    let without = set.run_with(&[]);
    assert_eq!(without.status.code(), Some(2));
    assert!(stderr(&without).contains("--board"), "{}", stderr(&without));
    let board = ["--board", "12x11:100:50"];
    let found = json_of(&set.run_with(&board));
    let fx = |value: &Value| value["camera"]["fx"].as_f64().unwrap();
    assert!((fx(&found["calibration"]) - fx(&usual["calibration"])).abs() < 1e-6, "{found}");
    let left_out = found["left_out"].as_array().unwrap();
    assert_eq!(left_out.len(), 2, "{found}");
    assert!(left_out.iter().all(|f| f["why"].as_str().unwrap().starts_with("a copy of")), "{found}");
    let camera = json_of(&set.run_with(&[&board[..], &["--camera-only"]].concat()));
    assert_eq!(camera["camera"]["format"], "boxline-camera/1", "{camera}");
    assert!((fx(&camera["camera"]) - fx(&usual["calibration"])).abs() < 0.05, "{camera}");
    assert_eq!(read(&set.output()), camera["camera"]);
    // Which OpenCV can have.
    let opencv = set.folder.path().join("opencv.json");
    let converted = boxline(&["convert", text(&set.output()), "--to", "opencv", "-o", text(&opencv)]);
    assert_eq!(converted.status.code(), Some(0), "{}", stderr(&converted));
    let matrix = &read(&opencv)["camera_matrix"]["data"];
    assert!((matrix[0].as_f64().unwrap() / fx(&camera["camera"]) - 1.0).abs() < 0.01, "{matrix}");
    let wrong = set.run_with(&["--board", "7x7:0.0375:0.01875"]);
    assert_eq!(wrong.status.code(), Some(2));
    assert!(stderr(&wrong).contains("COLUMNSxROWS"), "{}", stderr(&wrong));
}

/// Frames of another size than most are left out, and of as many of each the smaller ones.
#[test]
fn one_size_of_frames_is_the_heads() {
    let quarter = |half: &RgbImage| image::imageops::thumbnail(half, half.width() / 2, half.height() / 2);
    for small in [2, 6] {
        let mut set = Set::of(8, |i, half| if i < small { jpeg(&quarter(half)) } else { jpeg(half) });
        if small == 6 {
            // Six of each.
            for (i, half) in halves().iter().enumerate().take(4) {
                set.add(&format!("c9{i}"), &jpeg(half));
            }
        }
        let found = json_of(&set.run());
        let left_out = found["left_out"].as_array().unwrap();
        assert_eq!(left_out.len(), small, "{found}");
        assert!(left_out.iter().all(|f| f["why"].as_str().unwrap().contains("px")), "{found}");
        let width = read(&set.output())["image_size"][0].as_u64();
        assert_eq!(width, Some(u64::from(halves()[0].width())), "{found}");
    }
}

/// The serial number of a folder of pictures is its own name, by whatever way it is named; none is refused.
#[test]
fn a_head_always_has_a_serial_number() {
    let set = Set::of(8, |_, half| jpeg(half));
    std::fs::remove_file(set.folder.path().join("recording.json")).unwrap();
    let output = set.output();
    let run = |more: &[&str]| {
        let words = ["calibrate", ".", "--json", "-o", text(&output)];
        let mut program = std::process::Command::new(env!("CARGO_BIN_EXE_boxline"));
        program.args(words).args(more).current_dir(set.folder.path()).output().unwrap()
    };
    let found = json_of(&run(&[]));
    assert_eq!(found["calibration"]["serial"], set.folder.path().file_name().unwrap().to_str().unwrap());
    std::fs::remove_file(&output).unwrap();
    let empty = run(&["--serial", ""]);
    assert_eq!((empty.status.code(), set.left_behind()), (Some(2), 0), "{}", stderr(&empty));
}

/// Whoever asks for the skew is told it and how well it is known; nobody else is told of one.
#[test]
fn a_skew_that_is_asked_for_is_told_with_its_sigma() {
    let set = Set::of(8, |_, half| jpeg(half));
    let camera = json_of(&set.run_with(&["--camera-only", "--skew"]));
    let (skew, sigma) = (&camera["camera"]["camera"]["skew"], &camera["camera"]["sigmas"]["skew"]);
    let (skew, sigma) = (skew.as_f64().unwrap(), sigma.as_f64().unwrap());
    // Rendered without any.
    assert!(sigma > 0.0 && sigma < 1.0 && skew.abs() < 5.0 * sigma, "{skew} ± {sigma}");
    let output = set.output();
    let words = ["calibrate", text(set.folder.path()), "-o", text(&output)];
    let said = stdout(&boxline(&[&words[..], &["--skew"]].concat()));
    assert!(said.contains("\nskew       "), "{said}");
    let sigma = &read(&set.output())["residuals"]["skew_sigma_px"];
    assert!(sigma.as_f64().unwrap() > 0.0, "{sigma}");
    assert!(json_of(&set.run_with(&["--camera-only"]))["camera"]["sigmas"].get("skew").is_none());
}

#[test]
fn calibration_and_report_do_not_go_into_one_file() {
    let set = Set::of(1, |_, half| jpeg(half));
    let same = set.folder.path().join("out/../out/calibration.json");
    let output = set.run_with(&["--report", text(&same)]);
    assert_eq!((output.status.code(), set.left_behind()), (Some(2), 0));
    assert!(stderr(&output).contains("two results"), "{}", stderr(&output));
}

/// A pipe that nobody writes to is no file to wait for.
#[cfg(unix)]
#[test]
fn a_pipe_is_refused() {
    let mut set = Set::of(8, |_, half| jpeg(half));
    let pipe = |name: &str| {
        let path = set.folder.path().join(name);
        assert!(std::process::Command::new("mkfifo").arg(&path).status().unwrap().success());
        path
    };
    pipe("c99.jpg");
    let calibration = pipe("pipe.json");
    let output = boxline(&["convert", text(&calibration), "--to", "opencv", "-o", text(&set.output())]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("not a plain file"), "{}", stderr(&output));
    let output = boxline(&[
        "convert",
        text(&data("calibration_set/calibration.json")),
        "--from",
        "opencv",
        "--camera",
        text(&calibration),
        "-o",
        text(&set.output()),
    ]);
    assert!(stderr(&output).contains("not a plain file"), "{}", stderr(&output));
    set.frames.push(json!({"id": "c99", "file": "c99.jpg", "role": "board", "laser": "on"}));
    let recording = json!({"format": "boxline-recording/1", "device": {"serial": "T-1"},
        "calibration": "none.json", "frames": set.frames});
    set.write("recording.json", recording.to_string().as_bytes());
    let object = set.solved_without(&["c99"]);
    assert!(why(&object, 0).contains("not a plain file"), "{object}");
}

#[test]
fn verify_needs_a_face() {
    let calibration = data("calibration_set/calibration.json");
    let output = boxline(&[
        "verify",
        text(&data("board")),
        "--calibration",
        text(&calibration),
        "--length",
        "800",
        "--json",
    ]);
    assert_eq!(output.status.code(), Some(2), "{}", stdout(&output));
    let error = &json_of(&output)["error"];
    assert_eq!(error["kind"], "invalid_file");
    assert!(error["text"].as_str().unwrap().contains("no frame of a face"), "{error}");
}

#[test]
fn convert_goes_one_way_and_never_over_its_input() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (calibration, camera, new) = (at("c.json"), at("camera.json"), at("new.json"));
    std::fs::copy(data("calibration_set/calibration.json"), &calibration).unwrap();
    let convert = |more: &[&str], output: &Path| {
        boxline(&[&["convert", text(&calibration), "-o", text(output)], more].concat())
    };
    let from = ["--from", "opencv", "--camera", text(&camera)];
    assert_eq!(convert(&["--to", "opencv"], &camera).status.code(), Some(0));
    // Neither way, both, the other program's camera without a way.
    let both = [&from[..], &["--to", "opencv"]].concat();
    for words in [&[][..], &both, &from[2..], &["--to", "opencv", "--camera", text(&camera)]] {
        let output = convert(words, &new);
        assert_eq!(output.status.code(), Some(2), "{words:?}: {}", stdout(&output));
        assert!(!new.exists(), "{words:?}");
    }
    for (words, output) in [(&["--to", "opencv"][..], &calibration), (&from, &calibration), (&from, &camera)]
    {
        let before = std::fs::read(output).unwrap();
        let refused = convert(words, output);
        assert_eq!(refused.status.code(), Some(2), "{words:?}");
        assert!(stderr(&refused).contains("would overwrite an input"), "{}", stderr(&refused));
        assert_eq!(std::fs::read(output).unwrap(), before);
    }
    // A covariance is of the camera that is replaced.
    let mut value = read(&calibration);
    let row = |i: usize| (0..18).map(|j| if i == j { 1e-12 } else { 0.0 }).collect::<Vec<f64>>();
    assert!(!stdout(&convert(&from, &new)).contains("covariance"));
    value["covariance"] = json!((0..18).map(row).collect::<Vec<_>>());
    std::fs::write(&calibration, value.to_string()).unwrap();
    assert!(stdout(&convert(&from, &new)).contains("the calibration's covariance is of its old camera"));
    assert!(read(&new).get("covariance").is_none());
}

#[test]
fn a_camera_goes_to_opencv_and_back() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name);
    let calibration = data("calibration_set/calibration.json");
    let (camera, back) = (place("camera.json"), place("back.json"));
    let output = boxline(&["convert", text(&calibration), "--to", "opencv", "-o", text(&camera), "--json"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(json_of(&output)["max_px"].as_f64().unwrap() < 0.5);
    let from = |camera: &Path| {
        boxline(&[
            "convert",
            text(&calibration),
            "--from",
            "opencv",
            "--camera",
            text(camera),
            "-o",
            text(&back),
            "--json",
        ])
    };
    assert_eq!(from(&camera).status.code(), Some(0));
    let (there, again) = (read(&calibration), read(&back));
    assert_eq!(there["serial"], again["serial"]);
    let fx = |value: &Value| value["camera"]["fx"].as_f64().unwrap();
    assert!((fx(&there) - fx(&again)).abs() < 1.0);
    std::fs::remove_file(&back).unwrap();

    // What cannot be converted is named, and nothing is written.
    let good = read(&camera);
    let broken = |change: &dyn Fn(&mut Value), word: &str| {
        let mut value = good.clone();
        change(&mut value);
        let file = place("broken.json");
        std::fs::write(&file, value.to_string()).unwrap();
        let output = from(&file);
        assert_eq!(output.status.code(), Some(2), "{}", stdout(&output));
        assert_eq!(json_of(&output)["error"]["kind"], "invalid_file", "{}", stderr(&output));
        assert!(
            stderr(&output).contains("broken.json") && stderr(&output).contains(word),
            "{}",
            stderr(&output)
        );
        assert!(!back.exists());
    };
    broken(&|v| v["camera_matrix"]["data"][1] = json!(3.0), "skew");
    broken(&|v| v["image_width"] = json!(640), "image_width is 640");
    for odd in [json!("2592"), json!(2592.0), json!(-1), json!(1e308), json!(null)] {
        broken(&|v| v["image_width"] = odd.clone(), "image_width is ");
        broken(&|v| v["image_height"] = odd.clone(), "image_height is ");
    }
    for place in [3, 6, 7, 8] {
        broken(&|v| v["camera_matrix"]["data"][place] = json!(2.0), "last row");
    }
    broken(&|v| v["camera_matrix"]["data"][0] = json!(24.0), "fx is 24 px");
    broken(&|v| v["camera_matrix"]["data"][4] = json!(1e308), "fy is 1");
    broken(&|v| v["camera_matrix"]["data"][2] = json!(-99999.0), "cx is -99999 px");
    broken(&|v| v["distortion_coefficients"]["data"] = json!(vec![0.1; 8]), "8 numbers");
    broken(&|v| v["camera_matrix"] = json!(null), "camera_matrix");
    broken(&|v| v["distortion_model"] = json!("cv::fisheye"), "fisheye");
    broken(&|v| v["camera_matrix"]["data"][0] = json!(-5.0), "focal");
    // A lens that our terms leave 27 px of at the corners is none of ours.
    let mut value = good.clone();
    value["distortion_coefficients"]["data"] = json!([0.04, -0.39, 0.01, 0.02, 0.24]);
    let file = place("wild.json");
    std::fs::write(&file, value.to_string()).unwrap();
    let output = from(&file);
    assert_eq!(output.status.code(), Some(2), "{}", stdout(&output));
    for word in ["wild.json", "px rms and", "at most 1 px is allowed"] {
        assert!(stderr(&output).contains(word), "{}", stderr(&output));
    }
    assert!(!back.exists());
    // A decentred one is.
    value["distortion_coefficients"]["data"] = json!([0.03, -0.06, 0.0078, -0.003, 0.03]);
    std::fs::write(&file, value.to_string()).unwrap();
    assert_eq!(from(&file).status.code(), Some(0));
    let term = read(&back)["camera"]["p1"].as_f64().unwrap();
    assert!((term + 0.0078).abs() < 2e-3, "{term}");
    std::fs::remove_file(&back).unwrap();
    let mut skewed = there.clone();
    skewed["camera"]["skew"] = json!(2.5);
    let file = place("skewed.json");
    std::fs::write(&file, skewed.to_string()).unwrap();
    let output = boxline(&["convert", text(&file), "--to", "opencv", "-o", text(&back), "--json"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("skew"), "{}", stderr(&output));
    assert!(!back.exists());
}

#[test]
fn a_lens_of_opencvs_that_is_none_of_ours_is_refused_by_what_would_be_left() {
    let camera = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../../shared/cases/calibration/opencv_tangential.json");
    if !camera.is_file() {
        let mut stdout = std::io::stdout(); // what `println!` writes is hidden if the test passes
        writeln!(stdout, "SKIPPED large tangential terms: {} is not there", camera.display()).unwrap();
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let new = folder.path().join("new.json");
    let calibration = data("calibration_set/calibration.json");
    let from = ["--from", "opencv", "--camera", text(&camera), "-o", text(&new), "--json"];
    let output = boxline(&[&["convert", text(&calibration)], &from[..]].concat());
    assert_eq!(output.status.code(), Some(2), "{}", stdout(&output));
    assert_eq!(json_of(&output)["error"]["kind"], "invalid_calibration", "{}", stdout(&output));
    for word in ["opencv_tangential.json", "px rms and", "at most 1 px is allowed"] {
        assert!(stderr(&output).contains(word), "{}", stderr(&output));
    }
    assert!(!new.exists());
}
