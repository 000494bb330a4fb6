//! What makes a carton other than a sharp cuboid: rounded edges, bulging faces, edges that bow and wave, corners pressed in.
//! The box that counts is the sharp one of the nominal half sizes: bulges are nothing at a face's rim, waves have zero mean
//! along each edge, so that the rectangle that fits a face best is the sharp face.

use crate::rng::Rng;
use crate::solid::FACES;
use nalgebra::Vector3;

/// The shape of a body beside its half sizes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Shape {
    /// Radius of the edges, mm.
    pub radius_mm: f64,
    /// Outward bulge in the middle of each face, mm; 0 at its edges.
    pub bulge_mm: [f32; FACES],
    /// How each face, and with it the edges of its neighbours, bows and waves; `None` for straight edges.
    pub waves: Option<Box<[Wave; FACES]>>,
    /// Corners pressed in.
    pub crushed: Vec<Crushed>,
}

impl Shape {
    /// A cuboid with rounded edges.
    #[must_use]
    pub fn rounded(radius_mm: f64) -> Self {
        Self { radius_mm, ..Self::default() }
    }

    /// From the innermost to the outermost place of a face's edge, measured in the plane of that face, mm: the edge where `face`
    /// meets `beside` is where the surface of `beside` is.
    #[must_use]
    pub fn edge_wave_mm(&self, face: usize, beside: usize) -> f32 {
        let Some(waves) = &self.waves else { return 0.0 };
        let rim = if face.is_multiple_of(2) { 1.0 } else { -1.0 };
        // The face's own axis is the first or the second of its neighbour's two.
        let first = (beside / 2 + 1) % 3 == face / 2;
        let rises = (0..=64).map(|i| {
            let along = i as f32 / 32.0 - 1.0;
            let [s, t] = if first { [rim, along] } else { [along, rim] };
            waves[beside].rise(s, t).0
        });
        let (low, high) = rises.fold((f32::MAX, f32::MIN), |(low, high), r| (low.min(r), high.max(r)));
        high - low
    }
}

/// How far a face stands out beside its bulge. Along each of its edges the mean is zero; the corners of the four edges meet.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wave {
    /// By how much the middle of each edge stands out over its ends, mm.
    pub bow_mm: f32,
    /// Waves along the two axes of the face (the ones after its normal's, in turn), mm: an odd and an even one each.
    pub along_mm: [[f32; 2]; 2],
    /// By which share each is stronger at the upper end of the other axis, and weaker at the lower.
    pub tilt: [f32; 2],
}

/// Largest value of the odd wave x (1 - x^2), of the even one (1 - x^2)(1 - 5 x^2), and bound of both together.
const ODD_PEAK: f32 = 0.385;
const EVEN_PEAK: f32 = 1.0;
const BOTH_PEAK: f32 = 1.2;

impl Wave {
    /// Height over the flat face, mm, and its change with either coordinate, at shares (-1 to 1) of the half sizes.
    #[inline]
    #[must_use]
    pub fn rise(&self, s: f32, t: f32) -> (f32, [f32; 2]) {
        let (ss, tt) = (1.0 - s * s, 1.0 - t * t);
        // Both are zero at the ends and have zero mean.
        let wave = |x: f32, xx: f32, [odd, even]: [f32; 2]| {
            let height = xx * (odd * x + even * (5.0 * xx - 4.0));
            (height, odd * (3.0 * xx - 2.0) + even * x * (8.0 - 20.0 * xx))
        };
        let (p, dp) = wave(s, ss, self.along_mm[0]);
        let (q, dq) = wave(t, tt, self.along_mm[1]);
        let (a, b) = (1.0 + self.tilt[0] * t, 1.0 + self.tilt[1] * s);
        let height = self.bow_mm * (ss + tt - 2.0 / 3.0) + p * a + q * b;
        let by_s = -2.0 * self.bow_mm * s + dp * a + q * self.tilt[1];
        let by_t = -2.0 * self.bow_mm * t + dq * b + p * self.tilt[0];
        (height, [by_s, by_t])
    }

    /// No place of the face stands out or back by more, mm.
    #[must_use]
    pub fn most_mm(&self) -> f32 {
        let wave = |i: usize| {
            let [odd, even] = self.along_mm[i];
            (odd.abs() * ODD_PEAK + even.abs() * EVEN_PEAK) * (1.0 + self.tilt[i].abs())
        };
        self.bow_mm.abs() * 4.0 / 3.0 + wave(0) + wave(1)
    }
}

/// A corner pressed in: a shallow dome in place of the vertex.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crushed {
    /// Bit i is set where the corner is on the upper side of axis i.
    pub corner: usize,
    /// How far along each edge it reaches from the vertex, mm.
    pub reach_mm: f32,
}

