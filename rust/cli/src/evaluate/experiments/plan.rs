//! What the paper measured (section 4), as rendered twins: nine poses of one face (Table 3), boxes in one place (Table 4) and in ten
//! (Table 5), and one box under other optics and with other faces (section 4.4).

use anyhow::Context;
use boxline_sim::pose::place_seen_from;
use boxline_sim::render::sensor::Optics;
use boxline_sim::world::twin::{BOXES_MM, Finish, Order, ViewDirection, twin};
use boxline_sim::world::{Scene, View};
use boxline_sim::{Head, Rng, Stock};
use nalgebra::Vector3;
use rayon::prelude::*;
use std::sync::Arc;

/// Table 3: a face of 800 x 600 mm, seen from so many degrees to the right of its normal and above it.
pub const FACE_MM: [f64; 2] = [800.0, 600.0];
const FROM_DEG: [(&str, [f64; 2]); 9] = [
    ("straight on", [0.0, 0.0]),
    ("30° left", [-30.0, 0.0]),
    ("30° right", [30.0, 0.0]),
    ("30° up", [0.0, 30.0]),
    ("30° down", [0.0, -30.0]),
    ("60° left", [-60.0, 0.0]),
    ("60° right", [60.0, 0.0]),
    ("60° up", [0.0, 60.0]),
    ("60° down", [0.0, -60.0]),
];
/// The stripes then run along the face's edges.
const ROLL_DEG: f64 = 45.0;
/// How deep that box is, and how high it stands: it is seen from 60 degrees below. mm.
const DEPTH_MM: f64 = 500.0;
const COLUMN_MM: f64 = 1000.0;
/// Those of [`BOXES_MM`] that Table 4 has.
const OF_TABLE_4: [usize; 3] = [0, 2, 5];
/// Section 4.4: one box, its optics, its surfaces, and outward bulges (negative: dents) of its faces, mm.
pub const BOX_MM: [f64; 3] = [600.0, 400.0, 300.0];
const OPTICS: [(&str, Optics); 3] =
    [("sharp", Optics::Sharp), ("usual", Optics::Usual), ("blurred", Optics::Blurred)];
const FINISHES: [(&str, Finish); 3] =
    [("matt", Finish::Matt), ("printed", Finish::Printed), ("glossy", Finish::Glossy)];
const BULGES_MM: [f32; 6] = [0.0, 2.0, 4.0, 8.0, -2.0, -4.0];
/// Places from which a box is measured, except in Table 4.
pub const PLACES: usize = 10;
/// Farthest from looking straight at a face of a box, degrees.
pub const MOST_DEG: f64 = 25.0;

/// One of the paper's experiments.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Table {
    /// Table 3.
    Poses,
    /// Table 4.
    Repeated,
    /// Table 5.
    Boxes,
    /// Section 4.4, optics and surfaces.
    Optics,
    /// Section 4.4, deformed faces.
    Bulges,
}

impl Table {
    /// Its name in the csv and in JSON.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Poses => "table 3",
            Self::Repeated => "table 4",
            Self::Boxes => "table 5",
            Self::Optics => "optics",
            Self::Bulges => "bulges",
        }
    }

    /// How often the paper measured each line of it.
    pub const fn papers_shots(self) -> u64 {
        match self {
            Self::Poses => 30,
            Self::Repeated => 15,
            Self::Boxes | Self::Optics | Self::Bulges => 10,
        }
    }
}

/// One line of a table: what is measured again and again.
#[derive(Clone, Debug)]
pub struct Experiment {
    pub table: Table,
    pub name: String,
    /// True length and width of a face, or length, width, height of a box.
    pub sides_mm: Vec<f64>,
    /// Least and largest distance of the head to a face's middle.
    pub distance_mm: [f64; 2],
}

/// What is measured, where it stands and how it is looked at.
pub struct Subject {
    pub what: Experiment,
    pub scene: Arc<Scene>,
    /// Views of one shot in each place: one of a face, two of a box.
    pub places: Vec<Vec<usize>>,
    pub optics: Optics,
    /// Seed of its shots; the same where only optics or surface differ.
    pub seed: u64,
}

impl Subject {
    /// The views of a shot.
    pub fn views(&self, shot: u64) -> &[usize] {
        &self.places[(shot % self.places.len() as u64) as usize]
    }

    fn new(
        (table, name): (Table, String),
        sides_mm: &[f64],
        scene: &Arc<Scene>,
        places: Vec<Vec<usize>>,
        seed: u64,
    ) -> Self {
        let distance = |view: &usize| {
            let view: &View = &scene.views[*view];
            boxline_sim::truth::face_of(scene, view).map_or(f64::NAN, |face| face.centre.norm())
        };
        let distance_mm = places
            .iter()
            .flatten()
            .map(distance)
            .fold([f64::INFINITY, 0.0], |[least, most], d| [least.min(d), most.max(d)]);
        let what = Experiment { table, name, sides_mm: sides_mm.to_vec(), distance_mm };
        Self { what, scene: Arc::clone(scene), places, optics: Optics::AsFound, seed }
    }
}

/// One order for a scene and what is measured in it.
struct Draft {
    seed: u64,
    order: Order,
    tables: Vec<(Table, String, Optics)>,
}

