//! What the residuals of a fitted face say beside its size. Four stripes and four sides are 16 line coefficients for 8
//! unknowns (PHYSICS.md); the other 8 must be zero within their sigmas: 5 say whether the stripes lie on one plane (asked again for
//! each laser by itself, which is the sharper question if one has moved), 3 whether
//! the sides form a rectangle. Four more say whether each stripe is straight.
//!
//! Each check adds unknowns to the fit and asks how far from zero they come out (a score test: one linear step from the
//! solution, no second fit). Their covariance is that of the noise and of all known causes: a laser that drifted as
//! lasers do, or an edge that its background moves, is no failure.

use super::refine::{FittedRectangle, weigh_all};
use super::surface;
use super::uncertainty::{CAUSES, Causes, EDGES, TILTS};
use crate::calibration::Calibration;
use crate::face::model::{Row, SHAPE, Source};
use crate::face::outline::{SIDES, span_mm};
use crate::face_geometry::SIDE_SYSTEMATIC_PX;
use crate::statistics::{chi_square_limit, median};
use crate::units::LaserId;
use crate::warning::{Warning, WarningKind};
use nalgebra::{DMatrix, DVector, Matrix3, SMatrix, SVector, Vector3};

/// Whether the stripes lie on one plane is asked twice, each time for one sound face in two thousand: in general (the quantile at 0.9995 with
/// 5 degrees of freedom), and for each laser by itself (at 0.999875 with 1, the largest of four), which sees the tilt of one laser at a
/// smaller chi-square.
const LIMIT_5: f64 = 22.11;
const LIMIT_EACH: f64 = 14.71;

/// What the checks take for noise and known causes.
#[derive(Clone, Copy, Debug)]
struct CheckSettings {
    /// Ends of a stripe against those of the parabola through it, as a share of that one's height: 0 for a parabola, 0.20 and 0.27 for its
    /// square and cube, which are flat towards the ends. More takes a dent for a bow, and makes sigmas of bowed faces larger.
    no_parabola: f64,
    /// A laser is named if no other explains the stripes as well: its chi-square is larger by this (odds of 1 to 20). More leaves more lasers
    /// without a name.
    clearly: f64,
    /// Fewest centres with which a stripe's line and bend can be judged. A face with a stripe of fewer is not checked at all: more leaves small
    /// faces without checks.
    least_centres: usize,
    /// Variance that the noise about a parabola does not show: the sum of correlations ends where it is lost in noise, which leaves out
    /// about a tenth of it for neighbours that go together by 0.6. More misses what fails by little.
    unseen_noise: f64,
    /// How far the ends of a side move against each other since its rounding is seen at another angle there, mm, 1 sigma: a quarter of a
    /// radius of 1.7 mm. More misses sides that are tilted.
    rounding_turn_mm: f64,
    /// Steps of a robust parabola. More takes longer.
    rounds: usize,
}

impl CheckSettings {
    const DEFAULT: Self = Self {
        no_parabola: 0.25,
        clearly: 6.0,
        least_centres: 12,
        unseen_noise: 1.15,
        rounding_turn_mm: 0.4,
        rounds: 5,
    };
}

