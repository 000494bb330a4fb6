//! A frame may show a face whose sides are not clear: several lines may be one. It is then measured along each of them, and what
//! the measurements tell, and the other frames of the box, decide which is right.

use crate::measurement::FaceMeasurement;
use crate::reject::Reject;

/// A face that a frame may show.
pub(crate) struct Alternative {
    /// That its sides are the right lines.
    pub probability: f64,
    pub face: Result<Box<FaceMeasurement>, Reject>,
}

/// What a frame shows: the face or, if a network has said where it is, the faces it may be, likeliest first.
pub(crate) struct Seen {
    pub alternatives: Vec<Alternative>,
    /// Why the likeliest does not count by itself.
    pub unsure: Option<Reject>,
    /// Overlap of the outline with the network's mask (intersection over union); 0 without a network.
    pub overlap: f64,
}

impl Seen {
    /// The face alone.
    pub fn face(&self) -> Result<&FaceMeasurement, Reject> {
        match (&self.unsure, self.alternatives.first().map(|a| &a.face)) {
            (Some(reject), _) | (None, Some(Err(reject))) => Err(reject.clone()),
            (None, Some(Ok(face))) => Ok(face),
            (None, None) => Err(Reject::RectangleOpen { sides_found: 0 }),
        }
    }

    /// All that could be measured, with their probabilities.
    pub fn measured(&self) -> impl Iterator<Item = (f64, &FaceMeasurement)> {
        self.alternatives.iter().filter_map(|a| Some((a.probability, &**a.face.as_ref().ok()?)))
    }
}

/// One pair in so many that share no side is right all the same: a face measured wrong along the right lines.
const DISAGREE_THOUGH_RIGHT: f64 = 0.05;
/// A face along the right lines fails to be measured so much more seldom than others.
const FAILS_THOUGH_RIGHT: f64 = 0.25;
/// Two measurements of a frame found the same edges if their corners are nearer than this, px: edges scatter by 1 to 2 px.
const SAME_PX: f64 = 3.0;

/// Joins measurements that found the same edges, and lets those that failed count less; the likeliest first. Each face is told its
/// confidence: its probability times what `located` says of it, that sides along the right lines are right.
pub(crate) fn weighed(
    tried: Vec<Alternative>,
    located: impl Fn(&FaceMeasurement) -> f64,
) -> Vec<Alternative> {
    let untried = (1.0 - tried.iter().map(|a| a.probability).sum::<f64>()).max(0.0);
    let mut kept: Vec<Alternative> = Vec::with_capacity(tried.len());
    for mut alternative in tried {
        if alternative.face.is_err() {
            alternative.probability *= FAILS_THOUGH_RIGHT;
        }
        let same = |known: &&mut Alternative| matches!((&known.face, &alternative.face), (Ok(p), Ok(q)) if same_corners(p, q));
        match kept.iter_mut().find(same) {
            Some(known) => known.probability += alternative.probability,
            None => kept.push(alternative),
        }
    }
    let total = untried + kept.iter().map(|a| a.probability).sum::<f64>();
    for alternative in &mut kept {
        alternative.probability /= total.max(f64::MIN_POSITIVE);
        if let Ok(face) = &mut alternative.face {
            face.confidence = Some(alternative.probability * located(face));
        }
    }
    kept.sort_by(|a, b| b.probability.total_cmp(&a.probability));
    kept
}

fn same_corners(a: &FaceMeasurement, b: &FaceMeasurement) -> bool {
    a.corners_px.iter().all(|p| b.corners_px.iter().any(|q| p.distance_px(*q) < SAME_PX))
}

/// What is less likely than this is not put together with other faces: it could not change the third digit.
const LEAST: f64 = 1e-3;

/// Faces of one box, one a frame at most.
pub(crate) struct Together<'a, T> {
    /// Of each frame the face that fits; `None` where the box is told by the others.
    pub faces: Vec<Option<&'a FaceMeasurement>>,
    /// What they make together.
    pub agreed: T,
    /// That this is the box.
    pub probability: f64,
}

