//! The page about accuracy, in Markdown: one part for each file of rows.

use super::cause::Cause;
use super::rows::RunSettings;
use super::statistics::Share;
use super::summary::{Confidence, Errors, Group, HazardGroups, Size, Summary, Wrong};

/// Whether boxes were rendered with three faces of which two are used.
pub fn two_of_three(made: &RunSettings) -> bool {
    made.source == "three" && made.faces == 2
}
/// Limits on the probability that are tabled.
const LIMITS: [f64; 13] = [0.3, 0.5, 0.7, 0.8, 0.85, 0.88, 0.9, 0.92, 0.94, 0.95, 0.96, 0.97, 0.98];
/// "How many could be measured with so many wrong ones?"
const AT_MOST_WRONG: [usize; 5] = [0, 1, 2, 5, 10];

/// Names of a part's pictures, beside the page.
pub struct Pictures {
    pub reliability: String,
    pub risk: String,
}

/// The whole page. `note` is the user's, for what the numbers do not say: how often a set has been used.
pub fn text(parts: &[(Summary, Option<Pictures>)], note: Option<&str>) -> String {
    let mut page = String::from(
        "# Accuracy\n\n\
         Written by `boxline evaluate --report`, not by hand.\n\n\
         A result is **wrong** if a side is off by more than 5 mm, or by more than 3 mm and 4 of its sigmas, and whatever it is if the\n\
         view had to be refused. **Measurable** is what is whole in the frames, in range and not hidden. In brackets: intervals of 95 %\n\
         (Clopper and Pearson).\n",
    );
    if let Some(note) = note {
        page.push_str(&format!("\n{note}\n"));
    }
    for (summary, pictures) in parts {
        page.push('\n');
        page.push_str(&part(summary, pictures.as_ref()));
    }
    page
}

fn part(summary: &Summary, pictures: Option<&Pictures>) -> String {
    let made = &summary.made;
    let of_boxes = matches!(made.source.as_str(), "box" | "three" | "twins" | "folders");
    let things = if of_boxes { "boxes" } else { "faces" };
    let mut text = format!("## {}\n\n{}", title(made), how(summary));
    text.push_str(&measurable(summary, things).unwrap_or_default());
    text.push_str(&to_be_refused(summary, things).unwrap_or_default());
    let far = &summary.out_of_range;
    if far.count > 0 {
        text.push_str(&format!(
            "\nOut of range: {} {things} farther away than 2.5 m, of which {} were refused and {} measured, {} of them wrong.\n",
            far.count, far.refused, far.answered, far.wrong
        ));
    }
    if !summary.wrong.is_empty() {
        text.push_str(&wrong_results(&summary.wrong));
    }
    if let Some(confidence) = &summary.confidence {
        text.push_str(&stated(confidence, pictures));
    }
    if !summary.sizes.is_empty() {
        text.push_str(&sigmas(&summary.sizes));
    }
    for (name, groups) in &summary.groups {
        let rows: Vec<Vec<String>> =
            groups.iter().map(|g| [vec![g.name.clone()], of_group(g)].concat()).collect();
        text.push_str(&format!("\n### By {name}\n\n"));
        text.push_str(&table(&[name, things, "measured", "wrong, of the measured"], &rows));
    }
    if !summary.hazards.is_empty() {
        text.push_str(&by_hazard(&summary.hazards));
    }
    text
}

fn measurable(summary: &Summary, things: &str) -> Option<String> {
    let m = &summary.measurable;
    let (measured, wrong, ambiguous, refused) = (m.measured?, m.wrong?, m.ambiguous?, m.refused?);
    let mut rows = vec![
        vec!["measured".to_owned(), measured.count.to_string(), share(&measured)],
        vec!["**wrong**, of the measured".into(), wrong.count.to_string(), share(&wrong)],
    ];
    for cause in Cause::ALL {
        let count = m.causes.get(&cause).copied().unwrap_or(0);
        rows.push(vec![format!("... {}", cause.words()), count.to_string(), String::new()]);
    }
    rows.push(vec!["two boxes possible".into(), ambiguous.count.to_string(), share(&ambiguous)]);
    for (what, count) in
        [("... though the faces differ", m.undecided), ("... and neither is right", m.neither_right)]
    {
        if count > 0 {
            rows.push(vec![what.to_owned(), count.to_string(), String::new()]);
        }
    }
    rows.push(vec!["refused".into(), refused.count.to_string(), share(&refused)]);
    for (reason, count) in &m.reasons {
        rows.push(vec![format!("... {reason}"), count.to_string(), String::new()]);
    }
    let table = table(&["", "count", "share"], &rows);
    Some(format!("\n### Measurable: {} of {} {things}\n\n{table}", m.count, summary.count))
}

