//! A frame may show a face whose sides are not clear: several lines may be one. It is then measured along each of them, and what
//! the measurements tell, and the other frame of the box, decide which is right.

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

/// Two faces of one box.
pub(crate) struct Pair<'a, T> {
    pub faces: [&'a FaceMeasurement; 2],
    /// What they make together.
    pub agreed: T,
    /// That both are right.
    pub probability: f64,
}

/// Two faces of one box share a side: that tells which of the faces that each frame may show are right. `agree` puts two together, if
/// they do share one. `None` if no pair does.
pub(crate) fn likeliest_pair<'a, T>(
    seen: [&'a Seen; 2],
    mut agree: impl FnMut([&'a FaceMeasurement; 2]) -> Option<T>,
) -> Option<Pair<'a, T>> {
    let (mut agreeing, mut disagreeing, mut best) = (0.0, 0.0, None);
    for (p, a) in seen[0].measured() {
        for (q, b) in seen[1].measured() {
            let Some(agreed) = agree([a, b]) else {
                disagreeing += p * q;
                continue;
            };
            agreeing += p * q;
            if best.as_ref().is_none_or(|best: &Pair<'_, T>| p * q > best.probability) {
                best = Some(Pair { faces: [a, b], agreed, probability: p * q });
            }
        }
    }
    // What could not be measured or was not tried may share a side as well.
    let unknown = (1.0 - agreeing - disagreeing).max(0.0);
    let all = agreeing + DISAGREE_THOUGH_RIGHT * disagreeing + unknown;
    best.map(|pair| Pair { probability: pair.probability / all.max(f64::MIN_POSITIVE), ..pair })
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

    fn share_a_side(faces: [&FaceMeasurement; 2]) -> Option<()> {
        let [a, b] = faces.map(|f| [f.length.value_mm, f.width.value_mm]);
        a.iter().any(|x| b.iter().any(|y| (x - y).abs() < 2.0)).then_some(())
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

    #[test]
    fn the_shared_side_tells_which_of_two_lines_is_right() {
        let doubtful = Seen {
            alternatives: vec![tried(0.6, 400.0, 230.0), tried(0.4, 400.0, 200.0)],
            unsure: None,
            overlap: 0.0,
        };
        let sure = Seen { alternatives: vec![tried(0.95, 300.0, 200.0)], unsure: None, overlap: 0.0 };
        let pair = likeliest_pair([&doubtful, &sure], share_a_side).expect("one pair shares 200 mm");
        assert_eq!(pair.faces[0].width.value_mm, 200.0);
        // 0.38 agree, 0.57 disagree, 0.05 are unknown.
        let probability = 0.38 / (0.38 + 0.05 * 0.57 + 0.05);
        assert!((pair.probability - probability).abs() < 1e-9, "{}", pair.probability);
        // Where both lines leave the shared side as it is, it tells nothing.
        let other = Seen { alternatives: vec![tried(0.95, 400.0, 300.0)], unsure: None, overlap: 0.0 };
        let pair = likeliest_pair([&doubtful, &other], share_a_side).expect("both lines share 400 mm");
        assert!((pair.probability - 0.57).abs() < 1e-9, "{}", pair.probability);
    }

    #[test]
    fn a_pair_that_agrees_by_chance_is_none() {
        let likely = Seen {
            alternatives: vec![tried(0.98, 400.0, 230.0), tried(0.02, 400.0, 200.0)],
            unsure: None,
            overlap: 0.0,
        };
        let sure = Seen { alternatives: vec![tried(1.0, 300.0, 200.0)], unsure: None, overlap: 0.0 };
        assert!(likeliest_pair([&likely, &sure], share_a_side).is_some_and(|pair| pair.probability < 0.5));
    }
}
