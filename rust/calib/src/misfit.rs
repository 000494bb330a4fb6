//! Does the model fit the frames, or is only the residual small? What a lens, a board or a mount does that the model has not is no
//! noise: neighbours share it. Each pattern here is a few unknowns added to the adjustment, which is solved with them (Gauss-Newton).
//! Noise and its correlation are estimated from what is then left, so that the pattern does not hide in them, and the unknowns are
//! tested against their covariance (Wald 1943). Of the patterns that are significant Schwarz's criterion names one, then those that
//! explain more beside it.

use super::adjust::{
    FIXED, Fixed, FrameSeen, Information, Loss, Scatter, adjust, covariance, own_sigmas, residuals,
    rms_of_centres, scatter, solve_scaled, weight,
};
use super::lens::LensTerms;
use super::model::{POSE, Row, SHARED, Shared, centre_rows, point_on_board, px_by_point, stripe_row};
use boxline::calibration::{CalibrationCovariance, CalibrationStep, PLANES};
use boxline::eigen::symmetric_eigen;
use boxline::statistics::robust_sigma;
use boxline::units::Px;
use nalgebra::{DMatrix, DVector, Matrix2, SMatrix, SVector, Vector2, Vector3};

/// What may be wrong with a set of frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MisfitKind {
    /// The distortion has another shape than the lens's terms. Size: what it shifts circles by, px rms an axis.
    Lens,
    /// The board is no plane. Size: how far its middle stands before its corners or behind, mm.
    BoardBowed,
    /// The board's pitch along its columns is not that along its rows, or they are not at right angles. Size: the difference between the
    /// largest and the smallest pitch as a share. A part of a grid does not tell columns from rows: which way it is, each frame says.
    BoardStretched,
    /// The focal length changes from frame to frame. Size: by which share, rms.
    FocusChanges,
    /// The picture is shifted on the sensor from frame to frame: the lens or the sensor is loose. Size: px rms.
    Shifted,
    /// The boards of the frames are not one board. Size: difference of their pitches along columns and rows as a share, rms.
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
                write!(f, "the board is {:.3} % larger in one direction than in the other", 100.0 * size)?;
            }
            MisfitKind::FocusChanges => {
                write!(f, "the focal length changes between frames by {:.3} % rms", 100.0 * size)?;
            }
            MisfitKind::Shifted => {
                write!(f, "frames are shifted on the sensor against each other by {size:.2} px rms")?
            }
            MisfitKind::BoardsDiffer => {
                write!(f, "the frames show boards whose pitches differ by {:.3} % rms", 100.0 * size)?;
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
/// What a lens's terms p1, p2 and k3 may be before frames are seen: half of 0.01 and 0.2, the most that `rust/sim` draws.
const LENS_SIGMAS: [(usize, f64); 3] = [(18, 0.005), (19, 0.005), (20, 0.1)];
/// Steps of Gauss and Newton. Patterns are linear to some 0.1 % of themselves; the second step is for the noise, which is known after
/// the first, the third for what the weights then change.
const STEPS: usize = 3;

/// The solved adjustment whose residuals are asked.
#[derive(Clone)]
pub(super) struct Solved {
    pub shared: Shared,
    pub frames: Vec<FrameSeen>,
    pub scatter: Scatter,
    pub fixed: Fixed,
    pub image_px: [usize; 2],
}

/// What does not fit, and the solution with it.
pub(super) struct Found {
    /// The one that explains most first.
    pub misfits: Vec<Misfit>,
    /// Camera and planes solved with these patterns, but for a lens's, of which a camera has no terms.
    pub shared: Shared,
    /// Of these.
    pub covariance: CalibrationCovariance,
    /// What the frames tell about these, and what is known of the lens's terms before.
    pub information: Information,
}

/// The patterns in the residuals, and camera and planes with them. `None` if the frames do not fix these. A lens ends the search: its
/// unknowns can take the place of much else.
pub(super) fn misfits(solved: &Solved) -> Option<Found> {
    let single_px = solved.single_px();
    let mut misfits = Vec::new();
    let mut known = Wider::none(solved);
    let all = known.square_px;
    while let Some(wider) = known.best_wider(solved, all) {
        let Some(kind) = wider.patterns.last() else { break };
        misfits.push(Misfit {
            kind,
            size: wider.size().unwrap_or((known.square_px - wider.square_px).max(0.0).sqrt()),
            rms_px: all.sqrt(),
            single_px,
            chi_square: wider.chi_square,
            limit: wider.limit(),
        });
        if kind == MisfitKind::Lens {
            break;
        }
        known = wider;
    }
    let (information, covariance) = known.covariance()?;
    Some(Found { misfits, shared: known.left.shared, covariance, information })
}

/// The solution as it is, without a search for patterns.
#[cfg(test)]
pub(super) fn without_patterns(solved: &Solved) -> Option<Found> {
    let (information, covariance) = Wider::none(solved).covariance()?;
    Some(Found { misfits: Vec::new(), shared: solved.shared.clone(), covariance, information })
}

/// Wilson and Hilferty's quantile of chi-square.
fn one_in_a_thousand(degrees: f64) -> f64 {
    let part = 2.0 / (9.0 * degrees);
    degrees * (1.0 - part + ONE_IN_A_THOUSAND * part.sqrt()).powi(3)
}

/// Patterns side by side, their unknowns in this order.
#[derive(Clone)]
struct Patterns {
    kinds: Vec<MisfitKind>,
    frames: usize,
    /// 1, or -1 for frames that show columns and rows of a stretched board exchanged; `None`: each frame's board is stretched by itself.
    signs: Option<Vec<f64>>,
}

impl Patterns {
    fn columns(&self, kind: MisfitKind) -> usize {
        let (common, own) = self.unknowns(kind);
        common + own * self.frames
    }

    fn unknowns(&self, kind: MisfitKind) -> (usize, usize) {
        let each_by_itself = kind == MisfitKind::BoardStretched && self.signs.is_none();
        if each_by_itself { (0, 2) } else { kind.unknowns() }
    }

    fn all_columns(&self) -> usize {
        self.kinds.iter().map(|kind| self.columns(*kind)).sum()
    }

    fn last(&self) -> Option<MisfitKind> {
        self.kinds.last().copied()
    }

    fn with(&self, kind: MisfitKind) -> Self {
        let mut wider = self.clone();
        wider.kinds.push(kind);
        wider
    }
}

/// A set solved with patterns among its unknowns.
struct Wider {
    patterns: Patterns,
    values: DVector<f64>,
    /// Solved with observations from which the patterns are taken.
    left: Solved,
    /// Mean square of the circles' residuals an axis, px^2.
    square_px: f64,
    /// Of the last pattern's unknowns, the others free.
    chi_square: f64,
    variances: DVector<f64>,
    /// Combinations of the last pattern's unknowns that the frames tell.
    unknowns: usize,
}

fn square_px(solved: &Solved) -> f64 {
    0.5 * rms_of_centres(&solved.shared, &solved.frames).norm_squared()
}

impl Wider {
    fn none(solved: &Solved) -> Self {
        Self {
            patterns: Patterns { kinds: Vec::new(), frames: solved.frames.len(), signs: None },
            values: DVector::zeros(0),
            left: solved.clone(),
            square_px: square_px(solved),
            chi_square: 0.0,
            variances: DVector::zeros(0),
            unknowns: 0,
        }
    }

    /// With the pattern that is worth most of those that are significant and explain enough of the mean square `all`.
    fn best_wider(&self, solved: &Solved, all: f64) -> Option<Self> {
        let more = MisfitKind::ALL.into_iter().filter(|kind| !self.patterns.kinds.contains(kind));
        let tried: Vec<Self> = more.filter_map(|kind| self.wider(solved, kind)).collect();
        // How many residuals count as independent, by the pattern that leaves least.
        let least = tried.iter().min_by(|a, b| a.square_px.total_cmp(&b.square_px))?;
        let circles: usize = solved.frames.iter().map(|frame| frame.centres.len()).sum();
        let independent = 2.0 * circles as f64 / least.left.scatter.centre_correlation;
        let told = |wider: &Self| {
            // Frames whose own unknowns differ by less than noise does do not differ.
            let seen = wider.size().is_none_or(|size| size > 0.0);
            seen && wider.chi_square >= wider.limit()
                && self.square_px - wider.square_px >= LEAST_EXPLAINED * all
        };
        // Schwarz's criterion; choosing the frames' signs costs what 2 ln of their number does.
        let worth = |wider: &Self| {
            let unknowns = wider.unknowns as f64 * independent.ln() + wider.price_of_signs();
            -independent * wider.square_px.ln() - unknowns
        };
        tried.into_iter().filter(told).max_by(|a, b| worth(a).total_cmp(&worth(b)))
    }

    /// What one sound set in a thousand exceeds, at most: each choice of signs is a trial (Bonferroni).
    fn limit(&self) -> f64 {
        one_in_a_thousand(self.unknowns.max(1) as f64) + self.price_of_signs()
    }

    /// Twice the logarithm of how many ways there are to choose the frames' signs. All the other way round is the same.
    fn price_of_signs(&self) -> f64 {
        let stretched = self.patterns.last() == Some(MisfitKind::BoardStretched);
        let free = if stretched { self.patterns.frames - 1 } else { 0 };
        2.0 * std::f64::consts::LN_2 * free as f64
    }

    /// Solves with one more pattern. `None` if the observations do not allow it.
    fn wider(&self, solved: &Solved, kind: MisfitKind) -> Option<Self> {
        let mut patterns = self.patterns.with(kind);
        if kind == MisfitKind::BoardStretched {
            patterns.signs = Some(self.left.signs(&self.patterns)?);
        }
        let mut values = self.values.clone().resize_vertically(patterns.all_columns(), 0.0);
        let mut left = self.left.clone();
        for _ in 0..STEPS {
            values += left.told(&patterns, 0)?.step();
            left = solved.without(&left, &patterns, &values)?;
        }
        let asked = patterns.kinds.len() - 1;
        let told = left.told(&patterns, asked)?;
        let own = values.rows(self.values.len(), patterns.columns(kind)).into_owned();
        let (chi_square, unknowns, variances) = told.chi_square(&own);
        Some(Self { patterns, values, square_px: square_px(&left), left, chi_square, variances, unknowns })
    }

    /// Information and covariance of camera and planes, with the patterns and all of Brown's terms free. The patterns' unknowns are taken to
    /// be normal, about zero, as large as they came out: a mean focal length is known only as well as the frames' own are alike. A term that
    /// the camera has not is 0 as long as the frames do not choose it, and that may be wrong: it is known as well as [`LENS_SIGMAS`] and the
    /// frames together tell, and how far it would move from 0, and camera and planes with it, is one more standard deviation.
    fn covariance(&self) -> Option<(Information, CalibrationCovariance)> {
        let given = self.left.fixed;
        let fixed = Fixed { lens: LensTerms::BROWN, ..given };
        let free = Solved { fixed, ..self.left.clone() };
        let Told { mut information, right, .. } = free.normal_equations(&self.patterns)?;
        for (i, sigma) in LENS_SIGMAS {
            if given.contains(i) && !fixed.contains(i) {
                information[(i, i)] += sigma.powi(-2);
            }
        }
        let mut first = 0;
        for kind in &self.patterns.kinds {
            let (common, own) = self.patterns.unknowns(*kind);
            let columns = self.patterns.columns(*kind);
            // Unknowns of one meaning, one of each frame.
            let step = common + own;
            for i in 0..columns {
                let alike = || (i % step..columns).step_by(step).map(|j| self.values[first + j].powi(2));
                let square = alike().sum::<f64>() / alike().count() as f64;
                information[(SHARED + first + i, SHARED + first + i)] += 1.0 / square.max(f64::MIN_POSITIVE);
            }
            first += columns;
        }
        let all = information.nrows();
        let block = |i: usize, j: usize, n: usize, m: usize| information.view((i, j), (n, m)).into_owned();
        let rest = all - SHARED;
        let units =
            DMatrix::from_diagonal(&block(SHARED, SHARED, rest, rest).diagonal().map(|v| 1.0 / v.sqrt()));
        let patterns = (&units * block(SHARED, SHARED, rest, rest) * &units).cholesky()?;
        let across = &units * block(SHARED, 0, rest, SHARED);
        let left = block(0, 0, SHARED, SHARED) - across.transpose() * patterns.solve(&across);
        let mut left = Information::from_fn(|i, j| left[(i, j)]);
        (0..SHARED).filter(|i| fixed.contains(*i)).for_each(|i| left[(i, i)] = FIXED);
        let right =
            right.rows(0, SHARED) - across.transpose() * patterns.solve(&(&units * right.rows(SHARED, rest)));
        let (step, inverse) = solve_scaled(&left, &SVector::from_fn(|i, _| right[i]))?;
        let lens = CalibrationStep::from_fn(|i, _| if fixed.contains(i) { 0.0 } else { step[i] });
        let scale = self.scale_sigma();
        let mut scaled = CalibrationStep::zeros();
        for (k, plane) in self.left.shared.planes.iter().enumerate() {
            scaled.fixed_rows_mut::<3>(PLANES + 3 * k).copy_from(&(plane * scale));
        }
        Some((left, covariance(&inverse) + lens * lens.transpose() + scaled * scaled.transpose()))
    }

    /// Of a stretched board, which of its pitches is the file's is unknown: half of their difference, as a share of all lengths.
    fn scale_sigma(&self) -> f64 {
        let stretched = self.patterns.kinds.iter().position(|kind| *kind == MisfitKind::BoardStretched);
        stretched.map_or(0.0, |at| {
            let first: usize =
                self.patterns.kinds[..at].iter().map(|kind| self.patterns.columns(*kind)).sum();
            self.values[first].hypot(self.values[first + 1])
        })
    }

    /// The size of the last pattern from its unknowns; of a lens it is told by the residuals.
    fn size(&self) -> Option<f64> {
        let kind = self.patterns.last()?;
        let values =
            self.values.rows(self.values.len() - self.patterns.columns(kind), self.patterns.columns(kind));
        // Variance of what each frame has for itself, beyond what noise gives it.
        let spread = |first: usize, step: usize| {
            let own = || (first..values.len()).step_by(step);
            let n = own().count() as f64;
            let mean = own().map(|i| values[i]).sum::<f64>() / n;
            let squares = own().map(|i| (values[i] - mean).powi(2)).sum::<f64>() / (n - 1.0);
            (squares - own().map(|i| self.variances[i]).sum::<f64>() / n).max(0.0)
        };
        match kind {
            MisfitKind::Lens => None,
            MisfitKind::BoardBowed => {
                let all = self.left.frames.iter().flat_map(|f| f.centres.iter().map(|c| c.board_mm));
                let height = |at| bow(at).into_iter().zip(values.iter()).map(|(h, v)| h * v).sum::<f64>();
                let (low, high) = all.map(height).fold((0.0f64, 0.0f64), |(l, h), x| (l.min(x), h.max(x)));
                Some(high - low)
            }
            MisfitKind::BoardStretched => Some(2.0 * values[0].hypot(values[1])),
            MisfitKind::FocusChanges => Some(spread(0, 1).sqrt()),
            MisfitKind::Shifted | MisfitKind::BoardsDiffer => Some((spread(0, 2) + spread(1, 2)).sqrt()),
        }
    }
}

/// What the frames tell about unknowns once all others are free: normal equations.
struct Told {
    information: DMatrix<f64>,
    right: DVector<f64>,
    /// One over the root of the information if all others were known.
    units: DVector<f64>,
}

impl Told {
    /// Values and directions, in `units`, of the combinations that are known.
    fn known(&self) -> impl Iterator<Item = (f64, DVector<f64>)> {
        let scale = DMatrix::from_diagonal(&self.units);
        let eigen = symmetric_eigen(&(&scale * &self.information * &scale));
        let vectors: Vec<DVector<f64>> = eigen.vectors.column_iter().map(|v| v.into_owned()).collect();
        let values: Vec<f64> = eigen.values.iter().copied().collect();
        values.into_iter().zip(vectors).filter(|(value, _)| *value > LEAST_KNOWN)
    }

    fn step(&self) -> DVector<f64> {
        let right = self.right.component_mul(&self.units);
        let mut step = DVector::zeros(right.len());
        self.known().for_each(|(value, along)| step += &along * (along.dot(&right) / value));
        step.component_mul(&self.units)
    }

    /// What speaks against these unknowns being zero, how many combinations of them are known, and their variances.
    fn chi_square(&self, values: &DVector<f64>) -> (f64, usize, DVector<f64>) {
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
    fn single_px(&self) -> f64 {
        let off = self.frames.iter().flat_map(|frame| {
            let (centres, _) = residuals(&self.shared, frame);
            let against = |w: &[Vector2<f64>]| w[1] - 0.5 * (w[0] + w[2]);
            centres.windows(3).map(against).flat_map(|d| [d.x, d.y]).collect::<Vec<_>>()
        });
        // Of one and half a variance.
        robust_sigma(off).map_or(0.0, |sigma| sigma / 1.5f64.sqrt())
    }

    /// Solved again, from `near`, with observations from which patterns of these values are taken.
    fn without(&self, near: &Self, patterns: &Patterns, values: &DVector<f64>) -> Option<Self> {
        let of = |by: &By| by.iter().map(|(i, by)| by * values[*i]).sum::<f64>();
        let mut left = near.clone();
        for (i, (frame, seen)) in left.frames.iter_mut().zip(&self.frames).enumerate() {
            for (c, seen) in frame.centres.iter_mut().zip(&seen.centres) {
                let rows = centre_rows(&near.shared, &near.frames[i].pose, c.board_mm, c.at)?;
                let [u, v] = near.centre_by(patterns, i, c.board_mm, &rows)?;
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
    fn told(&self, patterns: &Patterns, asked: usize) -> Option<Told> {
        let before: usize = patterns.kinds[..asked].iter().map(|kind| patterns.columns(*kind)).sum();
        Some(self.normal_equations(patterns)?.without_first(SHARED + before))
    }

    /// What is told about camera, planes and the unknowns of these patterns, poses free.
    fn normal_equations(&self, patterns: &Patterns) -> Option<Told> {
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
                let by_pattern = self.centre_by(patterns, i, seen.board_mm, &rows)?;
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
        Some(Told { information, right, units })
    }

    /// Which frames show columns and rows of a stretched board exchanged: stretch and skew of each frame's board by itself are plus or
    /// minus one pair. Each frame in turn says which; the others join it, then turn as long as that explains more.
    fn signs(&self, patterns: &Patterns) -> Option<Vec<f64>> {
        let told = self.told(&patterns.with(MisfitKind::BoardStretched), patterns.kinds.len())?;
        let n = self.frames.len();
        let pair = |i: usize| Vector2::new(told.right[2 * i], told.right[2 * i + 1]);
        let block = |i: usize, j: usize| told.information.fixed_view::<2, 2>(2 * i, 2 * j).into_owned();
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
        patterns: &Patterns,
        frame: usize,
        board_mm: Vector2<f64>,
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
        let mut first = 0;
        for kind in &patterns.kinds {
            let mut put = |i: usize, value: Vector2<f64>| {
                by[0].push((first + i, value.x));
                by[1].push((first + i, value.y));
            };
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
        Some(by)
    }

    /// How a stripe's residual changes with them.
    fn stripe_by(&self, patterns: &Patterns, frame: usize, at: Px, row: &Row) -> Option<By> {
        let mut by = By::new();
        let pose = &self.frames[frame].pose;
        let mut first = 0;
        for kind in &patterns.kinds {
            let mut put = |i: usize, value: f64| by.push((first + i, value));
            match kind {
                MisfitKind::Lens => {
                    // A picture that is shifted here is as if cx and cy were.
                    for (i, shift) in self.lens_shifts(at).enumerate() {
                        put(2 * i, row.by_shared[2] * shift);
                        put(2 * i + 1, row.by_shared[3] * shift);
                    }
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
        Some(by)
    }
}

/// Heights of the three shapes of a bowed board at a place on it, mm for 1 mm at 1 m from the middle.
fn bow(at_mm: Vector2<f64>) -> [f64; 3] {
    let at = at_mm / 1000.0;
    [at.x * at.x, at.x * at.y, at.y * at.y]
}
