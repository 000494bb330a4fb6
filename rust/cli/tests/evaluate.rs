//! `boxline evaluate` with rows, pages and overlays, from outside.
#![allow(clippy::unwrap_used)] // the helpers are tests too, which clippy sees only in the functions marked #[test]

mod program;

use program::{boxline, data, json_of, stderr, stdout, text};
use std::path::{Path, PathBuf};

fn made_up(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/evaluate").join(name)
}

/// Rows without their last column, which is a time.
fn timeless(path: &Path) -> Vec<String> {
    let rows = std::fs::read_to_string(path).unwrap();
    assert!(rows.ends_with('\n'));
    rows.lines().skip(1).map(|line| line.rsplit_once(',').unwrap().0.to_owned()).collect()
}

/// The numbers of the page can be counted in `boxes.csv`; intervals were compared with sums of binomial terms.
/// `REGENERATE=1` writes the page anew; the difference is reviewed like code.
#[test]
fn a_page_of_made_up_rows() {
    let folder = tempfile::tempdir().unwrap();
    let page = folder.path().join("Accuracy.md");
    let rows = made_up("boxes.csv");
    let arguments = ["evaluate", "--report", text(&page), "--csv", text(&rows), "--note", "Made up."];
    let run = boxline(&arguments);
    assert_eq!(run.status.code(), Some(0), "{}", stderr(&run));
    let written = std::fs::read_to_string(&page).unwrap();
    if std::env::var_os("REGENERATE").is_some() {
        std::fs::write(made_up("page.expected"), &written).unwrap();
    }
    assert_eq!(written, std::fs::read_to_string(made_up("page.expected")).unwrap());
    for picture in ["accuracy-1-box-reliability.svg", "accuracy-1-box-risk.svg"] {
        let svg = std::fs::read_to_string(folder.path().join("docs").join(picture)).unwrap();
        assert!(svg.starts_with("<svg") && written.contains(picture), "{picture}");
    }

    // The same numbers as an object, and as text without a page.
    let object = json_of(&boxline(&[&arguments[..], &["--json"]].concat()));
    let measurable = &object["parts"][0]["measurable"];
    assert_eq!((&measurable["count"], &measurable["wrong"]["count"]), (&11.into(), &2.into()));
    assert_eq!(object["parts"][0]["wrong"].as_array().unwrap().len(), 4);

    let two = [&arguments[..], &["--csv", text(&rows)]].concat();
    assert_eq!(boxline(&two).status.code(), Some(0));
    assert_eq!(std::fs::read_to_string(&page).unwrap().matches("## Rendered boxes").count(), 2);
}

#[test]
fn a_run_is_gone_on_with_where_it_stopped() {
    let folder = tempfile::tempdir().unwrap();
    let (rows, overlays) = (folder.path().join("rows.csv"), folder.path().join("overlays"));
    let (b01, b02) = (data("b01"), data("b02"));
    let run = |more: &[&str]| {
        boxline(&[&["evaluate", text(&b01), text(&b02), "--csv", text(&rows)], more].concat())
    };
    let first = run(&[]);
    assert_eq!(first.status.code(), Some(0), "{}", stderr(&first));
    assert!(stdout(&first).contains("### Measurable: 2 of 2 boxes"), "{}", stdout(&first));
    let whole = timeless(&rows);
    assert_eq!(whole.len(), 1 + 3 + 3);
    assert!(whole[1].starts_with("data/b01,,a b,1,3,measure,,measured,,0.9"), "{}", whole[1]);
    assert!(whole[6].contains(",height,300.0,") && whole[6].contains(",false,"), "{}", whole[6]);

    // Stopped in the middle of the second box.
    let bytes = std::fs::read(&rows).unwrap();
    std::fs::write(&rows, &bytes[..bytes.len() - 40]).unwrap();
    let again = run(&["--overlays", text(&overlays)]);
    assert_eq!(again.status.code(), Some(0), "{}", stderr(&again));
    assert_eq!(timeless(&rows), whole);
    assert!(std::fs::read_dir(&overlays).unwrap().next().is_none(), "nothing is wrong");

    // Rows of another method do not go into the same file.
    let before = std::fs::read(&rows).unwrap();
    let other = run(&["--method", "keypoints"]);
    assert_eq!(other.status.code(), Some(2));
    assert!(stderr(&other).contains("rows.csv: was made otherwise"), "{}", stderr(&other));
    assert_eq!(std::fs::read(&rows).unwrap(), before);
}

