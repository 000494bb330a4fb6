//! The program from outside: exit codes, what is printed where, and that broken input leaves nothing behind.
#![allow(clippy::unwrap_used)] // the helpers are tests too, which clippy sees only in the functions marked #[test]

mod program;

use program::{boxline, data, json_of, stderr, stdout, text};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Output;

fn calibration() -> PathBuf {
    data("calibration_set/calibration.json")
}

/// Runs a command with `--json` that must fail on its input, and returns what it says on standard error.
fn fails(arguments: &[&str], kind: &str) -> String {
    let output = boxline(&[arguments, &["--json"]].concat());
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
    assert!(said.starts_with("error: "), "{said}");
    assert!(!said.contains("panicked"), "{said}");
    let object = json_of(&output);
    assert_eq!(object["outcome"], "error");
    assert_eq!(object["error"]["kind"], kind, "{said}");
    assert!(said.contains(object["error"]["text"].as_str().unwrap()), "{said}");

    // Without --json, standard output is empty.
    let output = boxline(arguments);
    assert_eq!((output.status.code(), stdout(&output).as_str()), (Some(2), ""));
    said
}

/// `boxline face` on a frame made of these bytes fails, names the file and leaves nothing beside it.
fn broken_frame(bytes: &[u8], kind: &str) -> String {
    let folder = tempfile::tempdir().unwrap();
    let frame = folder.path().join("frame.jpg");
    std::fs::write(&frame, bytes).unwrap();
    let overlay = folder.path().join("overlay.png");
    let said = fails(
        &["face", text(&frame), "--calibration", text(&calibration()), "--overlay", text(&overlay)],
        kind,
    );
    assert!(said.contains("frame.jpg"), "{said}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "something was left behind");
    said
}

/// `boxline face` with the true calibration changed.
fn broken_calibration(change: impl Fn(String) -> String, kind: &str) -> String {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("head.json");
    std::fs::write(&file, change(std::fs::read_to_string(calibration()).unwrap())).unwrap();
    let said = fails(&["face", text(&data("b02/a.jpg")), "--calibration", text(&file)], kind);
    assert!(said.contains("head.json"), "{said}");
    said
}

fn names_in(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap();
    let mut names: Vec<String> =
        entries.map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

#[test]
fn each_stage_is_drawn() {
    let parent = tempfile::tempdir().unwrap();
    let folder = parent.path().join("stages");
    let explained = boxline(&["measure", text(&data("b02")), "--explain", text(&folder)]);
    assert_eq!(explained.status.code(), Some(0), "{}", stderr(&explained));
    assert_eq!(stdout(&explained), stdout(&boxline(&["measure", text(&data("b02"))])));
    let stages = ["frame", "network", "laser-light", "planes", "stripes", "outlines", "edges", "face"]
        .iter()
        .enumerate();
    let of = |letter| stages.clone().map(move |(i, stage)| format!("{letter}-{}-{stage}.jpg", i + 1));
    let due: Vec<String> = of("a").chain(of("b")).chain(["box.jpg".to_owned()]).collect();
    assert_eq!(names_in(&folder), due);
    let pictures: Vec<image::RgbImage> =
        due.iter().map(|name| image::open(folder.join(name)).unwrap().into_rgb8()).collect();
    assert!(pictures.iter().all(|picture| picture.width() == pictures[0].width()));
    // What is drawn is drawn where it is: the middle of the face lies in the network's green and between its stripes.
    let at = |picture: &image::RgbImage| picture.get_pixel(picture.width() / 2, picture.height() / 2).0;
    let [r, g, b] = at(&pictures[1]);
    assert!(g > r && g > b, "{:?}", [r, g, b]);

    // Nothing is overwritten, and nothing is left beside it.
    let again = boxline(&["measure", text(&data("b02")), "--explain", text(&folder)]);
    assert_eq!((again.status.code(), stdout(&again).as_str()), (Some(2), ""));
    assert!(stderr(&again).contains("is there already"), "{}", stderr(&again));
    assert_eq!(names_in(parent.path()), ["stages"]);
}

#[test]
fn the_stages_of_a_refused_view_are_drawn_up_to_the_one_that_refuses() {
    let parent = tempfile::tempdir().unwrap();
    let folder = parent.path().join("stages");
    let (cut, none, head) = (data("refuse/r2.jpg"), data("refuse/r3.jpg"), calibration());
    let arguments =
        ["measure", text(&cut), text(&none), "--calibration", text(&head), "--explain", text(&folder)];
    let output = boxline(&arguments);
    assert_eq!(output.status.code(), Some(3), "{}", stderr(&output));
    assert!(stdout(&output).contains("border"), "{}", stdout(&output));
    let due = [
        "a-1-frame.jpg",
        "a-2-network.jpg",
        "a-3-laser-light.jpg",
        "a-4-planes.jpg",
        "a-5-stripes.jpg",
        "a-6-outlines.jpg",
        "a-8-face.jpg",
        "b-1-frame.jpg",
        "b-2-network.jpg",
        "b-3-laser-light.jpg",
        "b-4-planes.jpg",
        "b-8-face.jpg",
        "box.jpg",
    ];
    assert_eq!(names_in(&folder), due);

    // A folder that cannot be made: an error, and nothing left.
    let nowhere = parent.path().join("no/stages");
    let output = boxline(&[&arguments[..6], &[text(&nowhere)]].concat());
    assert_eq!((output.status.code(), stdout(&output).as_str()), (Some(2), ""));
    assert_eq!(names_in(parent.path()), ["stages"]);
}

#[test]
fn a_network_of_one_map_is_for_hough_alone() {
    let model = data("../../rust/edgenet/tests/data/ihed-tiny.onnx");
    let face =
        ["face", text(&data("b02/a.jpg")), "--calibration", text(&calibration()), "--model", text(&model)]
            .map(str::to_owned);
    let face: Vec<&str> = face.iter().map(String::as_str).collect();
    let said = fails(&face, "model_file");
    assert!(said.contains("ihed-tiny.onnx") && said.contains("--edges hough"), "{said}");
    // Nobody trained this one: it sees no face, which is no error.
    let output = boxline(&[&face[..], &["--edges", "hough", "--method", "keypoints", "--json"]].concat());
    assert_eq!(output.status.code(), Some(3), "{}", stderr(&output));
    assert_eq!(json_of(&output)["reject"]["reason"], "rectangle_open");
}

#[test]
fn measures_a_recording() {
    let folder = tempfile::tempdir().unwrap();
    let overlay = folder.path().join("b02.png");
    let output = boxline(&["measure", text(&data("b02")), "--json", "--overlay", text(&overlay)]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert_eq!(stderr(&output), "");
    let object = json_of(&output);
    assert_eq!(object["outcome"], "measured");
    for (side, truth_mm) in [("length_mm", 550.6), ("width_mm", 350.5), ("height_mm", 300.0)] {
        let value = object[side]["value"].as_f64().unwrap();
        assert!((value - truth_mm).abs() < 5.0, "{side} is {value}");
        assert!(object[side]["sigma"].as_f64().unwrap() > 0.0);
    }
    assert_eq!(object["faces"][0]["frame"], "a");
    assert_eq!(object["faces"][1]["frame"], "b");
    let picture = image::open(&overlay).unwrap();
    assert_eq!(picture.width(), 1600);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "a temporary file was left behind");
}

#[test]
fn frames_and_folder_give_the_same_numbers() {
    let folder = json_of(&boxline(&["measure", text(&data("b02")), "--ignore-off", "--json"]));
    let [a, b] = ["b02/a.jpg", "b02/b.jpg"].map(data);
    let frames =
        json_of(&boxline(&["measure", text(&a), text(&b), "--calibration", text(&calibration()), "--json"]));
    assert_eq!(folder["length_mm"], frames["length_mm"]);
    assert_eq!(folder["volume_m3"], frames["volume_m3"]);
    assert_eq!(frames["faces"][0]["frame"], "a.jpg");
}

#[test]
fn says_it_in_words() {
    let output = boxline(&["measure", text(&data("b02"))]);
    let said = stdout(&output);
    for word in ["length", "width", "height", "volume", "mm ±", "m³ ±", "frame a", "frame b"] {
        assert!(said.contains(word), "{word} is missing in\n{said}");
    }
}

#[test]
fn a_refusal_ends_with_3_and_says_what_to_do() {
    for (frame, reason) in [("r1", "stripe_missing"), ("r2", "face_cut_by_border"), ("r3", "no_box")] {
        let file = data(&format!("refuse/{frame}.jpg"));
        let calibration = calibration();
        let arguments = ["face", text(&file), "--calibration", text(&calibration)];
        let output = boxline(&[&arguments[..], &["--json"]].concat());
        assert_eq!(output.status.code(), Some(3));
        let object = json_of(&output);
        assert_eq!(object["outcome"], "rejected");
        assert_eq!(object["reject"]["reason"], reason);
        assert!(object["length_mm"].is_null());

        let output = boxline(&arguments);
        assert_eq!(output.status.code(), Some(3));
        assert!(stdout(&output).contains("not measured"), "{}", stdout(&output));
    }
}

#[test]
fn a_refusal_is_drawn_too() {
    let folder = tempfile::tempdir().unwrap();
    let overlay = folder.path().join("r2.jpg");
    let frame = data("refuse/r2.jpg");
    let calibration = calibration();
    let output =
        boxline(&["face", text(&frame), "--calibration", text(&calibration), "--overlay", text(&overlay)]);
    assert_eq!(output.status.code(), Some(3));
    assert_eq!(image::open(&overlay).unwrap().width(), 1600);
}

/// A picture of the same view, as a second exposure would be: encoded again, so not the very same.
fn again(frame: &Path, folder: &Path) -> PathBuf {
    let copy = folder.join("again.jpg");
    let picture = image::open(frame).unwrap();
    let file = std::fs::File::create(&copy).unwrap();
    picture.write_with_encoder(image::codecs::jpeg::JpegEncoder::new_with_quality(file, 97)).unwrap();
    copy
}

#[test]
fn the_same_face_twice_leaves_two_boxes() {
    let folder = tempfile::tempdir().unwrap();
    let a = data("b02/a.jpg");
    let (again, calibration) = (again(&a, folder.path()), calibration());
    let arguments = ["measure", text(&a), text(&again), "--calibration", text(&calibration), "--json"];
    let output = boxline(&arguments);
    assert_eq!(output.status.code(), Some(4), "{}", stderr(&output));
    let object = json_of(&output);
    assert_eq!(object["outcome"], "ambiguous");
    assert_eq!(object["candidates"].as_array().unwrap().len(), 2);

    for choice in ["1", "2"] {
        let output = boxline(&[&arguments[..], &["--choose", choice]].concat());
        assert_eq!(output.status.code(), Some(0));
        let index: usize = choice.parse::<usize>().unwrap() - 1;
        assert_eq!(json_of(&output)["length_mm"], object["candidates"][index]["length_mm"]);
        assert_eq!(json_of(&output)["width_mm"], object["candidates"][index]["width_mm"]);
    }
}

#[test]
fn views_with_the_lasers_off_are_used_and_one_that_does_not_fit_is_named_and_left_out() {
    let (a, b, a_off, b_off) =
        (data("b02/a.jpg"), data("b02/b.jpg"), data("b02/a_off.jpg"), data("b02/b_off.jpg"));
    let (calibration, folder) = (calibration(), data("b02"));
    let of_frames = |off: &[&Path]| {
        let mut arguments =
            vec!["measure", text(&a), text(&b), "--calibration", text(&calibration), "--json"];
        off.iter().for_each(|off| arguments.extend(["--off", text(off)]));
        boxline(&arguments)
    };
    let length = |output: &Output| json_of(output)["length_mm"]["value"].as_f64().unwrap();
    let recorded = boxline(&["measure", text(&folder), "--json"]);
    let with_off = of_frames(&[&a_off, &b_off]);
    assert_eq!(length(&with_off), length(&recorded), "a recording's own are used");
    let without = of_frames(&[]);
    assert_eq!(length(&without), length(&boxline(&["measure", text(&folder), "--ignore-off", "--json"])));
    assert!((length(&with_off) - length(&without)).abs() < 0.5);
    let wrong = of_frames(&[&b_off, &b_off]);
    assert!(
        stderr(&wrong).contains("another view") && stderr(&wrong).contains("not used"),
        "{}",
        stderr(&wrong)
    );
    let missing = of_frames(&[&data("b02/none.jpg"), &b_off]);
    assert_eq!(missing.status.code(), Some(0), "{}", stderr(&missing));
    assert!(stderr(&missing).contains("none.jpg"), "{}", stderr(&missing));
    for off in [&[&*a_off][..], &[&*a_off, &*b_off, &*b_off]] {
        let output = of_frames(off);
        assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
        assert!(stderr(&output).contains("--off"), "{}", stderr(&output));
    }
}

#[test]
fn a_third_frame_settles_which_box_it_is_and_one_that_shows_none_does_no_harm() {
    let folder = tempfile::tempdir().unwrap();
    let (a, b, dark) = (data("b02/a.jpg"), data("b02/b.jpg"), data("b02/a_off.jpg"));
    let (again, calibration) = (again(&a, folder.path()), calibration());
    let measured = |frames: &[&Path]| {
        let mut arguments = vec!["measure"];
        arguments.extend(frames.iter().map(|frame| text(frame)));
        arguments.extend(["--calibration", text(&calibration), "--json"]);
        let output = boxline(&arguments);
        assert_eq!(output.status.code(), Some(0), "{frames:?}: {}", stderr(&output));
        json_of(&output)
    };
    let two = measured(&[&a, &b]);
    for frames in [[&a, &again, &b], [&a, &b, &dark]] {
        let three = measured(&frames.map(|frame| frame.as_path()));
        assert_eq!(three["faces"].as_array().unwrap().len(), 3);
        for side in ["length_mm", "width_mm", "height_mm"] {
            let [value, due] = [&three, &two].map(|object| object[side]["value"].as_f64().unwrap());
            assert!((value - due).abs() < 0.5, "{frames:?}: {side} is {value}, by two frames {due}");
        }
    }
    assert_eq!(measured(&[&a, &b, &dark])["faces"][2]["outcome"], "rejected");
}

#[test]
fn methods_can_be_chosen() {
    for way in [["--method", "keypoints"], ["--edges", "hough"]] {
        let output = boxline(&[&["measure", text(&data("b03")), "--json"][..], &way].concat());
        assert!(matches!(output.status.code(), Some(0 | 3)), "{}", stderr(&output));
        json_of(&output);
    }
}

#[test]
fn broken_frames() {
    assert!(broken_frame(b"", "invalid_frame").contains("0 bytes"));
    broken_frame(b"this is no picture", "invalid_frame");
    broken_frame(&[0xff; 4096], "invalid_frame");
    let whole = std::fs::read(data("b02/a.jpg")).unwrap();
    broken_frame(&whole[..whole.len() / 2], "invalid_frame");
    broken_frame(&whole[..200], "invalid_frame");
}

/// Which would be a box of two equal faces, measured to a smaller sigma than one of them.
#[test]
fn one_picture_is_not_two_faces() {
    let folder = tempfile::tempdir().unwrap();
    let (a, b, calibration) = (data("b01/a.jpg"), data("b01/b.jpg"), calibration());
    let copy = folder.path().join("copy.jpg");
    std::fs::copy(&a, &copy).unwrap();
    for frames in [vec![&a, &a], vec![&a, &copy], vec![&a, &b, &copy]] {
        let mut words = vec!["measure"];
        words.extend(frames.iter().map(|frame| text(frame)));
        words.extend(["--calibration", text(&calibration)]);
        let said = fails(&words, "invalid_frame");
        assert!(said.contains("is the same picture as the"), "{said}");
    }
}

#[test]
fn a_network_is_a_plain_file() {
    let b02 = data("b02");
    let said = fails(&["measure", text(&b02), "--model", "/dev/zero"], "io");
    assert!(said.contains("not a plain file"), "{said}");
}

#[test]
fn a_frame_of_another_size() {
    let folder = tempfile::tempdir().unwrap();
    let small = folder.path().join("small.jpg");
    image::RgbImage::new(320, 240).save(&small).unwrap();
    let a = data("b02/a.jpg");
    let calibration = calibration();
    let said = fails(&["face", text(&small), "--calibration", text(&calibration)], "calibration_mismatch");
    assert!(said.contains("small.jpg") && said.contains("320 x 240"), "{said}");
    for pair in [[text(&a), text(&small)], [text(&small), text(&a)]] {
        let said = fails(
            &["measure", pair[0], pair[1], "--calibration", text(&calibration)],
            "calibration_mismatch",
        );
        assert!(said.contains("small.jpg"), "{said}");
    }
}

#[test]
fn missing_files() {
    let (a, calibration) = (data("b02/a.jpg"), calibration());
    let said = fails(&["measure", text(&a), "nowhere.jpg", "--calibration", text(&calibration)], "io");
    assert!(said.contains("nowhere.jpg"), "{said}");
    let said = fails(&["face", text(&a), "--calibration", "nowhere.json"], "io");
    assert!(said.contains("nowhere.json"), "{said}");
    assert!(fails(&["measure", "nowhere"], "io").contains("nowhere"));
    assert!(fails(&["evaluate", "nowhere"], "io").contains("nowhere"));
    // A folder in place of a frame.
    fails(&["face", text(&data("b02")), "--calibration", text(&calibration)], "io");
}

#[test]
fn broken_calibrations() {
    let kind = "invalid_calibration";
    broken_calibration(|_| String::new(), kind);
    broken_calibration(|_| "[]".to_owned(), kind);
    let said = broken_calibration(|text| text.replace("\"fx\"", "\"gx\""), kind);
    assert!(said.contains("fx"), "{said}");
    let said =
        broken_calibration(|text| text.replace("boxline-calibration/1", "boxline-calibration/9"), kind);
    assert!(said.contains("boxline-calibration/9"), "{said}");
    let said = broken_calibration(|text| text.replacen("\"k1\":", "\"k1\": NaN, \"unused\":", 1), kind);
    assert!(said.contains("k1"), "{said}");
    let said = broken_calibration(|text| text.replacen("\"k2\":", "\"k2\": null, \"unused\":", 1), kind);
    assert!(said.contains("k2"), "{said}");
}

#[test]
fn an_error_is_told_once() {
    let said = broken_calibration(|text| text[..text.len() / 2].to_owned(), "invalid_calibration");
    assert_eq!(said.matches("EOF while parsing").count(), 1, "{said}");
    let said = fails(&["face", text(&data("b02")), "--calibration", text(&calibration())], "io");
    assert_eq!(said.matches("os error").count(), 1, "{said}");
}

#[test]
fn negative_numbers_are_told_what_is_needed() {
    let b02 = data("b02");
    let (b02, calibration) = (text(&b02), calibration());
    let calibrated = ["--calibration", text(&calibration)];
    for (arguments, needed) in [
        (&["verify", b02, "--length", "-800"][..], "a positive number of mm"),
        (&["drift", b02, "--length", "-800"], "a positive number of mm"),
        (&["feasibility", "--face", "-800x600"], "LENGTHxWIDTH"),
        (&["face", "a.jpg", "--drift-mrad", "-1"], "0 to 10 mrad"),
        (&["face", "a.jpg", "--least-confidence", "-0.5"], "0 to 1"),
        (&["face", "a.jpg", "--threads", "-2"], "1 to 64 threads"),
        (&["face", "a.jpg", "--threads", "2000"], "1 to 64 threads"),
    ] {
        let said = fails(&[arguments, &calibrated].concat(), "usage");
        assert!(said.contains(needed) && !said.contains("unexpected argument"), "{arguments:?}: {said}");
    }
    for arguments in [
        &["laser", "all", "--seconds", "-1"][..],
        &["head", "calibration", "read", "-o", "x", "--device", "-1"],
    ] {
        let output = boxline(arguments);
        assert_eq!(output.status.code(), Some(2));
        assert!(!stderr(&output).contains("unexpected argument"), "{}", stderr(&output));
    }
}

#[test]
fn nothing_that_is_read_steers_the_terminal() {
    const CLEAR: &str = "\\u001b[2J\\u0007\\u009b";
    let folder =
        recording(&[frame(&format!("a{CLEAR}"), "a.jpg", "on"), frame("b", "b.jpg", "on")].join(","));
    let file = folder.path().join("calibration.json");
    let other = std::fs::read_to_string(&file).unwrap().replace("SIM-0001", &format!("S{CLEAR}"));
    std::fs::write(&file, other).unwrap();
    let strange = folder.path().join("\u{1b}[31m.jpg");
    for arguments in [
        &["measure", text(folder.path())][..],
        &["measure", text(folder.path()), "--json"],
        &["drift", text(folder.path())],
        &["face", text(&strange), "--calibration", text(&file)],
    ] {
        let output = boxline(arguments);
        let said = stdout(&output) + &stderr(&output);
        assert!(!said.contains(|c: char| c.is_control() && c != '\n'), "{arguments:?}: {said:?}");
        assert!(said.contains("\\u001b["), "{arguments:?}: {said:?}");
    }
    let object = json_of(&boxline(&["measure", text(folder.path()), "--json"]));
    assert_eq!(object["faces"][0]["frame"], "a\u{1b}[2J\u{7}\u{9b}");
}

/// A recording with this manifest, made of frames of b02.
fn recording(frames: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::copy(calibration(), folder.path().join("calibration.json")).unwrap();
    for name in ["a.jpg", "b.jpg"] {
        std::fs::copy(data("b02").join(name), folder.path().join(name)).unwrap();
    }
    let manifest = format!(
        r#"{{"format": "boxline-recording/1", "device": {{"serial": "SIM-0001"}},
            "calibration": "calibration.json", "frames": [{frames}]}}"#
    );
    std::fs::write(folder.path().join("recording.json"), manifest).unwrap();
    folder
}

