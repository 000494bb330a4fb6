//! How far a box reaches behind a measured face, read from the stripes on the faces beside it: what settles A x A x B.
//!
//! Both frames show A x B (A > B). Either they share A, and the box is A x B x B; or they share B, and it is A x A x B. Which
//! sides meet is not seen in a face itself, but what lies behind it differs: **behind both faces the box is B deep in the
//! first case and A deep in the second**, and every face beside a measured one reaches that deep, whichever of its sides it
//! shares. In an oblique view such a face is seen. A stripe goes on over it, bent at the shared edge: it stays in its laser's
//! plane and lies on the plane through the edge at a right angle to the measured face, so it is predicted to some px
//! ([`stripe_path`]); where it ends is the depth. A laser's plane nearly holds the line of sight, so it runs straight to the far end.
//!
//! Each stripe can show three things: it ends at the nearer depth B, it ends at the farther depth A, or it passes B without a
//! gap. B is settled if in both frames a stripe ends there and none says otherwise. A is settled if in both frames a stripe
//! passes B or ends at A, one at least does either, and none ends at B. The frames look along two different sides of the box, and
//! what lengthens one of them (a pallet, a box beneath) or shortens it (a box that stands on it) does not do so to the other; two
//! stripes of one frame end at one thing.
//!
//! What else could be there, and why it is not taken for it:
//! - nothing, or texture: the stripe must stand out against the same filter along lines beside it (which has texture's
//!   scatter, and its correlation along the line), allowing for all lines that were tried ([`DepthSettings::false_alarm`]);
//! - a flush face that goes on straight, the floor, a wall: their stripes leave the predicted line at an angle. How much later
//!   they seem to end ([`StripePath::late_mm`]) must be less than half of the nearer depth at the edge, and less than what the two
//!   depths differ behind it; and the stripe must begin at the edge;
//! - a flush box or pallet behind that carries the stripe on: the seam interrupts it at B, it would have to be there behind both
//!   faces, and to end at A; where A is a multiple of B, equal boxes in a row do, so such a pair is never settled as A deep;
//! - a stripe that is lost early or hidden in between (print, tape, a shadow): it must end at one depth and not at the other at
//!   odds that all stripes add up to ([`DepthSettings::least_log_odds`]), and one that ends elsewhere before the farther depth says nothing.

mod stripe_path;
#[cfg(test)]
mod tests;

use crate::calibration::Calibration;
use crate::image::Frame;
use crate::measurement::{BoxMeasurement, DepthEstimate, FaceMeasurement};
use crate::statistics::median;
use crate::stripe::centres::measure_half_width_px;
use crate::stripe::colour_projection::measure_projections;
use crate::stripe::stripe_line::StripeLine;
use crate::units::{Estimate, LaserId};
use std::ops::Range;
use stripe_path::{FramedStripe, PathSample, StripePath};

/// What a stripe on a neighbouring face must show. Where a field gives no reason for its value, none is on record.
#[derive(Clone, Copy, Debug)]
struct DepthSettings {
    /// Probability that noise alone looks like a stripe on any of the lines that are tried for one stripe. More takes texture for stripes.
    false_alarm: f64,
    /// Natural logarithm of the odds between the two depths that all stripes together must tell (10,000 to 1). More leaves more boxes open.
    least_log_odds: f64,
    /// ... and that a stripe must tell to count, for or against: more than one place can. More leaves out faint stripes, also those that speak
    /// against the others.
    least_of_one: f64,
    /// What one place counts at most, natural logarithm: print hides a stripe on one place in seven. Nearer to 0 a stripe's end is lost, farther
    /// from it print ends a stripe.
    unseen_log_odds: f64,
    /// ... and on one in fifty something else looks like one. More lets single bright places carry a stripe on.
    false_log_odds: f64,
    /// Neighbouring places share print: one in so many is independent. More leaves more boxes open.
    places_per_independent: f64,
    /// A stripe begins at the edge if its places up to this share of the nearer depth have on average this share of its usual strength. A larger
    /// first share lets stripes in that begin farther behind, a larger second one leaves out those with print at the edge.
    begins_within: f64,
    begins_with: f64,
    /// The end of a stripe is seen if it is gone behind it at odds of 20 to 1. More loses ends close to where the path itself ends.
    end_seen_log_odds: f64,
    /// A stripe that is dimmer than this share of what it is around has a gap: roundings of two edges take 2 to 8 mm of it, a place
    /// is about as long. More sees gaps in stripes over print, less overlooks seams.
    least_light: f64,
    /// ... around: within so many times the seam's own range. More compares with light farther away.
    around: f64,
    /// An end may lie this far from a depth, mm: rounding of two edges (4 mm) and a bulge. More leaves more depths open that lie close together.
    end_mm: f64,
    /// ... and this share of it: the neighbouring face's angle (half a degree) changes the depth that a place seems to have. The same.
    end_share: f64,
    /// ... and so many places. The same.
    end_places: f64,
    /// All of that is so many standard deviations. More makes the depth's sigma smaller.
    slack_sigmas: f64,
    /// A flush face that goes on straight may be taken for the neighbouring one over this share of the nearer depth. More takes it for one.
    most_late: f64,
    /// The farther depth over the nearer one is a whole number, and the box may be a row of equal ones, within so much of what an end may be off.
    /// More leaves more boxes open.
    in_a_row: f64,
    /// So far behind the edge a stripe is followed: farther depths, and what an end may be off. More takes longer, and what follows the box
    /// counts.
    follow_depths: f64,
    follow_ends: f64,
}

