//! Options of a bus.

use super::queue::TxOrder;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Recovery {
    /// The controller counts 128 sequences of eleven recessive bits at once.
    #[default]
    Automatic,
    /// It begins to count when its software requests it ([`Bus::request_recovery`](super::Bus::request_recovery)).
    OnRequest,
}

/// Bit rate that the model cannot represent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{bit_rate_bit_s} bit/s: a bit must last a whole number of nanoseconds, from 1 us (1 Mbit/s) to 100 us, in the data phase \
     of CAN FD from 100 ns (10 Mbit/s)"
)]
pub struct BitRateError {
    pub bit_rate_bit_s: u32,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BusConfig {
    /// Bits per second, 10 000 to 1 000 000, such that a bit is a whole number of nanoseconds.
    pub bit_rate_bit_s: u32,
    /// Bits per second of the data phase of CAN FD frames with bit rate switch, up to 10 000 000, such that a bit is a whole number
    /// of nanoseconds; `None`: all nodes are classical, unless the nodes need one ([`crate::Participants::data_bit_rate_bit_s`]).
    pub data_bit_rate_bit_s: Option<u32>,
    /// Frames that can wait in each node.
    pub queue_depth: usize,
    /// Order in which each node offers them.
    pub tx_order: TxOrder,
    pub recovery: Recovery,
}

impl Default for BusConfig {
    fn default() -> Self {
        Self {
            bit_rate_bit_s: 1_000_000,
            data_bit_rate_bit_s: None,
            queue_depth: 32,
            tx_order: TxOrder::Fifo,
            recovery: Recovery::Automatic,
        }
    }
}
