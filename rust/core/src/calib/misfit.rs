//! Does the model fit the frames, or is only the residual small? What a lens, a board or a mount does that the model has not is no
//! noise: neighbours share it. Each pattern here is a few unknowns added to the solved adjustment; one linear step from the solution says
//! how large they come out and how much of the residuals they explain (a score test, Rao 1948). The pattern that explains most is named, then
//! those that explain more beside it.

use super::adjust::{Fixed, FrameSeen, Loss, Scatter, residuals, rms_of_centres, weight};
use super::model::{POSE, Row, SHARED, Shared, centre_rows, point_on_board, px_by_point, stripe_row};
use super::rim::median;
use crate::eigen::symmetric_eigen;
use crate::units::Px;
use nalgebra::{DMatrix, DVector, SMatrix, SVector, Vector2, Vector3};

/// What may be wrong with a set of frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MisfitKind {
    /// The distortion has another shape than the lens's terms. Size: what it shifts circles by, px rms an axis.
    Lens,
    /// The board is no plane. Size: how far its middle stands before its corners or behind, mm.
    BoardBowed,
    /// The board's pitch along its columns is not that along its rows, or they are not at right angles. Size: the difference as a share.
    BoardStretched,
    /// The focal length changes from frame to frame. Size: by which share, rms.
    FocusChanges,
    /// The picture is shifted on the sensor from frame to frame: the lens or the sensor is loose. Size: px rms.
    Shifted,
    /// The boards of the frames are not one board, or frames show rows and columns of one exchanged that is stretched: a part of a grid does
    /// not tell which are which. Size: difference of their pitches as a share, rms.
    BoardsDiffer,
}

impl MisfitKind {
    /// All kinds.
    pub const ALL: [Self; 6] = [
        Self::Lens,
        Self::BoardBowed,
        Self::BoardStretched,
        Self::FocusChanges,
        Self::Shifted,
        Self::BoardsDiffer,
    ];

    /// The stable name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Lens => "lens",
            Self::BoardBowed => "board_bowed",
            Self::BoardStretched => "board_stretched",
            Self::FocusChanges => "focus_changes",
            Self::Shifted => "shifted",
            Self::BoardsDiffer => "boards_differ",
        }
    }

    /// Unknowns of a pattern that all frames share, and those that each frame has for itself.
    const fn unknowns(self) -> (usize, usize) {
        match self {
            Self::Lens => (2 * LENS_POWERS.len(), 0),
            Self::BoardBowed => (3, 0),
            Self::BoardStretched => (2, 0),
            Self::FocusChanges => (0, 1),
            Self::Shifted | Self::BoardsDiffer => (0, 2),
        }
    }
}

/// A pattern that is in the residuals.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Misfit {
    /// Which.
    pub kind: MisfitKind,
    /// How large, in the unit of its kind.
    pub size: f64,
    /// Root mean square of the circles' residuals an axis, px.
    pub rms_px: f64,
    /// How single circles scatter about their neighbours, an axis, px: what it would be if all fitted.
    pub single_px: f64,
    /// What speaks for it, and what one sound set in a thousand exceeds.
    pub chi_square: f64,
    /// See there.
    pub limit: f64,
}