impl Default for CheckSettings {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// Added unknowns: shift and slope of each stripe (8), bend of each stripe (4), shape of the four sides (3).
const LINES: std::ops::Range<usize> = 0..8;
const BENDS: std::ops::Range<usize> = 8..12;
const SHAPES: std::ops::Range<usize> = 12..15;
const ADDED: usize = 15;
/// With the fit's.
const SIZE: usize = SHAPE + ADDED;

/// What the checks of one face found.
#[derive(Clone, Debug, Default)]
pub(crate) struct ConsistencyChecks {
    pub warnings: Vec<Warning>,
    /// Tilt of a laser that the stripes show, rad, if the check failed.
    pub tilt_rad: Option<f64>,
    /// How far the sides may lie from the plane, mm, because the face is not flat.
    pub off_plane_mm: f64,
    /// How far the two lengths (across a, across b) may be off because the sides form no rectangle, 1 sigma, mm: a side that is tilted
    /// against the others, since it bulges or because a part of it is another line, lies somewhere within its tilt.
    pub tilted_mm: [f64; 2],
    /// Where one bow of the whole face explains the stripes: what it adds to each residual of a stripe, px, in the order of the rows;
    /// zero at the stripes' ends, which lie on the sides.
    pub bow_px: Vec<f64>,
}

/// Runs all checks.
pub(super) fn check(
    calibration: &Calibration,
    fit: &FittedRectangle,
    causes: &Causes,
    drift_rad: f64,
) -> Option<ConsistencyChecks> {
    let settings = &CheckSettings::default();
    let rows = &own_noise(&fit.rows, settings)?;
    // What the stripes say among themselves: the sides, whose shape is another question, have no part in it.
    let along = along_stripes(rows, settings.least_centres)?;
    let mut sums = Sums::new(settings.rounding_turn_mm);
    sums.add(rows, &along, causes, |source| matches!(source, Source::Stripe(_)));
    let stripes = sums.system();
    let mut found = ConsistencyChecks::default();
    coplanar(&stripes, drift_rad, settings.clearly, &mut found)?;
    straight(&stripes, calibration, fit, settings, &mut found)?;
    sums.add(rows, &along, causes, |source| matches!(source, Source::Edge(_)));
    rectangular(&sums.system(), fit, &mut found)?;
    Some(found)
}

/// Normal equations of the fit with the added unknowns; the first [`SHAPE`] indices are the fit's, then the added ones.
struct System {
    normal: DMatrix<f64>,
    score: DVector<f64>,
    /// What one of each unknown is in its own unit.
    units: DVector<f64>,
    /// Change of the score for one sigma of each cause.
    by_cause: DMatrix<f64>,
}

/// [`System`] while observations are added, each unknown in its own unit.
struct Sums {
    normal: SMatrix<f64, SIZE, SIZE>,
    score: SVector<f64, SIZE>,
    /// One column for each unknown.
    by_cause: SMatrix<f64, CAUSES, SIZE>,
    rounding_turn_mm: f64,
}

impl Sums {
    fn new(rounding_turn_mm: f64) -> Self {
        let (normal, score, by_cause) = (SMatrix::zeros(), SVector::zeros(), SMatrix::zeros());
        Self { normal, score, by_cause, rounding_turn_mm }
    }

    fn add(&mut self, rows: &[Row], along: &[f64], causes: &Causes, counts: impl Fn(Source) -> bool) {
        for (i, row) in rows.iter().enumerate().filter(|(_, r)| r.weight > 0.0 && counts(r.source)) {
            // Few of the columns belong to a row: stripes have no shape, sides no lines.
            let mut column = [(0, 0.0); SHAPE + 3];
            for (k, c) in column.iter_mut().enumerate().take(SHAPE) {
                *c = (k, row.derivative_px[k]);
            }
            match row.source {
                Source::Stripe(laser) => {
                    let t = along[i];
                    column[SHAPE] = (SHAPE + 2 * laser, 1.0);
                    column[SHAPE + 1] = (SHAPE + 2 * laser + 1, t);
                    column[SHAPE + 2] = (SHAPE + BENDS.start + laser, 1.5 * t * t - 0.5);
                }
                Source::Edge(_) => {
                    for k in 0..3 {
                        column[SHAPE + k] = (SHAPE + SHAPES.start + k, row.derivative_px[SHAPE + k]);
                    }
                }
            }
            let mut effect = causes.on_residuals_px[i];
            if let Source::Edge(side) = row.source {
                // A side also turns by how its rounding is seen along it.
                let px = self.rounding_turn_mm / row.mm_per_px.max(1e-9);
                effect[EDGES + 4 + side] *= (px / SIDE_SYSTEMATIC_PX).hypot(1.0);
            }
            for (a, x) in column.into_iter().filter(|(_, x)| *x != 0.0) {
                // The residual is observation minus model where it grows with the unknowns, so what is added explains it
                // with the same sign.
                let weighted = x * row.weight;
                self.score[a] += weighted * row.px;
                for (b, y) in column {
                    self.normal[(b, a)] += y * weighted;
                }
                let mut by_cause = self.by_cause.column_mut(a);
                by_cause += effect * weighted;
            }
        }
    }

