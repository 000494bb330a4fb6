//! Who may use whom. Inside `rust/core` a module may use only modules that stand before it in [`MODULES`]; a crate may
//! depend only on crates of a level below its own in [`CRATES`]. An edge upwards fails here, not in review.
#![allow(clippy::unwrap_used)] // the helpers of tests are tests

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The modules of `rust/core/src`, lowest first. A new module gets its line here.
const MODULES: [&str; 32] = [
    "noise",
    "eigen",
    "statistics",
    "units",
    "error",
    "frames",
    "warning",
    "reject",
    "image",
    "view",
    "network",
    "confidence",
    "trace",
    "camera",
    "calibration",
    "measurement",
    "paper_head",
    "stripe",
    "face",
    "face_geometry",
    "feasibility",
    "report",
    "sides",
    "edges",
    "scene",
    "rectangle",
    "diagnostics",
    "box_depth",
    "cuboid",
    "hypotheses",
    "points",
    "pipeline",
];

/// The crates with their levels.
const CRATES: [(&str, u32); 9] = [
    ("boxline", 0),
    ("boxline-calib", 1),
    ("boxline-edgenet", 1),
    ("boxline-proto", 1),
    ("boxline-sim", 1),
    ("boxline-uvc", 1),
    ("boxline-cli", 2),
    ("boxline-jni", 2),
    ("boxline-tests", 2),
];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap().to_owned()
}

#[test]
fn modules_of_core_use_only_modules_below() {
    let source = root().join("rust/core/src");
    let reexported = reexports(&std::fs::read_to_string(source.join("lib.rs")).unwrap());
    let mut wrong = Vec::new();
    for (path, text) in rust_files(&source) {
        let inside = path.strip_prefix(&source).unwrap();
        if inside.file_stem().unwrap() == "tests" || inside.as_os_str() == "lib.rs" {
            continue;
        }
        let module =
            inside.components().next().unwrap().as_os_str().to_str().unwrap().trim_end_matches(".rs");
        let Some(level) = MODULES.iter().position(|m| *m == module) else {
            wrong.push(format!("{}: module `{module}` is not in the table", inside.display()));
            continue;
        };
        for name in names_used(&text, depth(inside)) {
            let used = reexported.get(&name).unwrap_or(&name);
            match MODULES.iter().position(|m| m == used) {
                Some(other) if other <= level => {}
                Some(_) => {
                    wrong.push(format!("{}: `{module}` uses `{used}`, which is above it", inside.display()))
                }
                None => {
                    wrong.push(format!("{}: `crate::{name}` is no module in the table", inside.display()))
                }
            }
        }
    }
    assert!(wrong.is_empty(), "\n{}", wrong.join("\n"));
}

#[test]
fn crates_depend_only_on_crates_below() {
    let metadata = std::process::Command::new(env!("CARGO"))
        .current_dir(root())
        .args(["metadata", "--no-deps", "--format-version", "1"])
        .output()
        .unwrap();
    let metadata: serde_json::Value = serde_json::from_slice(&metadata.stdout).unwrap();
    let levels = BTreeMap::from(CRATES);
    let mut wrong = Vec::new();
    for package in metadata["packages"].as_array().unwrap() {
        let name = package["name"].as_str().unwrap();
        let Some(level) = levels.get(name) else {
            wrong.push(format!("crate `{name}` is not in the table"));
            continue;
        };
        for dependency in package["dependencies"].as_array().unwrap() {
            let other = dependency["name"].as_str().unwrap();
            let for_tests = dependency["kind"] == "dev"; // tests may look from above
            if !for_tests && levels.get(other).is_some_and(|other| other >= level) {
                wrong.push(format!("crate `{name}` depends on `{other}`, which is not below it"));
            }
        }
    }
    assert!(wrong.is_empty(), "\n{}", wrong.join("\n"));
}

/// All `.rs` files below a folder, with their code.
fn rust_files(folder: &Path) -> Vec<(PathBuf, String)> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            files.extend(rust_files(&path));
        } else if path.extension().is_some_and(|e| e == "rs") {
            let text = std::fs::read_to_string(&path).unwrap();
            files.push((path, text));
        }
    }
    files.sort();
    files
}

/// How many `super::` lead out of a file to the crate's root: 1 for `a.rs` and `a/mod.rs`, 2 for `a/b.rs`.
fn depth(inside: &Path) -> usize {
    inside.components().count() - usize::from(inside.file_stem().unwrap() == "mod")
}

/// The code without comments and without the unit tests, which stand at a file's end and may look from above.
fn code(text: &str) -> String {
    let text = text.split("#[cfg(test)]\nmod ").next().unwrap();
    text.lines().map(|line| line.split("//").next().unwrap()).collect::<Vec<_>>().join("\n")
}

/// The first name of every path that starts at the crate's root: `x` for `crate::x::Y` and for `use crate::{x::Y, ..}`.
fn names_used(text: &str, depth: usize) -> Vec<String> {
    let code = code(text);
    let from_root = ["crate::".to_owned(), "super::".repeat(depth)];
    let mut names = Vec::new();
    for start in
        from_root.iter().flat_map(|prefix| code.match_indices(prefix.as_str()).map(|(i, p)| i + p.len()))
    {
        let rest = &code[start..];
        match rest.strip_prefix('{') {
            Some(group) => names.extend(top_level_names(group)),
            None => names.extend(first_name(rest)),
        }
    }
    names
}

/// The first names of `a::B, c::{D, E}}`, up to the closing brace.
fn top_level_names(group: &str) -> Vec<String> {
    let mut level = 0;
    let mut names = Vec::from_iter(first_name(group));
    for (i, c) in group.char_indices() {
        match c {
            '{' => level += 1,
            '}' if level == 0 => break,
            '}' => level -= 1,
            ',' if level == 0 => names.extend(first_name(&group[i + 1..])),
            _ => {}
        }
    }
    names
}

fn first_name(text: &str) -> Option<String> {
    let name: String = text.trim_start().chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect();
    (!name.is_empty()).then_some(name)
}

/// Which module the names come from that `lib.rs` lifts to the root.
fn reexports(lib: &str) -> BTreeMap<String, String> {
    let code = code(lib);
    let mut names = BTreeMap::new();
    for statement in code.split(';').filter_map(|s| s.trim().strip_prefix("pub use ")) {
        let (module, rest) = statement.split_once("::").unwrap();
        let lifted = match rest.strip_prefix('{') {
            Some(group) => top_level_names(group),
            None => Vec::from_iter(first_name(rest)),
        };
        names.extend(lifted.into_iter().map(|name| (name, module.to_owned())));
    }
    names
}

#[test]
fn the_reader_finds_every_way_to_name_a_module() {
    let text = "use crate::a::X;\nuse crate::{b::{Y, Z}, c};\nlet x = crate::d::f(); // crate::no::X\n\
                use super::e;\n//! [`crate::no`]\n#[cfg(test)]\nmod tests { use crate::no; }";
    assert_eq!(names_used(text, 1), ["a", "b", "c", "d", "e"]);
    assert_eq!(names_used("use super::near;\nuse super::super::far;", 2), ["far"]);
    let lib = reexports("pub mod a;\npub use a::{\n    F, G,\n};\npub use b::h;\n");
    assert_eq!((lib["F"].as_str(), lib["G"].as_str(), lib["h"].as_str()), ("a", "a", "b"));
}
