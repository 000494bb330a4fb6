//! Adds up a map along a curve of the image: the innermost loop of the search for the stripes' grid, in whole numbers.

use crate::image::laser_response::Layout;

/// Places along the parabola through three pixels.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Curve {
    /// First place, px.
    from: [f32; 2],
    /// To the second place, and what every further step is longer, px.
    step: [f32; 2],
    longer: [f32; 2],
    /// Steps; places are one more.
    pub steps: u32,
}

/// Fewest steps along a curve.
const LEAST_STEPS: u32 = 8;
/// Most: every pixel across the largest image.
const MOST_STEPS: f32 = 20_000.0;
/// Bits of a place's fraction. After a thousand steps a rounded second difference is off by a hundred-millionth of a pixel.
const FRACTION: u32 = 40;

/// Steps of at most `every_px` along a length.
pub(crate) fn steps_for(length_px: f32, every_px: f32) -> u32 {
    let wanted = (length_px / every_px).min(MOST_STEPS);
    let whole = wanted as u32;
    (whole + u32::from(wanted > whole as f32)).max(LEAST_STEPS)
}

impl Curve {
    /// Through `a`, `middle` and `b` at even steps of at most `every_px` (for a straight curve).
    pub fn new(a: [f32; 2], middle: [f32; 2], b: [f32; 2], every_px: f32) -> Self {
        let chord = [b[0] - a[0], b[1] - a[1]];
        let steps = steps_for((chord[0] * chord[0] + chord[1] * chord[1]).sqrt(), every_px);
        // x(t) = a + chord t + 4 bend t (1 - t), its first and second differences.
        let h = 1.0 / steps as f32;
        let bend = [0, 1].map(|i| middle[i] - 0.5 * (a[i] + b[i]));
        let step = [0, 1].map(|i| (chord[i] + 4.0 * bend[i] * (1.0 - h)) * h);
        Self { from: a, step, longer: bend.map(|x| -8.0 * x * h * h), steps }
    }

    /// Sum of a map of `size`; nothing outside of it.
    pub fn sum(&self, map: &[i8], [width, height]: [usize; 2], layout: &Layout) -> i32 {
        let fixed = |place: f32| (f64::from(place) * (1u64 << FRACTION) as f64) as i64;
        let [mut x, mut y] = layout.place(self.from).map(fixed);
        let [mut dx, mut dy] = layout.way(self.step).map(fixed);
        let [ddx, ddy] = layout.way(self.longer).map(fixed);
        let lean = i64::from(layout.lean);
        let mut sum = 0;
        for _ in 0..=self.steps {
            let row = y >> FRACTION;
            // A negative place is a huge one.
            let (i, j) = ((x >> FRACTION).wrapping_add(row.wrapping_mul(lean)) as usize, row as usize);
            if i < width && j < height {
                sum += map.get(j * width + i).copied().map_or(0, i32::from);
            }
            // What has left every image may wrap.
            (x, y) = (x.wrapping_add(dx), y.wrapping_add(dy));
            (dx, dy) = (dx.wrapping_add(ddx), dy.wrapping_add(ddy));
        }
        sum
    }
}

impl Layout {
    /// Column and row of a pixel, without the row's lean. The image begins half a pixel before the centre of its first one.
    fn place(&self, px: [f32; 2]) -> [f32; 2] {
        let [column, row] = self.way(px.map(|x| x + 0.5));
        [column + self.first, row]
    }

    /// Columns and rows that a way in the image goes.
    fn way(&self, [du, dv]: [f32; 2]) -> [f32; 2] {
        [self.columns[0] * du + self.columns[1] * dv, self.rows * dv]
    }
}

