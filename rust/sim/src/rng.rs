//! The only source of chance. Written here, and not taken from a crate, so that a seed means the same frame for ever.

/// PCG-XSH-RR 64/32 (O'Neill 2014): small, fast, and fixed by its paper.
#[derive(Clone, Debug)]
pub struct Rng {
    state: u64,
    stream: u64,
}

/// SplitMix64: turns neighbouring seeds into unrelated states.
#[must_use]
pub const fn mix(seed: u64) -> u64 {
    let z = seed.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

impl Rng {
    /// A generator for a seed and a purpose; other purposes of the same seed are independent.
    #[must_use]
    pub fn new(seed: u64, purpose: u64) -> Self {
        let mut rng = Self { state: 0, stream: (mix(purpose ^ 0x51A7) << 1) | 1 };
        rng.state = mix(seed ^ mix(purpose)).wrapping_add(rng.stream);
        rng.bits();
        rng
    }

    /// An independent generator, so that one more draw here does not change everything after it.
    pub fn child(&mut self) -> Self {
        let seed = (u64::from(self.bits()) << 32) | u64::from(self.bits());
        Self::new(seed, 0xC41D)
    }

    /// 32 random bits.
    #[inline]
    pub fn bits(&mut self) -> u32 {
        let old = self.state;
        self.state = old.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(self.stream);
        let word = (((old >> 18) ^ old) >> 27) as u32;
        word.rotate_right((old >> 59) as u32)
    }

    /// Uniform in [0, 1).
    pub fn unit(&mut self) -> f64 {
        f64::from(self.bits()) / 4_294_967_296.0
    }

    /// Uniform between two numbers.
    pub fn range(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Like [`Rng::range`], single precision.
    pub fn range_f32(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.unit() as f32
    }

    /// Uniform in the logarithm between two positive numbers.
    pub fn log_range(&mut self, low: f64, high: f64) -> f64 {
        (low.ln() + (high.ln() - low.ln()) * self.unit()).exp()
    }

    /// Normal, zero mean, unit variance (Box-Muller).
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.unit()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.unit()).cos()
    }

    /// True with a probability.
    pub fn chance(&mut self, probability: f64) -> bool {
        self.unit() < probability
    }

    /// Uniform below `n` (0 if `n` is 0).
    pub fn below(&mut self, n: usize) -> usize {
        ((u64::from(self.bits()) * n as u64) >> 32) as usize
    }

    /// One of several.
    pub fn pick<T: Copy, const N: usize>(&mut self, items: [T; N]) -> T {
        items[self.below(N)]
    }

    /// One of two signs.
    pub fn sign(&mut self) -> f64 {
        if self.chance(0.5) { 1.0 } else { -1.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_seed_means_the_same_numbers_for_ever() {
        let mut rng = Rng::new(1, 2);
        let first: Vec<u32> = (0..3).map(|_| rng.bits()).collect();
        let mut again = Rng::new(1, 2);
        assert_eq!(first, (0..3).map(|_| again.bits()).collect::<Vec<_>>());
        assert_ne!(first[0], Rng::new(2, 2).bits());
        assert_ne!(first[0], Rng::new(1, 3).bits());
    }

    #[test]
    fn mean_and_spread_are_right() {
        let mut rng = Rng::new(5, 0);
        let n = 40_000;
        let (mut sum, mut square) = (0.0, 0.0);
        for _ in 0..n {
            let x = rng.normal();
            sum += x;
            square += x * x;
        }
        assert!((sum / f64::from(n)).abs() < 0.02);
        assert!((square / f64::from(n) - 1.0).abs() < 0.03);
    }
}
