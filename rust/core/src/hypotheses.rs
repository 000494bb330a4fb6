//! A frame may show a face whose sides are not clear: several lines may be one. It is then measured along each of them, and what
//! the measurements tell, and the other frames of the box, decide which is right.

use crate::cuboid;
use crate::measurement::FaceMeasurement;
use crate::rectangle::outlines::Pair;
use crate::reject::Reject;
use std::collections::BTreeMap;

/// A face that a frame may show.
pub(crate) struct FaceHypothesis {
    /// That its sides are the right lines.
    pub probability: f64,
    /// That its length, or its width, lies between the right lines, while the other lies between none that is known. Of faces with the
    /// same lines only the likeliest has it.
    pub half: [f64; 2],
    pub face: Result<Box<FaceMeasurement>, Reject>,
}

impl FaceHypothesis {
    /// The one that a frame shows where nothing tells of others.
    pub fn only(face: FaceMeasurement) -> Self {
        Self { probability: 1.0, half: [0.0; 2], face: Ok(Box::new(face)) }
    }
}

/// An outline that was tried: that it is right, its lines ([`Pair`], in the order of the raster), its sides in that order, mm.
pub(crate) struct MeasuredOutline {
    pub probability: f64,
    pub pairs: [Pair; 2],
    pub sides_mm: [f64; 2],
    pub face: Result<Box<FaceMeasurement>, Reject>,
}

/// What a frame shows: the faces that it may be, likeliest first; on the paper's map the one that was found.
pub(crate) struct FaceHypotheses {
    pub faces: Vec<FaceHypothesis>,
    /// Why the likeliest does not count by itself.
    pub unsure: Option<Reject>,
    /// Overlap of the outline with the network's mask (intersection over union); 0 without a network.
    pub overlap: f64,
}

impl FaceHypotheses {
    /// The face alone.
    pub fn face(&self) -> Result<&FaceMeasurement, Reject> {
        match (&self.unsure, self.faces.first().map(|a| &a.face)) {
            // Who goes nearer sees more clearly as well.
            (_, Some(Err(reject @ Reject::TooFar { .. }))) => Err(reject.clone()),
            (Some(reject), _) | (None, Some(Err(reject))) => Err(reject.clone()),
            (None, Some(Ok(face))) => Ok(face),
            (None, None) => Err(Reject::RectangleOpen { sides_found: 0 }),
        }
    }
}

/// What counts as one measurement, and what is assumed of frames in which not all is known.
#[derive(Clone, Copy, Debug)]
struct HypothesesSettings {
    /// Two measurements of a frame found the same edges if their corners are nearer than this, px: edges scatter by 1 to 2 px. More adds up what
    /// is likely of lines that are two, and a face is too sure.
    same_corner_px: f64,
    /// What is less likely than this is not put together with other faces: it could not change the third digit. More leaves out faces that may be
    /// right.
    least_probability: f64,
    /// A side that lies between unknown lines has any of so many lengths, mm: an assumption, since flaps, tape and print lie some tens of mm
    /// beside an edge. More believes faces whose sides agree sooner, also by chance.
    unknown_mm: f64,
    /// Three frames show three different pairs of sides; in so many cases, an assumption, they show a face twice, or opposite ones. More believes
    /// two frames that agree sooner than three that show a box.
    shown_twice: f64,
}

impl HypothesesSettings {
    const DEFAULT: Self =
        Self { same_corner_px: 3.0, least_probability: 1e-3, unknown_mm: 60.0, shown_twice: 0.05 };
}

