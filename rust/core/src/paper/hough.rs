//! The paper's procedure: edge map, Hough transform `rho = u cos(theta) + v sin(theta)` (eq. 20), clustering of the peaks
//! with 15 px and 1.8 degrees, line fits; of the lines, each side of the face takes the one that fits it.

use super::edge_map::{EdgePixel, edge_pixels, edge_pixels_of_map};
use crate::calibration::Calibration;
use crate::edges::subpixel::GradientDetector;
use crate::edges::{EdgeDetector, EdgePoint};
use crate::face::outline::{InitialRectangle, SIDES};
use crate::face::plane_fit::{PxView, residual_px};
use crate::frames::{Cam, Plane};
use crate::image::Frame;
use crate::network::MapView;
use crate::units::{LaserId, Px};
use std::f64::consts::PI;

/// The paper's chain, on a network's map if there is one.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct HoughDetector<'a> {
    pub map: Option<MapView<'a>>,
    /// If the map shows the stripes on this plane too, which are no edges of the face.
    pub stripes_on: Option<&'a Plane<Cam>>,
}

/// The transform, the clustering of its peaks, and which pixels are a line's.
#[derive(Clone, Copy, Debug)]
struct HoughSettings {
    /// Cells of the accumulator over half a turn: half a degree each. More splits a line's votes.
    theta_cells: usize,
    /// ... and their width, px. More is coarser, less splits a line's votes.
    rho_cell_px: f64,
    /// A pixel votes for lines whose normal is within this angle of its gradient, rad: Sobel is that exact at 3 levels of noise. More takes
    /// longer and adds votes by chance.
    vote_rad: f64,
    /// Clustering, px and rad, from the paper (section 3.5). More loses the weaker one of two sides or lines beside each other.
    cluster_rho_px: f64,
    cluster_theta_rad: f64,
    /// Peaks that are looked at. More takes longer.
    peaks: usize,
    /// Least votes of a peak: a line of 60 map pixels. More loses short sides.
    least_votes: f32,
    /// A side takes a line whose ends are within this distance of its own corners, px. More takes print beside it.
    side_distance_px: f64,
    /// Pixels of the map this near the line belong to it, px, in each of its fits: a cell is coarser than the pixels. More lets pixels of what
    /// lies beside it in.
    on_line_px: [f64; 3],
    /// Localisation of one map pixel, px: half-resolution ridge with parabola. More makes sigmas larger.
    sigma_px: f64,
    /// Pixels of the map this near a stripe and parallel to it are its own, pixels of the map: a line there is 1.9 px wide. More takes edges
    /// along a stripe for it.
    stripe_px: f64,
    /// How far along a pixel's line it is asked whether that is parallel to the stripe, pixels of the map. More asks for the same direction more
    /// exactly: pixels of a stripe whose direction is rough pass for an edge's.
    parallel_px: f64,
    /// ... and how far it may be off there. More takes edges that cross a stripe for it.
    off_parallel_px: f64,
}

impl HoughSettings {
    const DEFAULT: Self = Self {
        theta_cells: 360,
        rho_cell_px: 4.0,
        vote_rad: 0.07,
        cluster_rho_px: 15.0,
        cluster_theta_rad: 1.8 * PI / 180.0,
        peaks: 400,
        least_votes: 60.0,
        side_distance_px: 15.0,
        on_line_px: [6.0, 4.0, 2.5],
        sigma_px: 0.7,
        stripe_px: 2.0,
        parallel_px: 6.0,
        off_parallel_px: 3.5,
    };
}

impl Default for HoughSettings {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// A line of the picture, `rho = u cos(theta) + v sin(theta)`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Line {
    pub rho_px: f64,
    pub theta_rad: f64,
    pub votes: f32,
}

impl Line {
    /// Signed distance of a pixel.
    pub fn distance_px(&self, p: Px) -> f64 {
        p.u * self.theta_rad.cos() + p.v * self.theta_rad.sin() - self.rho_px
    }

    /// Difference to another line in rho and theta; (rho, theta) and (-rho, theta + pi) are one line.
    fn difference(&self, other: &Self) -> (f64, f64) {
        let d = (self.theta_rad - other.theta_rad).rem_euclid(PI);
        let turned = (self.theta_rad - other.theta_rad).cos() < 0.0;
        let rho = if turned { self.rho_px + other.rho_px } else { self.rho_px - other.rho_px };
        (rho.abs(), d.min(PI - d))
    }
}

