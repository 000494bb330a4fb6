//! What became of each shot, in a csv beside the page: one row a side, or one row for a refusal. A run that was stopped goes on from it.

use super::plan::Experiment;
use super::series::ShotResult;
use crate::input::Usage;
use crate::output::write_whole;
use anyhow::Context;
use boxline::Estimate;
use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Table, what was measured, in which way, which shot.
type Key = (String, String, String, u64);

/// The columns. `side` is in the order of [`Experiment::sides_mm`]; a refusal has one row, with its reason in `refused`.
const COLUMNS: [&str; 9] =
    ["table", "what", "way", "shot", "side", "value_mm", "sigma_mm", "warned", "refused"];

/// The file and all that is in it.
pub struct Ledger {
    path: PathBuf,
    file: File,
    shots: BTreeMap<Key, ShotResult>,
}

fn key(what: &Experiment, way: &str, shot: u64) -> Key {
    (what.table.word().to_owned(), what.name.clone(), way.to_owned(), shot)
}

impl Ledger {
    /// Opens or starts a file; `made_with` is all that its shots follow from.
    pub fn open(path: &Path, made_with: &str) -> anyhow::Result<Self> {
        let head = format!("# boxline experiments: {made_with}\n");
        let text = match std::fs::read(path) {
            Ok(bytes) => String::from_utf8(bytes)
                .map_err(|e| Usage(format!("{}: no csv of this command: {e}", path.display())))?,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => String::new(),
            Err(e) => return Err(e).with_context(|| format!("{}: cannot read", path.display())),
        };
        let mut shots = BTreeMap::new();
        if !text.is_empty() {
            let (found, rest) = text.split_once('\n').unwrap_or((&text, ""));
            if found != head.trim_end() {
                let text = format!(
                    "{}: made with other settings:\n{found}\nnow they are\n{}delete it or choose another --out",
                    path.display(),
                    head
                );
                return Err(Usage(text).into());
            }
            // A line that was being written when the run was stopped has no end.
            let whole = rest.rfind('\n').map_or("", |end| &rest[..=end]);
            shots = read(whole).with_context(|| format!("{}: broken", path.display()))?;
        }
        // Anew, so that nothing half written stays in it.
        let mut fresh = head.into_bytes();
        fresh.extend(rows_text(shots.iter(), true)?);
        write_whole(path, &fresh)?;
        let file = OpenOptions::new()
            .append(true)
            .open(path)
            .with_context(|| format!("{}: cannot write", path.display()))?;
        Ok(Self { path: path.to_owned(), file, shots })
    }

    /// What became of a shot, if it was made.
    pub fn shot(&self, what: &Experiment, way: &str, shot: u64) -> Option<&ShotResult> {
        self.shots.get(&key(what, way, shot))
    }

    /// Writes what became of one shot in several ways, at once.
    pub fn add(
        &mut self,
        what: &Experiment,
        shot: u64,
        found: Vec<(String, ShotResult)>,
    ) -> anyhow::Result<()> {
        let found: Vec<(Key, ShotResult)> =
            found.into_iter().map(|(way, became)| (key(what, &way, shot), became)).collect();
        let text = rows_text(found.iter().map(|(key, shot)| (key, shot)), false)?;
        self.file
            .write_all(&text)
            .and_then(|()| self.file.flush())
            .with_context(|| format!("{}: cannot write", self.path.display()))?;
        self.shots.extend(found);
        Ok(())
    }
}

fn rows_text<'a>(
    shots: impl Iterator<Item = (&'a Key, &'a ShotResult)>,
    with_head: bool,
) -> anyhow::Result<Vec<u8>> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    if with_head {
        writer.write_record(COLUMNS)?;
    }
    for ((table, what, way, shot), became) in shots {
        let of_shot = [table.clone(), what.clone(), way.clone(), shot.to_string()];
        let mut row = |rest: [String; 5]| writer.write_record(of_shot.iter().chain(&rest));
        match became {
            ShotResult::Refused(reason) => {
                let [value_mm, sigma_mm] = [String::new(), String::new()];
                row(["0".into(), value_mm, sigma_mm, false.to_string(), reason.clone()])?;
            }
            ShotResult::Measured { sides, warned } => {
                for (i, side) in sides.iter().enumerate() {
                    let [value_mm, sigma_mm] = [side.value_mm, side.sigma_mm].map(|mm| mm.to_string());
                    row([i.to_string(), value_mm, sigma_mm, warned.to_string(), String::new()])?;
                }
            }
        }
    }
    Ok(writer.into_inner()?)
}

