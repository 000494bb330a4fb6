//! What the network of sides sees, a face in its own plane ([`FaceView`]), and what it says of it ([`SideOdds`]): for each of the four sides
//! where it is, and whether something hides a piece of it. Which places the bins are, [`crate::sides`] knows.

/// Cells from the outermost crossing to the border, for each of the four sides: the places where the side may be.
pub const BINS: usize = 112;
/// Cells between the crossings, along each axis.
pub const INNER: usize = 32;
/// Columns and rows.
pub const CELLS: usize = 2 * BINS + INNER;
/// Channels, rows and columns of a view: red, green, blue (0 to 1); where stripes 1 and 2 lie on the plane (1) and would lie on a
/// surface a little nearer (a half); the same of stripes 3 and 4. All 0 outside the picture.
pub const VIEW: [usize; 3] = [5, CELLS, CELLS];

/// A face in its own plane.
#[derive(Clone, Debug, PartialEq)]
pub struct FaceView {
    /// As [`VIEW`].
    pub values: Vec<f32>,
}

/// A face turned by 180 degrees, or mirrored so that its rows are its columns, is a face: the network is asked in all four ways. Their
/// errors are not the same, so that together they err less ([`SideOdds::of_orientations`]).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Orientation {
    /// Rows and columns the other way round.
    pub reversed: bool,
    /// Rows are columns, after that.
    pub transposed: bool,
}

impl Orientation {
    /// All four; the first is the view as it is.
    pub const ALL: [Self; 4] = [
        Self { reversed: false, transposed: false },
        Self { reversed: true, transposed: true },
        Self { reversed: true, transposed: false },
        Self { reversed: false, transposed: true },
    ];

    /// Which side of the view as it is becomes side `side`, and the other way round.
    const fn side(self, side: usize) -> usize {
        let side = if self.transposed { (side + 2) % 4 } else { side };
        if self.reversed { side ^ 1 } else { side }
    }
}

impl FaceView {
    /// The view in another way; stripes 1 and 2 are then stripes 3 and 4 if it is transposed.
    #[must_use]
    pub fn turned(&self, orientation: Orientation) -> Self {
        let plane = CELLS * CELLS;
        let mut values = Vec::with_capacity(self.values.len());
        for channel in 0..VIEW[0] {
            let from = match channel {
                3 | 4 if orientation.transposed => 7 - channel,
                _ => channel,
            };
            let cells = &self.values[from * plane..(from + 1) * plane];
            let at = |row: usize, column: usize| {
                let (row, column) = if orientation.transposed { (column, row) } else { (row, column) };
                let index = row * CELLS + column;
                cells[if orientation.reversed { plane - 1 - index } else { index }]
            };
            values.extend((0..plane).map(|index| at(index / CELLS, index % CELLS)));
        }
        Self { values }
    }
}

/// Numbers of one side as the network gives them: logits of the places, of "not in view", and of "hidden".
const LOGITS: usize = BINS + 2;
/// Numbers that the network gives: sides one after the other.
pub const OUTPUTS: usize = 4 * LOGITS;
/// Two places of a side nearer than this are the same, bins: 1 to 2 % of the face. What lies closer is told apart in the frame itself.
const SAME_BINS: f64 = 2.0;

/// Probabilities of one side.
#[derive(Clone, Debug, PartialEq)]
struct Side {
    /// Of each place; with that of "not in view" they add up to 1.
    places: Vec<f64>,
    hidden: f64,
}

impl Side {
    fn not_in_view(&self) -> f64 {
        1.0 - self.places.iter().sum::<f64>()
    }
}

/// Probabilities of all four sides: low and high along the rows, low and high along the columns.
#[derive(Clone, Debug, PartialEq)]
pub struct SideOdds {
    sides: Vec<Side>,
}

impl SideOdds {
    /// From what the network gives. `None` if that is not [`OUTPUTS`] finite numbers.
    #[must_use]
    pub fn from_logits(logits: &[f32]) -> Option<Self> {
        if logits.len() != OUTPUTS || logits.iter().any(|v| !v.is_finite()) {
            return None;
        }
        let side = |logits: &[f32]| {
            let (places, hidden) = (&logits[..=BINS], f64::from(logits[BINS + 1]));
            let most = places.iter().copied().fold(f32::NEG_INFINITY, f32::max);
            let mut places: Vec<f64> = places.iter().map(|v| f64::from(v - most).exp()).collect();
            let total: f64 = places.iter().sum();
            places.iter_mut().for_each(|p| *p /= total);
            places.truncate(BINS);
            Side { places, hidden: 1.0 / (1.0 + (-hidden).exp()) }
        };
        Some(Self { sides: logits.chunks_exact(LOGITS).map(side).collect() })
    }

    /// Of one view asked in several ways, turned back: the geometric means of probabilities and of odds. `None` without any.
    #[must_use]
    pub fn of_orientations(answers: &[(Orientation, Self)]) -> Option<Self> {
        if answers.is_empty() {
            return None;
        }
        let share = 1.0 / answers.len() as f64;
        // Far from one, so that no way can rule a place out alone.
        let log = |p: f64| share * p.max(1e-9).ln();
        let side = |side: usize| {
            let all = answers.iter().map(|(orientation, odds)| &odds.sides[orientation.side(side)]);
            let mean = |of: &dyn Fn(&Side) -> f64| all.clone().map(|s| log(of(s))).sum::<f64>().exp();
            let mut places: Vec<f64> = (0..BINS).map(|bin| mean(&|s| s.places[bin])).collect();
            let total = places.iter().sum::<f64>() + mean(&Side::not_in_view);
            places.iter_mut().for_each(|p| *p /= total);
            let (hidden, free) = (mean(&|s| s.hidden), mean(&|s| 1.0 - s.hidden));
            Side { places, hidden: hidden / (hidden + free) }
        };
        Some(Self { sides: (0..4).map(side).collect() })
    }