impl EdgeDetector for HoughDetector<'_> {
    fn edge_points(
        &self,
        frame: &Frame,
        calibration: &Calibration,
        initial: &InitialRectangle,
        keep_out: &[(Px, f64)],
    ) -> [Vec<EdgePoint>; 4] {
        let settings = HoughSettings::default();
        let (mut pixels, coarseness) = match self.map {
            Some(map) => (edge_pixels_of_map(map), coarseness(map)),
            None => (edge_pixels(frame), 1.0),
        };
        if let Some(plane) = self.stripes_on {
            settings.leave_out_stripes(&mut pixels, calibration, plane, coarseness);
        }
        let lines = settings.lines(&pixels, frame, coarseness);
        [0, 1, 2, 3].map(|side| {
            let near = settings.side_line(calibration, initial, side, &lines);
            near.and_then(|near| settings.points(near, &pixels, keep_out, coarseness)).unwrap_or_default()
        })
    }
}

/// Frame px per map px, in those of the half-resolution map.
fn coarseness(map: MapView<'_>) -> f64 {
    map.px_per_raster_px() / 2.0
}

/// The lines of a map that shows the face's edges and the stripes on its plane, and the pixels they are made of: those of no stripe.
pub(crate) fn lines_beside_stripes(
    frame: &Frame,
    calibration: &Calibration,
    plane: &Plane<Cam>,
    map: MapView<'_>,
) -> (Vec<Line>, Vec<EdgePixel>) {
    let settings = HoughSettings::default();
    let mut pixels = edge_pixels_of_map(map);
    settings.leave_out_stripes(&mut pixels, calibration, plane, coarseness(map));
    (settings.lines(&pixels, frame, coarseness(map)), pixels)
}

impl HoughSettings {
    fn leave_out_stripes(
        &self,
        pixels: &mut Vec<EdgePixel>,
        calibration: &Calibration,
        plane: &Plane<Cam>,
        coarseness: f64,
    ) {
        let unit = 2.0 * coarseness; // frame px of a pixel of the map
        let near = |at: Px, laser: LaserId, limit_px: f64| {
            let view = PxView::new(calibration.camera(), at);
            residual_px(calibration, plane, laser, &view).is_some_and(|(off_px, _)| off_px.abs() < limit_px)
        };
        pixels.retain(|p| {
            let (s, c) = f64::from(p.normal_rad).sin_cos();
            let along = |by: f64| Px::new(p.at.u - s * by * unit, p.at.v + c * by * unit);
            !LaserId::ALL.into_iter().any(|laser| {
                near(p.at, laser, self.stripe_px * unit)
                    && [-self.parallel_px, self.parallel_px]
                        .into_iter()
                        .all(|by| near(along(by), laser, self.off_parallel_px * unit))
            })
        });
    }

    fn lines(&self, pixels: &[EdgePixel], frame: &Frame, coarseness: f64) -> Vec<Line> {
        self.cluster(self.peaks(pixels, frame.width_px(), frame.height_px(), coarseness))
    }

    fn peaks(&self, pixels: &[EdgePixel], width: usize, height: usize, coarseness: f64) -> Vec<Line> {
        let Self { theta_cells, rho_cell_px, .. } = *self;
        let reach = (width as f64).hypot(height as f64);
        let rho_cells = (2.0 * reach / rho_cell_px).ceil() as usize + 1;
        let mut votes = vec![0f32; theta_cells * rho_cells];
        let cell = PI / theta_cells as f64;
        let directions: Vec<(f64, f64)> = (0..theta_cells).map(|t| (t as f64 * cell).sin_cos()).collect();
        let spread = (self.vote_rad / cell).round() as i64;
        for p in pixels {
            let middle = (f64::from(p.normal_rad).rem_euclid(PI) / cell).round() as i64;
            for t in middle - spread..=middle + spread {
                let t = t.rem_euclid(theta_cells as i64) as usize;
                let (s, c) = directions[t];
                let rho = p.at.u * c + p.at.v * s;
                votes[t * rho_cells + ((rho + reach) / rho_cell_px) as usize] += 1.0;
            }
        }
        let min_votes = self.least_votes / coarseness as f32;
        let mut all: Vec<Line> = Vec::new();
        for t in 0..theta_cells {
            for r in 1..rho_cells - 1 {
                let v = votes[t * rho_cells + r];
                if v >= min_votes && v >= votes[t * rho_cells + r - 1] && v >= votes[t * rho_cells + r + 1] {
                    all.push(Line {
                        rho_px: (r as f64 + 0.5) * rho_cell_px - reach,
                        theta_rad: t as f64 * cell,
                        votes: v,
                    });
                }
            }
        }
        all.sort_by(|a, b| b.votes.total_cmp(&a.votes));
        all.truncate(self.peaks);
        all
    }