/// Faces of one box share sides: that tells which of the faces that each frame may show are right. `agree` puts two or more together,
/// if they do share sides; `same` says of two such results whether they are one box. A frame may also show a face that could not be
/// measured or was not tried: then the others make the box. The two likeliest boxes, fewer if fewer agree.
pub(crate) fn likeliest_boxes<'a, T>(
    seen: &[Option<&'a Seen>],
    mut agree: impl FnMut(&[Option<&'a FaceMeasurement>]) -> Option<T>,
    same: impl Fn(&T, &T) -> bool,
) -> Vec<Together<'a, T>> {
    let mut ways: Vec<(f64, Vec<Option<&'a FaceMeasurement>>)> = vec![(1.0, Vec::new())];
    for seen in seen {
        let faces: Vec<_> =
            seen.iter().flat_map(|seen| seen.measured()).filter(|(p, _)| *p >= LEAST).collect();
        let unknown = (1.0 - faces.iter().map(|(p, _)| p).sum::<f64>()).max(0.0);
        let choices = || faces.iter().map(|(p, face)| (*p, Some(*face))).chain([(unknown, None)]);
        let longer = |(p, known): &(f64, Vec<_>)| {
            let (p, known) = (*p, known.clone());
            choices()
                .map(move |(q, face)| (p * q, known.iter().copied().chain([face]).collect()))
                .collect::<Vec<_>>()
        };
        ways = ways.iter().flat_map(longer).collect();
    }
    let mut all = 0.0;
    let mut agreeing: Vec<Together<'a, T>> = Vec::new();
    for (probability, faces) in ways {
        if faces.iter().flatten().count() < 2 {
            all += probability; // what is unknown may share a side as well
            continue;
        }
        match agree(&faces) {
            Some(agreed) => {
                all += probability;
                agreeing.push(Together { faces, agreed, probability });
            }
            None => all += DISAGREE_THOUGH_RIGHT * probability,
        }
    }
    agreeing.sort_by(|a, b| b.probability.total_cmp(&a.probability));
    let mut boxes: Vec<Together<'a, T>> = Vec::new();
    for mut way in agreeing {
        way.probability /= all.max(f64::MIN_POSITIVE);
        match boxes.iter_mut().find(|known| same(&known.agreed, &way.agreed)) {
            Some(known) => known.probability += way.probability,
            None => boxes.push(way),
        }
    }
    boxes.sort_by(|a, b| b.probability.total_cmp(&a.probability));
    boxes.truncate(2);
    boxes
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tried(probability: f64, length_mm: f64, width_mm: f64) -> Alternative {
        Alternative { probability, face: Ok(Box::new(FaceMeasurement::made_up(length_mm, width_mm))) }
    }

    fn failed(probability: f64) -> Alternative {
        Alternative { probability, face: Err(Reject::RectangleOpen { sides_found: 3 }) }
    }

    #[test]
    fn the_same_edges_count_together_and_failures_less() {
        let kept = weighed(
            vec![tried(0.3, 400.0, 200.0), failed(0.4), tried(0.2, 401.0, 200.5), tried(0.1, 440.0, 200.0)],
            |_| 1.0,
        );
        let told: Vec<f64> = kept.iter().map(|a| a.probability).collect();
        assert_eq!(told.len(), 3);
        let of_faces: Vec<_> = kept.iter().filter_map(|a| a.face.as_ref().ok()?.confidence).collect();
        assert_eq!(of_faces, [told[0], told[2]], "the one in the middle failed");
        for (told, want) in told.iter().zip([0.5 / 0.7, 0.1 / 0.7, 0.1 / 0.7]) {
            assert!((told - want).abs() < 1e-9, "{told}, {want} is right");
        }
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

    fn seen(alternatives: Vec<Alternative>) -> Seen {
        Seen { alternatives, unsure: None, overlap: 0.0 }
    }

    fn likeliest<'a>(seen: &[Option<&'a Seen>]) -> Option<Together<'a, String>> {
        likeliest_boxes(seen, share_sides, |a, b| a == b).into_iter().next()
    }

    #[test]
    fn the_shared_side_tells_which_of_two_lines_is_right() {
        let doubtful = seen(vec![tried(0.6, 400.0, 230.0), tried(0.4, 400.0, 200.0)]);
        let sure = seen(vec![tried(0.95, 300.0, 200.0)]);
        let pair = likeliest(&[Some(&doubtful), Some(&sure)]).expect("one pair shares 200 mm");
        assert_eq!(pair.faces[0].map(|f| f.width.value_mm), Some(200.0));
        // 0.38 agree, 0.57 disagree, 0.05 are unknown.
        let probability = 0.38 / (0.38 + 0.05 * 0.57 + 0.05);
        assert!((pair.probability - probability).abs() < 1e-9, "{}", pair.probability);
        // Where both lines leave the shared side as it is, it tells nothing.
        let other = seen(vec![tried(0.95, 400.0, 300.0)]);
        let pair = likeliest(&[Some(&doubtful), Some(&other)]).expect("both lines share 400 mm");
        assert!((pair.probability - 0.57).abs() < 1e-9, "{}", pair.probability);
    }

    #[test]
    fn a_pair_that_agrees_by_chance_is_none() {
        let likely = seen(vec![tried(0.98, 400.0, 230.0), tried(0.02, 400.0, 200.0)]);
        let sure = seen(vec![tried(1.0, 300.0, 200.0)]);
        assert!(likeliest(&[Some(&likely), Some(&sure)]).is_some_and(|pair| pair.probability < 0.5));
    }

    #[test]
    fn a_third_face_tells_of_both_sides_that_two_do_not_share() {
        let doubtful = seen(vec![tried(0.6, 400.0, 230.0), tried(0.4, 400.0, 200.0)]);
        let other = seen(vec![tried(0.9, 400.0, 300.0)]);
        let third = seen(vec![tried(0.9, 300.0, 200.0)]);
        let two = likeliest(&[Some(&doubtful), Some(&other)]).expect("they share 400 mm");
        assert!(two.agreed == "[230, 300, 400]" && two.probability < 0.6);
        let three = likeliest(&[Some(&doubtful), Some(&other), Some(&third)]).expect("all share sides");
        assert_eq!(three.agreed, "[200, 300, 400]");
        assert!(three.probability > 0.75, "{}", three.probability);
        // A third frame that cannot be measured leaves the two as they were.
        let with_none = likeliest(&[Some(&doubtful), Some(&other), None]).expect("they share 400 mm");
        assert_eq!(with_none.agreed, two.agreed);
        assert!((with_none.probability - two.probability).abs() < 1e-9);
    }
}
