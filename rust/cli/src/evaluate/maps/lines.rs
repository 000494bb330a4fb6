//! Precision, recall and F of lines in a map (the paper's eqs. 17-19). Both maps are thinned to ridges; a predicted ridge
//! pixel is right when a true one is among it and its eight neighbours (1.5 px of a 256 x 192 map, 3 px of the network's
//! 512 px input), and the other way round for recall. The same definitions as `rust/edgenet/training/metrics.py`.

/// Thresholds that are tried: 0.1, 0.15 .. 0.9.
pub const THRESHOLDS: usize = 17;

/// A true ridge pixel is one from here on.
const TRUE_FROM: f32 = 0.4;

/// The threshold of an index.
pub fn threshold(index: usize) -> f32 {
    0.05f32.mul_add(index as f32, 0.1)
}

/// One channel, rows top to bottom.
#[derive(Clone, Debug, PartialEq)]
pub struct Map {
    pub width: usize,
    pub height: usize,
    pub values: Vec<f32>,
}

impl Map {
    /// The larger value of several maps of the same size at every pixel.
    pub fn largest<'a>(width: usize, height: usize, maps: impl IntoIterator<Item = &'a [f32]>) -> Self {
        let mut values = vec![0f32; width * height];
        for map in maps {
            values.iter_mut().zip(map).for_each(|(v, m)| *v = v.max(*m));
        }
        Self { width, height, values }
    }

    fn with(&self, values: Vec<f32>) -> Self {
        Self { width: self.width, height: self.height, values }
    }

    /// The value at a pixel; the border's beyond it.
    fn at(&self, x: isize, y: isize) -> f32 {
        let inside = |v: isize, n: usize| v.clamp(0, n as isize - 1) as usize;
        self.values[inside(y, self.height) * self.width + inside(x, self.width)]
    }

    fn pixels(&self) -> impl Iterator<Item = (isize, isize)> + use<> {
        let (width, height) = (self.width as isize, self.height as isize);
        (0..height).flat_map(move |y| (0..width).map(move |x| (x, y)))
    }

    /// Smoothed with the outer product of 1 4 6 4 1.
    fn smoothed(&self) -> Self {
        const KERNEL: [f32; 5] = [1.0 / 16.0, 4.0 / 16.0, 6.0 / 16.0, 4.0 / 16.0, 1.0 / 16.0];
        let one_way = |map: &Self, dx: isize, dy: isize| {
            let sum = |(x, y)| (-2..=2).zip(KERNEL).map(|(i, k)| k * map.at(x + i * dx, y + i * dy)).sum();
            map.with(map.pixels().map(sum).collect())
        };
        one_way(&one_way(self, 1, 0), 0, 1)
    }

    /// The map where it is a ridge, else 0: not below its neighbours across the direction of least curvature.
    pub fn thinned(&self) -> Self {
        const ACROSS: [(isize, isize); 4] = [(1, 0), (1, 1), (0, 1), (-1, 1)];
        let smooth = self.smoothed();
        let keep = |((x, y), value): ((isize, isize), &f32)| {
            // Below this a ridge is of no interest: no threshold reaches it, and the smoothing costs time.
            if *value < threshold(0) * 0.5 {
                return 0.0;
            }
            let here = smooth.at(x, y);
            let sides = ACROSS.map(|(dx, dy)| (smooth.at(x + dx, y + dy), smooth.at(x - dx, y - dy)));
            let mut second = sides.map(|(a, b)| a + b - 2.0 * here);
            second[1] *= 0.5; // diagonal neighbours are further away
            second[3] *= 0.5;
            let most = second.into_iter().fold(f32::INFINITY, f32::min);
            let is_ridge =
                most < 0.0 && second.iter().zip(sides).any(|(s, (a, b))| *s == most && here > a && here >= b);
            if is_ridge { *value } else { 0.0 }
        };
        self.with(self.pixels().zip(&self.values).map(keep).collect())
    }

    /// Each pixel's largest value among itself and its eight neighbours.
    fn dilated(&self) -> Self {
        let largest = |map: &Self, dx: isize, dy: isize| {
            let of = |(x, y)| (-1..=1).map(|i| map.at(x + i * dx, y + i * dy)).fold(0.0, f32::max);
            map.with(map.pixels().map(of).collect())
        };
        largest(&largest(self, 1, 0), 0, 1)
    }
}

