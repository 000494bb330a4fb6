//! Shifts of the picture over the sensor: any that a lens may make, and those of a sensor that is tilted behind its lens. A camera and a
//! turn of it take most of them; what is left over the whole sensor belongs to no term of the camera.

use super::model::ray_by_camera;
use boxline::camera::CameraModel;
use boxline::units::Px;
use nalgebra::{DMatrix, DVector, SMatrix, Vector2, Vector3};

/// Powers (of x and y, the place on the sensor from its middle, 1 at its longer border) of which any shift of the picture may consist.
const LENS_POWERS: [[i32; 2]; 18] = [
    [2, 0],
    [1, 1],
    [0, 2],
    [3, 0],
    [2, 1],
    [1, 2],
    [0, 3],
    [4, 0],
    [3, 1],
    [2, 2],
    [1, 3],
    [0, 4],
    [5, 0],
    [4, 1],
    [3, 2],
    [2, 3],
    [1, 4],
    [0, 5],
];
/// Unknowns of a lens: shifts along u and v of each power.
pub(super) const SHIFTS: usize = 2 * LENS_POWERS.len();
/// Unknowns of a tilted sensor: its angles about the rows and the columns, rad.
pub(super) const TILTS: usize = 2;
/// The camera's nine, and a turn.
const BY_CAMERA: usize = 12;
/// Places along u and v at which a camera is compared.
const PLACES: [usize; 2] = [20, 15];

/// The shifts that a lens may make at a place of the sensor, [`SHIFTS`] of them.
pub(super) fn lens_shifts(image_px: [usize; 2], at: Px) -> Vec<Vector2<f64>> {
    let d = from_middle(image_px, at);
    let half = 0.5 * image_px[0].max(image_px[1]) as f64;
    let powers = LENS_POWERS.map(|[m, n]| (d.x / half).powi(m) * (d.y / half).powi(n));
    powers.into_iter().flat_map(|x| [Vector2::new(x, 0.0), Vector2::new(0.0, x)]).collect()
}

fn from_middle([width, height]: [usize; 2], at: Px) -> Vector2<f64> {
    Vector2::new(at.u - 0.5 * (width as f64 - 1.0), at.v - 0.5 * (height as f64 - 1.0))
}

/// At one place of the sensor, px for one of each unknown: a lens's shifts, none if it is not asked, and a tilted sensor's.
pub(super) type ShiftsAt = (Vec<Vector2<f64>>, [Vector2<f64>; TILTS]);

/// Shifts of which the nearest camera, turned, takes nothing.
#[derive(Clone, Debug)]
pub(super) struct Fields {
    camera: CameraModel,
    image_px: [usize; 2],
    /// What camera and turn take of each shift, tilts first.
    taken: DMatrix<f64>,
}

impl Fields {
    /// Beside a camera. `None` if it is no camera.
    pub fn new(camera: &CameraModel, image_px: [usize; 2]) -> Option<Self> {
        let [columns, rows] = PLACES;
        let mut fields = Self { camera: *camera, image_px, taken: DMatrix::zeros(BY_CAMERA, TILTS + SHIFTS) };
        let mut by = DMatrix::zeros(2 * columns * rows, BY_CAMERA);
        let mut all = DMatrix::zeros(2 * columns * rows, TILTS + SHIFTS);
        for i in 0..columns * rows {
            let at = |k: usize, n: usize, size: usize| (k as f64 + 0.5) / n as f64 * size as f64 - 0.5;
            let px = Px::new(at(i % columns, columns, image_px[0]), at(i / columns, rows, image_px[1]));
            // A strong lens may end before the corners do.
            let Some(here) = by_camera(camera, px) else { continue };
            by.fixed_view_mut::<2, BY_CAMERA>(2 * i, 0).copy_from(&here);
            let shifts = fields.tilts(px).into_iter().chain(lens_shifts(image_px, px));
            shifts.enumerate().for_each(|(k, shift)| all.fixed_view_mut::<2, 1>(2 * i, k).copy_from(&shift));
        }
        // Terms of a lens and turns are of very different size.
        let units = DMatrix::from_diagonal(&DVector::from_fn(BY_CAMERA, |k, _| 1.0 / by.column(k).norm()));
        fields.taken = &units * (by * &units).svd(true, true).solve(&all, 1e-12).ok()?;
        Some(fields)
    }

    /// A place d from the middle of the tilted sensor is d / (1 + t . d / f) on one that faces the lens.
    fn tilts(&self, at: Px) -> [Vector2<f64>; TILTS] {
        let d = from_middle(self.image_px, at);
        [-d * (d.x / self.camera.fx), -d * (d.y / self.camera.fx)]
    }

    /// At a place of the sensor: the lens's, if they are asked for, and the tilts', px.
    pub fn shifts(&self, at: Px, lens: bool) -> Option<ShiftsAt> {
        let by = by_camera(&self.camera, at)?;
        let taken = |k: usize| by * self.taken.fixed_view::<BY_CAMERA, 1>(0, k);
        let tilts = self.tilts(at);
        let lens = if lens { lens_shifts(self.image_px, at) } else { Vec::new() };
        let lens = lens.into_iter().enumerate().map(|(k, shift)| shift - taken(TILTS + k));
        Some((lens.collect(), [0, 1].map(|k| tilts[k] - taken(k))))
    }
}

/// How far a ray's pixel moves with camera and turn.
fn by_camera(camera: &CameraModel, at: Px) -> Option<SMatrix<f64, 2, BY_CAMERA>> {
    let ray = camera.ray_from_px(at);
    let (_, px_by_ray) = camera.px_from_ray_with_jacobian(&ray)?;
    let mut by = SMatrix::<f64, 2, BY_CAMERA>::zeros();
    by.fixed_view_mut::<2, 9>(0, 0)
        .copy_from(&(px_by_ray * -ray_by_camera(camera, at).fixed_columns::<9>(0)));
    for k in 0..3 {
        let moved = Vector3::ith(k, 1.0).cross(&ray.xy1);
        by.set_column(9 + k, &(px_by_ray * (moved.xy() - ray.xy1.xy() * moved.z)));
    }
    Some(by)
}
