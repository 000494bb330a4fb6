//! Frames of the circle board for `boxline calibrate`, lasers on: a recording with `board.json`, the true calibration and, in `truth.json`,
//! the board's poses. What a real head or board does otherwise than the model is drawn too ([`Faults`]).

use crate::error::Error;
use crate::head::Head;
use crate::material::{Appearance, Art, Decal, Pattern, Surface};
use crate::pose::{FacePose, inside, px_of};
use crate::recording::{Detail, Exposure, expose_full_frame, jpeg};
use crate::rng::Rng;
use crate::shape::Shape;
use crate::stock::Stock;
use crate::vec3::v3;
use crate::world::compose::TruthWords;
use crate::world::light::{Lamp, lighting};
use crate::world::{Body, Role, Scene, View};
use nalgebra::{Matrix3, Rotation3, Vector3};
use serde_json::{Value, json};
use std::collections::BTreeSet;

/// The board of the paper's size: circles along its columns and rows, mm.
const CIRCLES: [u32; 2] = [12, 11];
const PITCH_MM: f64 = 100.0;
const DIAMETER_MM: f64 = 50.0;
const SIZE_MM: Vector3<f64> = Vector3::new(5.0, 1300.0, 1200.0);
/// The printed face looks along the body's x axis.
const FACE: usize = 0;
/// Views: distance, tilt, and the least share of the circles in the picture.
const DISTANCE_MM: (f64, f64) = (650.0, 2600.0);
const MOST_TILT_DEG: f64 = 45.0;
const LEAST_SEEN: f64 = 0.4;
/// A sensor soldered askew is tilted by tenths of a degree; more and half of the picture is out of focus.
const MOST_SENSOR_TILT_DEG: f64 = 5.0;
/// The lamp of uneven light stands so far beside the board's middle and before it, mm.
const LAMP_BESIDE_MM: f64 = 800.0;
const LAMP_BEFORE_MM: f64 = 500.0;

/// What is not as the model has it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Faults {
    /// The focal length changes from frame to frame by this share, 1 sigma.
    pub focus: f64,
    /// The board's middle stands before its border by this much, mm.
    pub bow_mm: f64,
    /// The pitch along the columns is larger by this share.
    pub stretch: f64,
    /// This share of the light comes from one lamp beside the board: its far border is that much darker than its near one, or nearly.
    pub light: f64,
    /// The sensor is tilted behind its lens by this angle about its columns, degrees.
    pub tilt_deg: f64,
}

impl Faults {
    /// `focus=0.003,bow=2,stretch=0.001,light=0.8,tilt=0.3`, each of which may be left out.
    ///
    /// # Errors
    /// What is none of these.
    pub fn parse(text: &str) -> Result<Self, String> {
        let mut faults = Self::default();
        for part in text.split(',').filter(|part| !part.is_empty()) {
            let wrong = || {
                format!(
                    "{part:?} is none of focus=SHARE, bow=MM, stretch=SHARE, light=SHARE (0 to 1), tilt=DEGREES"
                )
            };
            let (name, value) = part.split_once('=').ok_or_else(wrong)?;
            let value = value.parse().ok().filter(|v: &f64| v.is_finite()).ok_or_else(wrong)?;
            match name {
                "focus" => faults.focus = value,
                "bow" => faults.bow_mm = value,
                "stretch" => faults.stretch = value,
                "light" if (0.0..=1.0).contains(&value) => faults.light = value,
                "tilt" if value.abs() <= MOST_SENSOR_TILT_DEG => faults.tilt_deg = value,
                _ => return Err(wrong()),
            }
        }
        Ok(faults)
    }

    /// The keystone that the tilted sensor makes behind a lens ([`crate::raster::Raster::keystone_per_px`]).
    #[must_use]
    pub fn keystone_per_px(&self, head: &Head) -> [f64; 2] {
        [self.tilt_deg.to_radians().tan() / head.calibration.camera().fx, 0.0]
    }