impl std::fmt::Display for Misfit {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let size = self.size;
        match self.kind {
            MisfitKind::Lens => {
                write!(f, "the lens does not fit: it shifts circles by {size:.3} px rms an axis")?
            }
            MisfitKind::BoardBowed => write!(f, "the board is bowed by {size:.2} mm")?,
            MisfitKind::BoardStretched => {
                write!(
                    f,
                    "the board is {:.3} % larger along its columns than along its rows, or skewed",
                    100.0 * size
                )?;
            }
            MisfitKind::FocusChanges => {
                write!(f, "the focal length changes between frames by {:.3} % rms", 100.0 * size)?;
            }
            MisfitKind::Shifted => {
                write!(f, "frames are shifted on the sensor against each other by {size:.2} px rms")?
            }
            MisfitKind::BoardsDiffer => {
                write!(
                    f,
                    "the frames show boards whose pitches differ by {:.3} % rms, or one whose rows and columns differ",
                    100.0 * size
                )?;
            }
        }
        write!(
            f,
            " (circles are off by {:.3} px rms, where single ones scatter by {:.3} px)",
            self.rms_px, self.single_px
        )
    }
}

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
/// Quantile of the normal distribution that one set in a thousand exceeds.
const ONE_IN_A_THOUSAND: f64 = 3.09;
/// A pattern must explain this share of the residuals' squares: below, they rise by less than 3 % for it, and covariance takes that in.
const LEAST_EXPLAINED: f64 = 0.05;
/// Combinations of which less than this share of the information is left once poses and camera are free are none: they are a pose's or
/// the camera's (a board and planes that grow together are the same picture), and what is left is rounding.
const LEAST_KNOWN: f64 = 1e-6;

/// The solved adjustment whose residuals are asked.
pub(super) struct Solved<'a> {
    pub shared: &'a Shared,
    pub frames: &'a [FrameSeen],
    pub scatter: &'a Scatter,
    pub fixed: Fixed,
    pub image_px: [usize; 2],
}

/// The patterns in the residuals, the one that explains most first.
pub(super) fn misfits(solved: &Solved) -> Vec<Misfit> {
    let mut found: Vec<Misfit> = Vec::new();
    let mut kinds: Vec<MisfitKind> = Vec::new();
    // Chi-square and unknowns of the patterns so far.
    let mut before = (0.0, 0);
    let rms_px = rms_of_centres(solved.shared, solved.frames).norm() / std::f64::consts::SQRT_2;
    let single_px = solved.single_px();
    let mut left: f64 = 1.0;
    loop {
        let more = MisfitKind::ALL.into_iter().filter(|kind| !kinds.contains(kind)).filter_map(|kind| {
            let wider: Vec<MisfitKind> = kinds.iter().copied().chain([kind]).collect();
            let explained = solved.explained_by(&wider)?;
            let chi_square = explained.chi_square - before.0;
            let limit = one_in_a_thousand(explained.unknowns.saturating_sub(before.1).max(1) as f64);
            let then = (1.0 - explained.chi_square / explained.total).clamp(0.0, 1.0);
            let told = chi_square >= limit && left - then >= LEAST_EXPLAINED;
            told.then_some((kind, explained, chi_square, limit, then))
        });
        let best = more.max_by(|a, b| a.1.worth().total_cmp(&b.1.worth()));
        let Some((kind, explained, chi_square, limit, then)) = best else { return found };
        let own = solved.columns(kind);
        let first = explained.values.len() - own;
        let of_kind = |all: &DVector<f64>| all.rows(first, own).into_owned();
        let size = solved.size(kind, &of_kind(&explained.values), &of_kind(&explained.variances));
        let size = size.unwrap_or(rms_px * (left - then).sqrt());
        found.push(Misfit { kind, size, rms_px, single_px, chi_square, limit });
        kinds.push(kind);
        (before, left) = ((explained.chi_square, explained.unknowns), then);
    }
}

/// Wilson and Hilferty's quantile of chi-square.
fn one_in_a_thousand(degrees: f64) -> f64 {
    let part = 2.0 / (9.0 * degrees);
    degrees * (1.0 - part + ONE_IN_A_THOUSAND * part.sqrt()).powi(3)
}

/// What added unknowns do.
struct Explained {
    chi_square: f64,
    /// Weighted sum of squares of all residuals: of as many independent ones.
    total: f64,
    /// Combinations of the added unknowns that the frames tell.
    unknowns: usize,
    values: DVector<f64>,
    variances: DVector<f64>,
}

impl Explained {
    /// For choosing between patterns with few unknowns and with many (Schwarz's criterion).
    fn worth(&self) -> f64 {
        self.chi_square - self.unknowns as f64 * self.total.ln()
    }
}

