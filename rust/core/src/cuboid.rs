//! From two or three faces to a box: which sides they share (paper eqs. 10-11), three sides, volume, and the A x A x B case.
//!
//! Each face was fitted by itself. All together are the least-squares fit of three sides to four (or six) lengths with their full
//! covariance, in which a side that two faces show is one unknown. That is the joint fit of all frames: nothing else links
//! them but the shared sides and the causes that all faces have in common ([`crate::measurement::SideUncertainty`]).

use crate::confidence::RIGHT_MM;
use crate::measurement::{BoxMeasurement, FaceMeasurement, Outcome};
use crate::reject::Reject;
use crate::statistics::chi_square_limit;
use crate::units::{Estimate, Volume};
use crate::warning::{Warning, WarningKind};
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

/// Which lengths may be one side of a box, and which boxes are told. No measurement of the first three is on record.
#[derive(Clone, Copy, Debug)]
struct CuboidSettings {
    /// Lengths of two faces that differ by no more standard deviations may be one side; two boxes, all of whose sides do, are one. More puts faces
    /// of different boxes together.
    same_sigmas: f64,
    /// ... and always by so many mm: two faces of a real box need not agree better (bulges, flaps). More takes sides that differ by so little
    /// for one.
    same_mm: f64,
    /// ... and by this share of the side. More does the same to long sides.
    same_share: f64,
    /// How often two sides of a box are equal: 0.040 of the pairs of sides of 818 boxes of the learning and choosing seeds. An assumption for
    /// boxes of the world, of which many are square at one end. More takes boxes whose sides differ by some mm for square ones.
    equal_sides_share: f64,
    /// Over how many mm the difference of two others spreads: 0.127 of these pairs are within 20 mm. More has the same effect.
    spread_mm: f64,
    /// A way to put faces together of which lengths differ by more than is allowed still counts if it has this share of the probability: a box may
    /// be wrong once in 200. More measures a wrong box in place of two that may be right.
    least_share_of_second: f64,
}

impl CuboidSettings {
    const DEFAULT: Self = Self {
        same_sigmas: 4.0,
        same_mm: 2.0,
        same_share: 0.004,
        equal_sides_share: 0.04,
        spread_mm: 330.0,
        least_share_of_second: 0.005,
    };
}

impl Default for CuboidSettings {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// Which of the box's three sides a face's length and width are.
pub(crate) type SidesOfFace = [usize; 2];

/// All ways in which faces may show the three sides of a box. The first shows sides 0 and 1, which names them. With three faces: those
/// in which each shows another pair of sides, or those in which two show the same pair (a face twice, or opposite ones).
pub(crate) fn arrangements(faces: usize, all_differ: bool) -> Vec<Vec<SidesOfFace>> {
    const PAIRS: [SidesOfFace; 6] = [[0, 2], [2, 0], [1, 2], [2, 1], [0, 1], [1, 0]];
    let missing = |face: &SidesOfFace| 3 - face[0] - face[1];
    let mut found = vec![vec![[0, 1]]];
    for _ in 1..faces {
        let longer = |known: &Vec<SidesOfFace>| {
            let known = known.clone();
            PAIRS.into_iter().map(move |pair| known.iter().copied().chain([pair]).collect::<Vec<_>>())
        };
        found = found.iter().flat_map(longer).collect();
    }
    found.retain(|arrangement| {
        let sides = (0..3).filter(|side| arrangement.iter().any(|face| face.contains(side))).count();
        let missed = (0..3).filter(|side| arrangement.iter().any(|face| missing(face) == *side)).count();
        sides == 3 && (missed == faces) == all_differ
    });
    found
}

/// Two lengths of one side, of different faces.
#[derive(Clone, Copy, Debug)]
struct SharedSide {
    first: Estimate,
    second: Estimate,
    sigma_mm: f64,
}

impl SharedSide {
    fn difference_mm(&self) -> f64 {
        self.first.value_mm - self.second.value_mm
    }