/// All that is measured, in the order of the page.
pub fn subjects(head: &Head, stock: &Stock, seed: u64) -> anyhow::Result<Vec<Subject>> {
    let mut subjects = poses(head, stock, seed)?;
    let drafts: Vec<Draft> = drafts();
    let scenes: Vec<anyhow::Result<Scene>> =
        drafts.par_iter().map(|draft| scene(head, stock, seed, draft.seed, &draft.order)).collect();
    for (draft, scene) in drafts.into_iter().zip(scenes) {
        let scene = Arc::new(scene?);
        let [length, height, width] = draft.order.size_mm.into();
        for (table, name, optics) in draft.tables {
            let places = (0..scene.views.len() / 2).map(|place| vec![2 * place, 2 * place + 1]).collect();
            let sides_mm = [length, width, height];
            let subject = Subject::new((table, name), &sides_mm, &scene, places, draft.seed);
            subjects.push(Subject { optics, ..subject });
        }
    }
    // Surfaces share a scene over all optics; the page has them by optics.
    let place = |s: &Subject| OPTICS.iter().position(|(_, optics)| *optics == s.optics);
    subjects.sort_by_key(|s| (s.what.table as usize, place(s)));
    Ok(subjects)
}

fn scene(head: &Head, stock: &Stock, seed: u64, purpose: u64, order: &Order) -> anyhow::Result<Scene> {
    twin(&mut Rng::new(seed, purpose), head, order, stock).with_context(|| {
        format!(
            "no place for the twin of {:?} mm with seed {seed}: another seed has one",
            order.size_mm.as_slice()
        )
    })
}

/// One box, looked at from all directions, as near as it can be measured from each.
fn poses(head: &Head, stock: &Stock, seed: u64) -> anyhow::Result<Vec<Subject>> {
    let mut views = Vec::with_capacity(FROM_DEG.len());
    for (name, from_deg) in FROM_DEG {
        let pose = place_seen_from(head, FACE_MM, from_deg, ROLL_DEG)
            .with_context(|| format!("{name}: no distance at which all eight key points are in the frame"))?;
        views.push((3, ViewDirection::At(pose)));
    }
    let order = Order {
        size_mm: Vector3::new(FACE_MM[0], DEPTH_MM, FACE_MM[1]),
        bulge_mm: 0.0,
        finish: Finish::AsDrawn,
        column_mm: Some(COLUMN_MM),
        views,
    };
    let scene = Arc::new(scene(head, stock, seed, 0x7AB3, &order)?);
    let subject = |(i, (name, _)): (usize, &(&str, _))| {
        Subject::new((Table::Poses, (*name).into()), &FACE_MM, &scene, vec![vec![i]], 0x7AB3_0000 + i as u64)
    };
    Ok(FROM_DEG.iter().enumerate().map(subject).collect())
}

/// The boxes. Front is length x width, the right side height x width.
fn drafts() -> Vec<Draft> {
    let order = |[length, width, height]: [f64; 3], places: usize| {
        let aim = ViewDirection::ByHand { most_deg: MOST_DEG };
        Order {
            size_mm: Vector3::new(length, height, width),
            bulge_mm: 0.0,
            finish: Finish::AsDrawn,
            column_mm: None,
            views: (0..places).flat_map(|_| [(3, aim), (0, aim)]).collect(),
        }
    };
    let name = |size: [f64; 3]| size.map(|s| s.to_string()).join(" x ");
    let mut drafts = Vec::new();
    for index in OF_TABLE_4 {
        let tables = vec![(Table::Repeated, name(BOXES_MM[index]), Optics::AsFound)];
        drafts.push(Draft { seed: 0x7AB4_0000 + index as u64, order: order(BOXES_MM[index], 1), tables });
    }
    for (index, size_mm) in BOXES_MM.into_iter().enumerate() {
        let tables = vec![(Table::Boxes, name(size_mm), Optics::AsFound)];
        drafts.push(Draft { seed: 0x7AB5_0000 + index as u64, order: order(size_mm, PLACES), tables });
    }
    // One box in the same places: nothing else changes.
    let seed = 0x7AB6_0000;
    for (surface, finish) in FINISHES {
        let of = |(name, optics)| (Table::Optics, format!("{name}, {surface}"), optics);
        let order = Order { finish, ..order(BOX_MM, PLACES) };
        drafts.push(Draft { seed, order, tables: OPTICS.map(of).to_vec() });
    }
    for bulge_mm in BULGES_MM {
        let tables = vec![(Table::Bulges, format!("{bulge_mm:+.0} mm"), Optics::AsFound)];
        drafts.push(Draft { seed, order: Order { bulge_mm, ..order(BOX_MM, PLACES) }, tables });
    }
    drafts
}

#[cfg(test)]
mod tests {
    use super::*;
    use boxline_sim::Split;

    #[test]
    fn the_paper_s_poses_are_within_reach_and_are_what_they_are_called() {
        let head = Head::nominal().unwrap();
        let subjects = poses(&head, &Stock::new(Split::HeldOut), 1).unwrap();
        assert_eq!(subjects.len(), 9);
        for subject in &subjects {
            let view = subject.views(7)[0];
            let face = boxline_sim::truth::face_of(&subject.scene, &subject.scene.views[view]).unwrap();
            assert_eq!(face.size_mm(), FACE_MM);
            let angle: f64 = subject.what.name.split('°').next().unwrap().parse().unwrap_or(0.0);
            let found = face.angle_to_normal_rad().to_degrees();
            assert!((found - angle).abs() < 1e-6, "{}: {found} degrees", subject.what.name);
            assert!(face.crossings(&head, 6.0, 60.0).is_some(), "{}", subject.what.name);
            assert!(face.centre.norm() < 2500.0, "{}", subject.what.name);
        }
    }
}