/// Shots of which all sides are there: a face has two, a box three, and all sides of a shot are written at once.
fn read(text: &str) -> anyhow::Result<BTreeMap<Key, ShotResult>> {
    let mut shots: BTreeMap<Key, ShotResult> = BTreeMap::new();
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    for record in reader.records() {
        let record = record?;
        let fields: Vec<&str> = record.iter().collect();
        let [table, what, way, shot, side, value_mm, sigma_mm, warned, refused] = fields[..] else {
            anyhow::bail!("{fields:?}: a row has {} fields", COLUMNS.len());
        };
        let key = (table.to_owned(), what.to_owned(), way.to_owned(), shot.parse::<u64>()?);
        let became = if refused.is_empty() {
            let estimate = Estimate::new(value_mm.parse()?, sigma_mm.parse()?);
            let (index, warned) = (side.parse::<usize>()?, warned.parse::<bool>()?);
            match shots.remove(&key) {
                Some(ShotResult::Measured { mut sides, .. }) if sides.len() == index => {
                    sides.push(estimate);
                    ShotResult::Measured { sides, warned }
                }
                _ if index == 0 => ShotResult::Measured { sides: vec![estimate], warned },
                _ => anyhow::bail!("{fields:?}: the sides before it are missing"),
            }
        } else {
            ShotResult::Refused(refused.to_owned())
        };
        shots.insert(key, became);
    }
    let sides = |table: &str| if table == super::plan::Table::Poses.word() { 2 } else { 3 };
    shots.retain(|(table, ..), shot| match shot {
        ShotResult::Measured { sides: found, .. } => found.len() == sides(table),
        ShotResult::Refused(_) => true,
    });
    Ok(shots)
}

#[cfg(test)]
mod tests {
    use super::super::plan::Table;
    use super::*;

    fn what() -> Experiment {
        Experiment {
            table: Table::Boxes,
            name: "600 x 400, \"x\"".into(),
            sides_mm: vec![600.0, 400.0, 300.0],
            distance_mm: [1.0; 2],
        }
    }

    fn measured(value_mm: f64) -> ShotResult {
        let sides = [value_mm, 400.0 / 3.0, 300.0].map(|v| Estimate::new(v, 0.1 + 0.2)).to_vec();
        ShotResult::Measured { sides, warned: true }
    }

    #[test]
    fn a_run_goes_on_where_it_was_stopped_and_loses_only_what_was_half_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("page.csv");
        let what = what();
        let mut ledger = Ledger::open(&path, "seed 1").unwrap();
        let refused = ShotResult::Refused("no_box".into());
        ledger.add(&what, 0, vec![("fit".into(), measured(600.1)), ("key".into(), refused.clone())]).unwrap();
        ledger.add(&what, 1, vec![("fit".into(), measured(599.7))]).unwrap();
        let whole = std::fs::read_to_string(&path).unwrap();

        let mut again = Ledger::open(&path, "seed 1").unwrap();
        assert_eq!(again.shot(&what, "fit", 0), Some(&measured(600.1)));
        assert_eq!(again.shot(&what, "key", 0), Some(&refused));
        assert_eq!(again.shot(&what, "key", 1), None);
        again.add(&what, 1, vec![("key".into(), refused.clone())]).unwrap();
        assert_eq!(Ledger::open(&path, "seed 1").unwrap().shot(&what, "key", 1), Some(&refused));

        // Stopped at any byte after the first line: every shot is there as it was, or not at all.
        let first = whole.find('\n').unwrap() + 1;
        for end in first..whole.len() {
            std::fs::write(&path, &whole[..end]).unwrap();
            let torn = Ledger::open(&path, "seed 1").unwrap();
            for (way, shot, was) in [("fit", 0, measured(600.1)), ("fit", 1, measured(599.7))] {
                assert!(torn.shot(&what, way, shot).is_none_or(|found| *found == was), "{end}");
            }
        }
    }

    #[test]
    fn a_file_of_other_settings_is_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("page.csv");
        drop(Ledger::open(&path, "seed 1").unwrap());
        let message = Ledger::open(&path, "seed 2").err().unwrap().to_string();
        assert!(
            message.contains("page.csv") && message.contains("seed 1") && message.contains("--out"),
            "{message}"
        );
        std::fs::write(&path, "some notes of mine").unwrap();
        assert!(Ledger::open(&path, "seed 1").is_err());
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "some notes of mine");
    }
}
