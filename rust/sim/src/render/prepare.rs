//! Puts a scene before the camera: solids in the camera frame, stamps drawn for their distance, candidates per tile.

use crate::head::Head;
use crate::material::{Stamp, Surface, Wrap};
use crate::photos::Photos;
use crate::pose::px_of;
use crate::raster::Raster;
use crate::solid::{FACES, Hit, Solid};
use crate::vec3::{V3, v3};
use crate::world::{Role, Scene, View, axes};
use boxline::CameraModel;
use nalgebra::Vector3;

/// Side of a square of pixels that shares its list of candidates.
const TILE: usize = 16;

/// A solid larger than this is part of the room: it casts no shadows.
const ROOM_BOUND_MM: f32 = 2500.0;

/// What may be left out, mostly for tests.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// Lasers on.
    pub lasers: bool,
    /// Speckle on the stripes.
    pub speckle: bool,
    /// Seed of everything that differs between two frames of the same view (speckle, noise).
    pub seed: u64,
}

impl Default for Options {
    fn default() -> Self {
        Self { lasers: true, speckle: true, seed: 0 }
    }
}

/// A lamp in the camera frame.
#[derive(Clone, Copy, Debug)]
pub struct CamLamp {
    /// Position, mm.
    pub at: V3,
    /// Tangent of the half opening.
    pub width: f32,
    /// Irradiance at the reference distance.
    pub power: V3,
    /// That distance, mm.
    pub reference_mm: f32,
}

/// What is the same all over a flat face.
#[derive(Clone, Copy, Debug)]
pub struct FaceLight {
    /// Outward normal.
    pub normal: V3,
    /// Diffuse irradiance without occlusion.
    pub ambient: V3,
    /// By how much pixels on it are longer than those of a face seen straight on.
    pub stretch: f32,
}

/// A beam in single precision.
#[derive(Clone, Copy, Debug)]
pub struct CamBeam {
    /// Plane `p . X = 1`, 1/mm.
    pub plane: V3,
    /// 1 / |p|, mm.
    pub plane_mm: f32,
    /// Source, mm.
    pub source: V3,
    /// Middle of the fan.
    pub forward: V3,
    /// Cosine of the fan's half opening.
    pub fan_cos: f32,
    /// By how much the light rises per unit of the cosine from the fan's end inwards: within about 2 degrees to all of it.
    pub fan_rise: f32,
    /// Sheet thickness, rad.
    pub sigma_rad: f32,
    /// Peak irradiance at 1 m in scene units; 0 if dead.
    pub at_1m: f32,
}

impl CamBeam {
    /// The beam as a plane `normal . X = offset` mirrors it.
    fn mirrored(&self, normal: V3, offset: f32) -> Self {
        let flip = |v: V3| v - normal * (2.0 * normal.dot(v));
        let share = self.plane.dot(normal);
        let plane = flip(self.plane) * (1.0 / (1.0 - 2.0 * offset * share));
        Self {
            plane,
            plane_mm: 1.0 / plane.norm(),
            source: flip(self.source) + normal * (2.0 * offset),
            forward: flip(self.forward),
            ..*self
        }
    }
}

/// A face that sends laser light on.
#[derive(Clone, Copy, Debug)]
pub(super) struct BounceFace {
    pub(super) solid: usize,
    pub(super) face: usize,
    /// Outward normal, and its product with the face's points, mm.
    pub(super) normal: V3,
    pub(super) offset: f32,
}