fn frame(id: &str, file: &str, laser: &str) -> String {
    format!(r#"{{"id": "{id}", "file": "{file}", "role": "face", "laser": "{laser}"}}"#)
}

#[test]
fn a_recording_needs_two_lit_faces() {
    let other_names = recording(&[frame("top", "a.jpg", "on"), frame("side", "b.jpg", "on")].join(","));
    let output = boxline(&["measure", text(other_names.path()), "--json"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert_eq!(json_of(&output)["faces"][0]["frame"], "top");

    let one = recording(&[frame("a", "a.jpg", "on"), frame("b", "b.jpg", "off")].join(","));
    let said = fails(&["measure", text(one.path())], "invalid_file");
    assert!(said.contains("found 1: a"), "{said}");

    let none = recording("");
    let said = fails(&["measure", text(none.path())], "invalid_file");
    assert!(said.contains("found 0"), "{said}");

    let said = fails(&["measure", text(&data("refuse"))], "invalid_file");
    assert!(said.contains("found 3: r1, r2, r3"), "{said}");

    let gone = recording(&[frame("a", "a.jpg", "on"), frame("b", "gone.jpg", "on")].join(","));
    let said = fails(&["measure", text(gone.path())], "io");
    assert!(said.contains("gone.jpg"), "{said}");
}

#[test]
fn a_calibration_of_another_head_is_pointed_out() {
    let folder = recording(&[frame("a", "a.jpg", "on"), frame("b", "b.jpg", "on")].join(","));
    let file = folder.path().join("calibration.json");
    let other = std::fs::read_to_string(&file).unwrap().replace("SIM-0001", "SIM-0002");
    std::fs::write(&file, other).unwrap();
    let output = boxline(&["measure", text(folder.path()), "--json"]);
    assert!(stderr(&output).starts_with("warning: "), "{}", stderr(&output));
    assert_eq!(json_of(&output)["outcome"], "measured");
}

#[test]
fn an_overlay_that_cannot_be_written() {
    let (a, b, calibration) = (data("b02/a.jpg"), data("b02/b.jpg"), calibration());
    let measure = |overlay: &str, kind: &str| {
        fails(
            &["measure", text(&a), text(&b), "--calibration", text(&calibration), "--overlay", overlay],
            kind,
        )
    };
    assert!(measure("picture.gif", "usage").contains("picture.gif"));
    assert!(measure("no/such/folder/picture.png", "io").contains("picture.png"));
    // An input is never overwritten.
    let before = std::fs::read(&a).unwrap();
    measure(text(&a), "usage");
    assert_eq!(std::fs::read(&a).unwrap(), before);
}

#[test]
fn usage_errors() {
    let a = data("b02/a.jpg");
    let calibration = calibration();
    fails(&[], "usage");
    fails(&["weigh"], "usage");
    fails(&["measure"], "usage");
    fails(&["measure", text(&a)], "usage");
    fails(&["measure", text(&a), text(&a)], "usage");
    fails(&["measure", text(&a), text(&a), text(&a), text(&a), "--calibration", text(&calibration)], "usage");
    fails(&["measure", text(&data("b02")), "--choose", "3"], "usage");
    fails(&["measure", text(&data("b02")), "--method", "guess"], "usage");
    fails(&["face", text(&a)], "usage");
    fails(&["evaluate"], "usage");
    let empty = tempfile::tempdir().unwrap();
    fails(&["evaluate", text(empty.path())], "usage");
}

#[test]
fn help_and_version() {
    for arguments in [&["--help"][..], &["measure", "--help"], &["face", "--help"], &["evaluate", "--help"]] {
        let output = boxline(arguments);
        assert_eq!((output.status.code(), stderr(&output).as_str()), (Some(0), ""));
        assert!(stdout(&output).contains("Usage: boxline"));
        assert!(stdout(&output).contains("Exit codes"), "{}", stdout(&output));
        assert!(arguments.len() == 1 || stdout(&output).contains("Example"), "{}", stdout(&output));
    }
    let output = boxline(&["--version"]);
    assert_eq!(stdout(&output), format!("boxline {}\n", env!("CARGO_PKG_VERSION")));
}

#[test]
fn evaluates_all_recordings() {
    let output = boxline(&["evaluate", text(&data("")), "--method", "both", "--json"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert_eq!(stderr(&output), "", "progress is for terminals");
    let object = json_of(&output);
    let recordings = object["recordings"].as_array().unwrap();
    let of = |name: &str, method: &str| {
        recordings.iter().find(|r| r["recording"] == name && r["method"] == method).unwrap()
    };
    for method in ["fit", "keypoints"] {
        assert_eq!(of("b02", method)["box"]["true_mm"][0], 550.6);
        assert_eq!(of("b02", method)["box"]["error_mm"].as_array().unwrap().len(), 3);
        assert!(of("b02", method)["times_ms"]["decode"].as_f64().unwrap() > 0.0);
        assert!(of("b02", method)["faces"][0]["corners_px"]["rms"].as_f64().unwrap() < 20.0);
        assert!(of("refuse", method)["box"].is_null());
        assert_eq!(of("refuse", method)["faces"].as_array().unwrap().len(), 3);
    }
    assert!(!recordings.iter().any(|r| r["recording"] == "calibration_set"));
    // Refusals are missed, not wrong. The paper's key points are for comparison.
    let wrong = object["wrong"].as_array().unwrap().iter().map(|w| w.as_str().unwrap());
    assert_eq!(wrong.filter(|w| !w.contains(", keypoints: ")).collect::<Vec<_>>(), [""; 0]);
    assert!(object["missed"].as_array().unwrap().iter().all(|m| m.as_str().unwrap().contains("refused")));
    assert_eq!(object["summary"][0]["of"], "boxes");
}

#[test]
fn evaluates_in_words() {
    let output = boxline(&["evaluate", text(&data("b02")), text(&data("refuse"))]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let said = stdout(&output);
    for word in
        ["Boxes", "Faces", "must be refused", "Errors in mm", "Time in ms", "550.6", "no_box", "decode"]
    {
        assert!(said.contains(word), "{word} is missing in\n{said}");
    }
}

/// A truth that does not hold makes the evaluation shout.
#[test]
fn a_wrong_result_is_flagged() {
    let folder = recording(&[frame("a", "a.jpg", "on"), frame("b", "b.jpg", "on")].join(","));
    let truth = |text: String| std::fs::write(folder.path().join("truth.json"), text).unwrap();
    let original = std::fs::read_to_string(data("b02/truth.json")).unwrap();
    let wrong = |arguments: &[&str]| {
        let output = boxline(&[&["evaluate", text(folder.path())], arguments].concat());
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        stdout(&output)
    };

    truth(original.replacen("550.6", "580.6", 1));
    assert!(wrong(&[]).contains("WRONG: off by"), "{}", wrong(&[]));

    truth(original.replacen('{', "{\"must_refuse\": true,", 1));
    let said = wrong(&[]);
    assert!(said.contains("!!! 2 WRONG !!!") && said.contains("measured, a refusal was due"), "{said}");
    let object: Value = serde_json::from_str(&wrong(&["--json"])).unwrap();
    assert_eq!(object["wrong"].as_array().unwrap().len(), 2);
}

#[test]
fn without_a_box_every_frame_is_judged_by_itself() {
    let folder = recording(&[frame("a", "a.jpg", "on"), frame("b", "b.jpg", "on")].join(","));
    let mut truth: Value =
        serde_json::from_str(&std::fs::read_to_string(data("b02/truth.json")).unwrap()).unwrap();
    truth["box_mm"] = Value::Null;
    std::fs::write(folder.path().join("truth.json"), truth.to_string()).unwrap();
    let object = json_of(&boxline(&["evaluate", text(folder.path()), "--json"]));
    assert!(object["recordings"][0]["box"].is_null());
    let faces = object["recordings"][0]["faces"].as_array().unwrap();
    assert_eq!(faces.len(), 2);
    assert_eq!(faces[1]["verdict"], "right");

    // A frame without truth cannot be judged.
    truth["faces"].as_array_mut().unwrap().pop();
    std::fs::write(folder.path().join("truth.json"), truth.to_string()).unwrap();
    let said = fails(&["evaluate", text(folder.path())], "invalid_file");
    assert!(said.contains("truth.json") && said.contains("\"b\""), "{said}");
}
