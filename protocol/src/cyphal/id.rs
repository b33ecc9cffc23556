//! Content of a 29-bit identifier: sender, receiver, subject or service, urgency.
//!
//! Cyphal specification v1.0, section 4.2.1 (CAN ID field):
//!
//! ```text
//!  bit      28..26  25  24         23  22 21  20..........8      7  6.....0
//!  message  prio    0   anonymous  0   1  1   subject-ID (13)    0  source
//!  bit      28..26  25  24         23  22........14  13......7      6.....0
//!  service  prio    1   request    0   service-ID    destination    source
//! ```
//!
//! Bits 22 and 21 of a message are sent as ones and ignored on receipt.

use core::fmt;

use crate::id::ExtendedId;
use crate::module::RangeError;

macro_rules! small_number {
    ($(#[$doc:meta])* $name:ident, $repr:ty, $max:literal) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
        pub struct $name($repr);

        impl $name {
            /// Largest value.
            pub const MAX: Self = Self($max);

            /// Checks the range.
            pub const fn new(value: $repr) -> Result<Self, RangeError> {
                if value <= $max {
                    Ok(Self(value))
                } else {
                    Err(RangeError { value: value as u32, min: 0, max: $max })
                }
            }

            /// Takes the low bits, for numbers cut out of a field of exactly that width.
            pub const fn from_low_bits(value: $repr) -> Self {
                Self(value & $max)
            }

            /// The number.
            pub const fn get(self) -> $repr {
                self.0
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                self.0.fmt(f)
            }
        }
    };
}

small_number!(
    /// Address of a Cyphal node, 0..=127; not the address of a drive ([`crate::ModuleId`]).
    NodeId, u8, 127
);
small_number!(
    /// Number of a message stream, 0..=8191; below 6144 free for the integrator, from 7168 standard.
    SubjectId, u16, 8191
);
small_number!(
    /// Number of a service, 0..=511; below 256 free for the integrator, from 384 standard.
    ServiceId, u16, 511
);
small_number!(
    /// Number of a transfer within its session, counting modulo 32 (section 4.1.1.7).
    TransferId, u8, 31
);

impl TransferId {
    /// The first transfer of a session.
    pub const ZERO: Self = Self(0);

    /// The transfer after this one; 0 follows 31.
    #[must_use]
    pub const fn next(self) -> Self {
        Self::from_low_bits(self.0 + 1)
    }
}

/// Urgency of a transfer; the smaller number wins the bus (section 4.1.1.3).
///
/// On this bus only *stop* may be [`Exceptional`](Self::Exceptional): every message of that level
/// wins against every PowerCube id, every transfer of another level loses against all of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[repr(u8)]
pub enum Priority {
    /// 0: total failure; here: stop the arm.
    Exceptional = 0,
    /// 1: as fast as the bus allows.
    Immediate = 1,
    /// 2: short and bounded delay.
    Fast = 2,
    /// 3: before normal traffic.
    High = 3,
    /// 4: for everything that has no reason to use another.
    Nominal = 4,
    /// 5: may wait for normal traffic.
    Low = 5,
    /// 6: no time limit.
    Slow = 6,
    /// 7: may never be sent.
    Optional = 7,
}

impl Priority {
    /// All levels, most urgent first.
    pub const ALL: [Self; 8] = [
        Self::Exceptional,
        Self::Immediate,
        Self::Fast,
        Self::High,
        Self::Nominal,
        Self::Low,
        Self::Slow,
        Self::Optional,
    ];

    const fn from_low_bits(value: u32) -> Self {
        match value & 7 {
            0 => Self::Exceptional,
            1 => Self::Immediate,
            2 => Self::Fast,
            3 => Self::High,
            4 => Self::Nominal,
            5 => Self::Low,
            6 => Self::Slow,
            _ => Self::Optional,
        }
    }
}

/// Session specifier: subject or service, and the nodes (section 4.1.1.6).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Route {
    /// Message from a node to all nodes.
    Message {
        /// What the message is.
        subject: SubjectId,
        /// Who sends it.
        source: NodeId,
    },
    /// Message from a node without an address.
    Anonymous {
        /// What the message is.
        subject: SubjectId,
        /// Number that only distinguishes two senders in arbitration.
        pseudo_id: u8,
    },
    /// Request from a client to a server.
    Request {
        /// Requested service.
        service: ServiceId,
        /// The client.
        source: NodeId,
        /// The server.
        destination: NodeId,
    },
    /// Response from a server to a client.
    Response {
        /// Service of the request.
        service: ServiceId,
        /// The server.
        source: NodeId,
        /// The client.
        destination: NodeId,
    },
}