/// Everything that casting a ray needs.
pub struct Stage<'a> {
    /// The pixels.
    pub raster: Raster,
    /// The camera.
    pub camera: CameraModel,
    /// All solids before the camera.
    pub solids: Vec<Solid>,
    /// Their roles.
    pub roles: Vec<Role>,
    /// Their index among the scene's bodies.
    pub body: Vec<usize>,
    pub(super) surfaces: Vec<Surface>,
    pub(super) gloss: Vec<f32>,
    pub(super) wraps: Vec<Option<Wrap>>,
    pub(super) stamps: Vec<[Vec<Stamp>; FACES]>,
    /// Which solids cast shadows, with the spheres around them (side by side: most are only looked at and passed over).
    pub(super) casters: Vec<(V3, f32, usize)>,
    /// The spheres around all solids.
    pub(super) spheres: Vec<(V3, f32)>,
    pub(super) lamps: Vec<CamLamp>,
    pub(super) up: V3,
    pub(super) sky: V3,
    pub(super) ground: V3,
    pub(super) backdrop: V3,
    /// The four beams; behind them, if light comes by way of another surface, the same four mirrored in it.
    pub beams: Vec<CamBeam>,
    pub(super) laser_casters: Vec<Vec<usize>>,
    /// The surface in which the last four beams are mirrored.
    pub(super) bounce: Option<BounceFace>,
    /// What a polished floor mirrors: the scene as its image is seen.
    pub(super) image: Option<Box<Stage<'a>>>,
    pub(super) mirror: Vec<f32>,
    /// Multiplies light to full scale.
    pub exposure: f32,
    /// Sensor noise of the scene.
    pub noise: f64,
    /// By solid and face.
    pub(super) faces: Vec<FaceLight>,
    pub(super) photos: &'a Photos,
    pub(super) cell_per_mm: f32,
    pub(super) options: Options,
    outlines: Vec<Option<Outline>>,
    tiles: Vec<Vec<(f32, u16)>>,
    tiles_across: usize,
}

impl<'a> Stage<'a> {
    /// Prepares a scene for one view.
    #[must_use]
    pub fn new(
        scene: &Scene,
        view: &View,
        head: &Head,
        raster: Raster,
        photos: &'a Photos,
        options: Options,
    ) -> Self {
        let target = scene.target.map_or(Vector3::new(0.0, 0.0, 500.0), |t| scene.bodies[t].centre);
        let normal = -axes(view.face).column(2);
        let reference = scene.light.free_irradiance(target + normal * 100.0, normal).max(0.1);
        let beams = [0, 1, 2, 3].map(|i| {
            let (b, p) = (&scene.beams[i], head.plane(i));
            CamBeam {
                plane: p.into(),
                plane_mm: 1.0 / p.norm() as f32,
                source: b.source_mm.into(),
                forward: b.forward.into(),
                fan_cos: b.fan_half_rad.cos() as f32,
                fan_rise: 30.0 / b.fan_half_rad.sin() as f32,
                sigma_rad: b.sigma_rad as f32,
                at_1m: if options.lasers {
                    (b.power * scene.light.laser_to_ambient * reference) as f32
                } else {
                    0.0
                },
            }
        });
        let mut stage = Self::placed(scene, view, head, beams.to_vec(), raster, photos, options);
        if scene.bodies.iter().any(|b| b.look.mirror > 0.0) {
            let up: V3 = (view.cam_from_world * Vector3::z()).into();
            let beams = beams.map(|b| b.mirrored(up, -view.camera_mm.z as f32));
            let image = Self::placed(scene, &view.in_floor(), head, beams.to_vec(), raster, photos, options);
            stage.image = Some(Box::new(image));
        }
        stage
    }