/// A copy of b02 whose truth says that the box is longer by 20 mm.
fn longer(folder: &Path) -> PathBuf {
    let copy = folder.join("longer");
    std::fs::create_dir(&copy).unwrap();
    for name in ["a.jpg", "b.jpg", "recording.json"] {
        std::fs::copy(data("b02").join(name), copy.join(name)).unwrap();
    }
    let calibration = folder.join("calibration_set");
    std::fs::create_dir_all(&calibration).unwrap();
    std::fs::copy(data("calibration_set/calibration.json"), calibration.join("calibration.json")).unwrap();
    let truth = std::fs::read_to_string(data("b02/truth.json")).unwrap();
    std::fs::write(copy.join("truth.json"), truth.replacen("550.6", "570.6", 1)).unwrap();
    copy
}

#[test]
fn a_wrong_box_is_drawn_and_a_broken_one_does_not_stop_the_others() {
    let folder = tempfile::tempdir().unwrap();
    longer(folder.path());
    let broken = folder.path().join("broken");
    std::fs::create_dir(&broken).unwrap();
    std::fs::write(broken.join("recording.json"), "{}").unwrap();
    std::fs::write(broken.join("truth.json"), "{}").unwrap();
    let parent = text(folder.path());

    let table = boxline(&["evaluate", parent]);
    assert_eq!(table.status.code(), Some(2));
    assert!(
        stderr(&table).contains("/broken: ") && stderr(&table).contains("missing field `format`"),
        "{}",
        stderr(&table)
    );
    assert!(
        stdout(&table).contains("longer") && stdout(&table).contains("WRONG: off by"),
        "{}",
        stdout(&table)
    );
    assert!(stdout(&table).contains("/broken: not evaluated: "), "{}", stdout(&table));

    let overlays = folder.path().join("overlays");
    let arguments = ["evaluate", parent, "--overlays", text(&overlays), "--json"];
    let scored = boxline(&arguments);
    assert_eq!(scored.status.code(), Some(2));
    let object = json_of(&scored);
    assert_eq!(object["broken"].as_array().unwrap().len(), 1);
    let wrong = &object["parts"][0]["wrong"][0];
    let off = wrong["error_mm"].as_f64().unwrap();
    assert!((-22.0..-18.0).contains(&off), "{wrong}");
    let drawn: Vec<_> = std::fs::read_dir(&overlays).unwrap().map(|e| e.unwrap().path()).collect();
    assert_eq!(drawn.len(), 1);
    assert!(text(&drawn[0]).ends_with("_longer_a_b.jpg"), "{drawn:?}");
    assert!(std::fs::metadata(&drawn[0]).unwrap().len() > 50_000);
}

#[test]
fn senseless_command_lines() {
    let folder = tempfile::tempdir().unwrap();
    let rows = text(folder.path()).to_owned() + "/rows.csv";
    let b02 = data("b02");
    for (arguments, word) in [
        (vec!["evaluate", "--report", "page.md"], "--csv"),
        (vec!["evaluate", "--report", "page.html", "--csv", &rows], "page.html"),
        (vec!["evaluate", "--report", "page.md", "--csv", &rows], "no such file"),
        (vec!["evaluate", "--report", "page.md", "--csv", "page.md"], "would overwrite an input"),
        (vec!["evaluate", text(&b02), "--csv", &rows, "--method", "both"], "--method"),
        (vec!["evaluate", text(&b02), "--csv", &rows, "--csv", "b.csv"], "one --csv"),
        (vec!["evaluate", text(&b02), text(&b02), "--csv", &rows], "data/b02"),
        (vec!["evaluate", text(&b02), "--note", "text"], "--report"),
    ] {
        let run = boxline(&arguments);
        assert_eq!(run.status.code(), Some(2), "{arguments:?}");
        assert!(stderr(&run).contains(word) && run.stdout.is_empty(), "{arguments:?}: {}", stderr(&run));
    }
}
