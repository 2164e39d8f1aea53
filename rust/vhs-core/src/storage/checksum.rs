//! XXH64 (Collet, "xxHash fast digest algorithm", specification 0.1.1): a checksum at the speed of
//! memory.
//!
//! It finds damage, not forgery: a file that was altered on purpose can carry a matching checksum,
//! which is why `persist` also checks every number it reads.

const P1: u64 = 0x9E37_79B1_85EB_CA87;
const P2: u64 = 0xC2B2_AE3D_27D4_EB4F;
const P3: u64 = 0x1656_67B1_9E37_79F9;
const P4: u64 = 0x85EB_CA77_C2B2_AE63;
const P5: u64 = 0x27D4_EB2F_1656_67C5;
/// Bytes taken in at once.
const STRIPE: usize = 32;

/// A running checksum with seed 0.
#[derive(Clone, Debug)]
pub(crate) struct Checksum {
    lanes: [u64; 4],
    /// Bytes not yet taken in: the first `total % STRIPE` are valid.
    tail: [u8; STRIPE],
    /// Bytes seen so far.
    total: u64,
}

impl Checksum {
    pub(crate) const fn new() -> Self {
        let lanes = [P1.wrapping_add(P2), P2, 0, P1.wrapping_neg()];
        Self {
            lanes,
            tail: [0; STRIPE],
            total: 0,
        }
    }

    /// The checksum of `bytes` alone.
    #[cfg(test)]
    pub(crate) fn of(bytes: &[u8]) -> u64 {
        let mut checksum = Self::new();
        checksum.update(bytes);
        checksum.value()
    }

    pub(crate) fn update(&mut self, mut bytes: &[u8]) {
        let held = self.held();
        self.total += bytes.len() as u64;
        if held > 0 {
            let taken = bytes.len().min(STRIPE - held);
            self.tail[held..held + taken].copy_from_slice(&bytes[..taken]);
            bytes = &bytes[taken..];
            if held + taken < STRIPE {
                return;
            }
            let stripe = self.tail;
            self.take(&stripe);
        }
        let (stripes, rest) = bytes.as_chunks::<STRIPE>();
        for stripe in stripes {
            self.take(stripe);
        }
        self.tail[..rest.len()].copy_from_slice(rest);
    }

    /// The checksum of everything seen so far.
    pub(crate) fn value(&self) -> u64 {
        let start = if self.total < STRIPE as u64 {
            P5
        } else {
            self.merged()
        };
        let mut hash = start.wrapping_add(self.total);
        let (words, rest) = self.tail[..self.held()].as_chunks::<8>();
        for &word in words {
            hash = (hash ^ round(0, u64::from_le_bytes(word)))
                .rotate_left(27)
                .wrapping_mul(P1)
                .wrapping_add(P4);
        }
        let (halves, rest) = rest.as_chunks::<4>();
        for &half in halves {
            hash ^= u64::from(u32::from_le_bytes(half)).wrapping_mul(P1);
            hash = hash.rotate_left(23).wrapping_mul(P2).wrapping_add(P3);
        }
        for &byte in rest {
            hash = (hash ^ u64::from(byte).wrapping_mul(P5))
                .rotate_left(11)
                .wrapping_mul(P1);
        }
        avalanche(hash)
    }

    /// Bytes that wait in `tail`, in 0..STRIPE.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "below STRIPE after the remainder"
    )]
    const fn held(&self) -> usize {
        (self.total % STRIPE as u64) as usize
    }

    fn take(&mut self, stripe: &[u8; STRIPE]) {
        let (words, _) = stripe.as_chunks::<8>();
        for (lane, &word) in self.lanes.iter_mut().zip(words) {
            *lane = round(*lane, u64::from_le_bytes(word));
        }
    }

    fn merged(&self) -> u64 {
        let rotated = self
            .lanes
            .iter()
            .zip([1, 7, 12, 18])
            .map(|(lane, by)| lane.rotate_left(by));
        let sum = rotated.fold(0_u64, u64::wrapping_add);
        self.lanes.iter().fold(sum, |hash, &lane| {
            (hash ^ round(0, lane)).wrapping_mul(P1).wrapping_add(P4)
        })
    }
}

const fn round(lane: u64, word: u64) -> u64 {
    lane.wrapping_add(word.wrapping_mul(P2))
        .rotate_left(31)
        .wrapping_mul(P1)
}

const fn avalanche(mut hash: u64) -> u64 {
    hash = (hash ^ (hash >> 33)).wrapping_mul(P2);
    hash = (hash ^ (hash >> 29)).wrapping_mul(P3);
    hash ^ (hash >> 32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn short_inputs_have_the_published_values() {
        assert_eq!(Checksum::of(b""), 0xEF46_DB37_51D8_E999);
        assert_eq!(Checksum::of(b"a"), 0xD24E_C4F1_A98C_6E5B);
        assert_eq!(Checksum::of(b"abc"), 0x44BC_2CF5_AD77_0999);
    }

    #[test]
    fn pieces_add_up_to_the_whole() {
        let bytes: Vec<u8> = (0..=255).cycle().take(1000).collect();
        for cut in 0..bytes.len() {
            let mut checksum = Checksum::new();
            checksum.update(&bytes[..cut]);
            checksum.update(&bytes[cut..]);
            assert_eq!(checksum.value(), Checksum::of(&bytes), "cut at {cut}");
        }
    }
}
