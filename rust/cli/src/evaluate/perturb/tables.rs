//! What came of the changes: tables for people, one JSON object, one row of CSV a side, a section of a page.

use super::{PerturbedSubject, SIDES, SubjectResult};
use crate::args::EvaluateArgs;
use crate::evaluate::statistics::Share;
use crate::evaluate::tables::table;
use boxline_sim::perturb::Perturbation;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::io::Write;

/// A side that moves by more than this cannot have moved by chance: both results see the same box with the same head.
const MOVED_SIGMAS: f64 = 3.0;
const HEADING: &str = "## Pictures that are changed";

/// What one change did, or one kind of changes.
#[derive(Default)]
struct Sum {
    tried: usize,
    /// Measured as recorded, and of these refused or ambiguous after the change.
    measured: usize,
    lost: usize,
    /// Measured after the change only.
    gained: usize,
    moves: Vec<f64>,
    /// Right or refused as recorded, and of these wrong after the change.
    sound: usize,
    wrong: usize,
}

impl Sum {
    fn add(&mut self, tried: &PerturbedSubject, after: &SubjectResult) {
        let measured = |found: &SubjectResult| !found.sides.is_empty();
        self.tried += 1;
        self.measured += usize::from(measured(&tried.before));
        self.lost += usize::from(measured(&tried.before) && !measured(after));
        self.gained += usize::from(!measured(&tried.before) && measured(after));
        self.sound += usize::from(tried.before.wrong.is_none());
        self.wrong += usize::from(tried.before.wrong.is_none() && after.wrong.is_some());
        self.moves.extend(tried.moves(after));
    }

    fn wrong(&self) -> Share {
        Share::new(self.wrong, self.sound)
    }

    fn largest(&self) -> f64 {
        self.moves.iter().fold(0.0, |most, m| m.abs().max(most))
    }

    fn rms(&self) -> Option<f64> {
        let squares: f64 = self.moves.iter().map(|m| m * m).sum();
        (!self.moves.is_empty()).then(|| (squares / self.moves.len() as f64).sqrt())
    }

    fn moved(&self) -> usize {
        self.moves.iter().filter(|m| m.abs() > MOVED_SIGMAS).count()
    }

    fn cells(&self, name: String) -> Vec<String> {
        let of_sides = |text: String| if self.moves.is_empty() { "-".to_owned() } else { text };
        vec![
            name,
            self.tried.to_string(),
            format!("{} of {}", self.lost, self.measured),
            self.gained.to_string(),
            of_sides(format!("{:.1}", self.largest())),
            of_sides(format!("{:.2}", self.rms().unwrap_or_default())),
            of_sides(format!("{} of {}", self.moved(), self.moves.len())),
            share(&self.wrong()),
        ]
    }

    fn json(&self) -> Value {
        let [low, high] = self.wrong().interval;
        json!({
            "tried": self.tried, "measured_before": self.measured, "not_measured_after": self.lost,
            "measured_after_only": self.gained, "sides": self.moves.len(), "largest_move_sigmas": self.largest(),
            "rms_move_sigmas": self.rms(), "moved_beyond_3_sigmas": self.moved(),
            "right_or_refused_before": self.sound, "wrong": self.wrong, "wrong_interval_95": [low, high],
        })
    }
}

const HEADER: [&str; 8] = [
    "change",
    "tried",
    "not measured any more",
    "measured only now",
    "largest move, σ",
    "rms, σ",
    "sides beyond 3 σ",
    "wrong",
];

/// Sums by something that each change has, in the order of the list of changes.
fn sums(all: &[PerturbedSubject], by: impl Fn(&Perturbation) -> String) -> Vec<(String, Sum)> {
    let mut sums: Vec<(String, Sum)> = Vec::new();
    for change in Perturbation::all() {
        let name = by(&change);
        if !sums.iter().any(|(known, _)| *known == name) {
            sums.push((name, Sum::default()));
        }
    }
    for tried in all {
        for (change, found) in &tried.after {
            let name = by(change);
            if let Some((_, sum)) = sums.iter_mut().find(|(known, _)| *known == name) {
                sum.add(tried, found);
            }
        }
    }
    sums
}

fn by_kind(all: &[PerturbedSubject]) -> Vec<(String, Sum)> {
    let mut kinds = sums(all, |change| change.kind().to_owned());
    kinds.extend(sums(all, |_| "all".to_owned()));
    kinds
}

fn by_change(all: &[PerturbedSubject]) -> Vec<(String, Sum)> {
    sums(all, ToString::to_string)
}

/// Results that became wrong: recording, what, change, how.
fn became_wrong(all: &[PerturbedSubject]) -> impl Iterator<Item = (&PerturbedSubject, &Perturbation, &str)> {
    all.iter().filter(|tried| tried.before.wrong.is_none()).flat_map(|tried| {
        tried.after.iter().filter_map(move |(change, found)| Some((tried, change, found.wrong.as_deref()?)))
    })
}

