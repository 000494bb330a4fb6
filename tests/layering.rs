//! Who may use whom. Inside `rust/core` a module may use only modules that stand before it in [`MODULES`]; there and in `rust/jni` files of one
//! folder do not use each other in a circle; a crate may depend only on crates of a level below its own in [`CRATES`]. An edge upwards fails
//! here, not in review.
#![allow(clippy::unwrap_used)] // the helpers of tests are tests

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// The modules of `rust/core/src`, lowest first. A new module gets its line here.
const MODULES: [&str; 33] = [
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
    "paper",
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

/// Sources whose files are asked for circles. The other crates have some, mostly of a `mod.rs` and files that use its types; calib, edgenet,
/// sim and uvc also of two other files (adjust and lens, engine and forward, board and recording, head and store).
const SOURCES: [&str; 2] = ["rust/core/src", "rust/jni/src"];

/// A file, or a folder with all files in it: their code, and how many `super::` lead from each to the folder that it is a part of.
type Part = Vec<(usize, String)>;

/// Two files of one folder that use each other cannot be read one after the other. A folder within it counts as one file, `mod.rs` (`lib.rs`,
/// `main.rs`) as one of its files; what it only lifts from another of them counts as used there.
#[test]
fn files_of_a_folder_use_each_other_in_one_direction() {
    let mut wrong = Vec::new();
    for source in SOURCES {
        let mut folders: BTreeMap<PathBuf, BTreeMap<String, Part>> = BTreeMap::new();
        for (path, text) in rust_files(&root().join(source)) {
            let inside = path.strip_prefix(root().join(source)).unwrap();
            if text.starts_with("#![cfg(test)]") || is_for_tests(&path) {
                continue;
            }
            let code = code(&text);
            // The file is a part of its own folder, and its folder one of those above.
            for (up, folder) in inside.ancestors().skip(1).enumerate() {
                let part = inside.strip_prefix(folder).unwrap().components().next().unwrap();
                let name = Path::new(part.as_os_str()).file_stem().unwrap().to_str().unwrap();
                let is_root = ROOTS.iter().any(|root| inside.ends_with(root));
                let name = if up == 0 && is_root { "mod" } else { name };
                let supers = up + usize::from(!is_root);
                let parts = folders.entry(folder.to_owned()).or_default();
                parts.entry(name.to_owned()).or_default().push((supers, code.clone()));
            }
        }
        // The order of core's modules is that of `MODULES`.
        if source == "rust/core/src" {
            folders.remove(Path::new(""));
        }
        for (folder, parts) in folders {
            let uses = uses_in_folder(&folder, &parts);
            let circles = parts.keys().filter(|part| reachable(&uses, part).contains(part.as_str()));
            let circle: Vec<&str> = circles.map(String::as_str).collect();
            if !circle.is_empty() {
                let folder = Path::new(source).join(folder);
                wrong.push(format!("{}: {} use each other in a circle", folder.display(), circle.join(", ")));
            }
        }
    }
    assert!(wrong.is_empty(), "\n{}", wrong.join("\n"));
}

/// The files that say which modules a folder has.
const ROOTS: [&str; 3] = ["mod.rs", "lib.rs", "main.rs"];

/// Whether a file is a module that its folder has for tests only.
fn is_for_tests(path: &Path) -> bool {
    let stem = path.file_stem().unwrap().to_str().unwrap();
    let declared = ROOTS.iter().any(|root| {
        let parent = std::fs::read_to_string(path.with_file_name(root)).unwrap_or_default();
        ["", "pub(crate) "]
            .iter()
            .any(|public| parent.contains(&format!("#[cfg(test)]\n{public}mod {stem};")))
    });
    stem == "tests" || declared
}

/// Which parts of a folder each of them uses.
fn uses_in_folder(folder: &Path, parts: &BTreeMap<String, Part>) -> BTreeMap<String, BTreeSet<String>> {
    let from_root: String =
        folder.components().map(|c| format!("{}::", c.as_os_str().to_str().unwrap())).collect();
    let own = parts.get("mod").map_or("", |files| &files[0].1);
    let lifted = imports(own);
    let mut uses: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for (part, files) in parts {
        let mut names = Vec::new();
        for (supers, code) in files {
            names.extend(names_after(code, &format!("crate::{from_root}")));
            if *supers > 0 {
                names.extend(names_after(code, &"super::".repeat(*supers)));
            }
        }
        if part == "mod" {
            names.extend(parts.keys().filter(|other| mentions(own, other)).cloned());
        }
        let found =
            names.into_iter().filter_map(|name| match (parts.contains_key(&name), lifted.get(&name)) {
                _ if name == "super" => None,
                (true, _) => Some(name),
                // From another part of the folder, or from outside.
                (false, Some(from)) => parts.contains_key(from).then(|| from.clone()),
                (false, None) => parts.contains_key("mod").then(|| "mod".to_owned()),
            });
        uses.insert(part.clone(), found.filter(|used| used != part).collect());
    }
    uses
}

/// All files that a file uses, or that those use.
fn reachable<'a>(uses: &'a BTreeMap<String, BTreeSet<String>>, file: &str) -> BTreeSet<&'a str> {
    let mut found = BTreeSet::new();
    let mut open: Vec<&str> = vec![file];
    while let Some(next) = open.pop() {
        for used in uses.get(next).into_iter().flatten() {
            if found.insert(used.as_str()) {
                open.push(used);
            }
        }
    }
    found
}