/// A prediction and its truth, thinned and dilated, so that they can be counted more than once.
pub struct Compared {
    predicted: Map,
    near_predicted: Map,
    is_true: Vec<bool>,
    near_true: Map,
}

impl Compared {
    pub fn new(predicted: &Map, truth: &Map) -> Self {
        let predicted = predicted.thinned();
        let is_true: Vec<bool> = truth.thinned().values.iter().map(|v| *v >= TRUE_FROM).collect();
        let near_true = truth.with(is_true.iter().map(|t| f32::from(u8::from(*t))).collect()).dilated();
        Self { near_predicted: predicted.dilated(), predicted, is_true, near_true }
    }
}

/// Right and wrong pixels of one kind of line at every threshold.
#[derive(Clone, Debug, Default)]
pub struct LineCounts {
    predicted: [u64; THRESHOLDS],
    right: [u64; THRESHOLDS],
    found: [u64; THRESHOLDS],
    truth: u64,
}

/// Precision, recall and F at one threshold.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineScore {
    pub f: f64,
    pub precision: f64,
    pub recall: f64,
    pub threshold_index: usize,
}

impl LineCounts {
    pub fn add(&mut self, compared: &Compared) {
        let reached = |value: f32| (0..THRESHOLDS).take_while(move |i| value >= threshold(*i));
        let Compared { predicted, near_predicted, is_true, near_true } = compared;
        for (i, value) in predicted.values.iter().enumerate() {
            for t in reached(*value) {
                self.predicted[t] += 1;
                self.right[t] += u64::from(near_true.values[i] > 0.0);
            }
            if is_true[i] {
                self.truth += 1;
                reached(near_predicted.values[i]).for_each(|t| self.found[t] += 1);
            }
        }
    }

    /// At a threshold that was chosen elsewhere.
    pub fn score_at(&self, threshold_index: usize) -> LineScore {
        let share = |part: u64, of: u64| part as f64 / of.max(1) as f64;
        let precision = share(self.right[threshold_index], self.predicted[threshold_index]);
        let recall = share(self.found[threshold_index], self.truth);
        let f = 2.0 * precision * recall / (precision + recall).max(1e-9);
        LineScore { f, precision, recall, threshold_index }
    }

    /// The threshold with the largest F; for choosing on validation frames.
    pub fn best_threshold(&self) -> usize {
        let f = |i: usize| self.score_at(i).f;
        (0..THRESHOLDS).fold(0, |best, i| if f(i) > f(best) { i } else { best })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A soft line, as in the tests of `metrics.py`.
    fn line(slope: f32, offset: f32) -> Map {
        let values = (0..192 * 256).map(|i| {
            let (x, y) = ((i % 256) as f32, (i / 256) as f32);
            let distance = (y - slope * x - offset) / (1.0 + slope * slope).sqrt();
            (-0.5 * (distance / 0.8).powi(2)).exp()
        });
        Map { width: 256, height: 192, values: values.collect() }
    }

    fn f_of(predicted: &Map, truth: &Map) -> f64 {
        let mut counts = LineCounts::default();
        counts.add(&Compared::new(predicted, truth));
        counts.score_at(counts.best_threshold()).f
    }

    #[test]
    fn a_line_is_right_within_one_and_a_half_pixels() {
        let truth = line(0.2, 60.0);
        assert!(f_of(&truth, &truth) > 0.999);
        assert!(f_of(&line(0.2, 61.0), &truth) > 0.97);
        assert!(f_of(&line(0.2, 64.0), &truth) < 0.03);
    }

    #[test]
    fn a_thinned_line_is_about_one_pixel_wide() {
        let thin = line(0.3, 60.0).thinned();
        for x in 0..256 {
            let count = (0..192).filter(|y| thin.values[y * 256 + x] > 0.3).count();
            assert!((1..=2).contains(&count), "{count} in column {x}");
        }
    }

    #[test]
    fn half_a_line_has_full_precision_and_half_the_recall() {
        let truth = line(0.2, 60.0);
        let mut half = truth.clone();
        (0..half.values.len()).filter(|i| i % 256 >= 128).for_each(|i| half.values[i] = 0.0);
        let mut counts = LineCounts::default();
        counts.add(&Compared::new(&half, &truth));
        let score = counts.score_at(4);
        assert!(score.precision > 0.98 && (score.recall - 0.5).abs() < 0.02, "{score:?}");
    }
}