/// How many became wrong of each recording.
fn wrong_by_recording(all: &[PerturbedSubject]) -> BTreeMap<&str, usize> {
    let mut counts: BTreeMap<&str, usize> = all.iter().map(|t| (t.recording.as_str(), 0)).collect();
    for (tried, ..) in became_wrong(all) {
        *counts.entry(&tried.recording).or_default() += 1;
    }
    counts
}

/// The results as recorded, in a sentence each.
fn before(all: &[PerturbedSubject]) -> Vec<String> {
    let line = |tried: &PerturbedSubject| {
        let sides = tried.before.sides.iter().map(|s| format!("{:.1} ± {:.1}", s.value_mm, s.sigma_mm));
        let sides = sides.collect::<Vec<_>>().join(" x ");
        let found = tried.before.answer.reason().map_or(sides, ToOwned::to_owned);
        let wrong = tried.before.wrong.as_ref().map_or(String::new(), |w| format!(" (WRONG: {w})"));
        format!("{}: {} {found}{wrong}", tried.name, tried.before.answer.name())
    };
    all.iter().map(line).collect()
}

/// The tables, with what became wrong at the end, where it is seen.
pub fn text(all: &[PerturbedSubject]) -> String {
    let mut parts = vec![format!("As recorded (mm)\n  {}", before(all).join("\n  "))];
    for (title, rows) in [("By kind of change", by_kind(all)), ("By change", by_change(all))] {
        let mut table = table(&HEADER, 1);
        for (name, sum) in rows {
            table.add_row(sum.cells(name));
        }
        parts.push(format!("{title}\n{}", table.trim_fmt()));
    }
    let wrong: Vec<String> = wrong_lines(all);
    parts.push(if wrong.is_empty() {
        "Nothing became wrong.".to_owned()
    } else {
        format!("!!! {} BECAME WRONG !!!\n!!! {}", wrong.len(), wrong.join("\n!!! "))
    });
    parts.join("\n\n")
}

fn wrong_lines(all: &[PerturbedSubject]) -> Vec<String> {
    became_wrong(all).map(|(tried, change, how)| format!("{}, {change}: {how}", tried.name)).collect()
}

/// Everything as one object.
pub fn json(all: &[PerturbedSubject], seed: u64) -> Value {
    let named = |rows: Vec<(String, Sum)>| -> serde_json::Map<String, Value> {
        rows.into_iter().map(|(name, sum)| (name, sum.json())).collect()
    };
    let wrong: Vec<Value> = became_wrong(all)
        .map(|(tried, change, how)| {
            json!({"recording": tried.recording, "name": tried.name, "change": change.to_string(), "how": how})
        })
        .collect();
    json!({
        "seed": seed, "as_recorded": before(all), "kinds": named(by_kind(all)), "changes": named(by_change(all)),
        "wrong": wrong, "wrong_by_recording": wrong_by_recording(all),
    })
}

/// One row a side and change; a refused result has one row without a side.
pub fn csv(all: &[PerturbedSubject], out: impl Write) -> anyhow::Result<()> {
    let mut rows = csv::Writer::from_writer(out);
    rows.write_record([
        "recording",
        "name",
        "kind",
        "change",
        "outcome",
        "reason",
        "side",
        "truth_mm",
        "before_mm",
        "before_sigma_mm",
        "value_mm",
        "sigma_mm",
        "move_sigmas",
        "wrong",
    ])?;
    let number = |x: Option<f64>| x.map_or_else(String::new, |x| format!("{x:.4}"));
    for tried in all {
        for (change, found) in &tried.after {
            let moves = tried.moves(found);
            for (n, side) in SIDES.iter().enumerate().take(found.sides.len().max(1)) {
                let now = found.sides.get(n);
                let was = tried.before.sides.get(n);
                rows.write_record([
                    tried.recording.clone(),
                    tried.name.clone(),
                    change.kind().to_owned(),
                    change.to_string(),
                    found.answer.name().to_owned(),
                    found.answer.reason().unwrap_or_default().to_owned(),
                    now.map_or("", |_| *side).to_owned(),
                    number(tried.truth_mm.get(n).copied()),
                    number(was.map(|e| e.value_mm)),
                    number(was.map(|e| e.sigma_mm)),
                    number(now.map(|e| e.value_mm)),
                    number(now.map(|e| e.sigma_mm)),
                    number(moves.get(n).copied()),
                    found.wrong.is_some().to_string(),
                ])?;
            }
        }
    }
    rows.flush()?;
    Ok(())
}