impl Default for HypothesesSettings {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// Boxes that are told: more than the two likeliest settle nothing.
pub(crate) const LIKELIEST: usize = 2;

/// Pairs of lines that were measured as one.
struct Lines {
    pairs: Vec<Pair>,
    /// Probability of all outlines with them that were tried.
    tried: f64,
}

/// Joins measurements that found the same edges; the likeliest first. One that failed may be right as well. Each face is told its
/// confidence: its probability times what `located` says of it, that sides along the right lines are right.
pub(crate) fn weighed(
    tried: Vec<MeasuredOutline>,
    located: impl Fn(&FaceMeasurement) -> f64,
) -> Vec<FaceHypothesis> {
    let untried = (1.0 - tried.iter().map(|a| a.probability).sum::<f64>()).max(0.0);
    let mut kept: Vec<MeasuredOutline> = Vec::with_capacity(tried.len());
    let mut lines: [Vec<Lines>; 2] = Default::default();
    for outline in tried {
        let same = |known: &&mut MeasuredOutline| matches!((&known.face, &outline.face), (Ok(p), Ok(q)) if same_corners(p, q));
        let known = kept.iter_mut().find(same);
        for (direction, lines) in lines.iter_mut().enumerate() {
            let pair = outline.pairs[direction];
            let with = known.as_ref().map_or(pair, |known| known.pairs[direction]);
            join(lines, with, pair, outline.probability);
        }
        match known {
            Some(known) => known.probability += outline.probability,
            None => kept.push(outline),
        }
    }
    let total = (untried + kept.iter().map(|a| a.probability).sum::<f64>()).max(f64::MIN_POSITIVE);
    kept.sort_by(|a, b| b.probability.total_cmp(&a.probability));
    let hypothesis = |outline: MeasuredOutline| {
        let MeasuredOutline { pairs, sides_mm, .. } = outline;
        let probability = outline.probability / total;
        let (mut half, mut face) = ([0.0; 2], outline.face);
        if let Ok(face) = &mut face {
            face.confidence = Some(probability * located(face));
            half = [0, 1].map(|direction| untried_with(&mut lines[direction], pairs[direction]) / total);
            if sides_mm[0] < sides_mm[1] {
                half.swap(0, 1);
            }
        }
        FaceHypothesis { probability, half, face }
    };
    kept.into_iter().map(hypothesis).collect()
}

/// Takes up an outline's pair of lines, as the same as `with`.
fn join(all: &mut Vec<Lines>, with: Pair, pair: Pair, probability: f64) {
    let of =
        |all: &[Lines], pair: Pair| all.iter().position(|l| l.pairs.iter().any(|p| p.lines == pair.lines));
    let Some(at) = of(all, with) else {
        all.push(Lines { pairs: vec![pair], tried: probability });
        return;
    };
    all[at].tried += probability;
    match of(all, pair) {
        Some(other) if other != at => {
            let Lines { pairs, tried } = all.swap_remove(other);
            let at = if at == all.len() { other } else { at };
            all[at].pairs.extend(pairs);
            all[at].tried += tried;
        }
        Some(_) => {}
        None => all[at].pairs.push(pair),
    }
}

/// Probability of a pair of lines beyond that of all outlines with it that were tried; told once.
fn untried_with(all: &mut [Lines], pair: Pair) -> f64 {
    let known = all.iter_mut().find(|lines| lines.pairs.iter().any(|p| p.lines == pair.lines));
    known.map_or(0.0, |lines| {
        let left = lines.pairs.iter().map(|p| p.probability).sum::<f64>() - lines.tried;
        lines.pairs.iter_mut().for_each(|p| p.probability = 0.0);
        left.max(0.0)
    })
}

fn same_corners(a: &FaceMeasurement, b: &FaceMeasurement) -> bool {
    let limit_px = HypothesesSettings::DEFAULT.same_corner_px;
    a.corners_px.iter().all(|p| b.corners_px.iter().any(|q| p.distance_px(*q) < limit_px))
}

/// What may be true of a frame.
#[derive(Clone, Copy)]
struct State<'a> {
    probability: f64,
    /// Which of the frame's hypotheses.
    index: usize,
    face: Option<&'a FaceMeasurement>,
    /// Whether its length and its width lie between the right lines.
    right: [bool; 2],
    /// Whether the frame shows a face at all.
    face_seen: bool,
}