    /// The solids before the camera of a view, which may be that of a mirror image: then without what mirrors.
    fn placed(
        scene: &Scene,
        view: &View,
        head: &Head,
        mut beams: Vec<CamBeam>,
        raster: Raster,
        photos: &'a Photos,
        options: Options,
    ) -> Self {
        let image = view.cam_from_world.determinant() < 0.0;
        let camera = *head.calibration.camera();
        let cell_per_mm = raster.cell_per_mm(&camera) as f32;
        let mut placed: Vec<(usize, Solid)> = scene
            .bodies
            .iter()
            .enumerate()
            .filter(|(_, b)| !(image && b.look.mirror > 0.0))
            .map(|(i, b)| (i, b.solid(view)))
            .filter(|(_, s)| s.centre.z + s.bound > 0.0)
            .collect();
        placed.sort_by(|a, b| a.1.nearest.total_cmp(&b.1.nearest).then(a.0.cmp(&b.0)));
        let body: Vec<usize> = placed.iter().map(|p| p.0).collect();
        let mut solids: Vec<Solid> = placed.into_iter().map(|p| p.1).collect();
        for solid in &mut solids {
            solid.simplify(cell_per_mm * solid.nearest);
        }
        let bodies = || body.iter().map(|i| &scene.bodies[*i]);
        let outlines: Vec<Option<Outline>> = solids.iter().map(|s| outline(s, head, &raster)).collect();
        let stamps = bodies()
            .zip(&solids)
            .zip(&outlines)
            .map(|((b, s), seen)| {
                let mut faces: [Vec<Stamp>; FACES] = Default::default();
                if seen.is_some() {
                    for decal in b.look.decals.iter().filter(|d| faces_camera(s, d.face)) {
                        let foot = cell_per_mm * nearest_of_face(s, decal.face);
                        if decal.half[0].max(decal.half[1]) > 0.7 * foot {
                            faces[decal.face].push(decal.stamp(foot));
                        }
                    }
                }
                faces
            })
            .collect();
        let target = scene.target.map_or(Vector3::new(0.0, 0.0, 500.0), |t| scene.bodies[t].centre);
        let lamps = scene
            .light
            .lamps
            .iter()
            .map(|l| CamLamp {
                at: view.point(l.at_mm).into(),
                width: l.width,
                power: l.power,
                reference_mm: (l.at_mm - target).norm() as f32,
            })
            .collect();
        let spheres: Vec<(V3, f32)> = solids.iter().map(|s| (s.centre, s.bound)).collect();
        let casters: Vec<(V3, f32, usize)> = spheres
            .iter()
            .enumerate()
            .filter(|(_, s)| s.1 < ROOM_BOUND_MM)
            .map(|(i, s)| (s.0, s.1, i))
            .collect();
        let bounce = view.bounce.filter(|_| !image && options.lasers).and_then(|b| {
            let solid = body.iter().position(|i| *i == b.body)?;
            let normal = solids[solid].cam_dir(crate::solid::face_normal(b.face).into());
            let offset = normal.dot(solids[solid].centre) + solids[solid].half[b.face / 2];
            beams.extend_from_within(..);
            for beam in &mut beams[4..] {
                *beam = CamBeam {
                    at_1m: beam.at_1m * b.strength as f32,
                    sigma_rad: beam.sigma_rad * b.spread as f32,
                    ..beam.mirrored(normal, offset)
                };
            }
            Some(BounceFace { solid, face: b.face, normal, offset })
        });
        let laser_casters = beams
            .iter()
            .map(|beam| {
                casters
                    .iter()
                    .filter(|(c, r, _)| ((beam.plane.dot(*c) - 1.0) * beam.plane_mm).abs() < *r)
                    .map(|(.., i)| *i)
                    .collect()
            })
            .collect();
        let up: V3 = (view.cam_from_world * Vector3::z()).into();
        let faces = solids.iter().flat_map(|s| {
            (0..FACES).map(move |f| {
                let normal = s.cam_dir(crate::solid::face_normal(f).into());
                let slant = (-normal.dot(s.centre.unit())).max(0.15);
                FaceLight {
                    normal,
                    ambient: diffuse(&scene.light, normal.dot(up)),
                    stretch: 1.0 / slant.sqrt(),
                }
            })
        });
        let faces = faces.collect();
        let tiles_across = raster.width.div_ceil(TILE);
        let tiles = tile_lists(&solids, &outlines, &raster, &camera);
        Self {
            raster,
            camera,
            roles: bodies().map(|b| b.role).collect(),
            surfaces: bodies().map(|b| b.look.surface).collect(),
            gloss: bodies().map(|b| b.look.gloss).collect(),
            wraps: bodies().map(|b| b.look.wrap).collect(),
            mirror: bodies().map(|b| b.look.mirror).collect(),
            body,
            solids,
            stamps,
            casters,
            spheres,
            lamps,
            up,
            faces,
            sky: scene.light.sky,
            ground: scene.light.ground,
            backdrop: scene.light.backdrop,
            beams,
            laser_casters,
            bounce,
            image: None,
            exposure: view.exposure as f32,
            noise: scene.light.noise,
            photos,
            cell_per_mm,
            options,
            outlines,
            tiles,
            tiles_across,
        }
    }