    fn limit_mm(&self) -> f64 {
        let CuboidSettings { same_sigmas, same_mm, same_share, .. } = CuboidSettings::DEFAULT;
        (same_sigmas * self.sigma_mm).max(same_mm).max(same_share * self.first.value_mm)
    }

    fn excess(&self) -> f64 {
        self.difference_mm().abs() / self.limit_mm()
    }

    /// The density of their difference if they are one side, 1/mm: Student's with 8 degrees of freedom, as sigmas are themselves estimates.
    fn density(&self) -> f64 {
        let scale_mm = self.limit_mm() / CuboidSettings::DEFAULT.same_sigmas;
        0.3867 / scale_mm * (1.0 + (self.difference_mm() / scale_mm).powi(2) / 8.0).powf(-4.5)
    }

    /// How likely they are as two sides of a box, against two that differ by some tens of mm as those of most boxes do.
    fn as_different(&self) -> f64 {
        let CuboidSettings { equal_sides_share, spread_mm, .. } = CuboidSettings::DEFAULT;
        1.0 + equal_sides_share / (1.0 - equal_sides_share) * spread_mm * self.density()
    }

    fn warning(&self) -> Option<Warning> {
        let (found, sigma) = (self.difference_mm(), self.sigma_mm);
        let chi_square = (found / sigma).powi(2);
        let warning = Warning {
            kind: WarningKind::SidesDiffer,
            laser: None,
            found,
            sigma,
            chi_square,
            limit: chi_square_limit(1),
        };
        (chi_square > chi_square_limit(1)).then_some(warning)
    }
}

/// A face's length (0) or width (1).
pub(crate) type LengthOf<'a> = (&'a FaceMeasurement, usize);

/// How well two lengths agree if they are one side: the density of their difference, 1/mm.
pub(crate) fn agreement(first: LengthOf<'_>, second: LengthOf<'_>) -> f64 {
    compared(first, second).density()
}

/// How likely two lengths are as two sides of a box, against two that differ: a box with equal sides is no rare one.
pub(crate) fn as_different_sides(first: LengthOf<'_>, second: LengthOf<'_>) -> f64 {
    compared(first, second).as_different()
}

fn compared(first: LengthOf<'_>, second: LengthOf<'_>) -> SharedSide {
    let of = |(face, i): (&FaceMeasurement, usize)| if i == 0 { face.length } else { face.width };
    let [(a, i), (b, j)] = [first, second];
    let own = a.uncertainty.own_mm2[(i, i)] + b.uncertainty.own_mm2[(j, j)];
    let differing = a.uncertainty.shared_mm.row(i) - b.uncertainty.shared_mm.row(j);
    let sigma_mm = (own + differing.norm_squared()).max(1e-12).sqrt();
    SharedSide { first: of(first), second: of(second), sigma_mm }
}

/// The lengths of all faces, two each, and their covariance.
struct Lengths {
    lengths: Vec<Estimate>,
    covariance_mm2: DMatrix<f64>,
}

impl Lengths {
    fn new(faces: &[&FaceMeasurement]) -> Self {
        let lengths: Vec<Estimate> = faces.iter().flat_map(|face| [face.length, face.width]).collect();
        let covariance_mm2 = DMatrix::from_fn(lengths.len(), lengths.len(), |row, column| {
            let (u, v) = (&faces[row / 2].uncertainty, &faces[column / 2].uncertainty);
            let own = if row / 2 == column / 2 { u.own_mm2[(row % 2, column % 2)] } else { 0.0 };
            own + u.shared_mm.row(row % 2).dot(&v.shared_mm.row(column % 2))
        });
        if covariance_mm2.clone().cholesky().is_some() {
            return Self { lengths, covariance_mm2 };
        }
        // A face that came without its causes has sigmas at least.
        let variances = lengths.iter().map(|l| l.sigma_mm.max(1e-6).powi(2));
        let least = DVector::from_iterator(lengths.len(), variances);
        Self { covariance_mm2: DMatrix::from_diagonal(&least), lengths }
    }

