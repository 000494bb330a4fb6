//! Patterns that the model has not, as unknowns beside camera, planes and poses: how each moves circles and stripes, and what the frames
//! tell about them.

use super::adjust::{
    Fixed, FrameObservations, Loss, Scatter, adjust, own_sigmas, residuals, scatter, weight,
};
use super::board::Board;
use super::fields::{Fields, SHIFTS, ShiftsAt, TILTS, lens_shifts};
use super::misfit_kind::MisfitKind;
use super::model::{POSE, Row, SHARED, Shared, centre_rows, point_on_board, px_by_point, stripe_row};
use boxline::eigen::symmetric_eigen;
use boxline::statistics::robust_sigma;
use boxline::units::Px;
use nalgebra::{DMatrix, DVector, Matrix2, SMatrix, SVector, Vector2, Vector3};

/// Powers of x and y, the place on the board, of which the height of a bowed one consists. A sheet that is held at its border or carries
/// its own weight bends with the fourth power.
const BOW_POWERS: [[i32; 2]; 12] =
    [[2, 0], [1, 1], [0, 2], [3, 0], [2, 1], [1, 2], [0, 3], [4, 0], [3, 1], [2, 2], [1, 3], [0, 4]];
/// A board of a metre stands out by this much at so many m from its middle.
const BOW_MM: f64 = 2.0;
const BOW_AT_M: f64 = 0.6;
/// Paper and plates grow with moisture and heat by a thousandth.
const STRETCH: f64 = 0.001;
/// A lens breathes by this share.
const FOCUS: f64 = 0.003;
/// A loose lens.
const SHIFT_PX: f64 = 5.0;
/// What a lens's terms leave; under the paper's terms a decentred lens leaves some px.
const LENS_PX: f64 = 3.0;
/// A sensor is soldered askew by tenths of a degree.
const TILT_RAD: f64 = 0.005;
/// Combinations of which less than this share of the information is left once poses and camera are free are none: they are a pose's or
/// the camera's (a board and planes that grow together are the same picture), and what is left is rounding.
const LEAST_KNOWN: f64 = 1e-6;

/// Patterns side by side, their unknowns in this order; a tilted sensor's are the last.
#[derive(Clone)]
pub(super) struct Patterns {
    pub kinds: Vec<MisfitKind>,
    pub frames: usize,
    /// 1, or -1 for frames that show columns and rows of a stretched board exchanged; `None`: each frame's board is stretched by itself.
    pub signs: Option<Vec<f64>>,
    /// What a tilted sensor and a lens shift, of which the camera takes nothing; without it the sensor is not tilted, and a lens's shifts are
    /// any.
    pub fields: Option<Fields>,
}

impl Patterns {
    /// Number of unknowns of a pattern.
    pub fn columns(&self, kind: MisfitKind) -> usize {
        let each_by_itself = kind == MisfitKind::BoardStretched && self.signs.is_none();
        let (common, own) = if each_by_itself { (0, 2) } else { kind.unknowns() };
        common + own * self.frames
    }

    /// Unknowns of the first patterns.
    fn before(&self, patterns: usize) -> usize {
        self.kinds[..patterns].iter().map(|kind| self.columns(*kind)).sum()
    }

    /// Signs of frames that are chosen for a pattern. All the other way round is the same.
    pub fn free_signs(&self, kind: MisfitKind) -> usize {
        if kind == MisfitKind::BoardStretched { self.frames - 1 } else { 0 }
    }

    pub fn all_columns(&self) -> usize {
        self.tilt() + if self.fields.is_some() { TILTS } else { 0 }
    }

    /// Number of the first unknown of a pattern.
    pub fn first(&self, kind: MisfitKind) -> Option<usize> {
        self.kinds.iter().position(|k| *k == kind).map(|at| self.before(at))
    }

    /// Number of the first unknown of a tilted sensor.
    pub fn tilt(&self) -> usize {
        self.before(self.kinds.len())
    }

    /// What each unknown may be before frames are seen, standard deviations.
    pub fn usual(&self) -> DVector<f64> {
        let of_kind = |kind: &MisfitKind| (0..self.columns(*kind)).map(|i| kind.usual(i)).collect::<Vec<_>>();
        let tilt = [TILT_RAD; TILTS];
        let all = self.kinds.iter().flat_map(of_kind).chain(tilt).take(self.all_columns());
        DVector::from_iterator(self.all_columns(), all)
    }