    /// The ray (x, y, 1) of a position on the raster.
    #[inline]
    #[must_use]
    pub fn ray(&self, column: f64, row: f64) -> V3 {
        self.camera.ray_from_px(self.raster.px(column, row)).xy1.into()
    }

    /// Solids that may be seen at a pixel with the least depth that they can have in its tile, nearest first.
    #[inline]
    pub(super) fn candidates(&self, column: usize, row: usize) -> &[(f32, u16)] {
        &self.tiles[(row / TILE) * self.tiles_across + column / TILE]
    }

    /// Whether a solid's outline meets a part of the raster, given by its bounds along columns, rows and both diagonals.
    pub(super) fn may_cover(&self, solid: usize, span: &Outline) -> bool {
        self.outlines[solid].is_some_and(|outline| meet(&outline, span))
    }

    /// The nearest solid on a ray through the pixel (column, row), and where.
    #[inline]
    #[must_use]
    pub fn cast(&self, ray: V3, column: usize, row: usize) -> Option<(usize, Hit)> {
        let mut best: Option<(usize, Hit)> = None;
        let mut limit = f32::INFINITY;
        for &(nearest, i) in self.candidates(column, row) {
            if nearest >= limit {
                break; // sorted by nearest depth in this tile: nothing after this can be nearer
            }
            let solid = &self.solids[usize::from(i)];
            if let Some(hit) = solid.hit(ray, limit) {
                limit = hit.depth;
                best = Some((usize::from(i), hit));
            }
        }
        best
    }

    /// What a ray sees that meets nothing: paler towards the horizon.
    pub(super) fn nothing(&self, ray: V3) -> V3 {
        let up = ray.unit().dot(self.up).clamp(0.0, 1.0);
        let pale = (1.0 - up) * (1.0 - up);
        let grey = self.backdrop.y;
        let haze = v3(grey, grey, grey) * 1.1;
        (self.backdrop * (1.0 - pale) + haze * pale) * self.exposure
    }

    /// Diffuse irradiance on a free surface.
    pub(super) fn ambient(&self, normal: V3) -> V3 {
        let up = 0.5 + 0.5 * normal.dot(self.up);
        self.sky * up + self.ground * (1.0 - up)
    }

    /// Index of the target among the solids.
    #[must_use]
    pub fn target(&self) -> Option<usize> {
        self.roles.iter().position(|r| *r == Role::Target)
    }
}

fn diffuse(light: &crate::world::Lighting, up: f32) -> V3 {
    let up = 0.5 + 0.5 * up;
    light.sky * up + light.ground * (1.0 - up)
}

fn corners(half: V3) -> impl Iterator<Item = V3> {
    (0..8).map(move |i| {
        let sign = |bit: usize| if i >> bit & 1 == 1 { 1.0 } else { -1.0 };
        v3(half.x * sign(0), half.y * sign(1), half.z * sign(2))
    })
}

/// What a solid can cover on the raster: bounds along columns, rows and both diagonals. Boxes stand at 45 degrees in the
/// image, so the diagonals bound them best.
pub(super) type Outline = [[f64; 2]; 4];

fn meet(a: &Outline, b: &Outline) -> bool {
    a.iter().zip(b).all(|(a, b)| a[1] >= b[0] && a[0] <= b[1])
}