    /// All pairs of lengths that an arrangement takes for one side.
    fn shared(&self, sides: &[usize]) -> Vec<SharedSide> {
        let pairs = (0..sides.len()).flat_map(|i| (i + 1..sides.len()).map(move |j| (i, j)));
        pairs.filter(|(i, j)| sides[*i] == sides[*j]).map(|(i, j)| self.compared(i, j)).collect()
    }

    fn compared(&self, i: usize, j: usize) -> SharedSide {
        let c = &self.covariance_mm2;
        let sigma_mm = (c[(i, i)] + c[(j, j)] - 2.0 * c[(i, j)]).max(1e-12).sqrt();
        SharedSide { first: self.lengths[i], second: self.lengths[j], sigma_mm }
    }

    /// How likely an arrangement is, against others of the same faces: how well lengths of one side agree, and whether sides that it takes
    /// for different ones are equal.
    fn weight(&self, sides: &[usize], shared: &[SharedSide]) -> f64 {
        let first = |side: usize| sides.iter().position(|s| *s == side);
        let different =
            [(0, 1), (0, 2), (1, 2)].into_iter().filter_map(|(p, q)| Some((first(p)?, first(q)?)));
        let different = different.map(|(i, j)| self.compared(i, j).as_different());
        shared.iter().map(SharedSide::density).chain(different).product()
    }

    /// Three sides by least squares, with their covariance.
    fn adjusted(&self, sides: &[usize]) -> Option<(Vector3<f64>, Matrix3<f64>)> {
        let side_of = DMatrix::from_fn(sides.len(), 3, |row, side| f64::from(sides[row] == side));
        let values = DVector::from_iterator(sides.len(), self.lengths.iter().map(|l| l.value_mm));
        let weight = self.covariance_mm2.clone().cholesky()?.inverse();
        let normal = (side_of.transpose() * &weight * &side_of).fixed_view::<3, 3>(0, 0).into_owned();
        let covariance = normal.cholesky()?.inverse();
        let right: Vector3<f64> = (side_of.transpose() * weight * values).fixed_rows::<3>(0).into_owned();
        let found = covariance * right;
        found.iter().all(|s| s.is_finite() && *s > 0.0).then_some((found, covariance))
    }

    /// The plain mean of each side's lengths, where the covariance is no help.
    fn mean(&self, sides: &[usize]) -> (Vector3<f64>, Matrix3<f64>) {
        let of = |side: usize| (0..sides.len()).filter(move |i| sides[*i] == side);
        let values = Vector3::from_fn(|side, _| {
            of(side).map(|i| self.lengths[i].value_mm).sum::<f64>() / of(side).count().max(1) as f64
        });
        let variances =
            Vector3::from_fn(|side, _| of(side).map(|i| self.covariance_mm2[(i, i)]).fold(0.0, f64::max));
        (values, Matrix3::from_diagonal(&variances))
    }

    fn measurement(&self, sides: &[usize]) -> BoxMeasurement {
        let (found, covariance) = self.adjusted(sides).unwrap_or_else(|| self.mean(sides));
        let estimate = |i: usize| Estimate::new(found[i], covariance[(i, i)].max(0.0).sqrt());
        let mut sorted = [estimate(0), estimate(1), estimate(2)];
        sorted.sort_by(|a, b| b.value_mm.total_cmp(&a.value_mm));
        let [length, width, height] = sorted;
        let value_mm3 = found.product();
        let relative = found.map(|s| 1.0 / s);
        let sigma = (relative.transpose() * covariance * relative)[0].max(0.0).sqrt();
        let volume = Volume { value_m3: value_mm3 * 1e-9, sigma_m3: value_mm3 * 1e-9 * sigma };
        BoxMeasurement { length, width, height, volume }
    }
}

/// A way to put the faces together: which side each length is, which lengths it takes for one side, how much the worst of these differ, in
/// units of what is allowed, and how likely it is against the others.
struct SideAssignment {
    excess: f64,
    weight: f64,
    sides: Vec<usize>,
    shared: Vec<SharedSide>,
}