    fn json(&self) -> Value {
        let Self { focus, bow_mm, stretch, light, tilt_deg } = self;
        json!({"focus": focus, "bow_mm": bow_mm, "stretch": stretch, "light": light, "tilt_deg": tilt_deg})
    }
}

/// Renders a set of frames and hands over its files by name.
///
/// # Errors
/// Whatever `put` says, or core refuses the head.
pub fn render_board(
    head: &Head,
    frames: usize,
    faults: &Faults,
    rng: &mut Rng,
    stock: &Stock,
    mut put: impl FnMut(&str, Vec<u8>) -> Result<(), Error>,
) -> Result<(), Error> {
    let (mut listed, mut poses): (Vec<Value>, Vec<Value>) = (Vec::new(), Vec::new());
    for n in 0..frames {
        let rng = &mut rng.child();
        let focus = 1.0 + faults.focus * rng.normal();
        let seen_by = head.with_focus(focus)?;
        let pose = place(rng, &seen_by);
        let scene = scene(rng, &seen_by, &pose, faults);
        let seed = u64::from(rng.bits());
        let keystone_per_px = faults.keystone_per_px(head);
        let exposure = Exposure { keystone_per_px, ..Exposure::of(seed, Detail::Everywhere) };
        let rgb = expose_full_frame(&seen_by, &scene, &scene.views[0], &exposure, stock);
        let id = format!("c{:02}", n + 1);
        put(&format!("{id}.jpg"), jpeg(&rgb, seed)?)?;
        listed.push(json!({"id": id, "file": format!("{id}.jpg"), "role": "board", "laser": "on"}));
        // The board's frame has z out of the printed side; the face's has it into the board.
        let [x, y, z] = [0, 1, 2].map(|i| pose.cam_from_face.column(i).into_owned());
        let rotation = Matrix3::from_columns(&[x, -y, -z]);
        let rows: Vec<Vec<f64>> = rotation.row_iter().map(|r| r.iter().copied().collect()).collect();
        poses.push(
            json!({"frame": id, "R_board_to_cam": rows, "t_mm": pose.centre.as_slice(), "focus": focus}),
        );
    }
    let recording = json!({
        "format": "boxline-recording/1",
        "device": {"serial": head.calibration.serial()},
        "calibration": "calibration.json",
        "frames": listed,
    });
    let board = json!({
        "format": "boxline-board/1", "kind": "circles", "columns": CIRCLES[0], "rows": CIRCLES[1], "pitch_mm": PITCH_MM,
        "diameter_mm": DIAMETER_MM, "width_mm": SIZE_MM.y, "height_mm": SIZE_MM.z, "thickness_mm": SIZE_MM.x,
    });
    for (name, value) in [
        ("recording.json", recording),
        ("board.json", board),
        ("calibration.json", head.calibration_json()),
        ("truth.json", json!({"board_poses": poses, "faults": faults.json()})),
    ] {
        put(name, serde_json::to_vec_pretty(&value).map_err(|e| Error::new(name, e))?)?;
    }
    Ok(())
}

/// A board before the head, turned and tilted, much of it in the picture.
fn place(rng: &mut Rng, head: &Head) -> FacePose {
    loop {
        let tilt = Rotation3::from_axis_angle(
            &nalgebra::Unit::new_normalize(Vector3::new(rng.normal(), rng.normal(), 0.0)),
            rng.range(0.0, MOST_TILT_DEG).to_radians(),
        );
        let roll = Rotation3::from_axis_angle(&Vector3::z_axis(), rng.range(0.0, std::f64::consts::TAU));
        let distance_mm = rng.log_range(DISTANCE_MM.0, DISTANCE_MM.1);
        let aside = Vector3::new(rng.range(-0.25, 0.25), rng.range(-0.2, 0.2), 1.0);
        let half = [0.5 * SIZE_MM.y, 0.5 * SIZE_MM.z];
        let pose = FacePose { cam_from_face: (tilt * roll).into_inner(), centre: aside * distance_mm, half };
        let seen =
            centres(0.0).filter(|[u, v]| px_of(head, &pose.point(*u, *v)).is_some_and(|px| inside(px, 30.0)));
        if seen.count() as f64 >= LEAST_SEEN * f64::from(CIRCLES[0] * CIRCLES[1]) {
            return pose;
        }
    }
}