/// The section of a page.
pub fn section(all: &[PerturbedSubject], args: &EvaluateArgs) -> String {
    let folders: Vec<String> = args.folders.iter().map(|f| f.display().to_string()).collect();
    let mut text = format!(
        "{HEADING}\n\n    boxline evaluate {} --perturb --seed {}\n\n\
         Each recording is measured as it is, and again after each change of its pictures that leaves the true sizes as they are.\n\
         *Wrong*: of those that were right or refused as recorded, a side off by more than 5 mm, or by more than 3 mm and 4 sigma, or\n\
         a result where a refusal was due; with its 95 % Clopper-Pearson interval. *Move*: of a side, in units of the larger of both\n\
         stated sigmas; what both results share, such as the calibration, is in that sigma, so honest results move by far less than 1.\n\n\
         As recorded, mm:\n\n",
        folders.join(" "),
        args.seed
    );
    for line in before(all) {
        text += &format!("- {line}\n");
    }
    for rows in [by_kind(all), by_change(all)] {
        text += &format!("\n| {} |\n|---|{}\n", HEADER.join(" | "), "---:|".repeat(HEADER.len() - 1));
        for (name, sum) in rows {
            text += &format!("| {} |\n", sum.cells(name).join(" | "));
        }
    }
    let wrong = wrong_lines(all);
    text += if wrong.is_empty() { "\nNothing became wrong.\n" } else { "\nWhat became wrong:\n\n" };
    for line in wrong {
        text += &format!("- {line}\n");
    }
    text
}

/// A count of so many with its interval.
fn share(share: &Share) -> String {
    let [low, high] = share.interval.map(|x| 100.0 * x);
    format!("{} of {} ({low:.1} to {high:.1} %)", share.count, share.of)
}

#[cfg(test)]
mod tests {
    use super::super::ResultKind;
    use super::*;
    use boxline::Estimate;

    fn found(sides: &[(f64, f64)], wrong: bool) -> SubjectResult {
        SubjectResult {
            answer: if sides.is_empty() { ResultKind::Refused("no_box") } else { ResultKind::Measured },
            sides: sides.iter().map(|(value, sigma)| Estimate::new(*value, *sigma)).collect(),
            wrong: wrong.then(|| "length 90.0".to_owned()),
        }
    }

    /// A measured face that moves, is lost and becomes wrong; a refused one that becomes wrong; one that is wrong from the start.
    fn made_up() -> Vec<PerturbedSubject> {
        let changes = Perturbation::all();
        let tried = |name: &str, before, after: Vec<SubjectResult>| PerturbedSubject {
            recording: name.into(),
            name: format!("{name} a"),
            truth_mm: vec![100.0, 50.0],
            before,
            after: changes.iter().copied().zip(after).collect(),
        };
        vec![
            tried(
                "one",
                found(&[(100.0, 0.5), (50.0, 0.5)], false),
                vec![
                    found(&[(101.0, 0.5), (48.0, 0.4)], false),
                    found(&[], false),
                    found(&[(90.0, 1.0), (50.0, 1.0)], true),
                ],
            ),
            tried("two", found(&[], false), vec![found(&[(90.0, 0.5), (50.0, 0.5)], true)]),
            tried(
                "three",
                found(&[(80.0, 0.5), (50.0, 0.5)], true),
                vec![found(&[(80.0, 0.5), (50.0, 0.5)], true)],
            ),
        ]
    }

    #[test]
    fn sums_of_known_results() {
        let sums = by_change(&made_up());
        let first = &sums[0].1;
        assert_eq!((first.tried, first.measured, first.lost, first.gained), (3, 2, 0, 1));
        assert_eq!(first.moves, [2.0, -4.0, 0.0, 0.0]);
        assert_eq!((first.largest(), first.moved()), (4.0, 1));
        assert!((first.rms().unwrap() - 5f64.sqrt()).abs() < 1e-12);
        // What was wrong from the start did not become wrong.
        assert_eq!(first.wrong(), Share::new(1, 2));
        assert_eq!((sums[1].1.lost, sums[1].1.moves.len(), sums[1].1.rms()), (1, 0, None));
        let all = by_kind(&made_up()).pop().unwrap();
        assert_eq!((all.0.as_str(), all.1.tried, all.1.wrong), ("all", 5, 2));
        assert_eq!(wrong_by_recording(&made_up()), [("one", 1), ("three", 0), ("two", 1)].into());
    }

    #[test]
    fn what_became_wrong_is_told_everywhere() {
        let all = made_up();
        let third = Perturbation::all()[2].to_string();
        let line = format!("one a, {third}: length 90.0");
        assert!(text(&all).contains(&format!("!!! {line}")), "{}", text(&all));
        let object = json(&all, 1);
        assert_eq!(object["wrong"].as_array().unwrap().len(), 2);
        assert_eq!(object["changes"][&third]["wrong"], 1);
        let mut bytes = Vec::new();
        csv(&all, &mut bytes).unwrap();
        let rows = String::from_utf8(bytes).unwrap();
        assert_eq!(rows.lines().count(), 1 + 5 + 2 + 2);
        let lost = rows.lines().nth(3).unwrap();
        assert!(lost.contains(",refused,no_box,,100.0000,100.0000,0.5000,,,,false"), "{lost}");
    }
}
