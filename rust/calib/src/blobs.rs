//! Dark elliptic blobs in a frame, at half resolution: candidates for the board's circles.
//!
//! A circle is an isolated dark component for every threshold between its own brightness and that of the white around it,
//! whatever the light elsewhere: so components are collected over many thresholds and those that stay put are kept. Laser
//! light hardly shows in the green channel, where this is done.

use boxline::image::Frame;
use nalgebra::{Matrix2, Vector2};
use std::collections::BTreeMap;

/// A blob in full-resolution px.
#[derive(Clone, Copy, Debug)]
pub(super) struct Blob {
    pub at: Vector2<f64>,
    /// Second moments of its area, px^2: a quarter of (semi-axis)^2 for an ellipse.
    pub moments: Matrix2<f64>,
}

impl Blob {
    /// Length of a vector in units of the ellipse's radius in that direction: circles of one plane near each other are
    /// then circles of radius 1.
    pub fn in_radii(&self, vector: Vector2<f64>) -> f64 {
        self.moments
            .try_inverse()
            .map_or(f64::INFINITY, |m| (0.25 * vector.dot(&(m * vector))).max(0.0).sqrt())
    }

    /// Mean radius, px.
    pub fn radius_px(&self) -> f64 {
        2.0 * self.moments.determinant().max(0.0).powf(0.25)
    }
}

/// Steps between thresholds, grey levels: below half the contrast of a circle in the dimmest frame that can be used.
const LEVEL_STEP: u8 = 8;
/// Smallest area, half-resolution px: 6 px across, less has no rim to speak of.
const MIN_AREA: f64 = 28.0;
/// Largest share of the frame that one circle may take.
const MAX_SHARE: f64 = 0.1;
/// Area over that of the ellipse with the same moments: 1 for an ellipse, 0.955 for a square; the rest is pixel noise.
const ELLIPTIC: std::ops::Range<f64> = 0.96..1.04;
/// Smallest ratio of the axes: a board tilted by 45 degrees at the edge of the field is seen at 70 degrees.
const MIN_AXES: f64 = 0.3;

#[derive(Clone, Copy, Default)]
struct Sums {
    n: f64,
    x: f64,
    y: f64,
    xx: f64,
    xy: f64,
    yy: f64,
    at_border: bool,
}

impl Sums {
    fn add(&mut self, o: &Self) {
        self.n += o.n;
        self.x += o.x;
        self.y += o.y;
        self.xx += o.xx;
        self.xy += o.xy;
        self.yy += o.yy;
        self.at_border |= o.at_border;
    }

    fn of_run(first: usize, end: usize, y: usize) -> Self {
        let (a, b, y) = (first as f64, end as f64 - 1.0, y as f64);
        let n = b - a + 1.0;
        let x = 0.5 * (a + b) * n;
        let square = |m: f64| m * (m + 1.0) * (2.0 * m + 1.0) / 6.0;
        let xx = square(b) - square(a - 1.0);
        Self { n, x, y: y * n, xx, xy: x * y, yy: y * y * n, at_border: false }
    }

    /// The blob in half-resolution px, if its shape is an ellipse's.
    fn blob(&self, max_area: f64) -> Option<Blob> {
        if self.at_border || self.n < MIN_AREA || self.n > max_area {
            return None;
        }
        let at = Vector2::new(self.x, self.y) / self.n;
        // A pixel is a square of side 1: its own second moment is 1/12.
        let moments = Matrix2::new(self.xx, self.xy, self.xy, self.yy) / self.n - at * at.transpose()
            + Matrix2::identity() / 12.0;
        let root = moments.determinant().max(0.0).sqrt();
        let elliptic = self.n / (4.0 * std::f64::consts::PI * root);
        let half = 0.5 * moments.trace();
        let apart = (half * half - root * root).max(0.0).sqrt();
        let axes = ((half - apart) / (half + apart)).max(0.0).sqrt();
        // The fewer the pixels of the rim, the rougher its area.
        let rough = 2.0 / self.n;
        let fits = elliptic > ELLIPTIC.start - rough && elliptic < ELLIPTIC.end + rough && axes > MIN_AXES;
        fits.then_some(Blob { at, moments })
    }
}

/// Mean of green over 2 x 2 pixels; width and height of the result.
fn half_green(frame: &Frame) -> (usize, usize, Vec<u8>) {
    let (w, h) = (frame.width_px() / 2, frame.height_px() / 2);
    let stride = frame.width_px() * 3;
    let mut out = vec![0; w * h];
    for (j, row) in out.chunks_exact_mut(w.max(1)).enumerate() {
        let top = &frame.rgb()[2 * j * stride..][..w * 6];
        let bottom = &frame.rgb()[(2 * j + 1) * stride..][..w * 6];
        for ((o, t), b) in row.iter_mut().zip(top.chunks_exact(6)).zip(bottom.chunks_exact(6)) {
            let sum = u16::from(t[1]) + u16::from(t[4]) + u16::from(b[1]) + u16::from(b[4]);
            *o = (sum / 4) as u8;
        }
    }
    (w, h, out)
}

/// Pixels of a row whose range is kept.
const BLOCK: usize = 32;

/// A picture with the range of every 32 pixels of a row, so that the search for where a row passes a level skips blocks
/// that lie wholly on one side: the same runs, found several times faster, at every level.
struct Levels {
    width: usize,
    green: Vec<u8>,
    /// Darkest and brightest of each block, row by row.
    blocks: Vec<(u8, u8)>,
}

