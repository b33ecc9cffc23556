//! The two checksums of Cyphal: over the frames of one transfer, and over stored images.

/// CRC-16/CCITT-FALSE, the transfer CRC: polynomial 0x1021, initial value 0xFFFF, not reflected, no
/// final inversion (Cyphal specification v1.0, section 4.2.2.4 and appendix).
///
/// Sent big-endian after the payload, so that the CRC over payload and CRC is zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Crc16(u16);

impl Crc16 {
    /// Before the first byte.
    pub const INITIAL: Self = Self(0xFFFF);
    /// Before the first byte, with the initial value 0: CRC-16/XMODEM, as CANopen uses for blocks.
    pub const ZERO: Self = Self(0);

    /// Takes the next bytes of the transfer.
    pub fn update(&mut self, data: &[u8]) {
        for byte in data {
            // Byte-wise form of the polynomial division: no table, ten instructions a byte.
            let mut x = (self.0 >> 8) ^ u16::from(*byte);
            x ^= x >> 4;
            self.0 = (self.0 << 8) ^ (x << 12) ^ (x << 5) ^ x;
        }
    }

    /// The checksum of the data so far.
    pub const fn get(self) -> u16 {
        self.0
    }

    /// True if the data so far ended with its own CRC.
    pub const fn is_residue(self) -> bool {
        self.0 == 0
    }
}

/// CRC-64/WE, the checksum that Cyphal uses for software images (`GetInfo.software_image_crc`) and
/// that this project uses to name a stored file: polynomial 0x42F0E1EBA9EA3693, initial value and
/// final inversion all ones, not reflected.
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

    /// Takes the next bytes; bit by bit, about 50 instructions a byte on a Cortex-M.
    #[inline(never)]
    pub fn update(&mut self, data: &[u8]) {
        for byte in data {
            self.0 ^= u64::from(*byte) << 56;
            for _ in 0..8 {
                let out = (self.0 >> 63) != 0;
                self.0 <<= 1;
                if out {
                    self.0 ^= 0x42F0_E1EB_A9EA_3693;
                }
            }
        }
    }

    /// The checksum of the data so far.
    pub const fn get(self) -> u64 {
        self.0 ^ u64::MAX
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
        let mut crc = Crc16::INITIAL;
        crc.update(b"123456789");
        assert_eq!(crc.get(), 0x29B1);
        assert_eq!(Crc64::of(b"123456789"), 0x62EC_59E3_F1A4_F00A);
    }

    #[test]
    fn payload_followed_by_its_crc_leaves_no_residue() {
        let mut crc = Crc16::INITIAL;
        crc.update(b"drive");
        assert!(!crc.is_residue());
        let sum = crc.get().to_be_bytes();
        crc.update(&sum);
        assert!(crc.is_residue());
    }

    #[test]
    fn checksum_in_pieces_is_the_checksum_of_the_whole() {
        let mut crc = Crc64::new();
        crc.update(b"1234");
        crc.update(b"");
        crc.update(b"56789");
        assert_eq!(crc.get(), Crc64::of(b"123456789"));
    }
}
