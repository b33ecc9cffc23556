//! Errors of the bus as the CAN controller reports them.

use std::fmt;

/// What a CAN controller noticed on the bus: the error frame of Linux `can/error.h`, decoded.
///
/// Over socketcand only the class arrives and the details are zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BusError {
    /// Error class bits.
    pub class: u32,
    /// Details; which bytes mean something depends on the class.
    pub details: [u8; 8],
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Cause {
    /// A frame could not be sent in time (class bit 0).
    TxTimeout,
    /// Arbitration was lost (bit 1), at this bit if the controller knows it.
    LostArbitration {
        /// Counted from 1.
        bit: Option<u8>,
    },
    /// A received frame was overwritten before it was read (bit 2, details byte 1, bit 0).
    RxOverflow,
    /// The transmit queue of the controller overflowed (bit 2, byte 1, bit 1).
    TxOverflow,
    /// An error counter has reached 96 (bit 2, byte 1, bits 2 and 3).
    ErrorWarning,
    /// An error counter has reached 128: the controller no longer destroys frames of others (bit 2,
    /// byte 1, bits 4 and 5).
    ErrorPassive,
    /// Both error counters are below 128 again (bit 2, byte 1, bit 6).
    ErrorActive,
    /// The controller reports a problem without saying which (bit 2).
    Controller,
    /// A frame violated the protocol (bit 3): bit, form, stuff or overload error.
    Protocol {
        /// Kind: bits of details byte 2.
        kind: u8,
        /// Where in the frame: details byte 3.
        location: u8,
    },
    /// The transceiver reports a fault of the wires (bit 4, details byte 4).
    Transceiver {
        /// As in `can/error.h`.
        status: u8,
    },
    /// No node acknowledged a frame (bit 5).
    NoAcknowledge,
    /// The transmit error counter has passed 255: the controller has left the bus (bit 6).
    BusOff,
    /// Bus errors in general (bit 7).
    BusError,
    /// The controller is back after bus-off (bit 8).
    Restarted,
}

impl BusError {
    /// An error of which only the class is known.
    pub const fn from_class(class: u32) -> Self {
        Self { class, details: [0; 8] }
    }

    /// All causes in the report, most severe first.
    pub fn causes(&self) -> impl Iterator<Item = Cause> + use<> {
        let Self { class, details: [lost_at, controller, kind, location, status, ..] } = *self;
        let has = move |bit: u32| class & 1 << bit != 0;
        let says = move |mask: u8| has(2) && controller & mask != 0;
        [
            (has(6), Cause::BusOff),
            (has(8), Cause::Restarted),
            (says(0x30), Cause::ErrorPassive),
            (says(0x0C), Cause::ErrorWarning),
            (says(0x40), Cause::ErrorActive),
            (says(0x01), Cause::RxOverflow),
            (says(0x02), Cause::TxOverflow),
            (has(2) && controller & 0x7F == 0, Cause::Controller),
            (has(5), Cause::NoAcknowledge),
            (has(3), Cause::Protocol { kind, location }),
            (has(1), Cause::LostArbitration { bit: (lost_at > 0).then_some(lost_at) }),
            (has(4), Cause::Transceiver { status }),
            (has(0), Cause::TxTimeout),
            (has(7), Cause::BusError),
        ]
        .into_iter()
        .filter_map(|(present, cause)| present.then_some(cause))
    }

    /// Transmit and receive error counters, if the controller reports them (class bit 9).
    pub const fn counters(&self) -> Option<(u8, u8)> {
        let [.., tec, rec] = self.details;
        if self.class & 1 << 9 == 0 { None } else { Some((tec, rec)) }
    }
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TxTimeout => f.write_str("a frame could not be sent in time"),
            Self::LostArbitration { bit: Some(bit) } => write!(f, "arbitration lost at bit {bit}"),
            Self::LostArbitration { bit: None } => f.write_str("arbitration lost"),
            Self::RxOverflow => f.write_str("the controller lost received frames"),
            Self::TxOverflow => f.write_str("the controller lost frames to be sent"),
            Self::ErrorWarning => f.write_str("many errors (counter at 96 or above)"),
            Self::ErrorPassive => f.write_str("error passive (counter at 128 or above)"),
            Self::ErrorActive => f.write_str("error active again"),
            Self::Controller => f.write_str("a problem of the controller"),
            Self::Protocol { kind, location } => {
                write!(f, "protocol violation (kind {kind:02X} at {location:02X})")
            }
            Self::Transceiver { status } => write!(f, "fault of the wires (transceiver status {status:02X})"),
            Self::NoAcknowledge => {
                f.write_str("no node acknowledges: is another node on the bus, at this bit rate?")
            }
            Self::BusOff => f.write_str("bus off: the controller has left the bus"),
            Self::BusError => f.write_str("errors on the bus"),
            Self::Restarted => f.write_str("the controller is back on the bus"),
        }
    }
}

impl fmt::Display for BusError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut separator = "";
        for cause in self.causes() {
            write!(f, "{separator}{cause}")?;
            separator = "; ";
        }
        if separator.is_empty() {
            write!(f, "error class {:03X}", self.class)?;
        }
        match self.counters() {
            Some((tec, rec)) => write!(f, " (transmit errors {tec}, receive errors {rec})"),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn class_and_details_are_decoded_gravest_first() {
        // Bus-off, error passive on transmit, no acknowledge, with counters.
        let error = BusError { class: 0x264, details: [0, 0x20, 0, 0, 0, 0, 255, 12] };
        assert_eq!(
            error.causes().collect::<Vec<_>>(),
            [Cause::BusOff, Cause::ErrorPassive, Cause::NoAcknowledge]
        );
        assert_eq!(error.counters(), Some((255, 12)));
        assert!(error.to_string().starts_with("bus off: "), "{error}");
        assert!(error.to_string().ends_with("(transmit errors 255, receive errors 12)"), "{error}");
    }

    #[test]
    fn a_bare_class_still_says_something() {
        assert_eq!(BusError::from_class(0x04).causes().collect::<Vec<_>>(), [Cause::Controller]);
        assert_eq!(BusError::from_class(0x400).to_string(), "error class 400");
        let lost = BusError { class: 2, details: [13, 0, 0, 0, 0, 0, 0, 0] };
        assert_eq!(lost.to_string(), "arbitration lost at bit 13");
    }
}