    /// Probability that a side is at a place, a bin and its fraction, to within two bins.
    #[must_use]
    pub fn at(&self, side: usize, middle: f64) -> f64 {
        let share = |bin: usize| {
            // Of a bin that the window covers in part.
            let (from, to) = (bin as f64, bin as f64 + 1.0);
            (to.min(middle + SAME_BINS) - from.max(middle - SAME_BINS)).clamp(0.0, 1.0)
        };
        self.sides[side].places.iter().enumerate().map(|(bin, p)| p * share(bin)).sum()
    }

    /// Places of a side that have at least a probability, to within two bins each; likeliest first, farther apart than that.
    #[must_use]
    pub fn likely(&self, side: usize, least: f64) -> Vec<f64> {
        let mut places: Vec<(f64, f64)> = (0..BINS)
            .map(|bin| bin as f64 + 0.5)
            .map(|middle| (middle, self.at(side, middle)))
            .filter(|(_, probability)| *probability >= least)
            .collect();
        places.sort_by(|a, b| b.1.total_cmp(&a.1));
        let mut found: Vec<f64> = Vec::new();
        for (middle, _) in places {
            if found.iter().all(|known| (known - middle).abs() > 2.0 * SAME_BINS) {
                found.push(middle);
            }
        }
        found
    }

    /// Probability that a side is not in the picture.
    #[must_use]
    pub fn not_in_view(&self, side: usize) -> f64 {
        self.sides[side].not_in_view()
    }

    /// Probability that something in front of the face hides a piece of a side, its corners or a stripe's end there.
    #[must_use]
    pub fn hidden(&self, side: usize) -> f64 {
        self.sides[side].hidden
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The brightest of the first cells beyond each side's border, as a stand-in for the network.
    fn told_by_borders(view: &FaceView) -> SideOdds {
        let of = |row: usize, column: usize| view.values[row * CELLS + column];
        let mut logits = vec![0.0; OUTPUTS];
        for (side, value) in
            [of(CELLS / 2, 0), of(CELLS / 2 - 1, CELLS - 1), of(0, CELLS / 2), of(CELLS - 1, CELLS / 2 - 1)]
                .into_iter()
                .enumerate()
        {
            logits[side * LOGITS + value as usize] = 8.0;
            logits[side * LOGITS + BINS + 1] = value - 3.0;
        }
        SideOdds::from_logits(&logits).expect("finite")
    }

    #[test]
    fn each_likely_place_is_told_once_the_likeliest_first() {
        let mut logits = vec![0.0; OUTPUTS];
        // Two neighbouring bins share one place, another is less likely, a third is not likely enough.
        for (bin, logit) in [(20, 9.0), (21, 9.0), (60, 8.0), (90, 5.0)] {
            logits[LOGITS + bin] = logit;
        }
        let odds = SideOdds::from_logits(&logits).expect("finite");
        let likely = odds.likely(1, 0.03);
        assert_eq!(likely.len(), 2, "{likely:?}");
        assert!((likely[0] - 21.0).abs() <= SAME_BINS && (likely[1] - 60.5).abs() <= SAME_BINS, "{likely:?}");
        assert_eq!(odds.likely(1, 0.001).len(), 3);
        assert!(odds.at(1, likely[0]) > odds.at(1, likely[1]));
    }

    #[test]
    fn a_view_asked_in_all_ways_is_turned_back() {
        let mut view = FaceView { values: vec![0.0; VIEW.iter().product()] };
        let (middle, last) = (CELLS / 2, CELLS - 1);
        for (low, high, value) in
            [([middle, 0], [middle - 1, last], 10.0), ([0, middle], [last, middle - 1], 30.0)]
        {
            view.values[low[0] * CELLS + low[1]] = value;
            view.values[high[0] * CELLS + high[1]] = value + 10.0;
        }
        view.values[3 * CELLS * CELLS + 7] = 1.0;
        let answers =
            Orientation::ALL.map(|orientation| (orientation, told_by_borders(&view.turned(orientation))));
        let all = SideOdds::of_orientations(&answers).expect("four orientations");
        for (side, place) in [10, 20, 30, 40].into_iter().enumerate() {
            assert!(all.sides[side].places[place] > 0.9, "{side}");
            let (one, together) = (answers[0].1.hidden(side), all.hidden(side));
            assert!((one - together).abs() < 1e-6, "{one} {together}");
        }
        for orientation in Orientation::ALL {
            // Twice the same way is the view again, and what only stripes 1 and 2 have is theirs.
            assert_eq!(view.turned(orientation).turned(orientation), view);
            let of_pair = |pair: usize| {
                view.turned(orientation).values[(3 + pair) * CELLS * CELLS..][..CELLS * CELLS]
                    .iter()
                    .sum::<f32>()
            };
            assert_eq!(of_pair(usize::from(orientation.transposed)), 1.0);
        }
        assert_eq!(SideOdds::of_orientations(&[]), None);
    }

    #[test]
    fn probabilities_add_up_and_broken_numbers_are_refused() {
        let mut logits = vec![0.0; OUTPUTS];
        logits[LOGITS + 40] = 12.0; // low side of the first axis' other end
        let odds = SideOdds::from_logits(&logits).expect("finite");
        for side in &odds.sides {
            assert!(side.places.iter().sum::<f64>() < 1.0 && (side.hidden - 0.5).abs() < 1e-9);
        }
        assert!(odds.sides[1].places[40] > 0.99);
        assert!(SideOdds::from_logits(&logits[1..]).is_none());
        logits[3] = f32::NAN;
        assert!(SideOdds::from_logits(&logits).is_none());
    }
}
