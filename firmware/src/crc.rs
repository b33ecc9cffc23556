//! CRC-32 (ISO-HDLC: reflected polynomial 0xEDB88320, all ones before and after): ends every file and record. The
//! checksum that *names* a file on the wire is Cyphal's, [`protocol::cyphal::crc::Crc64`].

/// CRC-32 of the data so far; takes data in pieces.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Crc32(u32);

impl Default for Crc32 {
    fn default() -> Self {
        Self::new()
    }
}

impl Crc32 {
    /// State before the first byte.
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

    /// The checksum of the data so far.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn check_values_of_the_crc_catalogue() {
        assert_eq!(Crc32::of(b"123456789"), 0xCBF4_3926);
    }
}
