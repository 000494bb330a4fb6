//! What the documents say to type can be typed, and what they point to is there.
#![allow(clippy::unwrap_used)] // the helpers are tests too, which clippy sees only in the functions marked #[test]

mod program;

use program::{boxline, stdout};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Every page of the repository, with its text.
fn pages() -> Vec<(PathBuf, String)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let mut folders = vec![root.clone(), root.join(".github")];
    let mut pages = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            if path.is_dir() && !name.starts_with('.') && !["target", "build"].contains(&&*name) {
                folders.push(path);
            } else if name.ends_with(".md") {
                let text = std::fs::read_to_string(&path).unwrap();
                pages.push((path, text));
            }
        }
    }
    assert!(pages.len() > 20, "{}", pages.len());
    pages
}

/// `[text](target)`: the targets that are files of the repository.
fn links(text: &str) -> impl Iterator<Item = &str> {
    let targets = text.split("](").skip(1).filter_map(|rest| rest.split([')', '#']).next());
    targets.filter(|target| !target.is_empty() && !target.contains(':') && !target.contains(' '))
}

/// Every command line of the program in a page: the subcommand and what follows it, up to the end of its line or code.
fn commands(text: &str) -> Vec<(&str, Vec<&str>)> {
    let mut found = Vec::new();
    for start in ["boxline ", "cargo run --release -- ", "cargo run --release -p boxline-cli -- "] {
        for (at, _) in text.match_indices(start) {
            // In code: after a backtick, or at the beginning of a line or of a further command in it.
            let before = &text[..at];
            if !(before.ends_with(['`', '\n', '/']) || before.ends_with("\n    ") || before.ends_with("&& "))
            {
                continue;
            }
            let rest = &text[at + start.len()..];
            let line = rest.split(['`', '\n', '#', '|', '&', '>', '"']).next().unwrap();
            let mut words = line.split_whitespace();
            if let Some(command) = words.next() {
                found.push((command, words.collect()));
            }
        }
    }
    found
}

#[test]
fn every_link_leads_somewhere() {
    let mut wrong = Vec::new();
    for (page, text) in pages() {
        let folder = page.parent().unwrap();
        let lost = links(&text).filter(|target| !folder.join(target).exists());
        wrong.extend(lost.map(|target| format!("{}: {target}", page.display())));
    }
    assert!(wrong.is_empty(), "\n{}", wrong.join("\n"));
}

#[test]
fn every_option_in_a_document_is_one_of_the_program() {
    let mut helps: BTreeMap<String, Option<String>> = BTreeMap::new();
    let (mut wrong, mut count) = (Vec::new(), 0);
    for (page, text) in pages() {
        for (command, words) in commands(&text) {
            let help = helps.entry(command.to_owned()).or_insert_with(|| {
                let output = boxline(&[command, "--help"]);
                output.status.success().then(|| stdout(&output))
            });
            let Some(help) = help else {
                wrong.push(format!("{}: no command {command}", page.display()));
                continue;
            };
            for option in words.iter().filter(|word| word.starts_with('-') && word.len() > 1) {
                count += 1;
                let name = option.split('=').next().unwrap();
                if !help.split([' ', ',', '\n']).any(|word| word == name) {
                    wrong.push(format!("{}: {command} has no {name}", page.display()));
                }
            }
        }
    }
    assert!(count > 50, "{count} options were looked at");
    assert!(wrong.is_empty(), "\n{}", wrong.join("\n"));
}
