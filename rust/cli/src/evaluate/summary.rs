//! The numbers of a scored run, from its rows.

use super::cause::Cause;
use super::rows::{Expected, ResultKind, Row, RunSettings, SIZE_CLASSES, TOO_FAR, UNDECIDED};
use super::score::Statistics;
use super::statistics::{Bin, Limited, Share, Stated, calibration_error, limits, reliability};
use boxline::Estimate;
use boxline_proto::json::is_wrong_side;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};

/// Everything that is told of a file of rows.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    pub made: RunSettings,
    /// The lowest and the highest seed.
    pub seeds: Option<[u64; 2]>,
    /// Boxes, or faces that are judged by themselves.
    pub count: usize,
    pub measurable: Measurable,
    pub must_refuse: MustRefuse,
    /// Whole in view, but farther away than the head is made for.
    pub out_of_range: OutOfRange,
    pub wrong: Vec<Wrong>,
    pub confidence: Option<Confidence>,
    pub sizes: Vec<Size>,
    pub groups: Vec<(&'static str, Vec<Group>)>,
    pub hazards: Vec<HazardGroups>,
}

#[derive(Clone, Debug, Default, Serialize)]
pub struct Measurable {
    pub count: usize,
    pub measured: Option<Share>,
    /// Of the measured.
    pub wrong: Option<Share>,
    pub causes: BTreeMap<Cause, usize>,
    pub ambiguous: Option<Share>,
    /// Of the ambiguous: the two faces differ, which tells the box.
    pub undecided: usize,
    /// Of the ambiguous: neither of the two boxes is right.
    pub neither_right: usize,
    pub refused: Option<Share>,
    pub reasons: BTreeMap<String, usize>,
}

#[derive(Clone, Debug, Default, Serialize)]
pub struct MustRefuse {
    pub count: usize,
    /// What was measured, or was told to be one of two boxes.
    pub wrong: Option<Share>,
    /// By what was due.
    pub reasons: BTreeMap<String, Share>,
}

#[derive(Clone, Debug, Default, Serialize)]
pub struct OutOfRange {
    pub count: usize,
    pub refused: usize,
    pub answered: usize,
    pub wrong: usize,
}

/// A wrong result.
#[derive(Clone, Debug, Serialize)]
pub struct Wrong {
    pub name: String,
    pub frames: String,
    /// A refusal was due, for this reason.
    pub due: Option<String>,
    /// Two boxes were told to be possible, and neither is right.
    pub ambiguous: bool,
    /// Of the side that is farthest off, if there is a true one.
    pub error_mm: Option<f64>,
    pub sigma_mm: Option<f64>,
    pub confidence: Option<f64>,
    pub cause: Option<Cause>,
    pub hazards: String,
}

/// How well the stated probabilities hold, on measurable boxes: the measured ones, and the likeliest candidates of refused ones.
#[derive(Clone, Debug, Serialize)]
pub struct Confidence {
    pub bins: Vec<Bin>,
    /// Expected calibration error of all, and of the measured alone.
    pub calibration_error: Option<f64>,
    pub calibration_error_of_measured: Option<f64>,
    /// What each limit would leave of the measurable.
    pub limits: Vec<Limited>,
    /// What today's limits leave: measured and wrong.
    pub today: [usize; 2],
    pub measurable: usize,
}

/// Errors of a class of sides.
#[derive(Clone, Debug, Serialize)]
pub struct Size {
    pub class: &'static str,
    /// Of measured boxes without a wrong side, and of all.
    pub of_right: Errors,
    pub of_all: Errors,
}

#[derive(Clone, Debug, Serialize)]
pub struct Errors {
    pub count: usize,
    pub rms_mm: f64,
    /// Sides whose interval of 95 % holds the truth.
    pub covered: Share,
    pub mean_z2: f64,
}

/// Measurable boxes that have something in common.
#[derive(Clone, Debug, Serialize)]
pub struct Group {
    pub name: String,
    pub measured: Share,
    pub wrong: Share,
}

#[derive(Clone, Debug, Serialize)]
pub struct HazardGroups {
    pub hazard: String,
    pub with: Group,
    pub without: Group,
}

/// The rows of what was measured as one.
#[derive(Clone, Copy)]
struct Subject<'a> {
    first: &'a Row,
    sides: &'a [Row],
}