    pub fn last(&self) -> Option<MisfitKind> {
        self.kinds.last().copied()
    }

    pub fn with(&self, kind: MisfitKind) -> Self {
        let mut wider = self.clone();
        wider.kinds.push(kind);
        wider
    }
}

/// The solved adjustment whose residuals are asked.
#[derive(Clone)]
pub(super) struct Solved {
    pub shared: Shared,
    pub frames: Vec<FrameObservations>,
    pub scatter: Scatter,
    pub fixed: Fixed,
    pub image_px: [usize; 2],
    pub board: Board,
}

impl MisfitKind {
    /// Unknowns of a pattern that all frames share, and those that each frame has for itself.
    const fn unknowns(self) -> (usize, usize) {
        match self {
            Self::Lens => (SHIFTS, 0),
            Self::BoardBowed => (BOW_POWERS.len(), 0),
            Self::BoardStretched => (2, 0),
            Self::FocusChanges => (0, 1),
            Self::Shifted | Self::BoardsDiffer => (0, 2),
        }
    }

    /// What an unknown may be before frames are seen, a standard deviation: as much as heads and boards are found to be off.
    fn usual(self, i: usize) -> f64 {
        match self {
            Self::Lens => LENS_PX,
            Self::BoardBowed => {
                let [m, n] = BOW_POWERS[i];
                BOW_MM / BOW_AT_M.powi(m + n)
            }
            // Half of the difference of the pitches.
            Self::BoardStretched | Self::BoardsDiffer => 0.5 * STRETCH,
            Self::FocusChanges => FOCUS,
            Self::Shifted => SHIFT_PX,
        }
    }
}

/// What the frames tell about unknowns once all others are free: normal equations.
pub(super) struct ReducedSystem {
    pub information: DMatrix<f64>,
    pub right: DVector<f64>,
    /// One over the root of the information if all others were known.
    pub units: DVector<f64>,
}

impl ReducedSystem {
    /// Values and directions, in `units`, of the combinations that are known.
    fn known(&self) -> impl Iterator<Item = (f64, DVector<f64>)> {
        let scale = DMatrix::from_diagonal(&self.units);
        let eigen = symmetric_eigen(&(&scale * &self.information * &scale));
        let vectors: Vec<DVector<f64>> = eigen.vectors.column_iter().map(|v| v.into_owned()).collect();
        let values: Vec<f64> = eigen.values.iter().copied().collect();
        values.into_iter().zip(vectors).filter(|(value, _)| *value > LEAST_KNOWN)
    }

    /// Values of the unknowns, which are these now, that are normal about 0 before frames are seen.
    pub fn total(&self, values: &DVector<f64>, sigmas: &DVector<f64>) -> Option<DVector<f64>> {
        let right = (&self.right + &self.information * values).component_mul(sigmas);
        Some(self.beside(sigmas).cholesky()?.solve(&right).component_mul(sigmas))
    }

    /// Information in units of these standard deviations, with what is known before.
    pub fn beside(&self, sigmas: &DVector<f64>) -> DMatrix<f64> {
        let scale = DMatrix::from_diagonal(sigmas);
        DMatrix::identity(sigmas.len(), sigmas.len()) + &scale * &self.information * &scale
    }

    fn step(&self) -> DVector<f64> {
        let right = self.right.component_mul(&self.units);
        let mut step = DVector::zeros(right.len());
        self.known().for_each(|(value, along)| step += &along * (along.dot(&right) / value));
        step.component_mul(&self.units)
    }

    /// What speaks against these unknowns being zero, how many combinations of them are known, and their variances.
    pub fn chi_square(&self, values: &DVector<f64>) -> (f64, usize, DVector<f64>) {
        let values = values.component_div(&self.units);
        let mut variances = DVector::zeros(values.len());
        let (mut chi_square, mut unknowns) = (0.0, 0);
        for (value, along) in self.known() {
            chi_square += value * along.dot(&values).powi(2);
            unknowns += 1;
            variances += along.map(|x| x * x / value);
        }
        (chi_square, unknowns, variances.component_mul(&self.units).component_mul(&self.units))
    }

