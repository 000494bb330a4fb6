//! What may be wrong with head, board or frames, by name, and how it is told.

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