impl Subject<'_> {
    fn is_measurable(&self) -> bool {
        self.first.due == Expected::Measure
    }

    fn is(&self, answer: ResultKind) -> bool {
        self.first.outcome == answer
    }

    /// A result with a wrong side.
    fn is_wrong(&self) -> bool {
        self.sides.iter().any(|side| side.wrong)
    }

    /// Its stated probability, and whether it is, or would be, right.
    fn stated(&self) -> Option<Stated> {
        let probability = self.first.confidence?;
        let right = match self.first.outcome {
            ResultKind::Measured => !self.is_wrong(),
            ResultKind::Ambiguous => return None,
            ResultKind::Refused => !self.sides.iter().any(|side| {
                let candidate = side.candidate_mm.zip(side.candidate_sigma_mm).zip(side.truth_mm);
                candidate.is_none_or(|((mm, sigma), truth)| is_wrong_side(Estimate::new(mm, sigma), truth))
            }),
        };
        Some(Stated { probability, right })
    }
}

/// Bounds of the classes of angles, degrees.
const ANGLES_DEG: [(f64, f64, &str); 3] =
    [(0.0, 20.0, "below 20 degrees"), (20.0, 40.0, "20 to 40 degrees"), (40.0, 90.0, "above 40 degrees")];

/// Adds up a file.
pub fn summary(made: RunSettings, rows: &[Row]) -> Summary {
    let of_one = |a: &Row, b: &Row| a.name == b.name && a.frames == b.frames;
    let all: Vec<Subject<'_>> =
        rows.chunk_by(of_one).filter_map(|sides| Some(Subject { first: sides.first()?, sides })).collect();
    let measurable: Vec<Subject<'_>> = all.iter().copied().filter(Subject::is_measurable).collect();
    let seeds = || rows.iter().filter_map(|row| row.seed);
    Summary {
        made,
        seeds: seeds().min().zip(seeds().max()).map(|(low, high)| [low, high]),
        count: all.len(),
        measurable: of_measurable(&measurable),
        must_refuse: of_must_refuse(&all),
        out_of_range: of_out_of_range(&all),
        wrong: all.iter().filter(|s| s.is_wrong()).map(wrong).collect(),
        confidence: confidence(&measurable),
        sizes: SIZE_CLASSES.iter().filter_map(|(_, class)| size(class, &measurable)).collect(),
        groups: groups(&measurable),
        hazards: hazards(&measurable),
    }
}

fn counted<'a>(all: &[Subject<'a>], of: impl Fn(&Subject<'a>) -> bool) -> usize {
    all.iter().filter(|s| of(s)).count()
}