fn to_be_refused(summary: &Summary, things: &str) -> Option<String> {
    let must = &summary.must_refuse;
    let wrong = must.wrong.as_ref()?;
    let row =
        |name: String, s: &Share| vec![name, (s.of - s.count).to_string(), s.count.to_string(), share(s)];
    let mut rows = vec![row("all".into(), wrong)];
    rows.extend(must.reasons.iter().map(|(reason, s)| row(reason.clone(), s)));
    let table = table(&["refusal due", "refused", "**wrong**: measured", "share"], &rows);
    Some(format!("\n### To be refused: {} of {} {things}\n\n{table}", must.count, summary.count))
}

fn wrong_results(wrong: &[Wrong]) -> String {
    let rows: Vec<Vec<String>> = wrong
        .iter()
        .map(|w| {
            let number =
                |x: Option<f64>, digits: usize| x.map_or("-".to_owned(), |x| format!("{x:.digits$}"));
            vec![
                w.name.clone(),
                w.frames.clone(),
                number(w.error_mm, 1),
                number(w.sigma_mm, 2),
                number(w.confidence, 3),
                why(w),
                w.hazards.clone(),
            ]
        })
        .collect();
    let header = ["box", "frames", "off by, mm", "sigma, mm", "stated probability", "cause", "hazards"];
    format!("\n### Wrong results\n\n{}", table(&header, &rows))
}

fn sigmas(sizes: &[Size]) -> String {
    let errors = |e: &Errors| {
        if e.count == 0 {
            return vec!["0".to_owned(), "-".into(), "-".into(), "-".into()];
        }
        vec![e.count.to_string(), format!("{:.2}", e.rms_mm), share(&e.covered), format!("{:.2}", e.mean_z2)]
    };
    let rows: Vec<Vec<String>> = sizes
        .iter()
        .map(|s| [vec![s.class.to_owned()], errors(&s.of_right), errors(&s.of_all)].concat())
        .collect();
    let header = [
        "side, mm",
        "right: sides",
        "rms, mm",
        "in the interval of 95 %",
        "(error/sigma)²",
        "all: sides",
        "rms, mm",
        "in the interval of 95 %",
        "(error/sigma)²",
    ];
    format!(
        "\n### Sigma\n\nSides of measured boxes that are right, and of all. With true sigmas 95 % lie in the interval and the mean of (error/sigma)² is 1.\n\n{}",
        table(&header, &rows)
    )
}

fn by_hazard(hazards: &[HazardGroups]) -> String {
    let rows: Vec<Vec<String>> = hazards
        .iter()
        .map(|h| {
            let (with, without) = (h.with.measured.of, h.without.measured.of);
            let drawn = format!("{:.0} %", 100.0 * with as f64 / (with + without) as f64);
            [vec![h.hazard.clone(), drawn], of_group(&h.with), of_group(&h.without)].concat()
        })
        .collect();
    let header = ["hazard", "share", "with it", "measured", "wrong", "without it", "measured", "wrong"];
    format!("\n### By hazard\n\n{}", table(&header, &rows))
}

fn title(made: &RunSettings) -> &str {
    match made.source.as_str() {
        "box" => "Rendered boxes",
        "three" if two_of_three(made) => "The same boxes, two of the three faces",
        "three" => "Rendered boxes, three faces of each",
        "twins" => "Rendered boxes A x A x B",
        "face" => "Rendered faces",
        "refuse" => "Rendered frames that must be refused",
        "occluded" => "Rendered faces of which something hides a part",
        _ => "Recordings",
    }
}

/// How the part was made.
fn how(summary: &Summary) -> String {
    let made = &summary.made;
    let mut text = String::new();
    if let Some([first, last]) = summary.seeds {
        text.push_str(&format!(
            "Seeds {first} to {last}, held-out materials: `--simulate {} --seed {first} --kind {}{}{} --hazards {}`, photographs: {}.\n",
            last - first + 1,
            made.source,
            if two_of_three(made) { " --faces 2" } else { "" },
            if made.off { " --off" } else { "" },
            made.hazards.as_deref().unwrap_or("all"),
            made.photos.as_deref().unwrap_or("none"),
        ));
    }
    if let Some(serial) = &made.calibration {
        text.push_str(&format!("Calibration of head {serial} in place of the recordings' own.\n"));
    }
    if made.off && made.source != "folders" {
        text.push_str("Each view is there a second time, with the lasers off and the hand a fifteenth of a second farther.\n");
    }
    text + &format!(
        "Method {}, edges {}, network {}, limit {}, boxline {}.\n",
        made.method, made.edges, made.network, made.least_confidence, made.program
    )
}