/// `None` if the solid is outside the raster.
fn outline(solid: &Solid, head: &Head, raster: &Raster) -> Option<Outline> {
    let (w, h) = (raster.width as f64, raster.height as f64);
    let everything = [[0.0, w], [0.0, h], [0.0, w + h], [-h, w]];
    let mut bounds: Outline = [[f64::INFINITY, f64::NEG_INFINITY]; 4];
    for corner in corners(solid.outer()) {
        let p = solid.centre + solid.cam_dir(corner);
        // Points beside or behind the camera have no pixel: then the solid may be anywhere.
        if p.z < 10.0 || p.x.hypot(p.y) > 1.2 * p.z {
            return Some(everything);
        }
        let cam = Vector3::new(f64::from(p.x), f64::from(p.y), f64::from(p.z));
        let Some(px) = px_of(head, &cam) else { return Some(everything) };
        let [c, r] = raster.from_px(px);
        for ([low, high], at) in bounds.iter_mut().zip([c, r, c + r, c - r]) {
            *low = low.min(at);
            *high = high.max(at);
        }
    }
    // Distortion bends straight edges: a few thousandths of their length.
    let slack = 3.0 + 0.02 * (bounds[0][1] - bounds[0][0] + bounds[1][1] - bounds[1][0]);
    let bounds = bounds.map(|[low, high]| [low - slack, high + slack]);
    let [[x0, x1], [y0, y1], ..] = bounds;
    (x1 > 0.0 && y1 > 0.0 && x0 < w && y0 < h).then_some(bounds)
}

/// For each tile the solids that may be seen in it with the least depth they can have there, nearest first.
fn tile_lists(
    solids: &[Solid],
    outlines: &[Option<Outline>],
    raster: &Raster,
    camera: &CameraModel,
) -> Vec<Vec<(f32, u16)>> {
    let (across, down) = (raster.width.div_ceil(TILE), raster.height.div_ceil(TILE));
    let mut tiles = Vec::with_capacity(across * down);
    for ty in 0..down {
        for tx in 0..across {
            let (x0, y0) = ((tx * TILE) as f64 - 1.0, (ty * TILE) as f64 - 1.0);
            let (x1, y1) = (x0 + TILE as f64 + 1.0, y0 + TILE as f64 + 1.0);
            let ray = |c: f64, r: f64| V3::from(camera.ray_from_px(raster.px(c, r)).xy1);
            let rays = [ray(x0, y0), ray(x1, y0), ray(x0, y1), ray(x1, y1)];
            let span = [[x0, x1], [y0, y1], [x0 + y0, x1 + y1], [x0 - y1, x1 - y0]];
            let mut list = Vec::new();
            for (i, (solid, outline)) in solids.iter().zip(outlines).enumerate() {
                let Some(outline) = outline else { continue };
                let least = if meet(outline, &span) { solid.least_depth(&rays) } else { None };
                if let (Some(least), Ok(index)) = (least, u16::try_from(i)) {
                    list.push((least, index));
                }
            }
            list.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            tiles.push(list);
        }
    }
    tiles
}

/// Whether the camera is on the outer side of a face.
fn faces_camera(solid: &Solid, face: usize) -> bool {
    let camera = solid.local(V3::default());
    let side = if face.is_multiple_of(2) { 1.0 } else { -1.0 };
    camera[face / 2] * side > solid.half[face / 2]
}

/// Depth of the nearest corner of a face, at least 100 mm.
fn nearest_of_face(solid: &Solid, face: usize) -> f32 {
    let side = if face.is_multiple_of(2) { 1.0 } else { -1.0 };
    corners(solid.half)
        .filter(|c| c[face / 2] * side > 0.0)
        .map(|c| (solid.centre + solid.cam_dir(c)).z)
        .fold(f32::INFINITY, f32::min)
        .max(100.0)
}