    /// With the first unknowns free: what is told about the others.
    fn without_first(&self, n: usize) -> Self {
        let rest = self.right.len() - n;
        let view =
            |i: usize, j: usize, n: usize, m: usize| self.information.view((i, j), (n, m)).into_owned();
        let first = Self {
            information: view(0, 0, n, n),
            right: self.right.rows(0, n).into_owned(),
            units: self.units.rows(0, n).into_owned(),
        };
        let across = view(n, 0, rest, n);
        let mut information = view(n, n, rest, rest);
        for (value, along) in first.known() {
            let by = &across * along.component_mul(&first.units);
            information.ger(-1.0 / value, &by, &by, 1.0);
        }
        Self {
            information,
            right: self.right.rows(n, rest) - &across * first.step(),
            units: self.units.rows(n, rest).into_owned(),
        }
    }
}

/// Unknowns that a residual depends on, and by how much.
type By = Vec<(usize, f64)>;

impl Solved {
    /// From the residual of each circle against the mean of its two neighbours in the list, which are its neighbours on the board.
    pub fn single_px(&self) -> f64 {
        let off = self.frames.iter().flat_map(|frame| {
            let (centres, _) = residuals(&self.shared, frame);
            let against = |w: &[Vector2<f64>]| w[1] - 0.5 * (w[0] + w[2]);
            centres.windows(3).map(against).flat_map(|d| [d.x, d.y]).collect::<Vec<_>>()
        });
        // Of one and half a variance.
        robust_sigma(off).map_or(0.0, |sigma| sigma / 1.5f64.sqrt())
    }

    /// Solved again, from `near`, with observations from which patterns of these values are taken.
    pub fn without(&self, near: &Self, patterns: &Patterns, values: &DVector<f64>) -> Option<Self> {
        let of = |by: &By| by.iter().map(|(i, by)| by * values[*i]).sum::<f64>();
        let mut left = near.clone();
        for (i, (frame, seen)) in left.frames.iter_mut().zip(&self.frames).enumerate() {
            for (c, seen) in frame.centres.iter_mut().zip(&seen.centres) {
                let rows = centre_rows(&near.shared, &near.frames[i].pose, c.board_mm, c.at)?;
                let [u, v] = near.centre_by(patterns, i, c.board_mm, c.board_mm, &rows)?;
                c.at = Px::new(seen.at.u + of(&u), seen.at.v + of(&v));
            }
            for (s, seen) in frame.stripes.iter_mut().zip(&seen.stripes) {
                let row = stripe_row(&near.shared, &near.frames[i].pose, s.laser, seen.at)?;
                let off_px = of(&near.stripe_by(patterns, i, seen.at, &row)?);
                // Across the stripe, the way that the residual grows by one px a px.
                let line = super::model::board_plane(&near.frames[i].pose) - near.shared.planes[s.laser];
                let (_, by_px) = near.shared.camera.ray_from_px_with_jacobian(seen.at);
                let across = (by_px.transpose() * line.xy()).normalize();
                s.at = Px::new(seen.at.u + across.x * off_px, seen.at.v + across.y * off_px);
            }
        }
        own_sigmas(&left.shared, &mut left.frames);
        left.scatter = scatter(&left.shared, &left.frames);
        adjust(&mut left.shared, &mut left.frames, &left.scatter, self.fixed, Loss::Tukey)?;
        own_sigmas(&left.shared, &mut left.frames);
        left.scatter = scatter(&left.shared, &left.frames);
        Some(left)
    }

    /// What is told about the unknowns of these patterns from `asked` on, poses, camera and the patterns before them free.
    pub fn reduced(&self, patterns: &Patterns, asked: usize) -> Option<ReducedSystem> {
        Some(self.normal_equations(patterns)?.without_first(SHARED + patterns.before(asked)))
    }