    /// One line a cluster: the one with most votes stands for those near it.
    fn cluster(&self, peaks: Vec<Line>) -> Vec<Line> {
        let mut kept: Vec<Line> = Vec::new();
        for p in peaks {
            let known = kept.iter().any(|k| {
                let (rho, theta) = k.difference(&p);
                rho < self.cluster_rho_px && theta < self.cluster_theta_rad
            });
            if !known {
                kept.push(p);
            }
        }
        kept
    }

    /// The line that a side takes.
    fn side_line(
        &self,
        calibration: &Calibration,
        initial: &InitialRectangle,
        side: usize,
        lines: &[Line],
    ) -> Option<SideLine> {
        let (across, _) = SIDES[side];
        let (from, to) = initial.span_mm(side);
        let corner =
            |along: f64| initial.raster.pixel(calibration, across.at(initial.offsets_mm[side], along));
        let (first, last) = (corner(from)?, corner(to)?);
        let misfit = |l: &Line| l.distance_px(first).abs().max(l.distance_px(last).abs());
        let line = lines.iter().filter(|l| misfit(l) < self.side_distance_px).max_by(|a, b| {
            (f64::from(a.votes) / (4.0 + misfit(a))).total_cmp(&(f64::from(b.votes) / (4.0 + misfit(b))))
        })?;
        let length = first.distance_px(last);
        let direction = ((last.u - first.u) / length, (last.v - first.v) / length);
        let against = -direction.1 * line.theta_rad.cos() + direction.0 * line.theta_rad.sin() < 0.0;
        let sign = if against { -1.0 } else { 1.0 };
        let offset = (-sign * line.distance_px(first), -sign * line.distance_px(last));
        Some(SideLine { first, direction, length, offset })
    }

    /// The pixels near a side's line, which is fitted again to those near it each time.
    fn points(
        &self,
        SideLine { first, direction, length, mut offset }: SideLine,
        pixels: &[EdgePixel],
        keep_out: &[(Px, f64)],
        coarseness: f64,
    ) -> Option<Vec<EdgePoint>> {
        let corner = GradientDetector::DEFAULT.corner_share;
        let mut chosen = Vec::new();
        for near in self.on_line_px.map(|near| near * coarseness) {
            chosen.clear();
            let (mut n, mut st, mut stt, mut sd, mut std) = (0.0, 0.0, 0.0, 0.0, 0.0);
            for p in pixels {
                let (du, dv) = (p.at.u - first.u, p.at.v - first.v);
                let t = (du * direction.0 + dv * direction.1) / length;
                let d = -du * direction.1 + dv * direction.0;
                if !(corner..1.0 - corner).contains(&t)
                    || (d - offset.0 - (offset.1 - offset.0) * t).abs() > near
                {
                    continue;
                }
                let across_edge = (-f64::from(p.normal_rad.cos()) * direction.1
                    + f64::from(p.normal_rad.sin()) * direction.0)
                    .abs();
                if across_edge < 0.9 || keep_out.iter().any(|(c, r)| c.distance_px(p.at) < *r) {
                    continue;
                }
                n += 1.0;
                st += t;
                stt += t * t;
                sd += d;
                std += t * d;
                chosen.push(EdgePoint { at: p.at, sigma_px: self.sigma_px * coarseness });
            }
            let spread = stt - st * st / n;
            if n < 8.0 || spread < 1e-6 {
                return None;
            }
            let slope = (std - st * sd / n) / spread;
            let at_first = (sd - slope * st) / n;
            offset = (at_first, at_first + slope);
        }
        Some(chosen)
    }
}