/// Why a 29-bit id is not one of Cyphal v1.0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RouteError {
    /// Reserved bit 23 is one.
    ReservedBit23,
    /// Reserved bit 7 of a message is one.
    ReservedBit7,
    /// A service whose source is its destination.
    ToItself {
        /// The node that is both.
        node: NodeId,
    },
}

impl fmt::Display for RouteError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::ReservedBit23 => write!(f, "reserved bit 23 of the CAN id is set"),
            Self::ReservedBit7 => write!(f, "reserved bit 7 of the CAN id of a message is set"),
            Self::ToItself { node } => write!(f, "service transfer of node {node} to itself"),
        }
    }
}

impl core::error::Error for RouteError {}

const SERVICE: u32 = 1 << 25;
const ANONYMOUS: u32 = 1 << 24;
const REQUEST: u32 = 1 << 24;
const RESERVED_23: u32 = 1 << 23;
const MESSAGE_ONES: u32 = 3 << 21;
const RESERVED_7: u32 = 1 << 7;

impl Route {
    /// The identifier under which frames of this route travel.
    pub const fn can_id(self, priority: Priority) -> ExtendedId {
        let fields = match self {
            Self::Message { subject, source } => MESSAGE_ONES | (subject.0 as u32) << 8 | source.0 as u32,
            Self::Anonymous { subject, pseudo_id } => {
                MESSAGE_ONES | ANONYMOUS | (subject.0 as u32) << 8 | (pseudo_id & 0x7F) as u32
            }
            Self::Request { service, source, destination } => {
                SERVICE | REQUEST | service_fields(service, source, destination)
            }
            Self::Response { service, source, destination } => {
                SERVICE | service_fields(service, source, destination)
            }
        };
        ExtendedId::from_low_bits((priority as u32) << 26 | fields)
    }

    /// Reads an identifier; the inverse of [`Self::can_id`].
    pub const fn parse(id: ExtendedId) -> Result<(Priority, Self), RouteError> {
        let id = id.get();
        if id & RESERVED_23 != 0 {
            return Err(RouteError::ReservedBit23);
        }
        let source = NodeId::from_low_bits(id as u8);
        let route = if id & SERVICE != 0 {
            let service = ServiceId::from_low_bits((id >> 14) as u16);
            let destination = NodeId::from_low_bits((id >> 7) as u8);
            if source.0 == destination.0 {
                return Err(RouteError::ToItself { node: source });
            }
            if id & REQUEST != 0 {
                Self::Request { service, source, destination }
            } else {
                Self::Response { service, source, destination }
            }
        } else {
            if id & RESERVED_7 != 0 {
                return Err(RouteError::ReservedBit7);
            }
            let subject = SubjectId::from_low_bits((id >> 8) as u16);
            if id & ANONYMOUS != 0 {
                Self::Anonymous { subject, pseudo_id: source.0 }
            } else {
                Self::Message { subject, source }
            }
        };
        Ok((Priority::from_low_bits(id >> 26), route))
    }

    /// The sender; `None` if it has no address.
    pub const fn source(self) -> Option<NodeId> {
        match self {
            Self::Anonymous { .. } => None,
            Self::Message { source, .. } | Self::Request { source, .. } | Self::Response { source, .. } => {
                Some(source)
            }
        }
    }
}

const fn service_fields(service: ServiceId, source: NodeId, destination: NodeId) -> u32 {
    (service.0 as u32) << 14 | (destination.0 as u32) << 7 | source.0 as u32
}

/// Last byte of every frame: place of the frame in its transfer (section 4.2.2.1).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tail {
    /// First frame of the transfer.
    pub start: bool,
    /// Last frame of the transfer.
    pub end: bool,
    /// One in the first frame, then alternating. Zero in a first frame marks the older, different
    /// protocol UAVCAN v0.
    pub toggle: bool,
    /// Number of the transfer.
    pub transfer_id: TransferId,
}

impl Tail {
    /// Reads the byte; every value has a meaning.
    pub const fn parse(byte: u8) -> Self {
        Self {
            start: byte & 0x80 != 0,
            end: byte & 0x40 != 0,
            toggle: byte & 0x20 != 0,
            transfer_id: TransferId::from_low_bits(byte),
        }
    }