    /// What is told about camera, planes and the unknowns of these patterns, poses free.
    pub fn normal_equations(&self, patterns: &Patterns) -> Option<ReducedSystem> {
        let size = SHARED + patterns.all_columns();
        let mut information = DMatrix::<f64>::zeros(size, size);
        let mut alone = DVector::<f64>::zeros(size);
        let mut right = DVector::<f64>::zeros(size);
        for (i, frame) in self.frames.iter().enumerate() {
            let mut mixed = DMatrix::<f64>::zeros(size, POSE);
            let mut own = SMatrix::<f64, POSE, POSE>::zeros();
            let mut own_right = SVector::<f64, POSE>::zeros();
            let mut add = |row: &Row, by_pattern: &By, sigma_px: f64, share: f64| {
                let w = weight(row.px / sigma_px, Loss::Tukey) / (share * sigma_px * sigma_px);
                let by_shared = row.by_shared.iter().copied().enumerate();
                let free = by_shared.filter(|(i, by)| *by != 0.0 && !self.fixed.contains(*i));
                let by: By = free.chain(by_pattern.iter().map(|(i, by)| (SHARED + i, *by))).collect();
                for (i, by_i) in &by {
                    for (j, by_j) in &by {
                        information[(*i, *j)] += w * by_i * by_j;
                    }
                    alone[*i] += w * by_i * by_i;
                    right[*i] -= w * by_i * row.px;
                    for k in 0..POSE {
                        mixed[(*i, k)] += w * by_i * row.by_pose[k];
                    }
                }
                own.ger(w, &row.by_pose, &row.by_pose, 1.0);
                own_right -= row.by_pose * (w * row.px);
            };
            for seen in &frame.centres {
                let rows = centre_rows(&self.shared, &frame.pose, seen.board_mm, seen.at)?;
                let by_pattern = self.centre_by(patterns, i, seen.board_mm, seen.board_mm, &rows)?;
                for (row, by_pattern) in rows.iter().zip(&by_pattern) {
                    let sigma_px = seen.sigma_px * self.scatter.centres;
                    add(row, by_pattern, sigma_px, self.scatter.centre_correlation);
                }
            }
            for seen in &frame.stripes {
                let row = stripe_row(&self.shared, &frame.pose, seen.laser, seen.at)?;
                let by_pattern = self.stripe_by(patterns, i, seen.at, &row)?;
                add(&row, &by_pattern, seen.sigma_px * self.scatter.stripes, self.scatter.stripe_correlation);
            }
            let inverse = own.cholesky()?.inverse();
            let product = &mixed * inverse;
            information -= &product * mixed.transpose();
            right -= product * own_right;
        }
        let units = alone.map(|v| if v > 0.0 { 1.0 / v.sqrt() } else { 0.0 });
        Some(ReducedSystem { information, right, units })
    }

