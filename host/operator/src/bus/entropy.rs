//! Random bytes of the operating system, for tokens and keys.

use can_link::Clock;
use firmware::authority::{SEED_LEN, Seed};

/// The operating system gives no random bytes.
#[derive(Debug, thiserror::Error)]
#[error("no random bytes for tokens: {0}")]
pub struct NoEntropy(String);

impl NoEntropy {
    /// What to do.
    #[must_use]
    pub fn next(&self) -> Option<String> {
        Some("check that /dev/urandom can be read".to_owned())
    }
}

/// Seed of a controller that runs on `clock`: random bytes, or [`Seed::FORESEEABLE`] on a manual clock. In virtual time
/// nothing real moves, and a run must repeat byte for byte.
pub fn seed(clock: Clock) -> Result<Seed, NoEntropy> {
    if clock.is_manual() {
        return Ok(Seed::FORESEEABLE);
    }
    Ok(Seed::from_entropy(bytes::<SEED_LEN>()?))
}

pub fn bytes<const N: usize>() -> Result<[u8; N], NoEntropy> {
    let mut bytes = [0; N];
    getrandom::fill(&mut bytes).map_err(|error| NoEntropy(error.to_string()))?;
    Ok(bytes)
}
