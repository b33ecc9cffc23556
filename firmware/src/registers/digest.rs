//! The checksum of what a certificate of gains depends on, and the digest of what a run depends on. Both are
//! computed over the stored rows of registers: first those of the controller, then those of its drives.

use sha2::{Digest as _, Sha256};

use super::{RegisterInfo, all, to_row};
use crate::crc::Crc32;
use crate::credentials::Digest;
use crate::settings::Settings;

fn rows(settings: &Settings, wanted: fn(&RegisterInfo) -> bool, mut take: impl FnMut(&[u8])) {
    for (index, _) in all(settings).enumerate().filter(|(_, info)| wanted(info)) {
        if let Some(row) = to_row(settings, index) {
            take(&row);
        }
    }
}

/// Checksum over the settings that the certificate of the gains in `settings` must match: gains, weights, period,
/// delay, lag, age of a reply, acceleration and robot. Never 0, which stands for no certificate.
pub fn certificate_crc32(settings: &Settings) -> u32 {
    let mut crc = Crc32::new();
    rows(settings, |info| info.is_proven, |row| crc.update(row));
    crc.get().max(1)
}

/// SHA-256 over the SHA-256 of a trajectory file and the rows of all registers that its run depends on.
pub fn run_digest(file: &Digest, settings: &Settings) -> Digest {
    let mut sha256 = Sha256::new();
    sha256.update(file);
    rows(settings, RegisterInfo::is_in_digest, |row| sha256.update(row));
    sha256.finalize().into()
}
