//! Small units that travel everywhere: pixel positions, estimates, laser identity.

/// A position on the raw, distorted sensor in pixels. (0, 0) is the centre of the top-left pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Px {
    /// Column, to the right.
    pub u: f64,
    /// Row, downwards.
    pub v: f64,
}

impl Px {
    /// A pixel position from column and row.
    #[must_use]
    pub const fn new(u: f64, v: f64) -> Self {
        Self { u, v }
    }

    /// Euclidean distance in px.
    #[must_use]
    pub fn distance_px(self, other: Self) -> f64 {
        (self.u - other.u).hypot(self.v - other.v)
    }

    /// Whether it is nearer than `radius_px`, which takes no root.
    pub(crate) fn is_within(self, other: Self, radius_px: f64) -> bool {
        let (du, dv) = (self.u - other.u, self.v - other.v);
        du * du + dv * dv < radius_px * radius_px
    }
}

/// A length in mm with its standard deviation (1 sigma: observation and calibration together).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Estimate {
    /// Best value, mm.
    pub value_mm: f64,
    /// Standard deviation, mm.
    pub sigma_mm: f64,
}

impl Estimate {
    /// A value with its standard deviation, both in mm.
    #[must_use]
    pub const fn new(value_mm: f64, sigma_mm: f64) -> Self {
        Self { value_mm, sigma_mm }
    }
}

/// Half the width of a 95 % interval in standard deviations: many independent causes add to a normal error (GUM, G.2).
const COVERAGE_FACTOR: f64 = 1.96;

impl Estimate {
    /// The interval that contains the true length in 95 of 100 measurements, mm.
    #[must_use]
    pub fn interval_95_mm(&self) -> [f64; 2] {
        [-COVERAGE_FACTOR, COVERAGE_FACTOR].map(|k| self.value_mm + k * self.sigma_mm)
    }
}

/// An angle with its standard deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AngleEstimate {
    /// Best value, rad.
    pub value_rad: f64,
    /// Standard deviation, rad.
    pub sigma_rad: f64,
}

/// A volume in cubic metres with its standard deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Volume {
    /// Best value, m^3.
    pub value_m3: f64,
    /// Standard deviation, m^3.
    pub sigma_m3: f64,
}

impl Volume {
    /// The interval that contains the true volume in 95 of 100 measurements, m^3.
    #[must_use]
    pub fn interval_95_m3(&self) -> [f64; 2] {
        [-COVERAGE_FACTOR, COVERAGE_FACTOR].map(|k| self.value_m3 + k * self.sigma_m3)
    }
}

/// Which of the four lasers: 1 and 2 are one nearly parallel pair, 3 and 4 the other.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct LaserId(u8);

impl LaserId {
    /// All four lasers in order.
    pub const ALL: [Self; 4] = [Self(1), Self(2), Self(3), Self(4)];

    /// The laser with this number, if it is 1 to 4.
    #[must_use]
    pub const fn new(number: u8) -> Option<Self> {
        if number >= 1 && number <= 4 { Some(Self(number)) } else { None }
    }

    /// 1 to 4, as printed on the head and in every file.
    #[must_use]
    pub const fn number(self) -> u8 {
        self.0
    }

    /// 0 to 3, for arrays of four.
    #[must_use]
    pub const fn index(self) -> usize {
        self.0 as usize - 1
    }
}

impl std::fmt::Display for LaserId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", self.0)
    }
}
