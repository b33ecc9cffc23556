//! 11-bit ids of the M5 protocol: function code in bits 5.., module address in the low five bits.

use crate::id::{Id, StandardId};
use crate::module::ModuleId;

/// What travels on an id, seen from the module.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Channel {
    /// 0x060 + address: state word sent by the module unasked.
    State,
    /// 0x0A0 + address: answer of the module.
    Ack,
    /// 0x0C0 + address: host asks.
    Get,
    /// 0x0E0 + address: host orders.
    Put,
}

impl Channel {
    /// Id of the channel's address 0; a module's id is this plus its address.
    pub const fn base(self) -> u16 {
        match self {
            Self::State => 0x060,
            Self::Ack => 0x0A0,
            Self::Get => 0x0C0,
            Self::Put => 0x0E0,
        }
    }

    /// The id on which this channel of `module` travels.
    pub const fn id(self, module: ModuleId) -> Id {
        Id::Standard(StandardId::from_low_bits(self.base() + module.get() as u16))
    }
}

/// The id of every broadcast; no module answers.
pub const BROADCAST_ID: StandardId = StandardId::from_low_bits(0x100);

/// An id of the bus, understood.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Address {
    /// To or from one module.
    Module(Channel, ModuleId),
    /// To all modules.
    Broadcast,
}

impl Address {
    /// Understands an id; `None` if no PowerCube uses it (29-bit, other range, address 0).
    pub fn of(id: Id) -> Option<Self> {
        let Id::Standard(id) = id else { return None };
        if id == BROADCAST_ID {
            return Some(Self::Broadcast);
        }
        let channel = match id.get() & !0x1F {
            0x060 => Channel::State,
            0x0A0 => Channel::Ack,
            0x0C0 => Channel::Get,
            0x0E0 => Channel::Put,
            _ => return None,
        };
        let module = ModuleId::new((id.get() & 0x1F) as u8).ok()?;
        Some(Self::Module(channel, module))
    }

    /// The id of this address.
    pub const fn id(self) -> Id {
        match self {
            Self::Module(channel, module) => channel.id(module),
            Self::Broadcast => Id::Standard(BROADCAST_ID),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_id_of_every_channel_is_understood_and_no_other() {
        let mut known = 0;
        for raw in 0..=StandardId::MAX.get() {
            let id = Id::Standard(StandardId::from_low_bits(raw));
            if let Some(address) = Address::of(id) {
                known += 1;
                assert_eq!(address.id(), id);
            }
        }
        assert_eq!(known, 4 * 31 + 1);
    }

    #[test]
    fn first_and_last_id_of_each_channel_are_those_of_the_reference() {
        let ids = |channel: Channel| (channel.id(ModuleId::MIN).raw(), channel.id(ModuleId::MAX).raw());
        assert_eq!(ids(Channel::Get), (0x0C1, 0x0DF));
        assert_eq!(ids(Channel::Put), (0x0E1, 0x0FF));
        assert_eq!(ids(Channel::Ack), (0x0A1, 0x0BF));
        assert_eq!(ids(Channel::State), (0x061, 0x07F));
    }
}
