//! `truth.json` as it is read again: what was written, in the words of the format.

use boxline_proto::json::{EndClass, parse_truth};
use boxline_sim::pose::Refuse;
use boxline_sim::tremor::Motion;
use boxline_sim::truth::{Shot, truth};
use boxline_sim::world::{Plan, compose};
use boxline_sim::{Head, Rng, Stock};

#[test]
fn what_is_written_is_read_again() {
    let head = Head::random(&mut Rng::new(21, 1)).unwrap();
    let stock = Stock::default();
    let mut ends_met = 0;
    for seed in 0..4 {
        let scene = compose(&mut Rng::new(seed, 2), &head, Plan::Box, &stock);
        let motion = Motion::of_hand(&mut Rng::new(seed, 3));
        let shots: Vec<Shot<'_>> = scene
            .views
            .iter()
            .zip([("a", None), ("b", Some(motion))])
            .map(|(view, (id, off))| Shot { scene: &scene, view, id: id.to_owned(), off })
            .collect();
        let read =
            parse_truth(truth(&head, &shots, true, &stock).to_string().as_bytes(), "truth.json").unwrap();
        assert_eq!(read.box_mm.is_some(), !read.must_refuse);
        for (face, shot) in read.faces.iter().zip(&shots) {
            assert_eq!(face.frame, shot.id);
            let pose = boxline_sim::truth::face_of(&scene, shot.view).unwrap();
            assert!((face.notes.distance_mm.unwrap() - pose.centre.norm()).abs() < 0.01);
            let hazards: Vec<&str> = scene.hazards.iter().map(|h| h.word()).collect();
            assert_eq!(face.notes.hazards.as_ref().unwrap(), &hazards);
            assert_eq!(face.notes.neighbours.as_ref().unwrap(), &scene.words.neighbours);
            let target = &scene.bodies[0];
            let bulge_mm = f64::from(target.shape.bulge_mm[shot.view.face]);
            assert!((face.notes.bulge_mm.unwrap() - bulge_mm).abs() < 0.001);
            let waves = face.notes.wave_mm.unwrap();
            assert_eq!(waves.iter().any(|w| *w > 0.0), target.shape.waves.is_some(), "{waves:?}");
            // Ends lie at the key points: on the sharp edge.
            assert_eq!(face.stripe_ends.len(), 8);
            for end in &face.stripe_ends {
                let key = face.key_points_px[&end.stripe][end.end];
                let at = end.at_px.unwrap();
                assert!((at[0] - key[0]).hypot(at[1] - key[1]) < 1e-6, "{end:?} {key:?}");
                // Nothing hides a face that is to be measured.
                assert!(end.class != EndClass::Occluded && end.class != EndClass::Border, "{end:?}");
                ends_met += usize::from(end.class != EndClass::Dark);
            }
            assert_eq!(face.cam_off_from_cam_on.is_some(), shot.off.is_some());
            if let (Some(read), Some(written)) = (face.cam_off_from_cam_on, shot.off) {
                let mrad = written.rotation_rad * 1e3;
                for axis in 0..3 {
                    assert!((read.rotation_mrad[axis] - mrad[axis]).abs() < 1e-5);
                    assert!((read.translation_mm[axis] - written.translation_mm[axis]).abs() < 1e-4);
                }
            }
        }
    }
    assert!(ends_met > 40, "only {ends_met} ends are seen");
}

#[test]
fn what_an_object_hides_is_told_by_both_lists() {
    let head = Head::nominal().unwrap();
    let stock = Stock::default();
    let mut occluded = 0;
    for seed in 0..8 {
        let scene = compose(&mut Rng::new(seed, 5), &head, Plan::Refused(Refuse::Hidden), &stock);
        let shot = Shot { scene: &scene, view: &scene.views[0], id: "o01".to_owned(), off: None };
        let read =
            parse_truth(truth(&head, &[shot], false, &stock).to_string().as_bytes(), "truth.json").unwrap();
        assert!(read.must_refuse);
        let face = &read.faces[0];
        assert_eq!(face.refuse.as_deref(), Some("face_hidden"));
        let hidden = face.hidden.as_ref().unwrap();
        assert!((-1.0..=600.0).contains(&hidden.in_front_mm.unwrap()), "{hidden:?}");
        if hidden.in_front_mm.unwrap() < 10.0 {
            continue; // what touches the face may end within the last millimetres of the stripe
        }
        for end in face.stripe_ends.iter().filter(|e| hidden.stripe_ends.contains(&(e.stripe, e.end))) {
            assert!(matches!(end.class, EndClass::Occluded | EndClass::Dark), "{end:?} {hidden:?}");
            occluded += usize::from(end.class == EndClass::Occluded);
        }
    }
    assert!(occluded >= 4, "{occluded} of 64 ends");
}
