//! Seeded random streams, one per purpose.
//!
//! A simulator needs streams that are reproducible, cheap to create in large numbers and independent of each other;
//! it does not need secrecy. SplitMix64 (Steele, Lea and Flood, "Fast splittable pseudorandom number generators",
//! OOPSLA 2014) has these properties in eight lines: a counter with an odd step and a finaliser that passes
//! BigCrush.

/// Named random stream. Same seed and label, same numbers, on every target and profile.
#[derive(Clone, Debug)]
pub struct Rng {
    state: u64,
}

/// SplitMix64's counter step, the odd integer nearest to 2^64 / golden ratio.
const GAMMA: u64 = 0x9E37_79B9_7F4A_7C15;

const fn finalise(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

impl Rng {
    /// The stream `label` of the run `seed`.
    ///
    /// The label is hashed with FNV-1a. A stream depends on its own label only, so a further fault or
    /// drive leaves all other streams as they were.
    pub fn stream(seed: u64, label: &str) -> Self {
        let mut hash = 0xCBF2_9CE4_8422_2325_u64;
        for byte in label.bytes() {
            hash = (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01B3);
        }
        Self { state: finalise(seed ^ finalise(hash)) }
    }

    /// Uniform over all 64-bit numbers.
    pub fn next_u64(&mut self) -> u64 {
        self.state = self.state.wrapping_add(GAMMA);
        finalise(self.state)
    }

    /// Uniform over `0..bound`; 0 for a bound of 0.
    ///
    /// Multiply-and-shift: the bias is below `bound / 2^64`.
    pub fn below(&mut self, bound: u64) -> u64 {
        ((u128::from(self.next_u64()) * u128::from(bound)) >> 64) as u64
    }

    /// Uniform over `low..=high`; `low` if the bounds are reversed.
    pub fn within(&mut self, low: u64, high: u64) -> u64 {
        match high.checked_sub(low).map(|span| span.checked_add(1)) {
            None => low,
            Some(None) => self.next_u64(),
            Some(Some(count)) => low + self.below(count),
        }
    }

    /// Uniform over [0, 1) with 53 bits.
    pub fn unit(&mut self) -> f64 {
        (self.next_u64() >> 11) as f64 * (1.0 / (1_u64 << 53) as f64)
    }

    /// True with probability `p`; never for `p <= 0` or NaN, always for `p >= 1`.
    ///
    /// Always draws exactly one number, so that another `p` does not change later draws.
    pub fn chance(&mut self, p: f64) -> bool {
        self.unit() < p
    }

    /// Exponentially distributed with the given mean, by inversion; finite and not negative.
    pub fn exponential(&mut self, mean: f64) -> f64 {
        // 1 - u is in (0, 1], so the logarithm is finite. `libm` gives the same bits everywhere.
        -mean * libm::log(1.0 - self.unit())
    }

    /// Normally distributed with mean 0 and standard deviation 1 (Box and Muller); draws two numbers.
    pub fn normal(&mut self) -> f64 {
        let radius = libm::sqrt(-2.0 * libm::log(1.0 - self.unit()));
        radius * libm::cos(core::f64::consts::TAU * self.unit())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_numbers_match_the_published_generator() {
        // SplitMix64 from state 1234567, as listed with its public reference program.
        let mut rng = Rng { state: 1_234_567 };
        let first: Vec<u64> = (0..3).map(|_| rng.next_u64()).collect();
        assert_eq!(first, [6_457_827_717_110_365_317, 3_203_168_211_198_807_973, 9_817_491_932_198_370_423]);
    }

    #[test]
    fn streams_differ_by_label_and_by_seed_and_repeat_exactly() {
        let draw = |seed, label| Rng::stream(seed, label).next_u64();
        assert_eq!(draw(1, "drop@3"), draw(1, "drop@3"));
        assert_ne!(draw(1, "drop@3"), draw(1, "drop@4"));
        assert_ne!(draw(1, "drop@3"), draw(2, "drop@3"));
    }

    #[test]
    fn ranges_include_both_ends_and_survive_extremes() {
        let mut rng = Rng::stream(7, "range");
        let drawn: Vec<u64> = (0..200).map(|_| rng.within(3, 6)).collect();
        assert_eq!((drawn.iter().min(), drawn.iter().max()), (Some(&3), Some(&6)));
        assert_eq!(rng.within(5, 5), 5);
        assert_eq!(rng.within(6, 5), 6);
        rng.within(0, u64::MAX);
        assert_eq!(rng.below(0), 0);
    }

    #[test]
    fn chance_is_exact_at_its_ends_and_near_its_mean_between() {
        let mut rng = Rng::stream(7, "chance");
        assert!((0..1000).all(|_| !rng.chance(0.0) && rng.chance(1.0) && !rng.chance(f64::NAN)));
        let hits = (0..100_000).filter(|_| rng.chance(0.25)).count();
        // Five standard deviations of a binomial with n = 1e5, p = 1/4 are 685.
        assert!((24_315..=25_685).contains(&hits), "{hits}");
    }

    #[test]
    fn normal_has_its_mean_and_deviation() {
        let mut rng = Rng::stream(7, "normal");
        let draws: Vec<f64> = (0..100_000).map(|_| rng.normal()).collect();
        let mean = draws.iter().sum::<f64>() / draws.len() as f64;
        let variance = draws.iter().map(|x| x * x).sum::<f64>() / draws.len() as f64;
        // Five standard deviations: 0.0158 of the mean, 0.0224 of the variance.
        assert!(mean.abs() < 0.0158 && (variance - 1.0).abs() < 0.0224, "{mean} {variance}");
        let beyond = draws.iter().filter(|x| x.abs() > 1.959_964).count();
        assert!((4_655..=5_345).contains(&beyond), "{beyond}");
    }

    #[test]
    fn exponential_has_its_mean_and_never_goes_negative() {
        let mut rng = Rng::stream(7, "exp");
        let draws: Vec<f64> = (0..100_000).map(|_| rng.exponential(2.0)).collect();
        assert!(draws.iter().all(|x| x.is_finite() && *x >= 0.0));
        let mean = draws.iter().sum::<f64>() / draws.len() as f64;
        assert!((1.97..=2.03).contains(&mean), "{mean}");
    }
}