impl Solved<'_> {
    fn columns(&self, kind: MisfitKind) -> usize {
        let (common, own) = kind.unknowns();
        common + own * self.frames.len()
    }

    fn columns_of(&self, kinds: &[MisfitKind]) -> usize {
        kinds.iter().map(|kind| self.columns(*kind)).sum()
    }

    /// From the residual of each circle against the mean of its two neighbours in the list, which are its neighbours on the board.
    fn single_px(&self) -> f64 {
        let off = self.frames.iter().flat_map(|frame| {
            let (centres, _) = residuals(self.shared, frame);
            let against = |w: &[Vector2<f64>]| w[1] - 0.5 * (w[0] + w[2]);
            centres.windows(3).map(against).flat_map(|d| [d.x.abs(), d.y.abs()]).collect::<Vec<_>>()
        });
        // Of one and half a variance.
        median(off).map_or(0.0, |m| m / 0.6745 / 1.5f64.sqrt())
    }

    /// Adds the unknowns of these patterns. `None` if a frame cannot be computed.
    fn explained_by(&self, kinds: &[MisfitKind]) -> Option<Explained> {
        let added = self.columns_of(kinds);
        let size = SHARED + added;
        let mut information = DMatrix::<f64>::zeros(size, size);
        let mut alone = DVector::<f64>::zeros(size);
        let mut right = DVector::<f64>::zeros(size);
        let mut total = 0.0;
        for (i, frame) in self.frames.iter().enumerate() {
            let mut mixed = DMatrix::<f64>::zeros(size, POSE);
            let mut own = SMatrix::<f64, POSE, POSE>::zeros();
            let mut own_right = SVector::<f64, POSE>::zeros();
            let mut add = |row: &Row, by_added: &DVector<f64>, sigma_px: f64, share: f64| {
                let w = weight(row.px / sigma_px, Loss::Tukey) / (share * sigma_px * sigma_px);
                total += w * row.px * row.px;
                if w > 0.0 {
                    let mut by = DVector::zeros(size);
                    by.rows_mut(0, SHARED).copy_from(&row.by_shared);
                    by.rows_mut(SHARED, added).copy_from(by_added);
                    information.ger(w, &by, &by, 1.0);
                    alone += by.map(|x| w * x * x);
                    mixed.ger(w, &by, &row.by_pose, 1.0);
                    own.ger(w, &row.by_pose, &row.by_pose, 1.0);
                    right.axpy(-w * row.px, &by, 1.0);
                    own_right -= row.by_pose * (w * row.px);
                }
            };
            for seen in &frame.centres {
                let rows = centre_rows(self.shared, &frame.pose, seen.board_mm, seen.at)?;
                let by_added = self.centre_by(kinds, i, frame, seen.board_mm, &rows)?;
                for (row, by_added) in rows.iter().zip(&by_added) {
                    add(row, by_added, seen.sigma_px * self.scatter.centres, self.scatter.centre_correlation);
                }
            }
            for seen in &frame.stripes {
                let row = stripe_row(self.shared, &frame.pose, seen.laser, seen.at)?;
                let by_added = self.stripe_by(kinds, i, frame, seen.at, &row)?;
                add(&row, &by_added, seen.sigma_px * self.scatter.stripes, self.scatter.stripe_correlation);
            }
            let inverse = own.cholesky()?.inverse();
            let product = &mixed * inverse;
            information -= &product * mixed.transpose();
            right -= product * own_right;
        }
        // What is fixed takes no part.
        for i in (0..SHARED).filter(|i| self.fixed.contains(*i)) {
            information.row_mut(i).fill(0.0);
            information.column_mut(i).fill(0.0);
            (information[(i, i)], alone[i]) = (1.0, 1.0);
            right[i] = 0.0;
        }
        // Each in units of what it would be known by alone, then the added ones with the camera free.
        let units = alone.map(|v| 1.0 / v.max(1e-300).sqrt());
        let scale = DMatrix::from_diagonal(&units);
        let (information, right) = (&scale * information * &scale, scale * right);
        let of = |i: usize, j: usize, n: usize, m: usize| information.view((i, j), (n, m)).into_owned();
        let camera = of(0, 0, SHARED, SHARED).cholesky()?;
        let across = of(SHARED, 0, added, SHARED);
        let reduced = of(SHARED, SHARED, added, added) - &across * camera.solve(&across.transpose());
        let score = right.rows(SHARED, added) - &across * camera.solve(&right.rows(0, SHARED).into_owned());
        let eigen = symmetric_eigen(&(0.5 * (&reduced + reduced.transpose())));
        let (mut values, mut variances) = (DVector::zeros(added), DVector::zeros(added));
        let (mut chi_square, mut unknowns) = (0.0, 0);
        for (value, vector) in
            eigen.values.iter().zip(eigen.vectors.column_iter()).filter(|(v, _)| **v > LEAST_KNOWN)
        {
            let along = vector.dot(&score);
            chi_square += along * along / value;
            unknowns += 1;
            values += vector * (along / value);
            variances += vector.map(|x| x * x / value);
        }
        let units = units.rows(SHARED, added).into_owned();
        Some(Explained {
            chi_square,
            total,
            unknowns,
            values: values.component_mul(&units),
            variances: variances.component_mul(&units.map(|u| u * u)),
        })
    }

    /// The shifts that a lens may make at a place of the sensor, [`LENS_POWERS`] each.
    fn lens_shifts(&self, at: Px) -> impl Iterator<Item = f64> + use<> {
        let [width, height] = self.image_px.map(|n| n as f64);
        let half = 0.5 * width.max(height);
        let (x, y) = ((at.u - 0.5 * (width - 1.0)) / half, (at.v - 0.5 * (height - 1.0)) / half);
        LENS_POWERS.into_iter().map(move |[m, n]| x.powi(m) * y.powi(n))
    }

    /// How a circle's two residuals change with the unknowns of these patterns.
    fn centre_by(
        &self,
        kinds: &[MisfitKind],
        frame: usize,
        seen: &FrameSeen,
        board_mm: Vector2<f64>,
        rows: &[Row; 2],
    ) -> Option<[DVector<f64>; 2]> {
        let added = self.columns_of(kinds);
        let mut by = [DVector::zeros(added), DVector::zeros(added)];
        let (px, by_point, _) = px_by_point(&self.shared.camera, &point_on_board(&seen.pose, board_mm))?;
        // Observed minus projected: what moves the projection moves the residual the other way.
        let moved = |point: Vector3<f64>| -(by_point * point);
        let axis = |i: usize| -> Vector3<f64> { seen.pose.rotation.column(i).into() };
        let mut first = 0;
        for kind in kinds {
            let mut put = |i: usize, value: Vector2<f64>| {
                by[0][first + i] = value.x;
                by[1][first + i] = value.y;
            };
            let by_camera = |i: usize| Vector2::new(rows[0].by_shared[i], rows[1].by_shared[i]);
            match kind {
                MisfitKind::Lens => {
                    for (i, shift) in self.lens_shifts(px).enumerate() {
                        put(2 * i, Vector2::new(-shift, 0.0));
                        put(2 * i + 1, Vector2::new(0.0, -shift));
                    }
                }
                MisfitKind::BoardBowed => {
                    for (i, up) in bow(board_mm).into_iter().enumerate() {
                        put(i, moved(axis(2) * up));
                    }
                }
                MisfitKind::BoardStretched => {
                    put(0, moved(axis(0) * board_mm.x));
                    put(1, moved(axis(0) * board_mm.y));
                }
                MisfitKind::FocusChanges => {
                    let c = &self.shared.camera;
                    put(frame, by_camera(0) * c.fx + by_camera(1) * c.fy);
                }
                MisfitKind::Shifted => {
                    put(2 * frame, by_camera(2));
                    put(2 * frame + 1, by_camera(3));
                }
                MisfitKind::BoardsDiffer => {
                    put(2 * frame, moved(axis(0) * board_mm.x + axis(1) * board_mm.y));
                    put(2 * frame + 1, moved(axis(0) * board_mm.x));
                }
            }
            first += self.columns(*kind);
        }
        Some(by)
    }

    /// How a stripe's residual changes with them.
    fn stripe_by(
        &self,
        kinds: &[MisfitKind],
        frame: usize,
        seen: &FrameSeen,
        at: Px,
        row: &Row,
    ) -> Option<DVector<f64>> {
        let added = self.columns_of(kinds);
        let mut by = DVector::zeros(added);
        let mut first = 0;
        for kind in kinds {
            match kind {
                MisfitKind::Lens => {
                    // A picture that is shifted here is as if cx and cy were.
                    for (i, shift) in self.lens_shifts(at).enumerate() {
                        by[first + 2 * i] = row.by_shared[2] * shift;
                        by[first + 2 * i + 1] = row.by_shared[3] * shift;
                    }
                }
                MisfitKind::BoardBowed => {
                    let on_board = super::rim::on_board(&self.shared.camera, &seen.pose, at)?;
                    // The board that much nearer along its normal: what the pose's shift along it does.
                    let normal: Vector3<f64> = seen.pose.rotation.column(2).into();
                    let up = row.by_pose.fixed_rows::<3>(3).dot(&normal);
                    for (i, height) in bow(on_board).into_iter().enumerate() {
                        by[first + i] = up * height;
                    }
                }
                MisfitKind::FocusChanges => {
                    let c = &self.shared.camera;
                    by[first + frame] = row.by_shared[0] * c.fx + row.by_shared[1] * c.fy;
                }
                MisfitKind::Shifted => {
                    by[first + 2 * frame] = row.by_shared[2];
                    by[first + 2 * frame + 1] = row.by_shared[3];
                }
                // A stripe does not care where on the board it lies.
                MisfitKind::BoardStretched | MisfitKind::BoardsDiffer => {}
            }
            first += self.columns(*kind);
        }
        Some(by)
    }

    /// The size of a pattern from its unknowns; of a lens it is told by the residuals.
    fn size(&self, kind: MisfitKind, values: &DVector<f64>, variances: &DVector<f64>) -> Option<f64> {
        // Variance of what each frame has for itself, beyond what noise gives it.
        let spread = |first: usize, step: usize| {
            let own = || (first..values.len()).step_by(step);
            let n = own().count() as f64;
            let mean = own().map(|i| values[i]).sum::<f64>() / n;
            (own().map(|i| (values[i] - mean).powi(2) - variances[i]).sum::<f64>() / n).max(0.0)
        };
        match kind {
            MisfitKind::Lens => None,
            MisfitKind::BoardBowed => {
                let all = self.frames.iter().flat_map(|f| f.centres.iter().map(|c| c.board_mm));
                let height = |at| bow(at).into_iter().zip(values.iter()).map(|(h, v)| h * v).sum::<f64>();
                let (low, high) = all.map(height).fold((0.0f64, 0.0f64), |(l, h), x| (l.min(x), h.max(x)));
                Some(high - low)
            }
            MisfitKind::BoardStretched => Some(values[0].abs().max(values[1].abs())),
            MisfitKind::FocusChanges => Some(spread(0, 1).sqrt()),
            MisfitKind::Shifted | MisfitKind::BoardsDiffer => Some((spread(0, 2) + spread(1, 2)).sqrt()),
        }
    }
}

/// Heights of the three shapes of a bowed board at a place on it, mm for 1 mm at 1 m from the middle.
fn bow(at_mm: Vector2<f64>) -> [f64; 3] {
    let at = at_mm / 1000.0;
    [at.x * at.x, at.x * at.y, at.y * at.y]
}