fn of_measurable(all: &[Subject<'_>]) -> Measurable {
    if all.is_empty() {
        return Measurable::default();
    }
    let measured = counted(all, |s| s.is(ResultKind::Measured));
    let wrong = |s: &Subject<'_>| s.is(ResultKind::Measured) && s.is_wrong();
    let (mut causes, mut reasons) = (BTreeMap::new(), BTreeMap::new());
    for subject in all {
        if wrong(subject) {
            *causes.entry(subject.first.cause.unwrap_or(Cause::Other)).or_default() += 1;
        }
        if subject.is(ResultKind::Refused) {
            *reasons.entry(subject.first.reason.clone()).or_default() += 1;
        }
    }
    let of_all = |answer| Some(Share::new(counted(all, |s| s.is(answer)), all.len()));
    Measurable {
        count: all.len(),
        measured: of_all(ResultKind::Measured),
        wrong: Some(Share::new(counted(all, wrong), measured)),
        causes,
        ambiguous: of_all(ResultKind::Ambiguous),
        undecided: counted(all, |s| s.is(ResultKind::Ambiguous) && s.first.reason == UNDECIDED),
        neither_right: counted(all, |s| s.is(ResultKind::Ambiguous) && s.is_wrong()),
        refused: of_all(ResultKind::Refused),
        reasons,
    }
}

fn of_must_refuse(all: &[Subject<'_>]) -> MustRefuse {
    let due: Vec<Subject<'_>> =
        all.iter().copied().filter(|s| !s.is_measurable() && s.first.due_reason != TOO_FAR).collect();
    let answered = |s: &Subject<'_>| !s.is(ResultKind::Refused);
    let words: BTreeSet<&str> = due.iter().map(|s| s.first.due_reason.as_str()).collect();
    let of_reason = |word: &str| {
        let of = |s: &Subject<'_>| s.first.due_reason == word;
        (word.to_owned(), Share::new(counted(&due, |s| of(s) && answered(s)), counted(&due, of)))
    };
    MustRefuse {
        count: due.len(),
        wrong: (!due.is_empty()).then(|| Share::new(counted(&due, answered), due.len())),
        reasons: words.into_iter().map(of_reason).collect(),
    }
}

fn of_out_of_range(all: &[Subject<'_>]) -> OutOfRange {
    let far: Vec<Subject<'_>> =
        all.iter().copied().filter(|s| !s.is_measurable() && s.first.due_reason == TOO_FAR).collect();
    let refused = counted(&far, |s| s.is(ResultKind::Refused));
    OutOfRange {
        count: far.len(),
        refused,
        answered: far.len() - refused,
        wrong: counted(&far, Subject::is_wrong),
    }
}

fn wrong(subject: &Subject<'_>) -> Wrong {
    let first = subject.first;
    let off = |row: &&Row| row.error_mm.map_or(0.0, f64::abs);
    let worst =
        subject.sides.iter().filter(|row| row.error_mm.is_some()).max_by(|a, b| off(a).total_cmp(&off(b)));
    Wrong {
        name: first.name.clone(),
        frames: first.frames.clone(),
        due: (!subject.is_measurable()).then(|| first.due_reason.clone()),
        ambiguous: subject.is(ResultKind::Ambiguous),
        error_mm: worst.and_then(|row| row.error_mm),
        sigma_mm: worst.and_then(|row| row.sigma_mm),
        confidence: first.confidence,
        cause: first.cause,
        hazards: first.hazards.clone(),
    }
}

fn confidence(measurable: &[Subject<'_>]) -> Option<Confidence> {
    let all: Vec<Stated> = measurable.iter().filter_map(Subject::stated).collect();
    let measured = || measurable.iter().filter(|s| s.is(ResultKind::Measured));
    let of_measured: Vec<Stated> = measured().filter_map(Subject::stated).collect();
    let bins = reliability(&all);
    (!all.is_empty()).then(|| Confidence {
        calibration_error: calibration_error(&bins),
        calibration_error_of_measured: calibration_error(&reliability(&of_measured)),
        bins,
        limits: limits(&all),
        today: [measured().count(), measured().filter(|s| s.is_wrong()).count()],
        measurable: measurable.len(),
    })
}

fn size(class: &'static str, measurable: &[Subject<'_>]) -> Option<Size> {
    let (mut right, mut all) = (Statistics::default(), Statistics::default());
    for subject in measurable.iter().filter(|s| s.is(ResultKind::Measured)) {
        for row in subject.sides.iter().filter(|row| row.size_class == class) {
            let Some((error_mm, sigma_mm)) = row.error_mm.zip(row.sigma_mm) else { continue };
            all.add(error_mm, sigma_mm);
            if !subject.is_wrong() {
                right.add(error_mm, sigma_mm);
            }
        }
    }
    let errors = |s: &Statistics| Errors {
        count: s.count(),
        rms_mm: s.rms_mm(),
        covered: Share::new(s.covered(), s.count()),
        mean_z2: s.mean_z2(),
    };
    (all.count() > 0).then(|| Size { class, of_right: errors(&right), of_all: errors(&all) })
}

fn group<'a>(name: impl Into<String>, all: &[Subject<'a>], has: impl Fn(&Subject<'a>) -> bool) -> Group {
    let measured = counted(all, |s| has(s) && s.is(ResultKind::Measured));
    let wrong = counted(all, |s| has(s) && s.is(ResultKind::Measured) && s.is_wrong());
    Group {
        name: name.into(),
        measured: Share::new(measured, counted(all, &has)),
        wrong: Share::new(wrong, measured),
    }
}

fn groups(all: &[Subject<'_>]) -> Vec<(&'static str, Vec<Group>)> {
    let neighbours = [(Some(true), "free-standing"), (Some(false), "with neighbours"), (None, "not known")]
        .map(|(free, name)| group(name, all, |s| s.first.free == free));
    let lights: BTreeSet<&str> = all.iter().map(|s| s.first.ambient.as_str()).collect();
    let lights = lights.into_iter().map(|light| {
        group(if light.is_empty() { "not known" } else { light }, all, |s| s.first.ambient == light)
    });
    let angles = ANGLES_DEG.map(|(from, to, name)| {
        group(name, all, |s| s.first.angle_deg.is_some_and(|deg| (from..to).contains(&deg)))
    });
    [
        ("neighbours", neighbours.to_vec()),
        ("light", lights.collect()),
        ("angle off the normal", angles.to_vec()),
    ]
    .into_iter()
    .map(|(name, groups)| (name, groups.into_iter().filter(|g| g.measured.of > 0).collect::<Vec<_>>()))
    .filter(|(_, groups)| groups.len() > 1)
    .collect()
}

fn hazards(all: &[Subject<'_>]) -> Vec<HazardGroups> {
    let words = |s: &Subject<'_>| s.first.hazards.split_whitespace().map(str::to_owned).collect::<Vec<_>>();
    let known: BTreeSet<String> = all.iter().flat_map(words).collect();
    known
        .into_iter()
        .map(|hazard| {
            let has = |s: &Subject<'_>| s.first.hazards.split_whitespace().any(|word| word == hazard);
            let (with, without) = (group("with", all, has), group("without", all, |s| !has(s)));
            HazardGroups { hazard, with, without }
        })
        .collect()
}
