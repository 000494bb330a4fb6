//! A frame made small for a network: every pixel is the mean of the area it covers, as in the frames networks are trained on.

use super::Frame;
use crate::units::Px;

/// Columns and rows of the picture that networks see of a frame.
pub const SMALL: [usize; 2] = [512, 384];

/// Pixels that one input pixel covers along one axis: `first..=last`, the outer two in part.
#[derive(Clone, Copy)]
struct Span {
    first: usize,
    last: usize,
    /// Shares of `first` and `last` that are covered, px. If both are the same pixel, `last_share` is 0.
    first_share: f32,
    last_share: f32,
}

impl Span {
    /// The span of pixel `i` of `n` laid over `total` pixels. In units of 1/n px all bounds are integers, hence exact.
    fn new(i: usize, n: usize, total: usize) -> Self {
        let (start, end) = (i * total, (i + 1) * total);
        let (first, last) = (start / n, (end - 1) / n);
        let share = |units: usize| units as f32 / n as f32;
        let first_share = share(end.min((first + 1) * n) - start);
        Self { first, last, first_share, last_share: if last > first { share(end - last * n) } else { 0.0 } }
    }
}

/// Averages areas; keeps its buffers from frame to frame.
pub struct Downscaler {
    size: [usize; 2],
    columns: Vec<Span>,
    /// The frame width that `columns` is for.
    frame_width_px: usize,
    /// Sums of whole rows. 255 x 16384 px (the largest frame) / 384 rows fits easily.
    whole_rows: Vec<u16>,
    /// The same with the rows that are covered in part.
    line: Vec<f32>,
}

impl Downscaler {
    /// For an input of `size` = columns, rows.
    #[must_use]
    pub fn new(size: [usize; 2]) -> Self {
        Self { size, columns: Vec::new(), frame_width_px: 0, whole_rows: Vec::new(), line: Vec::new() }
    }

    /// Writes the frame to `out` as red, green and blue planes in 0..1, rows top to bottom. The whole frame is stretched to the
    /// whole input, whatever its shape.
    pub fn run(&mut self, frame: &Frame, out: &mut [f32]) {
        let [width, height] = self.size;
        let row_bytes = frame.width_px() * 3;
        if self.frame_width_px != frame.width_px() {
            self.frame_width_px = frame.width_px();
            self.columns = (0..width).map(|x| Span::new(x, width, frame.width_px())).collect();
            self.whole_rows = vec![0; row_bytes];
            self.line = vec![0.0; row_bytes];
        }
        let plane = width * height;
        let area_px = frame.width_px() as f32 / width as f32 * (frame.height_px() as f32 / height as f32);
        let scale = 1.0 / (255.0 * area_px);
        let (red, rest) = out.split_at_mut(plane);
        let (green, blue) = rest.split_at_mut(plane);
        for y in 0..height {
            self.add_rows(frame.rgb(), row_bytes, Span::new(y, height, frame.height_px()));
            let row = y * width..(y + 1) * width;
            let outputs = red[row.clone()].iter_mut().zip(&mut green[row.clone()]).zip(&mut blue[row]);
            for (((r, g), b), span) in outputs.zip(&self.columns) {
                let at = |x: usize| -> &[f32] { &self.line[3 * x..3 * x + 3] };
                let (first, last) = (at(span.first), at(span.last));
                let mut sum = [0, 1, 2].map(|c| first[c] * span.first_share + last[c] * span.last_share);
                for px in
                    self.line[3 * span.first + 3..(3 * span.last).max(3 * span.first + 3)].chunks_exact(3)
                {
                    for (s, v) in sum.iter_mut().zip(px) {
                        *s += v;
                    }
                }
                [*r, *g, *b] = sum.map(|s| s * scale);
            }
        }
    }