    /// The byte.
    pub const fn byte(self) -> u8 {
        (self.start as u8) << 7 | (self.end as u8) << 6 | (self.toggle as u8) << 5 | self.transfer_id.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::id::{Id, StandardId};
    use proptest::prelude::*;

    fn node(id: u8) -> NodeId {
        NodeId::new(id).unwrap()
    }

    #[test]
    fn ids_of_the_examples_in_the_specification() {
        // Section 4.2.3: heartbeat of node 42.
        let heartbeat = Route::Message { subject: SubjectId::new(7509).unwrap(), source: node(42) };
        assert_eq!(heartbeat.can_id(Priority::Nominal).get(), 0x107D_552A);
        // Anonymous message on subject 0x1337, pseudo-ID 0x75.
        let anonymous = Route::Anonymous { subject: SubjectId::new(0x1337).unwrap(), pseudo_id: 0x75 };
        assert_eq!(anonymous.can_id(Priority::Nominal).get(), 0x1113_3775 | 0x60_0000);
        // The specification prints that id with bits 22 and 21 at zero; both read alike.
        assert_eq!(Route::parse(ExtendedId::from_low_bits(0x1113_3775)).unwrap().1, anonymous);
        // GetInfo of node 42 by node 123.
        let service = ServiceId::new(430).unwrap();
        let request = Route::Request { service, source: node(123), destination: node(42) };
        assert_eq!(request.can_id(Priority::Nominal).get(), 0x136B_957B);
        let response = Route::Response { service, source: node(42), destination: node(123) };
        assert_eq!(response.can_id(Priority::Nominal).get(), 0x126B_BDAA);
    }

    #[test]
    fn reserved_bits_and_services_to_oneself_are_refused() {
        let parse = |id| Route::parse(ExtendedId::from_low_bits(id)).unwrap_err();
        assert_eq!(parse(0x107D_552A | 1 << 23), RouteError::ReservedBit23);
        assert_eq!(parse(0x107D_552A | 1 << 7), RouteError::ReservedBit7);
        assert_eq!(parse(0x136B_957B & !0x7F | 42), RouteError::ToItself { node: node(42) });
    }

    /// Every id that a PowerCube or its host uses: state, answer, get, set, broadcast.
    fn power_cube_ids() -> impl Iterator<Item = Id> {
        [0x060, 0x0A0, 0x0C0, 0x0E0]
            .into_iter()
            .flat_map(|base| (1..=31).map(move |module| base + module))
            .chain([0x100])
            .map(|id| Id::Standard(StandardId::new(id).unwrap()))
    }

    fn all_routes() -> impl Iterator<Item = Route> {
        let nodes = [0, 1, 42, 126, 127].map(|id| NodeId::new(id).unwrap());
        let pairs = nodes.into_iter().flat_map(move |a| nodes.map(move |b| (a, b))).filter(|(a, b)| a != b);
        let messages = (0..=8191).flat_map(move |subject| {
            let subject = SubjectId::new(subject).unwrap();
            nodes.into_iter().flat_map(move |source| {
                [Route::Message { subject, source }, Route::Anonymous { subject, pseudo_id: source.get() }]
            })
        });
        let services = (0..=511).flat_map(move |service| {
            let service = ServiceId::new(service).unwrap();
            pairs.clone().flat_map(move |(source, destination)| {
                [
                    Route::Request { service, source, destination },
                    Route::Response { service, source, destination },
                ]
            })
        });
        messages.chain(services)
    }

    #[test]
    fn a_message_of_priority_0_wins_against_every_power_cube_id() {
        for route in all_routes() {
            if let Route::Message { .. } = route {
                let id = Id::Extended(route.can_id(Priority::Exceptional));
                assert!(power_cube_ids().all(|cube| id < cube), "{route:?}");
            }
        }
    }

    #[test]
    fn every_other_priority_loses_against_every_power_cube_id() {
        for route in all_routes() {
            for priority in Priority::ALL.into_iter().skip(1) {
                let id = Id::Extended(route.can_id(priority));
                assert!(power_cube_ids().all(|cube| cube < id), "{priority:?} {route:?}");
            }
        }
    }

    proptest! {
        #[test]
        fn any_id_parses_and_what_parses_is_written_back(raw in 0_u32..=0x1FFF_FFFF) {
            let id = ExtendedId::from_low_bits(raw);
            if let Ok((priority, route)) = Route::parse(id) {
                let ones = if raw & SERVICE == 0 { MESSAGE_ONES } else { 0 };
                prop_assert_eq!(route.can_id(priority).get(), raw | ones);
                prop_assert_eq!(Route::parse(route.can_id(priority)), Ok((priority, route)));
            }
        }

        #[test]
        fn any_tail_byte_is_written_back(byte: u8) {
            prop_assert_eq!(Tail::parse(byte).byte(), byte);
        }
    }
}