/// In what way it is wrong, and the cause.
fn why(wrong: &Wrong) -> String {
    let due = wrong.due.as_ref().map(|due| format!("refusal due: {due}"));
    let ambiguous = wrong.ambiguous.then(|| "neither of two boxes".to_owned());
    let cause = wrong.cause.map(|cause| cause.words().to_owned());
    due.into_iter().chain(ambiguous).chain(cause).collect::<Vec<_>>().join("; ")
}

fn stated(confidence: &Confidence, pictures: Option<&Pictures>) -> String {
    let mut text = String::from(
        "\n### Stated probability\n\n\
         Measured boxes, and the likeliest candidates of refused ones: how many are right. The expected calibration error is the mean\n\
         distance of stated and observed.\n\n",
    );
    let bins: Vec<Vec<String>> = confidence
        .bins
        .iter()
        .map(|b| {
            let between = format!("{} to {}", b.from, b.to);
            vec![between, b.right.of.to_string(), format!("{:.3}", b.stated), share(&b.right)]
        })
        .collect();
    text.push_str(&table(&["stated", "boxes", "mean", "right"], &bins));
    let percent = |x: Option<f64>| x.map_or("-".to_owned(), |x| format!("{:.1} %", 100.0 * x));
    text.push_str(&format!(
        "\nExpected calibration error: {}, of the measured alone {}.\n",
        percent(confidence.calibration_error),
        percent(confidence.calibration_error_of_measured)
    ));
    if let Some(pictures) = pictures {
        text.push_str(&format!("\n![Share right over stated probability]({})\n", pictures.reliability));
    }
    text.push_str("\n### Risk and coverage\n\nWhat a limit on the stated probability would leave, of the measurable boxes.\n\n");
    let of = |results: usize, wrong: usize| {
        [
            share(&Share::new(results, confidence.measurable)),
            wrong.to_string(),
            share(&Share::new(wrong, results)),
        ]
    };
    let mut rows = Vec::new();
    for limit in LIMITS {
        if let Some(left) = confidence.limits.iter().rev().find(|l| l.limit >= limit) {
            rows.push([vec![format!("{limit}")], of(left.results, left.wrong).to_vec()].concat());
        }
    }
    let [measured, wrong] = confidence.today;
    rows.push([vec!["**as measured**".to_owned()], of(measured, wrong).to_vec()].concat());
    text.push_str(&table(&["limit", "measured", "wrong", "wrong, of the measured"], &rows));
    let most = |wrong: usize| confidence.limits.iter().rev().find(|l| l.wrong <= wrong);
    let most: Vec<String> = AT_MOST_WRONG
        .iter()
        .filter_map(|wrong| {
            let left = most(*wrong)?;
            Some(format!(
                "{wrong} wrong: {} (limit {:.3})",
                share(&Share::new(left.results, confidence.measurable)),
                left.limit
            ))
        })
        .collect();
    text.push_str(&format!("\nMost that could be measured with at most\n{}.\n", most.join(",\n")));
    if let Some(pictures) = pictures {
        text.push_str(&format!("\n![Wrong over measured; the dot is today's limit]({})\n", pictures.risk));
    }
    text
}

fn of_group(group: &Group) -> Vec<String> {
    vec![group.measured.of.to_string(), share(&group.measured), share(&group.wrong)]
}

/// In percent with its interval.
fn share(share: &Share) -> String {
    let [low, high] = share.interval.map(|x| 100.0 * x);
    share.value().map_or("-".to_owned(), |value| format!("{:.1} % ({low:.1} to {high:.1})", 100.0 * value))
}

fn table(header: &[&str], rows: &[Vec<String>]) -> String {
    let mut text = format!("| {} |\n|{}\n", header.join(" | "), "---|".repeat(header.len()));
    for row in rows {
        text.push_str(&format!("| {} |\n", row.join(" | ")));
    }
    text
}