impl Levels {
    fn new(width: usize, green: Vec<u8>) -> Self {
        let range = |block: &[u8]| block.iter().fold((u8::MAX, 0), |(l, h), g| (l.min(*g), h.max(*g)));
        let blocks = green.chunks_exact(width).flat_map(|row| row.chunks(BLOCK).map(range)).collect();
        Self { width, green, blocks }
    }

    /// The first pixel of a row, from `x` on, that is darker than `level`, or, with `dark` false, that is not.
    fn find(&self, y: usize, mut x: usize, level: u8, dark: bool) -> Option<usize> {
        let row = &self.green[y * self.width..][..self.width];
        let in_row = self.width.div_ceil(BLOCK);
        let blocks = &self.blocks[y * in_row..][..in_row];
        while x < self.width {
            let (darkest, brightest) = blocks[x / BLOCK];
            let end = ((x / BLOCK + 1) * BLOCK).min(self.width);
            let crossed = if dark { darkest < level } else { brightest >= level };
            if crossed && let Some(found) = row[x..end].iter().position(|g| (*g < level) == dark) {
                return Some(x + found);
            }
            x = end;
        }
        None
    }
}

/// All dark elliptic blobs of a frame.
pub(super) fn dark_blobs(frame: &Frame) -> Vec<Blob> {
    let (w, h, green) = half_green(frame);
    if w < 16 || h < 16 {
        return Vec::new();
    }
    let max_area = MAX_SHARE * (w * h) as f64;
    let (low, high) = green.iter().fold((u8::MAX, 0), |(l, h), g| (l.min(*g), h.max(*g)));
    let picture = Levels::new(w, green);
    // Blobs of all levels by place, in cells of 16 px, to find those that stay put.
    let mut groups: Vec<Vec<Blob>> = Vec::new();
    let mut cells: BTreeMap<(i64, i64), Vec<usize>> = BTreeMap::new();
    let cell = |at: Vector2<f64>| ((at.x / 16.0) as i64, (at.y / 16.0) as i64);
    for level in (low.saturating_add(LEVEL_STEP)..high).step_by(usize::from(LEVEL_STEP)) {
        for blob in components(&picture, level).iter().filter_map(|sums| sums.blob(max_area)) {
            let (i, j) = cell(blob.at);
            let near = (i - 1..=i + 1).flat_map(|i| (j - 1..=j + 1).map(move |j| (i, j)));
            let same = near.filter_map(|c| cells.get(&c)).flatten().copied().find(|g| {
                groups[*g].last().is_some_and(|other| {
                    other.in_radii(blob.at - other.at) < 0.3
                        && (0.6..1.7).contains(&(blob.radius_px() / other.radius_px()))
                })
            });
            match same {
                Some(g) => groups[g].push(blob),
                None => {
                    cells.entry((i, j)).or_default().push(groups.len());
                    groups.push(vec![blob]);
                }
            }
        }
    }
    // The middle level lies half way between dark and white, where blur does not change the size.
    let middle = |group: &Vec<Blob>| group[group.len() / 2];
    let full = |b: Blob| Blob { at: b.at * 2.0 + Vector2::new(0.5, 0.5), moments: b.moments * 4.0 };
    groups.iter().filter(|g| g.len() >= 2).map(middle).map(full).collect()
}

/// Moments of the connected sets of pixels darker than `level`, from runs of rows joined where they touch.
fn components(picture: &Levels, level: u8) -> Vec<Sums> {
    let (w, h) = (picture.width, picture.green.len() / picture.width);
    let mut parent: Vec<usize> = Vec::new();
    let mut sums: Vec<Sums> = Vec::new();
    let mut above: Vec<(usize, usize, usize)> = Vec::new();
    let mut here: Vec<(usize, usize, usize)> = Vec::new();
    for y in 0..h {
        here.clear();
        let mut x = 0;
        let mut k = 0;
        while x < w {
            let Some(first) = picture.find(y, x, level, true) else { break };
            let end = picture.find(y, first, level, false).unwrap_or(w);
            x = end;
            let mut own = Sums::of_run(first, end, y);
            own.at_border = y == 0 || y + 1 == h || first == 0 || end == w;
            let mut label = None;
            while k < above.len() && above[k].1 <= first {
                k += 1;
            }
            let mut touching = k;
            while touching < above.len() && above[touching].0 < end {
                let other = root(&mut parent, above[touching].2);
                match label {
                    None => label = Some(other),
                    Some(mine) if mine != other => {
                        parent[other] = mine;
                        let moved = sums[other];
                        sums[mine].add(&moved);
                        sums[other] = Sums::default();
                    }
                    Some(_) => {}
                }
                touching += 1;
            }
            let label = label.unwrap_or_else(|| {
                parent.push(parent.len());
                sums.push(Sums::default());
                parent.len() - 1
            });
            sums[label].add(&own);
            here.push((first, end, label));
        }
        std::mem::swap(&mut above, &mut here);
    }
    sums.retain(|s| s.n > 0.0);
    sums
}

fn root(parent: &mut [usize], mut label: usize) -> usize {
    while parent[label] != label {
        parent[label] = parent[parent[label]];
        label = parent[label];
    }
    label
}