impl DepthSettings {
    const DEFAULT: Self = Self {
        false_alarm: 1e-4,
        least_log_odds: 9.2,
        least_of_one: 2.0,
        unseen_log_odds: -1.9,
        false_log_odds: 3.9,
        places_per_independent: 2.0,
        begins_within: 0.25,
        begins_with: 0.5,
        end_seen_log_odds: 3.0,
        least_light: 0.6,
        around: 3.0,
        end_mm: 6.0,
        end_share: 0.012,
        end_places: 2.0,
        slack_sigmas: 2.0,
        most_late: 0.5,
        in_a_row: 2.0,
        follow_depths: 1.5,
        follow_ends: 10.0,
    };
}

impl Default for DepthSettings {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// Which of two candidates the frames show, and the depth that says so; `None` if they do not tell.
pub(crate) fn settle(
    calibration: &Calibration,
    frames: [&Frame; 2],
    faces: [&FaceMeasurement; 2],
    candidates: &[BoxMeasurement; 2],
) -> Option<(usize, DepthEstimate)> {
    let sides = |b: &BoxMeasurement| [b.length, b.width, b.height];
    let face_mm = 0.5 * faces.iter().map(|f| f.length.value_mm + f.width.value_mm).sum::<f64>();
    // What is left of the three sides after those of the face.
    let behind = candidates.each_ref().map(|c| sides(c).iter().map(|s| s.value_mm).sum::<f64>() - face_mm);
    let nearer = usize::from(behind[1] < behind[0]);
    let depths = Depths { near_mm: behind[nearer], far_mm: behind[1 - nearer] };
    let of_frame = |i: usize| stripes_beside(calibration, frames[i], faces[i], &depths);
    let of_frames = [of_frame(0), of_frame(1)];
    let seen: Vec<DepthEvidence> = of_frames.iter().flatten().copied().collect();
    let any = |says: fn(&DepthEvidence) -> bool| seen.iter().any(says);
    let in_both = |says: fn(&DepthEvidence) -> bool| of_frames.iter().all(|seen| seen.iter().any(says));
    let (near, far) = (any(|s| s.end == End::Near), any(|s| s.end == End::Far));
    let passing = any(|s| s.passes);
    let log_odds = seen.iter().map(|s| s.log_odds).sum();
    if log_odds < DepthSettings::DEFAULT.least_log_odds {
        return None;
    }
    let deep = match (near, far) {
        (true, false) if !passing && in_both(|s| s.end == End::Near) => false,
        (false, true) if passing && in_both(|s| s.passes || s.end == End::Far) => true,
        _ => return None,
    };
    let at_end = || seen.iter().filter(|s| s.end != End::Beyond);
    let weight: f64 = at_end().map(|s| s.sigma_mm.powi(-2)).sum();
    let depth_mm = at_end().map(|s| s.depth_mm * s.sigma_mm.powi(-2)).sum::<f64>() / weight;
    let settled = DepthEstimate {
        depth: Estimate::new(depth_mm, weight.sqrt().recip()),
        log_odds,
        stripes: seen.len(),
    };
    Some((if deep { 1 - nearer } else { nearer }, settled))
}

/// The two depths between which is to be told, mm.
#[derive(Clone, Copy, Debug)]
struct Depths {
    near_mm: f64,
    far_mm: f64,
}

/// Where a stripe ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum End {
    Near,
    Far,
    /// Somewhere behind the nearer depth.
    Beyond,
}

/// What one stripe on a neighbouring face says.
#[derive(Clone, Copy, Debug)]
struct DepthEvidence {
    end: End,
    /// It goes through the nearer depth without a gap.
    passes: bool,
    depth_mm: f64,
    sigma_mm: f64,
    log_odds: f64,
}

/// What the stripes beside one face say; those that say nothing are left out.
fn stripes_beside(
    calibration: &Calibration,
    frame: &Frame,
    face: &FaceMeasurement,
    depths: &Depths,
) -> Vec<DepthEvidence> {
    // How the stripes look on the face itself.
    let on_face = LaserId::ALL.map(|id| {
        let line = StripeLine::new(calibration, id, &face.plane);
        let [p, q] = face.key_points_px[id.index()];
        let (first, last) = if line.scan.along(p) <= line.scan.along(q) { (p, q) } else { (q, p) };
        (line, line.scan.along(first)..line.scan.along(last), first)
    });
    let projections = measure_projections(frame, calibration, &on_face);
    let Some(foot_px) = measure_half_width_px(frame, calibration, &on_face, &projections) else {
        return Vec::new();
    };
    let DepthSettings { follow_depths, follow_ends, end_mm, .. } = DepthSettings::DEFAULT;
    let most_mm = follow_depths * depths.far_mm + follow_ends * end_mm;
    let mut all = Vec::new();
    for side in 0..4 {
        for id in LaserId::ALL {
            let paper = FramedStripe { calibration, frame, projection: projections[id.index()], foot_px };
            let stripe_path = StripePath::new(&paper, face, side, id, most_mm);
            all.extend(stripe_path.and_then(|stripe_path| look(&stripe_path, &paper, depths)));
        }
    }
    all
}

