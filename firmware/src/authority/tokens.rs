//! Unpredictable numbers: HMAC-SHA-256 over a counter, with the board's seed as key.

use hmac::{Hmac, KeyInit, Mac};
use sha2::Sha256;

/// Bytes of a seed.
pub const SEED_LEN: usize = 32;

/// Start value of all tokens and challenges of one power cycle.
#[derive(Clone)]
pub struct Seed([u8; SEED_LEN]);

impl Seed {
    /// A public seed: tokens can be predicted. For virtual time, emulated boards and tests, where equal runs must
    /// give equal logs; never for a bus with hardware on it.
    pub const FORESEEABLE: Self = Self(*b"cube-cell seed of virtual time..");

    /// Seed of random bytes: a hardware generator, or the operating system's.
    pub const fn from_entropy(bytes: [u8; SEED_LEN]) -> Self {
        Self(bytes)
    }
}

/// Does not print the bytes.
impl core::fmt::Debug for Seed {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("Seed")
    }
}

/// Stream of numbers of one seed.
pub(crate) struct Tokens {
    seed: Seed,
    count: u64,
}

impl Tokens {
    pub(crate) const fn new(seed: Seed) -> Self {
        Self { seed, count: 0 }
    }

    /// The next eight bytes of the stream.
    pub(crate) fn next_bytes(&mut self) -> [u8; 8] {
        self.count = self.count.wrapping_add(1);
        let mut bytes = [0; 8];
        // HMAC takes a key of any length.
        if let Ok(mut mac) = <Hmac<Sha256> as KeyInit>::new_from_slice(&self.seed.0) {
            mac.update(&self.count.to_le_bytes());
            for (to, from) in bytes.iter_mut().zip(mac.finalize().into_bytes()) {
                *to = from;
            }
        }
        bytes
    }

    /// A token. Never 0, because an unset field holds 0.
    pub(crate) fn next_token(&mut self) -> u32 {
        let [a, b, c, d, ..] = self.next_bytes();
        u32::from_le_bytes([a, b, c, d]).max(1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tokens_differ_by_count_and_by_seed_and_repeat_for_the_same_seed() {
        let draw = |seed: Seed| {
            let mut tokens = Tokens::new(seed);
            core::array::from_fn::<u32, 4, _>(|_| tokens.next_token())
        };
        let (one, two) = (draw(Seed::FORESEEABLE), draw(Seed::from_entropy([7; SEED_LEN])));
        assert_eq!(one, draw(Seed::FORESEEABLE));
        let mut all: Vec<u32> = one.into_iter().chain(two).collect();
        all.sort_unstable();
        all.dedup();
        assert_eq!(all.len(), 8);
    }

    /// RFC 4231, test case 2, through the same crates.
    #[test]
    fn hmac_is_the_one_of_the_standard() {
        let mut mac = <Hmac<Sha256> as KeyInit>::new_from_slice(b"Jefe").unwrap();
        mac.update(b"what do ya want for nothing?");
        let bytes = mac.finalize().into_bytes();
        assert_eq!(bytes[..8], [0x5b, 0xdc, 0xc1, 0x46, 0xbf, 0x60, 0x75, 0x4e]);
    }
}