/// A box that a way makes.
struct Fit {
    measurement: BoxMeasurement,
    warnings: Vec<Warning>,
}

/// Puts two or three faces together, with what was noticed. `choose` settles an A x A x B box: 0 or 1.
pub(crate) fn assemble(faces: &[&FaceMeasurement], choose: Option<usize>) -> (Outcome, Vec<Warning>) {
    let lengths = Lengths::new(faces);
    let mut nearest: Option<SharedSide> = None;
    for all_differ in [true, false] {
        let mut assignments: Vec<SideAssignment> = Vec::new();
        for arrangement in arrangements(faces.len(), all_differ) {
            let sides = arrangement.concat();
            let shared = lengths.shared(&sides);
            let Some(worst) = shared.iter().copied().max_by(|a, b| a.excess().total_cmp(&b.excess())) else {
                continue;
            };
            if all_differ && nearest.is_none_or(|known: SharedSide| worst.excess() < known.excess()) {
                nearest = Some(worst);
            }
            let weight = lengths.weight(&sides, &shared);
            assignments.push(SideAssignment { excess: worst.excess(), weight, sides, shared });
        }
        if assignments.iter().all(|way| way.excess > 1.0) {
            continue; // lengths that agree nowhere make no box
        }
        let total = assignments.iter().map(|way| way.weight).sum::<f64>();
        let least = CuboidSettings::DEFAULT.least_share_of_second * total;
        assignments.retain(|way| way.excess <= 1.0 || way.weight >= least);
        assignments.sort_by(|a, b| a.excess.total_cmp(&b.excess));
        let mut possible: Vec<Fit> = Vec::with_capacity(2);
        for SideAssignment { sides, shared, .. } in &assignments {
            let measurement = lengths.measurement(sides);
            // Two ways that give the same box (a cube's) are one.
            if possible.iter().all(|p| !same_box(&p.measurement, &measurement)) {
                let warnings = shared.iter().filter_map(SharedSide::warning).collect();
                possible.push(Fit { measurement, warnings });
            }
        }
        let measured = |fit: &Fit| (Outcome::Measured(fit.measurement), fit.warnings.clone());
        match (possible.as_slice(), choose) {
            ([], _) => {}
            ([only], _) => return measured(only),
            ([one, _, ..], Some(0)) => return measured(one),
            ([_, two, ..], Some(1)) => return measured(two),
            ([one, two, ..], _) => {
                let both = Outcome::Ambiguous([one.measurement, two.measurement]);
                return (both, one.warnings.clone());
            }
        }
    }
    let reject = match nearest {
        Some(shared) => {
            let limit_mm = shared.limit_mm();
            Reject::SidesDisagree { first: shared.first, second: shared.second, limit_mm }
        }
        None => Reject::RectangleOpen { sides_found: 0 }, // of fewer than two faces: nobody asks
    };
    (Outcome::Rejected(reject), Vec::new())
}

/// Whether two outcomes are the same box within their uncertainties.
pub(crate) fn same_outcome(a: &Outcome, b: &Outcome) -> bool {
    match (a, b) {
        (Outcome::Measured(a), Outcome::Measured(b)) => same_box(a, b),
        (Outcome::Ambiguous([a, b]), Outcome::Ambiguous([c, d])) => same_box(a, c) && same_box(b, d),
        _ => false,
    }
}