/// A line of the picture beside a side.
struct SideLine {
    /// The side's first corner, the unit vector to its last one, and how far that is, px.
    first: Px,
    direction: (f64, f64),
    length: f64,
    /// How far the line lies beside either corner, px.
    offset: (f64, f64),
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::edges::detector_tests::{
        bears_frames_of_any_size, finds_known_sides, finds_nothing_in_the_dark, keeps_out_of_laser_light,
        noise_frame,
    };
    use proptest::prelude::*;

    /// On the picture's gradient, without a network.
    const DETECTOR: HoughDetector<'static> = HoughDetector { map: None, stripes_on: None };

    const SETTINGS: HoughSettings = HoughSettings::DEFAULT;

    /// Map pixels along `u cos(theta) + v sin(theta) = rho` within a frame of 600 x 400.
    fn pixels_on(rho_px: f64, theta_rad: f64) -> Vec<EdgePixel> {
        let (s, c) = theta_rad.sin_cos();
        (-400..400)
            .map(|k| f64::from(k) * 2.0)
            .map(|t| Px::new(rho_px * c - t * s, rho_px * s + t * c))
            .filter(|p| p.u > 0.0 && p.v > 0.0 && p.u < 600.0 && p.v < 400.0)
            .map(|at| EdgePixel { at, normal_rad: theta_rad as f32 })
            .collect()
    }

    #[test]
    fn lines_are_found_to_a_cell_and_once() {
        for (rho_px, theta_rad) in [(250.0, 0.8), (120.0, 0.01), (-90.0, 2.4), (300.0, 1.57), (-400.0, 3.13)]
        {
            let pixels = pixels_on(rho_px, theta_rad);
            assert!(pixels.len() as f32 > SETTINGS.least_votes, "{rho_px}, {theta_rad}");
            let lines = SETTINGS.cluster(SETTINGS.peaks(&pixels, 600, 400, 1.0));
            let best = lines.first().expect("a line");
            let (rho, theta) = best.difference(&Line { rho_px, theta_rad, votes: 0.0 });
            assert!(rho < 2.0 * SETTINGS.rho_cell_px && theta < 0.01, "{best:?} for {rho_px}, {theta_rad}");
        }
    }

    #[test]
    fn two_ways_to_write_a_line_do_not_differ() {
        let line = |rho_px: f64, theta_rad: f64| Line { rho_px, theta_rad, votes: 1.0 };
        let (rho, theta) = line(50.0, 0.01).difference(&line(-50.0, PI - 0.01));
        assert!(rho < 1e-9 && (theta - 0.02).abs() < 1e-9);
        let (rho, theta) = line(50.0, 0.5).difference(&line(64.0, 0.5));
        assert!((rho - 14.0).abs() < 1e-9 && theta < 1e-9);
    }

    #[test]
    fn neighbours_within_the_papers_distances_are_one_line() {
        let line =
            |rho_px: f64, theta_deg: f64, votes| Line { rho_px, theta_rad: theta_deg.to_radians(), votes };
        let kept = SETTINGS.cluster(vec![
            line(100.0, 40.0, 9.0),
            line(112.0, 41.0, 8.0),
            line(120.0, 40.0, 7.0),
            line(100.0, 42.0, 6.0),
        ]);
        assert_eq!(kept.iter().map(|l| l.votes).collect::<Vec<_>>(), [9.0, 7.0, 6.0]);
    }

    #[test]
    fn no_pixels_no_lines() {
        for (width, height) in [(1, 1), (3, 2), (64, 64)] {
            assert!(SETTINGS.peaks(&[], width, height, 1.0).is_empty());
        }
    }

    #[test]
    fn known_sides_are_found_to_a_fifth_of_a_pixel() {
        finds_known_sides(&DETECTOR);
    }

    #[test]
    fn no_point_lies_where_laser_light_disturbs() {
        keeps_out_of_laser_light(&DETECTOR);
    }

    #[test]
    fn a_black_frame_has_no_edges() {
        finds_nothing_in_the_dark(&DETECTOR);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn frames_of_any_size_do_no_harm(width in 1..90usize, height in 1..90usize, seed: u32) {
            bears_frames_of_any_size(&DETECTOR, width, height, seed);
            for pixel in edge_pixels(&noise_frame(width, height, seed)) {
                prop_assert!(pixel.at.u > 0.0 && pixel.at.u < width as f64);
                prop_assert!(pixel.at.v > 0.0 && pixel.at.v < height as f64);
            }
        }
    }
}