fn states<'a>(seen: Option<&'a FaceHypotheses>) -> Vec<State<'a>> {
    let mut found = Vec::new();
    for (index, hypothesis) in seen.iter().flat_map(|seen| seen.faces.iter().enumerate()) {
        if let Ok(face) = &hypothesis.face {
            let mut state = |probability, right| {
                found.push(State { probability, index, face: Some(&**face), right, face_seen: true })
            };
            state(hypothesis.probability, [true, true]);
            state(hypothesis.half[0], [true, false]);
            state(hypothesis.half[1], [false, true]);
        }
    }
    found.retain(|state| state.probability >= HypothesesSettings::DEFAULT.least_probability);
    let probability = (1.0 - found.iter().map(|state| state.probability).sum::<f64>()).max(0.0);
    let face_seen = !found.is_empty();
    found.push(State { probability, index: 0, face: None, right: [false; 2], face_seen });
    found
}

/// How well frames in these states agree if they show the sides of the box in this arrangement: a density, 1/mm for each time that a side
/// is seen again, times how likely sides are that differ so much, or so little.
fn agreement(states: &[State<'_>], arrangement: &[cuboid::SidesOfFace]) -> f64 {
    let mut density = 1.0;
    let mut known_sides = Vec::with_capacity(3);
    for side in 0..3 {
        let mut first = None;
        let mut unknown = 0;
        for (state, sides) in states.iter().zip(arrangement) {
            for direction in (0..2).filter(|direction| state.face_seen && sides[*direction] == side) {
                match (state.face.filter(|_| state.right[direction]), first) {
                    (Some(face), Some(known)) => density *= cuboid::agreement(known, (face, direction)),
                    (Some(face), None) => first = Some((face, direction)),
                    (None, _) => unknown += 1,
                }
            }
        }
        let told_by_none = i32::from(first.is_none());
        density /= HypothesesSettings::DEFAULT.unknown_mm.powi((unknown - told_by_none).max(0));
        for other in &known_sides {
            density *= first.map_or(1.0, |side| cuboid::as_different_sides(*other, side));
        }
        known_sides.extend(first);
    }
    density
}

/// A face of each frame, or none.
type OneEach<'a> = Vec<Option<&'a FaceMeasurement>>;

/// Faces of one box, one a frame at most.
pub(crate) struct BoxHypothesis<'a, T> {
    /// Of each frame the face that fits; `None` where the box is told by the others.
    pub faces: OneEach<'a>,
    /// What they make together.
    pub agreed: T,
    /// That this is the box.
    pub probability: f64,
}