/// Whether two boxes are one, so that either is right if the other is: a result is right within [`RIGHT_MM`], however large its sigmas.
fn same_box(a: &BoxMeasurement, b: &BoxMeasurement) -> bool {
    let CuboidSettings { same_sigmas, same_mm, .. } = CuboidSettings::DEFAULT;
    let near = |x: Estimate, y: Estimate| {
        let by_sigmas = same_sigmas * x.sigma_mm.hypot(y.sigma_mm);
        (x.value_mm - y.value_mm).abs() <= same_mm.max(by_sigmas.min(0.5 * RIGHT_MM))
    };
    near(a.length, b.length) && near(a.width, b.width) && near(a.height, b.height)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measurement::SideUncertainty;
    use nalgebra::Matrix2;

    fn face(length: f64, width: f64) -> FaceMeasurement {
        let uncertainty = SideUncertainty { own_mm2: Matrix2::identity() * 0.16, ..Default::default() };
        FaceMeasurement { uncertainty, ..FaceMeasurement::made_up(length, width) }
    }

    fn assembled(first: &FaceMeasurement, second: &FaceMeasurement, choose: Option<usize>) -> Outcome {
        assemble(&[first, second], choose).0
    }

    #[test]
    fn the_shared_side_is_averaged_and_the_others_kept() {
        let Outcome::Measured(b) = assembled(&face(550.0, 300.4), &face(550.6, 350.0), None) else {
            panic!()
        };
        assert!((b.length.value_mm - 550.3).abs() < 1e-9);
        assert_eq!((b.width.value_mm, b.height.value_mm), (350.0, 300.4));
        assert!((b.volume.value_m3 - 0.5503 * 0.35 * 0.3004).abs() < 1e-9);
    }

    #[test]
    fn two_equal_faces_are_ambiguous_until_chosen() {
        let (a, b) = (face(500.0, 300.0), face(500.3, 300.2));
        let Outcome::Ambiguous(c) = assembled(&a, &b, None) else { panic!() };
        assert!((c[0].width.value_mm - c[1].width.value_mm).abs() > 100.0);
        for (i, candidate) in c.iter().enumerate() {
            assert_eq!(assembled(&a, &b, Some(i)), Outcome::Measured(*candidate));
        }
    }

    /// Four lengths within their sigmas of each other, of a box of 106.7 x 100 x 100 mm: it is not known whether the long sides or
    /// the short ones meet.
    #[test]
    fn nearly_a_cube_is_no_cube() {
        let wide = |length: f64, width: f64| {
            let uncertainty = SideUncertainty { own_mm2: Matrix2::identity() * 1.5, ..Default::default() };
            FaceMeasurement { uncertainty, ..FaceMeasurement::made_up(length, width) }
        };
        let Outcome::Ambiguous([one, two]) = assembled(&wide(107.8, 101.2), &wide(106.4, 100.0), None) else {
            panic!()
        };
        assert!((one.width.value_mm - two.width.value_mm).abs() > 4.0, "{one:?} {two:?}");
    }

    /// Both faces of a box of 130.3 x 100 x 100 mm, one of them long by four sigmas: 132.6 x 129.5 x 100 mm is likelier if any difference is as
    /// good as none, but boxes are square at one end more often than their sides differ by 3 mm.
    #[test]
    fn sides_that_nearly_agree_may_be_one() {
        let outcome = assembled(&face(129.5, 99.85), &face(132.6, 100.17), None);
        let Outcome::Ambiguous([one, two]) = outcome else { panic!("{outcome:?}") };
        assert!((one.width.value_mm - two.width.value_mm).abs() > 20.0, "{one:?} {two:?}");
        // Ten millimetres are no error of theirs.
        assert!(matches!(assembled(&face(129.5, 99.85), &face(139.5, 100.17), None), Outcome::Measured(_)));
    }

    #[test]
    fn a_third_face_settles_which_box_it_is() {
        let (a, b) = (face(500.0, 300.0), face(500.3, 300.2));
        for (third, box_mm) in [
            (face(500.2, 499.9), [500.0, 500.0, 300.0]), // A x A
            (face(300.1, 299.8), [500.0, 300.0, 300.0]), // B x B
        ] {
            for order in [[&a, &b, &third], [&a, &third, &b], [&third, &b, &a]] {
                let (Outcome::Measured(b), warnings) = assemble(&order, None) else { panic!() };
                let found = [b.length, b.width, b.height];
                assert!(found.iter().zip(box_mm).all(|(l, due)| (l.value_mm - due).abs() < 0.4), "{found:?}");
                assert!(warnings.is_empty());
            }
        }
        // The same face once more settles nothing.
        let again = face(499.9, 300.1);
        assert!(matches!(assemble(&[&a, &b, &again], None).0, Outcome::Ambiguous(_)));
    }

    #[test]
    fn with_three_faces_every_side_is_a_mean_of_two_and_a_wrong_one_shows() {
        let (a, b, c) = (face(550.0, 300.4), face(550.6, 350.0), face(350.4, 300.0));
        let (Outcome::Measured(found), _) = assemble(&[&a, &b, &c], None) else { panic!() };
        for (side, mean) in [(found.length, 550.3), (found.width, 350.2), (found.height, 300.2)] {
            assert!((side.value_mm - mean).abs() < 1e-9 && (side.sigma_mm - 0.4 / 2f64.sqrt()).abs() < 1e-9);
        }
        let long = face(380.0, 300.0);
        let (Outcome::Rejected(Reject::SidesDisagree { first, second, .. }), _) =
            assemble(&[&a, &b, &long], None)
        else {
            panic!()
        };
        assert_eq!([first.value_mm, second.value_mm], [350.0, 380.0]);
    }

    #[test]
    fn a_face_seen_twice_counts_twice() {
        let (a, b, again) = (face(550.0, 300.0), face(550.0, 350.0), face(551.0, 300.0));
        let (Outcome::Measured(found), _) = assemble(&[&a, &b, &again], None) else { panic!() };
        assert!((found.length.value_mm - 1651.0 / 3.0).abs() < 1e-9, "{:?}", found.length);
        assert_eq!(found.width.value_mm, 350.0);
    }

    #[test]
    fn a_cube_is_not_ambiguous() {
        assert!(matches!(assembled(&face(300.2, 300.0), &face(300.1, 299.9), None), Outcome::Measured(_)));
    }

    #[test]
    fn faces_of_two_boxes_are_refused_with_the_numbers() {
        let Outcome::Rejected(Reject::SidesDisagree { first, second, limit_mm }) =
            assembled(&face(500.0, 300.0), &face(420.0, 250.0), None)
        else {
            panic!()
        };
        assert!((first.value_mm - second.value_mm).abs() > limit_mm);
    }

    #[test]
    fn what_both_faces_share_does_not_average_out() {
        let shared = SideUncertainty { own_mm2: Matrix2::identity() * 0.04, ..SideUncertainty::default() };
        // One cause that scales everything by a thousandth.
        let scaled = |length: f64, width: f64| {
            let mut uncertainty = shared;
            uncertainty.shared_mm[(0, 0)] = length * 1e-3;
            uncertainty.shared_mm[(1, 0)] = width * 1e-3;
            FaceMeasurement { uncertainty, ..face(length, width) }
        };
        let Outcome::Measured(b) = assembled(&scaled(550.0, 300.0), &scaled(550.2, 350.0), None) else {
            panic!()
        };
        assert!((b.length.sigma_mm - (0.02f64 + 0.55 * 0.55).sqrt()).abs() < 1e-3, "{:?}", b.length);
        // Three sides of a common scale: three thousandths of the volume, not the square root of three.
        let relative = b.volume.sigma_m3 / b.volume.value_m3;
        assert!((3.0e-3..3.3e-3).contains(&relative), "{relative}");
    }

    #[test]
    fn a_shared_side_that_differs_beyond_its_sigmas_is_told() {
        let (outcome, warnings) = assemble(&[&face(500.0, 300.0), &face(501.9, 350.0)], None);
        assert!(matches!(outcome, Outcome::Measured(_)));
        let [warning] = warnings[..] else { panic!("{warnings:?}") };
        assert_eq!(warning.kind, WarningKind::SidesDiffer);
        assert!((warning.found + 1.9).abs() < 1e-9 && (warning.sigma - 0.566).abs() < 0.01);
        assert!(assemble(&[&face(500.0, 300.0), &face(501.0, 350.0)], None).1.is_empty());
    }
}