/// Sums of a map, as [`Curve::sum`] has them, along straight lines from one place to each of many in `steps` even steps.
///
/// Line by line within each step, so that the places themselves are vector code.
pub(crate) fn fan_sums(
    map: &[i8],
    width: usize,
    layout: &Layout,
    from: [f32; 2],
    ends: &[[f32; 2]],
    steps: u32,
) -> Vec<i32> {
    // 1/65536 px: a line's end is missed by less than a thousandth.
    let fixed = |place: f32| (place * 65536.0) as i32;
    let [first_x, first_y] = layout.place(from).map(fixed);
    let way = |end: &[f32; 2]| layout.way([0, 1].map(|i| (end[i] - from[i]) / steps as f32)).map(fixed);
    let (dx, dy): (Vec<i32>, Vec<i32>) = ends.iter().map(|end| way(end).into()).unzip();
    let (mut x, mut y) = (vec![first_x; ends.len()], vec![first_y; ends.len()]);
    let mut sums = vec![0i32; ends.len()];
    // A row's lean makes it begin so much farther on.
    let stride = (width as i32).wrapping_add(layout.lean);
    for _ in 0..=steps {
        for ((sum, x), y) in sums.iter_mut().zip(&x).zip(&y) {
            let at = (y >> 16).wrapping_mul(stride).wrapping_add(x >> 16);
            *sum = sum.wrapping_add(map.get(at as usize).copied().map_or(0, i32::from));
        }
        for ((x, dx), (y, dy)) in x.iter_mut().zip(&dx).zip(y.iter_mut().zip(&dy)) {
            (*x, *y) = (x.wrapping_add(*dx), y.wrapping_add(*dy));
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;

    const HALF: Layout = Layout::even([0.5; 2], 9.0);
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn it_adds_what_lies_on_the_parabola(
            a in prop::array::uniform2(-50.0..250.0f32), b in prop::array::uniform2(-50.0..250.0f32),
            bend in prop::array::uniform2(-9.0..9.0f32), every_px in 2.0..40.0f32
        ) {
            // A map that tells where it was read: columns in one, rows in the other.
            let (width, height) = (100, 80);
            let columns: Vec<i8> = (0..width * height).map(|i| (i % width) as i8).collect();
            let rows: Vec<i8> = (0..width * height).map(|i| (i / width) as i8).collect();
            let middle = [0, 1].map(|i| 0.5 * (a[i] + b[i]) + bend[i]);
            let curve = Curve::new(a, middle, b, every_px);
            let length = (b[0] - a[0]).hypot(b[1] - a[1]);
            prop_assert!(curve.steps >= LEAST_STEPS);
            prop_assert!(curve.steps == LEAST_STEPS || (curve.steps as f32 - length / every_px - 0.5).abs() < 0.51);
            let (mut want, mut unsure) = ([0.0; 2], 0.0);
            for s in 0..=curve.steps {
                let t = s as f32 / curve.steps as f32;
                let at = [0, 1].map(|i| {
                    let px = a[i] + (b[i] - a[i]) * t + 4.0 * bend[i] * t * (1.0 - t);
                    (px + 0.5) * 0.5
                });
                let inside = at[0] >= 0.0 && at[1] >= 0.0 && at[0] < width as f32 && at[1] < height as f32;
                let edge = |x: f32| (x - x.round()).abs() < 1e-3;
                if inside {
                    want = [want[0] + at[0].floor(), want[1] + at[1].floor()];
                }
                if edge(at[0]) || edge(at[1]) {
                    unsure += width as f32; // rounding decides which pixel it is
                }
            }
            for (map, want) in [(&columns, want[0]), (&rows, want[1])] {
                let found = curve.sum(map, [width, height], &HALF) as f32;
                prop_assert!((found - want).abs() <= unsure, "{found} for {want}");
            }
        }
    }

    proptest! {
        #[test]
        fn a_fan_is_many_straight_curves(
            from in prop::array::uniform2(0.0..150.0f32),
            ends in prop::collection::vec(prop::array::uniform2(0.0..150.0f32), 0..20),
            steps in 8..40u32
        ) {
            // A slope, so that a neighbouring pixel differs by one.
            let map: Vec<i8> = (0..80 * 80).map(|i| (i % 80 + i / 80 - 80) as i8).collect();
            let sums = fan_sums(&map, 80, &HALF, from, &ends, steps);
            prop_assert_eq!(sums.len(), ends.len());
            for (end, found) in ends.iter().zip(sums) {
                let chord = [0, 1].map(|i| (end[i] - from[i]) / steps as f32);
                let want = Curve { from, step: chord, longer: [0.0; 2], steps }.sum(&map, [80, 80], &HALF);
                // Rounding decides which pixel a place on the border of two is in.
                let edge = |x: f32| i32::from((x - x.round()).abs() < 2e-3);
                let unsure: i32 = (0..=steps)
                    .map(|s| [0, 1].map(|i| edge((from[i] + chord[i] * s as f32 + 0.5) * 0.5)).iter().sum::<i32>())
                    .sum();
                prop_assert!((found - want).abs() <= unsure, "{} for {}, {} places unsure", found, want, unsure);
            }
        }
    }

    #[test]
    fn what_lies_outside_or_nowhere_adds_nothing() {
        let map = [1i8; 16];
        for far in [1e9, -1e9, f32::INFINITY, f32::NAN] {
            let curve = Curve::new([far, 0.0], [far, 1.0], [far, 2.0], 3.0);
            if far.is_finite() {
                assert_eq!(curve.sum(&map, [4, 4], &HALF), 0);
            } else {
                curve.sum(&map, [4, 4], &HALF); // no harm
            }
        }
    }
}