    /// Adds the rows of a span into `line`.
    fn add_rows(&mut self, rgb: &[u8], row_bytes: usize, span: Span) {
        let row = |y: usize| &rgb[y * row_bytes..][..row_bytes];
        self.whole_rows.fill(0);
        for y in span.first + 1..span.last {
            // Wrapping only for speed: checked additions are not vectorised, and these cannot overflow.
            self.whole_rows.iter_mut().zip(row(y)).for_each(|(s, v)| *s = s.wrapping_add(u16::from(*v)));
        }
        let parts = row(span.first).iter().zip(row(span.last));
        for ((sum, whole), (first, last)) in self.line.iter_mut().zip(&self.whole_rows).zip(parts) {
            *sum =
                f32::from(*whole) + f32::from(*first) * span.first_share + f32::from(*last) * span.last_share;
        }
    }
}

/// A picture made small: red, green and blue planes (0 to 1), rows top to bottom, that cover the whole sensor.
#[derive(Clone, Copy, Debug)]
pub struct SmallPicture<'a> {
    /// Columns and rows.
    pub size: [usize; 2],
    /// One plane after the other.
    pub rgb: &'a [f32],
}

impl SmallPicture<'_> {
    /// Bilinear; `None` outside.
    pub(crate) fn at(&self, sensor: [f64; 2], px: Px) -> Option<[f32; 3]> {
        let [width, height] = self.size;
        let x = (px.u + 0.5) * width as f64 / sensor[0] - 0.5;
        let y = (px.v + 0.5) * height as f64 / sensor[1] - 0.5;
        if !(x > -0.5 && y > -0.5 && x < width as f64 - 0.5 && y < height as f64 - 0.5) {
            return None;
        }
        let (x, y) = (x.clamp(0.0, (width - 1) as f64), y.clamp(0.0, (height - 1) as f64));
        let (left, upper) = (x as usize, y as usize);
        let (right, lower) = ((left + 1).min(width - 1), (upper + 1).min(height - 1));
        let (fx, fy) = ((x - left as f64) as f32, (y - upper as f64) as f32);
        let plane = width * height;
        Some([0, 1, 2].map(|c| {
            let value = |x: usize, y: usize| self.rgb[c * plane + y * width + x];
            let above = value(left, upper) * (1.0 - fx) + value(right, upper) * fx;
            let below = value(left, lower) * (1.0 - fx) + value(right, lower) * fx;
            above * (1.0 - fy) + below * fy
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The same by definition, in f64: every frame pixel weighted with its overlap.
    fn by_definition(frame: &Frame, [width, height]: [usize; 2], c: usize, x: usize, y: usize) -> f64 {
        let overlap = |i: usize, n: usize, j: usize, total: usize| {
            let (a, b) = (i as f64 * total as f64 / n as f64, (i + 1) as f64 * total as f64 / n as f64);
            (b.min((j + 1) as f64) - a.max(j as f64)).max(0.0)
        };
        let (mut sum, mut area) = (0.0, 0.0);
        for v in 0..frame.height_px() {
            for u in 0..frame.width_px() {
                let w = overlap(x, width, u, frame.width_px()) * overlap(y, height, v, frame.height_px());
                sum += w * f64::from(frame.rgb()[(v * frame.width_px() + u) * 3 + c]) / 255.0;
                area += w;
            }
        }
        sum / area
    }

    #[test]
    fn every_value_is_the_mean_of_its_area() {
        let size = [16, 12];
        let mut downscaler = Downscaler::new(size);
        let mut out = vec![0.0; 3 * 16 * 12];
        for (w, h) in [(1, 1), (7, 5), (16, 12), (17, 13), (48, 36), (81, 61), (81, 9), (5, 100)] {
            let rgb = (0..w * h * 3).map(|i| (i * 7919 % 251) as u8).collect();
            let frame = Frame::from_rgb(w, h, rgb).expect("the sizes fit");
            downscaler.run(&frame, &mut out);
            for c in 0..3 {
                for y in 0..12 {
                    for x in 0..16 {
                        let (found, due) = (out[(c * 12 + y) * 16 + x], by_definition(&frame, size, c, x, y));
                        assert!(
                            (f64::from(found) - due).abs() < 2e-6,
                            "{w}x{h} at {c} {x} {y}: {found} {due}"
                        );
                    }
                }
            }
        }
    }
}