/// Faces of one box share sides: that tells which of the faces that each frame may show are right, and how sure it is of those sides.
/// By Bayes' rule over what each frame may show and over which sides are shared. `put_together` makes a box of two faces or more, if they
/// do share sides; `same` says of two results whether they are one box. A frame may also show a face that could not be measured or
/// was not tried: then the others make the box. The two likeliest boxes, fewer if fewer agree.
pub(crate) fn likeliest_boxes<'a, T>(
    seen: &[Option<&'a FaceHypotheses>],
    mut put_together: impl FnMut(&[Option<&'a FaceMeasurement>]) -> Option<T>,
    same: impl Fn(&T, &T) -> bool,
) -> Vec<BoxHypothesis<'a, T>> {
    let of_frames: Vec<Vec<State<'a>>> = seen.iter().map(|seen| states(*seen)).collect();
    let mut all: Vec<Vec<State<'a>>> = vec![Vec::new()];
    for states in &of_frames {
        let longer = |known: &Vec<State<'a>>| {
            let known = known.clone();
            states.iter().map(move |state| known.iter().copied().chain([*state]).collect::<Vec<_>>())
        };
        all = all.iter().flat_map(longer).collect();
    }
    let HypothesesSettings { least_probability, shown_twice, .. } = HypothesesSettings::DEFAULT;
    let arrangements: Vec<(f64, Vec<Vec<cuboid::SidesOfFace>>)> =
        [(1.0 - shown_twice, true), (shown_twice, false)]
            .map(|(share, all_differ)| (share, cuboid::arrangements(seen.len(), all_differ)))
            .into_iter()
            .filter(|(_, arrangements)| !arrangements.is_empty())
            .collect();
    let mut total = 0.0;
    let mut ways: BTreeMap<Vec<Option<usize>>, (f64, OneEach<'a>)> = BTreeMap::new();
    for states in &all {
        let prior: f64 = states.iter().map(|state| state.probability).product();
        let likelihood: f64 = arrangements
            .iter()
            .map(|(share, arrangements)| {
                let sum: f64 = arrangements.iter().map(|arrangement| agreement(states, arrangement)).sum();
                share * sum / arrangements.len() as f64
            })
            .sum();
        total += prior * likelihood;
        let known = |state: &State<'a>| state.right == [true, true];
        if states.iter().filter(|state| known(state)).count() >= 2 {
            let key = states.iter().map(|state| known(state).then_some(state.index)).collect();
            let faces = || states.iter().map(|state| state.face.filter(|_| known(state))).collect();
            ways.entry(key).or_insert_with(|| (0.0, faces())).0 += prior * likelihood;
        }
    }
    let mut boxes: Vec<BoxHypothesis<'a, T>> = Vec::new();
    let mut ways: Vec<_> = ways.into_values().map(|(weight, faces)| (weight / total, faces)).collect();
    ways.retain(|(probability, _)| *probability >= least_probability);
    ways.sort_by(|a, b| b.0.total_cmp(&a.0));
    for (probability, faces) in ways {
        let Some(agreed) = put_together(&faces) else { continue };
        match boxes.iter_mut().find(|known| same(&known.agreed, &agreed)) {
            Some(known) => known.probability += probability,
            None => boxes.push(BoxHypothesis { faces, agreed, probability }),
        }
    }
    boxes.sort_by(|a, b| b.probability.total_cmp(&a.probability));
    boxes.truncate(LIKELIEST);
    boxes
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lines of the two pairs with their probabilities; all outlines are tried in one raster.
    fn tried(lines: [usize; 2], probabilities: [f64; 2], length_mm: f64, width_mm: f64) -> MeasuredOutline {
        let pair = |i: usize| Pair { lines: [lines[i], 0], probability: probabilities[i] };
        MeasuredOutline {
            probability: probabilities[0] * probabilities[1],
            pairs: [pair(0), pair(1)],
            sides_mm: [length_mm, width_mm],
            face: Ok(Box::new(FaceMeasurement::made_up(length_mm, width_mm))),
        }
    }

    fn failed(lines: [usize; 2], probabilities: [f64; 2]) -> MeasuredOutline {
        MeasuredOutline {
            face: Err(Reject::RectangleOpen { sides_found: 3 }),
            ..tried(lines, probabilities, 400.0, 200.0)
        }
    }

    fn seen(outlines: Vec<MeasuredOutline>) -> FaceHypotheses {
        FaceHypotheses { faces: weighed(outlines, |_| 1.0), unsure: None, overlap: 0.0 }
    }

    /// Two frames show both long faces of a box with a square end. In one of them a line inside the face is likelier than the side: then the box
    /// would have three different sides, one of them as long as in neither face.
    #[test]
    fn a_face_like_the_other_one_is_likelier_than_one_that_only_shares_a_side() {
        let sure = seen(vec![tried([0, 0], [0.99, 1.0], 168.7, 100.2)]);
        let unsure =
            seen(vec![tried([0, 0], [0.98, 1.0], 150.7, 100.4), tried([1, 0], [0.02, 1.0], 168.5, 100.4)]);
        let boxes = likeliest_boxes(
            &[Some(&sure), Some(&unsure)],
            |faces| faces[1].map(|face| face.length.value_mm),
            |a, b| a == b,
        );
        let of = |length_mm: f64| boxes.iter().find(|b| b.agreed == length_mm).map_or(0.0, |b| b.probability);
        assert!(of(150.7) < 0.9 && of(168.5) > 0.08, "{} {}", of(150.7), of(168.5));
    }

    #[test]
    fn the_same_edges_count_together_and_what_fails_may_be_right() {
        let kept = weighed(
            vec![
                failed([1, 0], [0.4, 1.0]),
                tried([0, 0], [0.3, 1.0], 400.0, 200.0),
                tried([2, 0], [0.2, 1.0], 401.0, 200.5),
                tried([3, 0], [0.1, 1.0], 440.0, 200.0),
            ],
            |_| 1.0,
        );
        let probabilities: Vec<f64> = kept.iter().map(|a| a.probability).collect();
        let of_faces: Vec<_> = kept.iter().filter_map(|a| a.face.as_ref().ok()?.confidence).collect();
        assert_eq!(probabilities.len(), 3);
        assert_eq!(of_faces.len(), 2, "one failed");
        for (probability, want) in probabilities.iter().zip([0.5, 0.4, 0.1]) {
            assert!((probability - want).abs() < 1e-9, "{probability}, {want} is right");
        }
        assert!(kept.iter().flat_map(|a| a.half).all(|half| half < 1e-9), "all is tried");
    }

    /// Of each pair something is left that no outline was tried with: told once a pair, as length or width as it is measured.
    #[test]
    fn what_was_not_tried_with_a_pair_is_known() {
        for turned in [false, true] {
            let of = |lines: [usize; 2], probabilities: [f64; 2], sides: [f64; 2]| {
                let mut outline = tried(lines, probabilities, 400.0, sides[1].min(sides[0]));
                outline.sides_mm = sides;
                if turned {
                    outline.pairs.swap(0, 1);
                    outline.sides_mm.swap(0, 1);
                }
                outline
            };
            let kept = weighed(
                vec![of([0, 0], [0.9, 0.6], [400.0, 200.0]), of([0, 1], [0.9, 0.3], [400.0, 230.0])],
                |_| 1.0,
            );
            let half: Vec<[f64; 2]> = kept.iter().map(|a| a.half).collect();
            // Length: 0.9 less 0.81 that was tried. Widths: 0.6 less 0.54, 0.3 less 0.27.
            for (half, want) in half.iter().zip([[0.09, 0.06], [0.0, 0.03]]) {
                assert!(half.iter().zip(want).all(|(p, want)| (p - want).abs() < 1e-9), "{half:?} {want:?}");
            }
        }
    }

    #[test]
    fn a_face_that_is_too_far_is_not_called_unsure() {
        let unsure = Reject::RectangleOpen { sides_found: 3 };
        let too_far = Reject::TooFar { distance_mm: 2700.0, limit_mm: 2500.0 };
        let mut face = seen(vec![tried([0, 0], [0.9, 0.9], 900.0, 600.0)]);
        face.unsure = Some(unsure.clone());
        assert_eq!(face.face().unwrap_err().reason(), unsure.reason());
        face.faces[0].face = Err(too_far.clone());
        assert_eq!(face.face().unwrap_err().reason(), too_far.reason());
    }

    /// Sides of two faces that share one, as text; of three faces, each pair shares one.
    fn share_sides(faces: &[Option<&FaceMeasurement>]) -> Option<String> {
        let known: Vec<_> = faces.iter().flatten().map(|f| [f.length.value_mm, f.width.value_mm]).collect();
        let share = |a: &[f64; 2], b: &[f64; 2]| a.iter().any(|x| b.iter().any(|y| (x - y).abs() < 2.0));
        let all = known.iter().enumerate().all(|(i, a)| known[..i].iter().all(|b| share(a, b)));
        let mut sides: Vec<i64> = known.concat().iter().map(|mm| mm.round() as i64).collect();
        sides.sort_unstable();
        sides.dedup();
        all.then(|| format!("{sides:?}"))
    }

    fn likeliest<'a>(seen: &[Option<&'a FaceHypotheses>]) -> Option<BoxHypothesis<'a, String>> {
        likeliest_boxes(seen, share_sides, |a, b| a == b).into_iter().next()
    }

    /// A face whose width lies between one pair of lines or another.
    fn doubtful(first: (f64, f64), second: (f64, f64)) -> FaceHypotheses {
        let of = |line: usize, (probability, width): (f64, f64)| {
            tried([0, line], [1.0, probability], 400.0, width)
        };
        seen(vec![of(0, first), of(1, second)])
    }

    #[test]
    fn the_shared_side_tells_which_of_two_lines_is_right() {
        let face = doubtful((0.6, 230.0), (0.4, 200.0));
        let sure = seen(vec![tried([0, 0], [0.97, 0.98], 300.0, 200.0)]);
        let pair = likeliest(&[Some(&face), Some(&sure)]).expect("one pair shares 200 mm");
        assert_eq!(pair.faces[0].map(|f| f.width.value_mm), Some(200.0));
        assert!((0.9..0.98).contains(&pair.probability), "{}", pair.probability);
        // Where both lines leave the shared side as it is, it tells nothing of them.
        let other = seen(vec![tried([0, 0], [0.97, 0.98], 400.0, 300.0)]);
        let pair = likeliest(&[Some(&face), Some(&other)]).expect("both lines share 400 mm");
        assert!((0.55..0.6).contains(&pair.probability), "{}", pair.probability);
    }

    /// Faces whose lengths are right by 0.9 each, widths by 0.95 each, and nothing else is known. Where the lengths agree they are
    /// right, so that the widths are left: 0.9, less what speaks for a square face, which has that length twice and of which the width is
    /// wrong (0.05 beforehand). Where they differ by 4 sigmas something is wrong.
    #[test]
    fn lengths_that_agree_are_right_and_the_others_stay_as_they_are() {
        let of = |length_mm| seen(vec![tried([0, 0], [0.9, 0.95], length_mm, 200.0)]);
        let with = |length_mm| {
            let (first, second) = (of(400.0), seen(vec![tried([0, 0], [0.9, 0.95], length_mm, 300.0)]));
            likeliest(&[Some(&first), Some(&second)]).map_or(0.0, |pair| pair.probability)
        };
        let agree = with(400.2);
        assert!((0.95 * 0.95 - 0.07..0.95 * 0.95).contains(&agree), "{agree}");
        assert!(with(401.9) < agree - 0.1, "{} {agree}", with(401.9));
    }

    #[test]
    fn a_pair_that_agrees_by_chance_is_none() {
        let likely = doubtful((0.9995, 230.0), (0.0005, 200.0));
        let sure = seen(vec![tried([0, 0], [0.95, 0.95], 300.0, 200.0)]);
        assert!(likeliest(&[Some(&likely), Some(&sure)]).is_none_or(|pair| pair.probability < 0.5));
    }

    #[test]
    fn a_third_face_tells_of_both_sides_that_two_do_not_share() {
        let face = doubtful((0.6, 230.0), (0.4, 200.0));
        let other = seen(vec![tried([0, 0], [0.95, 0.95], 400.0, 300.0)]);
        let third = seen(vec![tried([0, 0], [0.95, 0.95], 300.0, 200.0)]);
        let two = likeliest(&[Some(&face), Some(&other)]).expect("they share 400 mm");
        assert!(two.agreed == "[230, 300, 400]" && two.probability < 0.6);
        let three = likeliest(&[Some(&face), Some(&other), Some(&third)]).expect("all share sides");
        assert_eq!(three.agreed, "[200, 300, 400]");
        assert!(three.probability > 0.9, "{}", three.probability);
        // A third frame that cannot be measured leaves the two as they were.
        let with_none = likeliest(&[Some(&face), Some(&other), None]).expect("they share 400 mm");
        assert_eq!(with_none.agreed, two.agreed);
        assert!(
            (with_none.probability - two.probability).abs() < 0.02,
            "{} {}",
            with_none.probability,
            two.probability
        );
    }
}
