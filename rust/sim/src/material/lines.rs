//! Straight lines on a face that run along one of its edges and are none: borders of print, tape, straps, labels, seams.
//! Whoever looks for the face's sides finds them too; the truth file lists them, so that a wrong side has a name.

use super::{Art, Decal};
use std::f32::consts::FRAC_PI_2;

/// A straight line on a face, parallel to one of its edges and longer than half of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FalseLine {
    /// Which face.
    pub face: usize,
    /// The edge that it runs along, as the face is seen from outside with its picture axes (u right, v down): 0 left, 1 right,
    /// 2 upper, 3 lower.
    pub side: usize,
    /// From that edge into the face, mm.
    pub offset_mm: f32,
    /// What ends there: the word of the decal.
    pub kind: &'static str,
}

/// Lines are told up to this far from an edge: in mm, or as a share of the face, whichever is more.
const NEAR_MM: f32 = 60.0;
const NEAR_SHARE: f32 = 0.3;
/// A line closer to the edge than this is the edge.
const APART_MM: f32 = 0.5;
/// What is narrower than this is one line, not two borders.
const NARROW_MM: f32 = 4.0;
/// What is turned by less than this looks parallel.
const PARALLEL_RAD: f32 = 0.006;

/// The lines that decals draw on the faces of a carton, each face of the half sizes (right, down) that `half_of` gives, mm.
#[must_use]
pub fn false_lines(decals: &[Decal], half_of: impl Fn(usize) -> [f32; 2]) -> Vec<FalseLine> {
    let mut found: Vec<(FalseLine, f32)> = Vec::new();
    for decal in decals {
        let quarters = (decal.turn_rad / FRAC_PI_2).round();
        if (decal.turn_rad - quarters * FRAC_PI_2).abs() > PARALLEL_RAD || !has_borders(&decal.art) {
            continue;
        }
        let mut half = decal.half;
        if quarters.rem_euclid(2.0) > 0.5 {
            half.swap(0, 1);
        }
        let room = half_of(decal.face);
        for across in [0, 1] {
            let along = 1 - across;
            let (low, high) = (decal.centre[along] - half[along], decal.centre[along] + half[along]);
            let length = high.min(room[along]) - low.max(-room[along]);
            for at in borders(&decal.art, half[across]) {
                for (side, way) in [(2 * across, 1.0), (2 * across + 1, -1.0)] {
                    let offset_mm = room[across] + way * (decal.centre[across] + at);
                    let near = offset_mm <= NEAR_MM.max(NEAR_SHARE * 2.0 * room[across]);
                    if near && offset_mm >= APART_MM && length > 0.0 {
                        add(
                            &mut found,
                            FalseLine { face: decal.face, side, offset_mm, kind: decal.kind },
                            length,
                        );
                    }
                }
            }
        }
    }
    let long = |line: &FalseLine| {
        let room = half_of(line.face);
        if line.side < 2 { room[1] } else { room[0] }
    };
    found.into_iter().filter(|(line, length)| *length > long(line)).map(|(line, _)| line).collect()
}

/// Adds a piece of a line; dashes of one line join.
fn add(found: &mut Vec<(FalseLine, f32)>, line: FalseLine, length: f32) {
    let same = |l: &FalseLine| {
        (l.face, l.side, l.kind) == (line.face, line.side, line.kind)
            && (l.offset_mm - line.offset_mm).abs() < 0.1
    };
    match found.iter_mut().find(|(l, _)| same(l)) {
        Some((_, sum)) => *sum += length,
        None => found.push((line, length)),
    }
}

fn has_borders(art: &Art) -> bool {
    match art {
        Art::Fill(_) | Art::Print(..) | Art::Tape(..) | Art::Outline(..) | Art::Label(..) | Art::Photo(_) => {
            true
        }
        Art::Text(..) | Art::Arrows(_) | Art::Glass(_) | Art::Hole | Art::Disc(_) => false,
    }
}

/// Where straight borders are, mm from the decal's middle, if it is this wide to either side.
fn borders(art: &Art, half: f32) -> Vec<f32> {
    match art {
        Art::Outline(_, line) if *line >= NARROW_MM => vec![-half, line - half, half - line, half],
        Art::Outline(_, line) => vec![0.5 * line - half, half - 0.5 * line],
        _ if 2.0 * half < NARROW_MM => vec![0.0],
        _ => vec![-half, half],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn decal(centre: [f32; 2], half: [f32; 2], turn_rad: f32, art: Art) -> Decal {
        Decal { kind: "thing", face: 3, centre, turn_rad, half, art, gloss: None }
    }

    fn lines(decals: &[Decal]) -> Vec<(usize, f32)> {
        false_lines(decals, |_| [200.0, 100.0]).iter().map(|l| (l.side, l.offset_mm)).collect()
    }

    #[test]
    fn a_band_has_two_lines_beside_its_edge_and_a_short_one_none() {
        let fill = Art::Fill([0; 3]);
        // 10 to 30 mm inside the lower edge, over the whole width.
        assert_eq!(lines(&[decal([0.0, 80.0], [200.0, 10.0], 0.0, fill.clone())]), [(3, 30.0), (3, 10.0)]);
        assert_eq!(
            lines(&[decal([0.0, 80.0], [10.0, 200.0], FRAC_PI_2, fill.clone())]),
            [(3, 30.0), (3, 10.0)]
        );
        assert_eq!(lines(&[decal([0.0, 80.0], [90.0, 10.0], 0.0, fill.clone())]), []);
        assert_eq!(lines(&[decal([0.0, 80.0], [200.0, 10.0], 0.1, fill.clone())]), []);
        // Tape up to the edge has its inner border only; a fine line is one.
        assert_eq!(lines(&[decal([190.0, 0.0], [10.0, 100.0], 0.0, fill.clone())]), [(1, 20.0)]);
        assert_eq!(lines(&[decal([-180.0, 0.0], [1.0, 100.0], 0.0, fill)]), [(0, 20.0)]);
    }

    #[test]
    fn frames_have_lines_along_all_four_edges_and_dashes_join() {
        let frame = lines(&[decal([0.0; 2], [185.0, 85.0], 0.0, Art::Outline([0; 3], 2.0))]);
        assert_eq!(frame, [(0, 16.0), (1, 16.0), (2, 16.0), (3, 16.0)]);
        let dash = |u: f32| decal([u, -90.0], [20.0, 1.0], 0.0, Art::Fill([0; 3]));
        assert_eq!(lines(&[-150.0, -90.0, -30.0, 30.0, 90.0, 150.0].map(dash)), [(2, 10.0)]);
    }
}