    /// All unknowns alike, since they have sizes from 1e-4 to 1e3.
    fn system(&self) -> System {
        let units = self.normal.diagonal().map(|n| if n > 0.0 { 1.0 / n.sqrt() } else { 0.0 });
        let scale = SMatrix::<f64, SIZE, SIZE>::from_diagonal(&units);
        System {
            normal: DMatrix::from_iterator(SIZE, SIZE, (scale * self.normal * scale).iter().copied()),
            score: DVector::from_iterator(SIZE, self.score.component_mul(&units).iter().copied()),
            units: DVector::from_iterator(SIZE, units.iter().copied()),
            by_cause: DMatrix::from_iterator(
                SIZE,
                CAUSES,
                (scale * self.by_cause.transpose()).iter().copied(),
            ),
        }
    }
}

impl System {
    /// The unknowns `wanted` with `others` free beside them.
    fn test(&self, wanted: &[usize], others: &[usize]) -> Option<Test> {
        let part = |rows: &[usize], columns: &[usize]| self.normal.select_rows(rows).select_columns(columns);
        let pass = part(wanted, others) * part(others, others).cholesky()?.inverse();
        let score = self.score.select_rows(wanted) - &pass * self.score.select_rows(others);
        let information = part(wanted, wanted) - &pass * part(others, wanted);
        let by_cause = self.by_cause.select_rows(wanted) - &pass * self.by_cause.select_rows(others);
        let covariance = &information + &by_cause * by_cause.transpose();
        let unit = self.units[*wanted.first()?];
        Some(Test { inverse: inverse(covariance)?, information, score, by_cause, unit })
    }
}

/// The score of some added unknowns with its covariance.
struct Test {
    score: DVector<f64>,
    information: DMatrix<f64>,
    /// Inverse of the score's covariance.
    inverse: DMatrix<f64>,
    by_cause: DMatrix<f64>,
    /// What one of the first unknown is in its own unit.
    unit: f64,
}

impl Test {
    fn chi_square(&self) -> f64 {
        (self.score.transpose() * &self.inverse * &self.score)[0]
    }

    /// Best value of the only unknown and its sigma.
    fn single(&self) -> (f64, f64) {
        let unit = self.unit / self.information[(0, 0)].max(1e-300);
        (self.score[0] * unit, unit / self.inverse[(0, 0)].max(1e-300).sqrt())
    }