/// Waves of a real carton's edges: 0.15 to 0.4 % of the edge's length to either side, 0.3 to 4 mm.
#[must_use]
pub fn waves(rng: &mut Rng, half: &Vector3<f64>) -> Box<[Wave; FACES]> {
    Box::new(std::array::from_fn(|face| {
        let axes = [(face / 2 + 1) % 3, (face / 2 + 2) % 3];
        let peaks = axes.map(|axis| (2.0 * half[axis] as f32 * rng.range_f32(0.0015, 0.004)).clamp(0.3, 4.0));
        // At an edge's ends the bow is two thirds of itself. Panels bow outwards more often than inwards.
        let bowed = rng.range_f32(0.0, 0.8) * peaks[0].min(peaks[1]);
        let bow_mm = if rng.chance(0.75) { 1.5 } else { -1.5 } * bowed;
        let tilt = [0, 1].map(|_| rng.range_f32(-0.5, 0.5));
        let along_mm = [0, 1].map(|i| {
            let rest = (peaks[i] - bowed) / (BOTH_PEAK * (1.0 + tilt[i].abs()));
            let (sin, cos) = rng.range_f32(0.0, std::f32::consts::TAU).sin_cos();
            [rest * cos / ODD_PEAK, rest * sin / EVEN_PEAK]
        });
        Wave { bow_mm, along_mm, tilt }
    }))
}

/// One to four corners of a carton pressed in by 5 to 30 mm, less on a small box.
#[must_use]
pub fn crushed(rng: &mut Rng, half: &Vector3<f64>) -> Vec<Crushed> {
    let mut left: Vec<usize> = (0..8).collect();
    let count = 1 + rng.below(4);
    (0..count)
        .map(|_| {
            let corner = left.swap_remove(rng.below(left.len()));
            let reach_mm = (rng.log_range(5.0, 30.0) as f32).min(0.3 * half.min() as f32);
            Crushed { corner, reach_mm }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waves_have_zero_mean_along_every_edge_and_keep_their_bounds() {
        let half = Vector3::new(300.0, 120.0, 60.0);
        for seed in 0..40 {
            let shape = Shape { waves: Some(waves(&mut Rng::new(seed, 1), &half)), ..Shape::default() };
            let waves = shape.waves.as_ref().unwrap();
            for wave in waves.iter() {
                for rim in [-1.0, 1.0] {
                    let n = 2000;
                    let mean = |of: &dyn Fn(f32) -> f32| {
                        (0..n).map(|i| of((i as f32 + 0.5) / n as f32 * 2.0 - 1.0)).sum::<f32>() / n as f32
                    };
                    assert!(mean(&|x| wave.rise(rim, x).0).abs() < 0.002);
                    assert!(mean(&|x| wave.rise(x, rim).0).abs() < 0.002);
                    for i in 0..=40 {
                        let x = i as f32 / 20.0 - 1.0;
                        assert!(
                            wave.rise(x, rim).0.abs() < 4.01 && wave.rise(x, rim).0.abs() <= wave.most_mm()
                        );
                        assert!(wave.rise(0.1, x).0.abs() <= wave.most_mm());
                    }
                }
            }
            // The front (3) is 600 x 120 mm: its upper edge is where the top's (4) surface is.
            let long = shape.edge_wave_mm(3, 4);
            assert!((0.3..8.0).contains(&long), "{long}");
        }
    }

    #[test]
    fn slopes_are_those_of_the_heights() {
        let wave = waves(&mut Rng::new(3, 1), &Vector3::new(300.0, 120.0, 60.0))[2];
        for (s, t) in [(0.3, -0.7), (-0.9, 0.2), (0.0, 0.95)] {
            let (_, [by_s, by_t]) = wave.rise(s, t);
            let e = 1e-2;
            let s_way = (wave.rise(s + e, t).0 - wave.rise(s - e, t).0) / (2.0 * e);
            let t_way = (wave.rise(s, t + e).0 - wave.rise(s, t - e).0) / (2.0 * e);
            assert!(
                (s_way - by_s).abs() < 0.02 && (t_way - by_t).abs() < 0.02,
                "{s_way} {by_s} {t_way} {by_t}"
            );
        }
    }

    #[test]
    fn crushed_corners_are_different_ones_of_5_to_30_mm() {
        let mut most = 0.0f32;
        for seed in 0..100 {
            let all = crushed(&mut Rng::new(seed, 2), &Vector3::new(300.0, 200.0, 150.0));
            for (i, c) in all.iter().enumerate() {
                assert!(c.corner < 8 && (5.0..=30.0).contains(&c.reach_mm));
                assert!(all[..i].iter().all(|other| other.corner != c.corner));
                most = most.max(c.reach_mm);
            }
        }
        assert!(most > 25.0);
    }
}
