//! A small seeded generator whose output is part of the file format.
//!
//! xoshiro256++ 1.0 (Blackman and Vigna, "Scrambled Linear Pseudorandom Number Generators", 2021),
//! its state filled by `SplitMix64` from one 64-bit seed, as its authors advise. It is our own so
//! that a saved state means the same batches in every later version: a change of any output here is
//! a change of the file format. Of [`Rng::fill_normal`] that holds on one machine: the last bits of its logarithm
//! and sines are the platform's.

use crate::fork;

/// Generator state: 256 bits, never all zero.
///
/// ```
/// use vhs_base::rng::Rng;
/// let (mut a, mut b) = (Rng::new(7), Rng::new(7));
/// assert_eq!(a.below(10), b.below(10));
/// let mut resumed = Rng::from_state(a.state()).expect("a state that a generator had");
/// assert_eq!(resumed.next_u64(), a.next_u64());
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Rng {
    state: [u64; 4],
}

impl Rng {
    /// A generator whose whole output follows from `seed`.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        let mut counter = seed;
        let mut split_mix = || {
            counter = counter.wrapping_add(0x9E37_79B9_7F4A_7C15);
            let mut z = counter;
            z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
            z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
            z ^ (z >> 31)
        };
        Self {
            state: [split_mix(), split_mix(), split_mix(), split_mix()],
        }
    }

    /// The state, to be stored and given to [`Rng::from_state`].
    #[must_use]
    pub const fn state(&self) -> [u64; 4] {
        self.state
    }

    /// A generator that goes on where the one with this state stood; `None` for the all-zero state,
    /// which only ever yields 0.
    #[must_use]
    pub fn from_state(state: [u64; 4]) -> Option<Self> {
        (state != [0; 4]).then_some(Self { state })
    }

    /// A generator for one call alone, which starts at the next number of this one: calls may draw side by
    /// side, and the same calls in the same order draw the same.
    #[must_use]
    pub fn split(&mut self) -> Self {
        Self::new(self.next_u64())
    }

    /// Makes this generator one of this process, where it was made under `lineage`: in a forked child it goes on
    /// from another state than its parent's and its siblings', in any other process from its own.
    pub fn own(&mut self, lineage: &mut u64) {
        let here = fork::lineage();
        if *lineage != here {
            *lineage = here;
            *self = Self::new(self.next_u64() ^ here);
        }
    }

    /// 64 random bits.
    pub fn next_u64(&mut self) -> u64 {
        let [s0, s1, s2, s3] = &mut self.state;
        let result = s0.wrapping_add(*s3).rotate_left(23).wrapping_add(*s0);
        let shifted = *s1 << 17;
        *s2 ^= *s0;
        *s3 ^= *s1;
        *s1 ^= *s2;
        *s0 ^= *s3;
        *s2 ^= shifted;
        *s3 = s3.rotate_left(45);
        result
    }

    /// A whole number in `0..limit`, all equally likely; 0 where `limit` is 0.
    ///
    /// Lemire, "Fast Random Integer Generation in an Interval", 2019: the high half of a 128-bit
    /// product, redrawn in the rare case that would favour some numbers.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "the halves of the 128-bit product are what the method needs"
    )]
    pub fn below(&mut self, limit: usize) -> usize {
        let limit = limit as u64;
        if limit == 0 {
            return 0;
        }
        let threshold = limit.wrapping_neg() % limit;
        loop {
            let wide = u128::from(self.next_u64()) * u128::from(limit);
            if wide as u64 >= threshold {
                return (wide >> 64) as usize;
            }
        }
    }

    /// A number in `[0, 1)`, a multiple of 2^-53.
    #[expect(clippy::cast_precision_loss, reason = "53 bits fit a double exactly")]
    pub fn unit(&mut self) -> f64 {
        (self.next_u64() >> 11) as f64 * 2.0_f64.powi(-53)
    }

    /// True with the given probability. Always draws once, so that the stream does not depend on
    /// the probability.
    pub fn chance(&mut self, probability: f64) -> bool {
        self.unit() < probability
    }

    /// Puts the items in random order (Fisher and Yates), every order equally likely.
    pub fn shuffle<T>(&mut self, items: &mut [T]) {
        for last in (1..items.len()).rev() {
            items.swap(last, self.below(last + 1));
        }
    }

    /// Fills `out` with independent draws from N(0, 1), by Box and Muller's method.
    ///
    /// A pair of draws a time and none kept back, so that the four words of [`Rng::state`] are the
    /// whole state.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "a rounding to f32 is meant"
    )]
    pub fn fill_normal(&mut self, out: &mut [f32]) {
        for pair in out.chunks_mut(2) {
            // 1 - unit() lies in (0, 1], where the logarithm is finite.
            let radius = (-2.0 * (1.0 - self.unit()).ln()).sqrt();
            let (sine, cosine) = (std::f64::consts::TAU * self.unit()).sin_cos();
            for (value, part) in pair.iter_mut().zip([cosine, sine]) {
                *value = (radius * part) as f32;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_outputs_are_those_of_the_published_generator() {
        // Reference: the authors' C code for xoshiro256++ 1.0, started at the state 1, 2, 3, 4.
        let mut rng = Rng::from_state([1, 2, 3, 4]).expect("not the zero state");
        let first: Vec<u64> = (0..4).map(|_| rng.next_u64()).collect();
        assert_eq!(
            first,
            [
                41_943_041,
                58_720_359,
                3_588_806_011_781_223,
                3_591_011_842_654_386
            ]
        );
    }

    #[test]
    fn seeding_is_split_mix_64() {
        // The published first output of SplitMix64 from seed 0.
        assert_eq!(Rng::new(0).state()[0], 0xE220_A839_7B1D_CDAF);
    }

    #[test]
    fn below_reaches_every_number_about_equally_often() {
        let (mut rng, mut counts) = (Rng::new(3), [0_i32; 7]);
        for _ in 0..70_000 {
            counts[rng.below(7)] += 1;
        }
        // 10,000 expected each, standard deviation 93: six of them.
        assert!(
            counts.iter().all(|count| (count - 10_000).abs() < 560),
            "{counts:?}"
        );
    }

    #[test]
    #[cfg(target_pointer_width = "64")]
    fn below_favours_no_number_where_limits_are_large() {
        // Scaling 64 random bits to 3 * 2^62 numbers gives the multiples of 3 two chances each, unless
        // some draws are rejected: they would be half of all instead of a third.
        let (limit, mut rng) = (3_usize << 62, Rng::new(5));
        let multiples = (0..9000)
            .filter(|_| rng.below(limit).is_multiple_of(3))
            .count();
        // 3,000 expected, standard deviation 45: six of them.
        assert!(multiples.abs_diff(3000) < 270, "{multiples}");
    }

    #[test]
    fn normal_draws_have_mean_zero_and_variance_one() {
        let mut draws = vec![0.0; 100_001];
        Rng::new(1).fill_normal(&mut draws);
        let mean = draws.iter().sum::<f32>() / 100_001.0;
        let variance = draws.iter().map(|x| x * x).sum::<f32>() / 100_001.0;
        assert!(mean.abs() < 0.02, "{mean}");
        assert!((variance - 1.0).abs() < 0.03, "{variance}");
    }

    #[test]
    fn the_zero_state_is_refused() {
        assert_eq!(Rng::from_state([0; 4]), None);
    }
}