    /// Best value of a cause in its sigmas, its own sigma, and the chi-square that it explains.
    fn of_cause(&self, cause: usize) -> (f64, f64, f64) {
        let shape = self.by_cause.column(cause);
        let power = (shape.transpose() * &self.inverse * shape)[0].max(1e-300);
        let pull = (shape.transpose() * &self.inverse * &self.score)[0];
        (pull / power, 1.0 / power.sqrt(), pull * pull / power)
    }
}

/// Inverse where the observations say something, zero where they do not: the plane already explains three combinations of
/// the stripes' lines. Unknowns are scaled so that what is said is of the order of 1; what is left of the three is below
/// 1e-4, since distortion bends lines a little.
fn inverse(matrix: DMatrix<f64>) -> Option<DMatrix<f64>> {
    matrix.pseudo_inverse(1e-3).ok()
}

/// The rows with weights from their noise about a parabola of each stripe and side of its own. In the fit's weights a stripe that lies
/// off the plane as a whole, which is what the checks look for, would count as noise and excuse itself.
fn own_noise(rows: &[Row], settings: &CheckSettings) -> Option<Vec<Row>> {
    let mut own = rows.to_vec();
    for laser_or_side in 0..4 {
        for source in [Source::Stripe(laser_or_side), Source::Edge(laser_or_side)] {
            let members: Vec<usize> = (0..rows.len()).filter(|i| rows[*i].source == source).collect();
            let count = members.len();
            if count < settings.least_centres {
                continue;
            }
            let shape = |k: usize| {
                let t = 2.0 * k as f64 / (count - 1) as f64 - 1.0;
                Vector3::new(1.0, t, 1.5 * t * t - 0.5)
            };
            let mut curve = Vector3::zeros();
            let mut scale = f64::INFINITY;
            for _ in 0..settings.rounds {
                let mut normal = Matrix3::zeros();
                let mut right = Vector3::zeros();
                for (k, i) in members.iter().enumerate() {
                    let off = (rows[*i].px - curve.dot(&shape(k))) / (rows[*i].sigma_px * scale);
                    let weight = (rows[*i].sigma_px * (1.0 + off * off)).powi(-2);
                    normal += shape(k) * shape(k).transpose() * weight;
                    right += shape(k) * (weight * rows[*i].px);
                }
                curve = normal.cholesky()?.solve(&right);
                let sizes = members
                    .iter()
                    .enumerate()
                    .map(|(k, i)| ((rows[*i].px - curve.dot(&shape(k))) / rows[*i].sigma_px).abs());
                scale = 3.0 * median(sizes)?.max(0.1);
            }
            // Three of so many went into the parabola.
            let lost = (count as f64 / (count as f64 - 3.0)).sqrt();
            for (k, i) in members.iter().enumerate() {
                own[*i].px = (rows[*i].px - curve.dot(&shape(k))) * lost;
            }
        }
    }
    weigh_all(&mut own);
    for (own, row) in own.iter_mut().zip(rows) {
        own.px = row.px;
        own.weight /= settings.unseen_noise;
    }
    Some(own)
}

/// Position of each row along its stripe, -1 to 1. `None` if a stripe has too few centres.
fn along_stripes(rows: &[Row], least_centres: usize) -> Option<Vec<f64>> {
    let mut along = vec![0.0; rows.len()];
    for laser in 0..4 {
        let of_stripe = |r: &Row| r.source == Source::Stripe(laser) && r.weight > 0.0;
        let used: Vec<usize> = (0..rows.len()).filter(|i| of_stripe(&rows[*i])).collect();
        if used.len() < least_centres {
            return None;
        }
        let (first, last) = (rows[*used.first()?].at, rows[*used.last()?].at);
        let length = first.distance_px(last).max(1.0);
        let (du, dv) = ((last.u - first.u) / length, (last.v - first.v) / length);
        for i in (0..rows.len()).filter(|i| rows[*i].source == Source::Stripe(laser)) {
            let at = rows[i].at;
            along[i] = 2.0 * ((at.u - first.u) * du + (at.v - first.v) * dv) / length - 1.0;
        }
    }
    Some(along)
}

/// Do the stripes lie on one plane, and which laser explains it if not?
fn coplanar(system: &System, drift_rad: f64, clearly: f64, found: &mut ConsistencyChecks) -> Option<()> {
    let lines: Vec<usize> = LINES.map(|i| SHAPE + i).collect();
    let plane: Vec<usize> = (0..3).collect();
    let test = system.test(&lines, &plane)?;
    let chi_square = test.chi_square();
    // A cause is given for a tilt of `drift_rad`; beside it, the drift that is normal stays in the covariance.
    let mut lasers: Vec<_> =
        LaserId::ALL.into_iter().map(|id| (id, test.of_cause(TILTS + id.index()))).collect();
    lasers.sort_by(|a, b| b.1.2.total_cmp(&a.1.2));
    let (likeliest, (tilt, sigma, explained)) = lasers[0];
    let (chi_square, limit) = match (chi_square > LIMIT_5, explained > LIMIT_EACH) {
        (false, false) => return Some(()),
        (true, _) => (chi_square, LIMIT_5),
        (false, true) => (explained, LIMIT_EACH),
    };
    let named = explained > lasers[1].1.2 + clearly;
    found.tilt_rad = Some(tilt * drift_rad);
    found.warnings.push(Warning {
        kind: WarningKind::LaserMoved,
        laser: named.then_some(likeliest),
        found: tilt * drift_rad,
        sigma: sigma * drift_rad,
        chi_square,
        limit,
    });
    Some(())
}

/// Is each stripe straight?
fn straight(
    system: &System,
    calibration: &Calibration,
    fit: &FittedRectangle,
    settings: &CheckSettings,
    found: &mut ConsistencyChecks,
) -> Option<()> {
    let bends: Vec<usize> = BENDS.map(|i| SHAPE + i).collect();
    // Each stripe's own shift and slope, which hold all that the plane could explain.
    let others: Vec<usize> = LINES.map(|i| SHAPE + i).collect();
    let chi_square = system.test(&bends, &others)?.chi_square();
    if chi_square <= chi_square_limit(4) {
        return Some(());
    }
    let mut most: Option<Warning> = None;
    let mut stripes = Vec::with_capacity(4);
    for id in LaserId::ALL {
        let (bend, sigma) = system.test(&bends[id.index()..=id.index()], &others)?.single();
        let height_mm = height_of_px(fit, id);
        // The bend grows from -1/2 in the middle of the stripe to 1 at its ends.
        let (sagitta_mm, sigma_mm) = (-1.5 * bend * height_mm, 1.5 * sigma * height_mm.abs());
        // On a bow over the whole face, a parabola each way, a stripe bends the less the nearer it is to the sides beside it.
        let share = 1.0 - beside_middle(calibration, fit, id)?.powi(2);
        stripes.push(Bent { bend, sigma, by_mm: -share / (1.5 * height_mm) });
        if most.is_none_or(|m| sagitta_mm.abs() > m.found.abs()) {
            most = Some(Warning {
                kind: WarningKind::FaceNotFlat,
                laser: Some(id),
                found: sagitta_mm,
                sigma: sigma_mm,
                chi_square,
                limit: chi_square_limit(4),
            });
        }
    }
    if let Some(warning) = most {
        // The sides lie where the stripes end: two thirds of the sagitta off the mean plane.
        found.off_plane_mm = warning.found.abs() / 1.5;
        found.warnings.push(warning);
    }
    if let Some(bow_mm) = common_bow_mm(&stripes, settings.no_parabola) {
        let along = along_stripes(&fit.rows, settings.least_centres)?;
        let stripe = |r: &Row| if let Source::Stripe(laser) = r.source { stripes.get(laser) } else { None };
        found.bow_px = fit
            .rows
            .iter()
            .zip(along)
            .map(|(row, t)| stripe(row).map_or(0.0, |s| 1.5 * s.by_mm * bow_mm * (t * t - 1.0)))
            .collect();
        found.off_plane_mm = bow_mm.abs() * settings.no_parabola;
    }
    Some(())
}

/// How one stripe is bent.
struct Bent {
    /// The added unknown and its sigma, px.
    bend: f64,
    sigma: f64,
    /// What 1 mm of bow in the middle of the face makes of it, px.
    by_mm: f64,
}

/// Height of the one bow that bends all stripes as they are bent, mm. `None` if they bend otherwise: print, or a dent somewhere.
fn common_bow_mm(stripes: &[Bent], no_parabola: f64) -> Option<f64> {
    let weighed =
        |of: &dyn Fn(&Bent) -> f64| stripes.iter().map(|s| of(s) / (s.sigma * s.sigma)).sum::<f64>();
    let power = weighed(&|s| s.by_mm * s.by_mm);
    let bow_mm = weighed(&|s| s.by_mm * s.bend) / power;
    let left = |s: &Bent| {
        let expected = s.by_mm * bow_mm;
        (s.bend - expected).powi(2) / (s.sigma.powi(2) + (no_parabola * expected).powi(2))
    };
    let chi_square: f64 = stripes.iter().map(left).sum();
    // Without any weight it is no number.
    (chi_square <= chi_square_limit(3) && bow_mm.is_finite()).then_some(bow_mm)
}

/// Where a stripe runs between the two sides beside it, -1 to 1.
fn beside_middle(calibration: &Calibration, fit: &FittedRectangle, id: LaserId) -> Option<f64> {
    let (across, _) = SIDES.into_iter().find(|(across, _)| across.stripes().contains(&id))?;
    let side = SIDES.iter().position(|(a, _)| *a == across)?;
    let (from, to) = span_mm(&fit.offsets_mm, side);
    let of_stripe = fit.rows.iter().filter(|r| r.source == Source::Stripe(id.index()) && r.weight > 0.0);
    let (sum, count) = of_stripe
        .filter_map(|r| fit.raster.on_plane(calibration, r.at))
        .fold((0.0, 0.0), |(s, n), at| (s + across.along(at), n + 1.0));
    Some((2.0 * (sum / f64::max(count, 1.0) - from) / (to - from) - 1.0).clamp(-1.0, 1.0))
}

/// Mean over a stripe of [`surface::height_of_px`], mm.
fn height_of_px(fit: &FittedRectangle, id: LaserId) -> f64 {
    let of_stripe = fit.rows.iter().filter(|r| r.source == Source::Stripe(id.index()) && r.weight > 0.0);
    let (sum, count) = of_stripe.fold((0.0, 0.0), |(s, n), r| (s + surface::height_of_px(fit, r), n + 1.0));
    sum / f64::max(count, 1.0)
}

/// Do the four sides form a rectangle?
fn rectangular(system: &System, fit: &FittedRectangle, found: &mut ConsistencyChecks) -> Option<()> {
    let [a0, a1, b0, b1] = fit.offsets_mm;
    // Opposite sides at an angle make the two others differ: their distance changes by it along the side.
    let lengths_mm = [1.0, b1 - b0, a1 - a0];
    for (k, length_mm) in lengths_mm.into_iter().enumerate() {
        let wanted = SHAPE + SHAPES.start + k;
        let beside = SHAPES.map(|i| SHAPE + i).filter(|i| *i != wanted);
        let others: Vec<usize> = (0..SHAPE).chain(beside).collect();
        let test = system.test(&[wanted], &others)?;
        let chi_square = test.chi_square();
        if chi_square <= chi_square_limit(1) {
            continue;
        }
        let (missing, sigma) = test.single();
        // Evenly within the tilt of a side over its length; two sides at an angle differ by what one of them is tilted.
        let evenly_mm = |length_mm: f64| (missing * length_mm).abs() / 12f64.sqrt();
        for (i, tilted_mm) in found.tilted_mm.iter_mut().enumerate() {
            if k == 0 || k == i + 1 {
                *tilted_mm = tilted_mm.hypot(evenly_mm(lengths_mm[i + 1]));
            }
        }
        found.warnings.push(Warning {
            kind: if k == 0 { WarningKind::NotRightAngled } else { WarningKind::OppositeEdges },
            laser: None,
            // The residual is minus what the unknown has to make good.
            found: -missing * length_mm,
            sigma: sigma * length_mm,
            chi_square,
            limit: chi_square_limit(1),
        });
    }
    Some(())
}
