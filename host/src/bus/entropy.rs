//! Random bytes of the operating system, for tokens and keys.

use firmware::authority::{SEED_LEN, Seed};

use super::session::BusFailure;

/// Seed of a controller on a live bus.
///
/// # Errors
/// The operating system gives no random bytes.
pub fn seed() -> Result<Seed, BusFailure> {
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