/// Whether code names something of a module: `name::`, not behind another path.
fn mentions(code: &str, module: &str) -> bool {
    let path = format!("{module}::");
    code.match_indices(&path).any(|(at, _)| {
        let before = code[..at].strip_suffix("self::").unwrap_or(&code[..at]);
        !before.ends_with(|c: char| c.is_alphanumeric() || c == '_' || c == ':')
    })
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
    let text = text.split("#[cfg(test)]\nmod tests {").next().unwrap();
    text.lines().map(|line| line.split("//").next().unwrap()).collect::<Vec<_>>().join("\n")
}

/// The first name of every path that starts at the crate's root: `x` for `crate::x::Y` and for `use crate::{x::Y, ..}`.
fn names_used(text: &str, depth: usize) -> Vec<String> {
    let code = code(text);
    let from_root = ["crate::".to_owned(), "super::".repeat(depth)];
    from_root.iter().flat_map(|prefix| names_after(&code, prefix)).collect()
}

/// The first name behind every `prefix`: `x` for `prefix x::Y` and for `prefix {x::Y, ..}`.
fn names_after(code: &str, prefix: &str) -> Vec<String> {
    let mut names = Vec::new();
    for (at, _) in code.match_indices(prefix) {
        let rest = &code[at + prefix.len()..];
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
    imports(&code(lib))
}

/// For each name that code imports with `use` or `pub use`: the first part of its path.
fn imports(code: &str) -> BTreeMap<String, String> {
    let mut names = BTreeMap::new();
    let starts = code.match_indices("use ").filter(|(at, _)| {
        let line = code[..*at].rsplit('\n').next().unwrap();
        line.is_empty() || line == "pub " || line == "pub(crate) " || line == "pub(super) "
    });
    for (at, word) in starts {
        let tree = code[at + word.len()..].split(';').next().unwrap();
        let Some(first) = first_name(tree) else { continue };
        // The last name of each path is what is imported.
        for path in tree.split([',', '{', '}']).filter(|path| !path.trim_end().ends_with("::")) {
            let last =
                path.rsplit(|c: char| !(c.is_alphanumeric() || c == '_')).find(|name| !name.is_empty());
            names.extend(last.map(|name| (name.to_owned(), first.clone())));
        }
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

#[test]
fn a_circle_in_a_folder_is_seen_and_a_lifted_name_is_none() {
    let uses = |mod_rs: &str, a: &str, b: &str| {
        let files = [("mod", mod_rs), ("a", a), ("b", b)];
        let part = |name: &str, code: &str| vec![(usize::from(name != "mod"), code.to_owned())];
        let files = files.map(|(name, code)| (name.to_owned(), part(name, code))).into();
        uses_in_folder(Path::new("x/y"), &files)
    };
    let circle = uses("mod a;\nmod b;", "use super::b::{F, G};", "fn f() { crate::x::y::a::g() }");
    assert!(reachable(&circle, "a").contains("a") && !reachable(&circle, "mod").contains("mod"));
    let by_parent = uses("mod a;\nfn f() { a::g() }", "use super::{Error, f};", "");
    assert!(reachable(&by_parent, "mod").contains("mod"));
    let lifted =
        uses("use b::f;\nuse crate::{error::Error, z};\nfn g() { a::g() }", "use super::{Error, f};", "");
    assert_eq!(lifted["a"], BTreeSet::from(["b".to_owned()]));
    assert!(!mentions("super::a::X + c::a::Y + ba::Z", "a") && mentions("self::a::X", "a"));
}
