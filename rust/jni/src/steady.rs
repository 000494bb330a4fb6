//! Whether the head is held still enough for a sharp picture, from where the corners of the face were in the last frames.

use boxline::Px;
use std::time::{Duration, Instant};

/// Speed of a corner in the picture, px/s. The head exposes for up to 10 ms: at this speed an edge smears over half a
/// pixel, which the model of an edge's blur still covers.
const MOST_PX_PER_S: f64 = 50.0;
/// For how long it must be so: a hand that turns round at the end of a swing is slow for less (about 4 swings a second).
const HOLD: Duration = Duration::from_millis(300);

/// What was seen so far.
#[derive(Debug, Default)]
pub(crate) struct Steadiness {
    last: Option<([Px; 4], Instant)>,
    still_since: Option<Instant>,
}

impl Steadiness {
    /// Takes the corners of the next view, seen at `at`, if there is a face; says whether the head is still.
    pub fn next(&mut self, corners_px: Option<[Px; 4]>, at: Instant) -> bool {
        let Some(now) = corners_px else {
            *self = Self::default();
            return false;
        };
        let before = self.last.replace((now, at));
        let slow = before.is_some_and(|(corners, then)| {
            let seconds = at.saturating_duration_since(then).as_secs_f64();
            largest_shift_px(corners, now) <= MOST_PX_PER_S * seconds
        });
        if slow {
            let since = *self.still_since.get_or_insert(before.map_or(at, |(_, then)| then));
            at.saturating_duration_since(since) >= HOLD
        } else {
            self.still_since = None;
            false
        }
    }
}

/// How far the corner went that went farthest; corners may start anywhere and go round either way.
fn largest_shift_px(before: [Px; 4], now: [Px; 4]) -> f64 {
    let shift =
        |i: usize, j: usize| ((before[i].u - now[j].u).powi(2) + (before[i].v - now[j].v).powi(2)).sqrt();
    let orders = (0..4).flat_map(|start| [true, false].map(|forward| (start, forward)));
    orders
        .map(|(start, forward)| {
            let at = |i: usize| if forward { (start + i) % 4 } else { (start + 4 - i) % 4 };
            (0..4).map(|i| shift(i, at(i))).fold(0.0, f64::max)
        })
        .fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn face(shift_px: f64, turned: usize) -> Option<[Px; 4]> {
        let square = [(0.0, 0.0), (900.0, 0.0), (900.0, 500.0), (0.0, 500.0)];
        let mut corners_px = square.map(|(u, v)| Px::new(u + shift_px, v));
        corners_px.rotate_left(turned);
        Some(corners_px)
    }

    /// Answers to views 100 ms apart.
    fn answers(views: &[Option<[Px; 4]>]) -> Vec<bool> {
        let mut steadiness = Steadiness::default();
        let start = Instant::now();
        let at = |i: usize| start + Duration::from_millis(100) * u32::try_from(i).expect("few");
        views.iter().enumerate().map(|(i, view)| steadiness.next(*view, at(i))).collect()
    }

    #[test]
    fn still_for_long_enough_is_steady_whatever_the_order_of_corners() {
        let views: Vec<_> =
            (0..6).map(|i| face(2.0 * f64::from(i), usize::try_from(i % 4).expect("small"))).collect();
        assert_eq!(answers(&views), [false, false, false, true, true, true]);
    }

    #[test]
    fn a_swing_or_a_refusal_starts_the_wait_anew() {
        let moving: Vec<_> = (0..6).map(|i| face(6.0 * f64::from(i), 0)).collect();
        assert_eq!(answers(&moving), [false; 6]);
        let mut views: Vec<_> = (0..8).map(|_| face(0.0, 0)).collect();
        views[4] = None;
        assert_eq!(answers(&views), [false, false, false, true, false, false, false, false]);
    }
}