/// Centres of the circles on the face, right and down, mm.
fn centres(stretch: f64) -> impl Iterator<Item = [f64; 2]> {
    let at = |i: u32, n: u32| (f64::from(i) - 0.5 * f64::from(n - 1)) * PITCH_MM;
    let [columns, rows] = CIRCLES;
    (0..rows).flat_map(move |r| (0..columns).map(move |c| [at(c, columns) * (1.0 + stretch), at(r, rows)]))
}

fn scene(rng: &mut Rng, head: &Head, pose: &FacePose, faults: &Faults) -> Scene {
    let centre = Vector3::new(0.0, 0.0, 1200.0);
    let white = rng.range_f32(0.7, 0.9);
    let surface = Surface {
        kind: "board",
        pattern: Pattern::Paint,
        base: v3(white, white, white),
        second: v3(white, white, white),
        strength: 0.3,
        offset: [rng.range_f32(0.0, 500.0), rng.range_f32(0.0, 500.0)],
    };
    let mut look = Appearance::bare(surface, 0.03);
    look.decals = centres(faults.stretch)
        .map(|at| Decal {
            kind: "circle",
            face: FACE,
            centre: at.map(|x| x as f32),
            turn_rad: 0.0,
            half: [0.5 * DIAMETER_MM as f32; 2],
            art: Art::Disc([28, 28, 30]),
            gloss: None,
        })
        .collect();
    let mut shape = Shape::default();
    shape.bulge_mm[FACE] = faults.bow_mm as f32;
    let half = 0.5 * SIZE_MM;
    let body = Body { centre, rotation: Matrix3::identity(), half, shape, look, role: Role::Target };
    let mut view = View::of_face(pose, FACE, centre, &half);
    let normal = Vector3::x();
    let mut light = lighting(rng, centre, pose.centre.norm());
    if faults.light > 0.0 {
        let turn = rng.range(0.0, std::f64::consts::TAU);
        let beside = Vector3::new(0.0, turn.cos(), turn.sin()) * LAMP_BESIDE_MM;
        let share = faults.light as f32;
        (light.sky, light.ground) = (light.sky * (1.0 - share), light.ground * (1.0 - share));
        let power = v3(share, share, share);
        light.lamps = vec![Lamp { at_mm: centre + normal * LAMP_BEFORE_MM + beside, width: 0.2, power }];
    }
    view.exposure =
        rng.range(0.75, 1.0) / light.free_irradiance(centre + normal * 100.0, normal).max(0.15).powf(0.9);
    Scene {
        bodies: vec![body],
        target: Some(0),
        light,
        views: vec![view],
        beams: head.beams,
        refuse: None,
        hidden: None,
        words: TruthWords { base: "none", stand: "none", neighbours: Vec::new() },
        hazards: BTreeSet::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_are_read_and_others_named() {
        let all = Faults { focus: 0.003, bow_mm: -2.0, stretch: 0.001, light: 0.8, tilt_deg: 0.3 };
        assert_eq!(Faults::parse("focus=0.003,bow=-2,stretch=0.001,light=0.8,tilt=0.3"), Ok(all));
        assert_eq!(Faults::parse(""), Ok(Faults::default()));
        for wrong in ["bow", "bow=much", "bow=inf", "shrink=1", "light=2", "tilt=9", "focus=0.1,"] {
            let found = Faults::parse(wrong);
            assert!(wrong.ends_with(',') == found.is_ok(), "{wrong}: {found:?}");
        }
    }
}
