//! The library as a JVM sees it: builds `libboxline_jni`, compiles the callers in `tests/jvm/java`, runs them on the
//! machine's JDK and compares the bytes that come out with what the same frames give here, without a JVM in between.
//! Without a JDK it is skipped, and says so.
#![allow(clippy::unwrap_used)] // the helpers of tests are tests

use boxline::{Frame, measure_box};
use boxline_proto::json::{read_calibration, read_recording, report_json};
use boxline_proto::message::{decode_report, encode_report};
use boxline_tests::shipped;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

/// What `BoundaryCheck` must print, in order.
const CHECKS: [&str; 14] = [
    "measure",
    "position_and_limit",
    "echo",
    "panic",
    "errors",
    "broken_calibration",
    "broken_frames",
    "wrong_arguments",
    "closed_handle",
    "open_and_close_50_times",
    "stop",
    "threads",
    "close_during_calls",
    "nothing_left_open",
];

#[test]
fn a_jvm_gets_the_same_bytes_and_typed_failures() {
    let Some(bin) = jdk_bin() else {
        // Straight to stdout: the test harness hides what a passing test prints, and a skipped test must be seen.
        writeln!(std::io::stdout(), "SKIPPED jvm: no javac in JAVA_HOME or PATH").unwrap();
        return;
    };
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    let scratch = Path::new(env!("CARGO_TARGET_TMPDIR")).join("jvm");
    let library = build_library(root, &scratch.join("target"));
    let classes = scratch.join("classes");
    compile_java(&bin, &root.join("tests/jvm/java"), &classes);

    let recording = read_recording(&root.join("tests/data/b02")).unwrap();
    let measured = scratch.join("measured.bin");
    // -Xcheck:jni makes the JVM look over every call that comes out of the library.
    let output = Command::new(bin.join("java"))
        .args(["-Xcheck:jni", "-Xmx256m", "-Dfile.encoding=UTF-8", "-cp"])
        .arg(&classes)
        .arg("dev.boxline.BoundaryCheck")
        .args([&library, &recording.calibration_file, &recording.folder, &measured])
        .output()
        .unwrap();
    let stdout = String::from_utf8_lossy(&output.stdout);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{}\n{stdout}\n{stderr}", output.status);
    // Exactly these lines: a complaint of the JVM would stand between them.
    assert_eq!(stdout.lines().collect::<Vec<_>>(), CHECKS.map(|name| format!("ok {name}")));

    let frame = |id: &str| {
        let file = &recording.frames.iter().find(|f| f.id == id).unwrap().file;
        Frame::from_jpeg(&std::fs::read(file).unwrap()).unwrap()
    };
    let calibration = read_calibration(&recording.calibration_file).unwrap();
    let (a, b) = (frame("a"), frame("b"));
    let report = measure_box(&[&a, &b], &calibration, &shipped()).unwrap();
    let by_jvm = std::fs::read(&measured).unwrap();
    assert_eq!(by_jvm, encode_report(&report, &["a", "b"]), "the bytes differ");
    // The same numbers as `boxline measure --json` prints, digit by digit.
    let decoded = decode_report(&by_jvm).unwrap();
    assert_eq!(
        report_json(&decoded.report, &["a", "b"]).to_string(),
        report_json(&report, &["a", "b"]).to_string()
    );
}

/// The folder with `java` and `javac`.
fn jdk_bin() -> Option<PathBuf> {
    let home = std::env::var_os("JAVA_HOME").map(|home| PathBuf::from(home).join("bin"));
    let path = std::env::var_os("PATH").unwrap_or_default();
    let folders = home.into_iter().chain(std::env::split_paths(&path));
    folders.into_iter().find(|folder| folder.join("javac").is_file() && folder.join("java").is_file())
}

/// Builds the library with its testing entry points, in a folder of its own: a library with them must never lie where
/// one without them is expected, and the running cargo holds the lock of its own folder.
fn build_library(root: &Path, target: &Path) -> PathBuf {
    let profile = if cfg!(debug_assertions) { "dev" } else { "release" };
    run(Command::new(env!("CARGO"))
        .current_dir(root)
        .args([
            "build",
            "--package",
            "boxline-jni",
            "--features",
            "testing",
            "--profile",
            profile,
            "--target-dir",
        ])
        .arg(target));
    let name = format!("{}boxline_jni{}", std::env::consts::DLL_PREFIX, std::env::consts::DLL_SUFFIX);
    target.join(if cfg!(debug_assertions) { "debug" } else { "release" }).join(name)
}

fn compile_java(bin: &Path, sources: &Path, classes: &Path) {
    std::fs::remove_dir_all(classes).unwrap_or_default();
    std::fs::create_dir_all(classes).unwrap();
    let files = ["", "internal"].into_iter().flat_map(|folder| {
        std::fs::read_dir(sources.join("dev/boxline").join(folder))
            .unwrap()
            .map(|entry| entry.unwrap().path())
    });
    let files = files.filter(|path| path.extension().is_some_and(|e| e == "java"));
    run(Command::new(bin.join("javac"))
        .args(["--release", "11", "-Xlint:all,-options", "-Werror", "-encoding", "UTF-8", "-d"])
        .arg(classes)
        .args(files));
}

fn run(command: &mut Command) {
    let output = command.output().unwrap_or_else(|e| panic!("{command:?}: {e}"));
    assert!(output.status.success(), "{command:?}:\n{}", String::from_utf8_lossy(&output.stderr));
}