    /// Which frames show columns and rows of a stretched board exchanged: stretch and skew of each frame's board by itself are plus or
    /// minus one pair. Each frame in turn says which; the others join it, then turn as long as that explains more.
    pub fn signs(&self, patterns: &Patterns) -> Option<Vec<f64>> {
        let others = Patterns { fields: None, ..patterns.clone() };
        let reduced = self.reduced(&others.with(MisfitKind::BoardStretched), patterns.kinds.len())?;
        let n = self.frames.len();
        let pair = |i: usize| Vector2::new(reduced.right[2 * i], reduced.right[2 * i + 1]);
        let block = |i: usize, j: usize| reduced.information.fixed_view::<2, 2>(2 * i, 2 * j).into_owned();
        let explained = |signs: &[f64]| -> f64 {
            let mut information = Matrix2::zeros();
            for i in 0..n {
                (0..n).for_each(|j| information += block(i, j) * (signs[i] * signs[j]));
            }
            let right: Vector2<f64> = (0..n).map(|i| pair(i) * signs[i]).sum();
            information.cholesky().map_or(0.0, |known| right.dot(&known.solve(&right)))
        };
        let from = |first: usize| -> Option<(f64, Vec<f64>)> {
            let along = block(first, first).cholesky()?.solve(&pair(first));
            let mut signs: Vec<f64> = (0..n).map(|i| pair(i).dot(&along).signum()).collect();
            let mut most = explained(&signs);
            loop {
                let before = most;
                for i in 0..n {
                    signs[i] = -signs[i];
                    let now = explained(&signs);
                    if now > most {
                        most = now;
                    } else {
                        signs[i] = -signs[i];
                    }
                }
                if most <= before {
                    return Some((most, signs));
                }
            }
        };
        (0..n).filter_map(from).max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, signs)| signs)
    }

    /// What a lens and a tilted sensor shift at a place of the sensor, px for one of each of their unknowns.
    fn shifts(&self, patterns: &Patterns, at: Px) -> Option<ShiftsAt> {
        let lens = patterns.kinds.contains(&MisfitKind::Lens);
        match &patterns.fields {
            Some(fields) => fields.shifts(at, lens),
            None => Some((
                if lens { lens_shifts(self.image_px, at) } else { Vec::new() },
                [Vector2::zeros(); TILTS],
            )),
        }
    }

    /// How a circle's two residuals change with the unknowns of these patterns, if the board is bowed as at another place of it.
    pub fn centre_by(
        &self,
        patterns: &Patterns,
        frame: usize,
        board_mm: Vector2<f64>,
        bowed_at_mm: Vector2<f64>,
        rows: &[Row; 2],
    ) -> Option<[By; 2]> {
        let mut by = [By::new(), By::new()];
        let pose = &self.frames[frame].pose;
        let (px, by_point, _) = px_by_point(&self.shared.camera, &point_on_board(pose, board_mm))?;
        // Observed minus projected: what moves the projection moves the residual the other way.
        let moved = |point: Vector3<f64>| -(by_point * point);
        let axis = |i: usize| -> Vector3<f64> { pose.rotation.column(i).into() };
        // One direction longer and the other shorter, and both turned towards each other.
        let (x, y) = (axis(0), axis(1));
        let stretch = x * board_mm.x - y * board_mm.y;
        let skew = x * board_mm.y + y * board_mm.x;
        let by_camera = |i: usize| Vector2::new(rows[0].by_shared[i], rows[1].by_shared[i]);
        let (lens, tilt) = self.shifts(patterns, px)?;
        let mut first = 0;
        for kind in &patterns.kinds {
            let mut put = |i: usize, value: Vector2<f64>| {
                by[0].push((first + i, value.x));
                by[1].push((first + i, value.y));
            };
            match kind {
                MisfitKind::Lens => {
                    lens.iter().enumerate().for_each(|(i, shift)| put(i, -shift));
                }
                MisfitKind::BoardBowed => {
                    for (i, up) in bow(bowed_at_mm).into_iter().enumerate() {
                        put(i, moved(axis(2) * up));
                    }
                }
                MisfitKind::BoardStretched => {
                    let (at, sign) =
                        patterns.signs.as_ref().map_or((2 * frame, 1.0), |signs| (0, signs[frame]));
                    put(at, moved(stretch * sign));
                    put(at + 1, moved(skew * sign));
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
                    put(2 * frame, moved(x * board_mm.x + y * board_mm.y));
                    put(2 * frame + 1, moved(stretch));
                }
            }
            first += patterns.columns(*kind);
        }
        if patterns.fields.is_some() {
            for (i, shift) in tilt.iter().enumerate() {
                by[0].push((first + i, -shift.x));
                by[1].push((first + i, -shift.y));
            }
        }
        Some(by)
    }

    /// How a stripe's residual changes with them.
    fn stripe_by(&self, patterns: &Patterns, frame: usize, at: Px, row: &Row) -> Option<By> {
        let mut by = By::new();
        let pose = &self.frames[frame].pose;
        let (lens, tilt) = self.shifts(patterns, at)?;
        // A picture that is shifted here is as if cx and cy were.
        let by_shift = |shift: &Vector2<f64>| row.by_shared[2] * shift.x + row.by_shared[3] * shift.y;
        let mut first = 0;
        for kind in &patterns.kinds {
            let mut put = |i: usize, value: f64| by.push((first + i, value));
            match kind {
                MisfitKind::Lens => {
                    lens.iter().enumerate().for_each(|(i, shift)| put(i, by_shift(shift)));
                }
                MisfitKind::BoardBowed => {
                    let on_board = super::rim::on_board(&self.shared.camera, pose, at)?;
                    // The board that much nearer along its normal: what the pose's shift along it does.
                    let normal: Vector3<f64> = pose.rotation.column(2).into();
                    let up = row.by_pose.fixed_rows::<3>(3).dot(&normal);
                    for (i, height) in bow(on_board).into_iter().enumerate() {
                        put(i, up * height);
                    }
                }
                MisfitKind::FocusChanges => {
                    let c = &self.shared.camera;
                    put(frame, row.by_shared[0] * c.fx + row.by_shared[1] * c.fy);
                }
                MisfitKind::Shifted => {
                    put(2 * frame, row.by_shared[2]);
                    put(2 * frame + 1, row.by_shared[3]);
                }
                // A stripe does not care where on the board it lies.
                MisfitKind::BoardStretched | MisfitKind::BoardsDiffer => {}
            }
            first += patterns.columns(*kind);
        }
        if patterns.fields.is_some() {
            by.extend(tilt.iter().enumerate().map(|(i, shift)| (first + i, by_shift(shift))));
        }
        Some(by)
    }
}

/// Heights of the shapes of a bowed board at a place on it, mm for 1 mm at 1 m from the middle.
pub(super) fn bow(at_mm: Vector2<f64>) -> [f64; BOW_POWERS.len()] {
    let at = at_mm / 1000.0;
    BOW_POWERS.map(|[m, n]| at.x.powi(m) * at.y.powi(n))
}
