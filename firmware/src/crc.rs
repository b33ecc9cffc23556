//! The two checksums of stored things.
//!
//! CRC-32 (ISO-HDLC: reflected polynomial 0xEDB88320, all ones before and after) ends every file and
//! record. CRC-64/WE (polynomial 0x42F0E1EBA9EA3693, not reflected, all ones before and after; the checksum
//! of software images in Cyphal) names a file on the wire.

/// CRC-32 of what came so far; takes data in pieces.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Crc32(u32);

impl Default for Crc32 {
    fn default() -> Self {
        Self::new()
    }
}

impl Crc32 {
    /// Before the first byte.
    pub const fn new() -> Self {
        Self(u32::MAX)
    }

    /// Takes the next bytes; bit by bit, without a table: a file is checked once, when nothing moves.
    pub fn update(&mut self, data: &[u8]) {
        for byte in data {
            self.0 ^= u32::from(*byte);
            for _ in 0..8 {
                let out = self.0 & 1 != 0;
                self.0 >>= 1;
                if out {
                    self.0 ^= 0xEDB8_8320;
                }
            }
        }
    }

    /// The checksum of what came so far.
    pub const fn get(self) -> u32 {
        !self.0
    }

    /// Checksum of one piece of data.
    pub fn of(data: &[u8]) -> u32 {
        let mut crc = Self::new();
        crc.update(data);
        crc.get()
    }
}

/// CRC-64/WE of what came so far; takes data in pieces.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Crc64(u64);

impl Default for Crc64 {
    fn default() -> Self {
        Self::new()
    }
}

impl Crc64 {
    /// Before the first byte.
    pub const fn new() -> Self {
        Self(u64::MAX)
    }

    /// Takes the next bytes.
    pub fn update(&mut self, data: &[u8]) {
        for byte in data {
            self.0 ^= u64::from(*byte) << 56;
            for _ in 0..8 {
                let out = self.0 >> 63 != 0;
                self.0 <<= 1;
                if out {
                    self.0 ^= 0x42F0_E1EB_A9EA_3693;
                }
            }
        }
    }

    /// The checksum of what came so far.
    pub const fn get(self) -> u64 {
        !self.0
    }

    /// Checksum of one piece of data.
    pub fn of(data: &[u8]) -> u64 {
        let mut crc = Self::new();
        crc.update(data);
        crc.get()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn check_values_of_the_crc_catalogue() {
        assert_eq!(Crc64::of(b"123456789"), 0x62EC_59E3_F1A4_F00A);
        assert_eq!(Crc32::of(b"123456789"), 0xCBF4_3926);
    }
}
