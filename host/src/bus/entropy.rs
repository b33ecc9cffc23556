//! Random bytes of the operating system, for tokens and keys.

use can_link::Clock;
use firmware::authority::{SEED_LEN, Seed};

use super::session::BusFailure;

/// Seed of a controller that runs on `clock`: random bytes, or [`Seed::FORESEEABLE`] on a manual clock. In virtual time
/// nothing real moves, and a run must repeat byte for byte.
///
/// # Errors
/// The operating system gives no random bytes.
pub fn seed(clock: Clock) -> Result<Seed, BusFailure> {
    if clock.is_manual() {
        return Ok(Seed::FORESEEABLE);
    }
    Ok(Seed::from_entropy(bytes::<SEED_LEN>()?))
}

/// Random bytes.
///
/// # Errors
/// The operating system gives none.
pub fn bytes<const N: usize>() -> Result<[u8; N], BusFailure> {
    let mut bytes = [0; N];
    getrandom::fill(&mut bytes).map_err(|error| BusFailure::Entropy(error.to_string()))?;
    Ok(bytes)
}