/// What one trail shows, if anything.
fn look(stripe_path: &StripePath, paper: &FramedStripe, depths: &Depths) -> Option<DepthEvidence> {
    let Depths { near_mm, far_mm } = *depths;
    let settings = &DepthSettings::DEFAULT;
    let lit = stripe_path.brightest(paper, near_mm)?;
    // The largest of so many normal values is larger than this once in 1 / `false_alarm` times.
    let needed = (2.0 * (lit.tried as f64 / settings.false_alarm).ln()).sqrt();
    if lit.significance < needed {
        return None;
    }
    let places = &lit.places;
    let usual = lit.usual;
    // It begins at the edge.
    let of_first = |p: &&PathSample| p.depth_mm < settings.begins_within * near_mm;
    if mean(places.iter().filter(of_first).map(|p| p.strength))? < settings.begins_with * usual {
        return None;
    }
    // Logarithm of the odds that it goes on at least to each place.
    let mut sum = 0.0;
    let odds: Vec<f64> = places
        .iter()
        .map(|p| {
            let gain = usual * p.strength - 0.5 * usual * usual;
            sum += gain.clamp(settings.unseen_log_odds, settings.false_log_odds)
                / settings.places_per_independent;
            sum
        })
        .collect();
    let end = (0..odds.len()).max_by(|a, b| odds[*a].total_cmp(&odds[*b]))?;
    let (depth_mm, step_mm) = (places[end].depth_mm, places[end].step_mm);
    let (most, last) = (odds[end], odds.len() - 1);
    let odds_at = |depth_mm: f64| odds[places.partition_point(|p| p.depth_mm <= depth_mm).min(last)];
    let slack_mm =
        |depth_mm: f64| settings.end_mm + settings.end_share * depth_mm + settings.end_places * step_mm;
    let latest_mm = |depth_mm: f64| depth_mm + slack_mm(depth_mm) + stripe_path.late_mm(depth_mm);
    let from_far_mm = far_mm - slack_mm(far_mm);
    // A face that goes on straight must be told from this one, and the depths from each other.
    if stripe_path.late_mm(0.0) > settings.most_late * near_mm || near_mm + slack_mm(near_mm) > from_far_mm {
        return None;
    }
    let near = near_mm - slack_mm(near_mm)..latest_mm(near_mm).min(from_far_mm);
    let far = from_far_mm.max(latest_mm(near_mm))..latest_mm(far_mm);
    let end_seen = most - odds[last] >= settings.end_seen_log_odds;
    // Of this end against the other one.
    let (end, log_odds) = if near.contains(&depth_mm) && end_seen {
        (End::Near, most - odds_at(far_mm - settings.end_mm - settings.end_share * far_mm))
    } else if depth_mm >= latest_mm(near_mm) {
        // Equal boxes in a row would end at the farther depth as well.
        let rows = far_mm / near_mm;
        let in_a_row = (rows - rows.round()).abs() * near_mm <= settings.in_a_row * slack_mm(far_mm);
        let at_far = far.contains(&depth_mm) && end_seen && !in_a_row;
        (if at_far { End::Far } else { End::Beyond }, most - odds_at(latest_mm(near_mm)))
    } else {
        return None;
    };
    let seam_mm = near_mm - slack_mm(near_mm)..near_mm + slack_mm(near_mm);
    let passes = end != End::Near && passes(places, &seam_mm);
    let sigma_mm = slack_mm(depth_mm) / settings.slack_sigmas;
    let tells = log_odds >= settings.least_of_one && (passes || end != End::Beyond);
    tells.then_some(DepthEvidence { end, passes, depth_mm, sigma_mm, log_odds })
}

/// Whether the stripe goes through this range of depths without a gap, such as the seam between two flush boxes is.
fn passes(places: &[PathSample], range: &Range<f64>) -> bool {
    let DepthSettings { least_light, around, .. } = DepthSettings::DEFAULT;
    let mid = 0.5 * (range.start + range.end);
    let around = around * (range.end - mid);
    let lights =
        |reach_mm: f64| places.iter().filter(move |p| (p.depth_mm - mid).abs() <= reach_mm).map(|p| p.light);
    let Some(usual) = median(lights(around)) else { return false };
    lights(range.end - mid).all(|light| light > least_light * usual)
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0), |(s, n), v| (s + v, n + 1));
    (count > 0).then(|| sum / f64::from(count))
}
