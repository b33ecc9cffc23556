//! Cyphal/CAN v1.0: the link between the controller and its hosts, on 29-bit ids.
//!
//! A standard protocol, so that unmodified public tools (`yakut`, `pycyphal`) can read the controller, and users
//! need not learn another protocol. Written from the *Cyphal Specification v1.0* for classical CAN (8-byte frames).
//!
//! # Layers (arrows go up the table)
//!
//! | layer | modules | is | must not |
//! |---|---|---|---|
//! | serialisation | [`bits`], [`crc`] | DSDL bit fields, checksums | know a message |
//! | transport | [`id`], [`tx`], [`rx`] | frames to transfers and back | know what bytes mean, read a clock |
//! | messages | [`uavcan`], [`cubecell`] | standard types; our own types (`protocol/dsdl/cubecell`) | know who sends them when |
//! | node | [`server`], [`client`], [`upload`], [`host`] | functions of every node; requests in flight; file transfer; a host | do IO, know the controller |
//!
//! # Shared bus
//!
//! The drives speak on 11-bit ids 0x061..=0x100. A Cyphal message of priority 0 wins against all of
//! them and everything of another priority loses; only *stop* may use priority 0 (tested in
//! [`id`]). UAVCAN v0 frames, 11-bit frames and remote frames are counted and ignored.

pub mod bits;
pub mod client;
pub mod crc;
pub mod cubecell;
pub mod host;
pub mod id;
pub mod rx;
pub mod server;
pub mod tx;
pub mod uavcan;
pub mod upload;

/// Calls the macro `$then` with its own arguments and then every message and both halves of every
/// service, as a list of types: for checks and measurements that must not miss one.
#[macro_export]
macro_rules! for_every_cyphal_type {
    ($then:ident $(, $argument:expr)*) => {
        $then!(
            $($argument,)*
            $crate::cyphal::uavcan::heartbeat::Heartbeat,
            $crate::cyphal::uavcan::diagnostic::Record<'_>,
            $crate::cyphal::uavcan::port_list::PortList<'_>,
            $crate::cyphal::uavcan::info::NodeInfo<'_>,
            $crate::cyphal::uavcan::register::AccessRequest<'_>,
            $crate::cyphal::uavcan::register::AccessResponse<'_>,
            $crate::cyphal::uavcan::register::ListRequest,
            $crate::cyphal::uavcan::register::ListResponse<'_>,
            $crate::cyphal::uavcan::command::CommandRequest<'_>,
            $crate::cyphal::uavcan::command::CommandResponse<'_>,
            $crate::cyphal::uavcan::file::ReadRequest<'_>,
            $crate::cyphal::uavcan::file::ReadResponse<'_>,
            $crate::cyphal::uavcan::file::WriteRequest<'_>,
            $crate::cyphal::uavcan::file::WriteResponse,
            $crate::cyphal::cubecell::stop::Stop,
            $crate::cyphal::cubecell::group_state::GroupState,
            $crate::cyphal::cubecell::joint_state::JointState,
            $crate::cyphal::cubecell::target::TargetState,
            $crate::cyphal::cubecell::target::TargetAnswer,
            $crate::cyphal::cubecell::command::ArmPrepare,
            $crate::cyphal::cubecell::command::ArmOffer,
            $crate::cyphal::cubecell::command::ArmConfirm,
            $crate::cyphal::cubecell::command::Trajectory,
            $crate::cyphal::cubecell::command::Run,
            $crate::cyphal::cubecell::command::ClockReading,
            $crate::cyphal::cubecell::command::Room,
            $crate::cyphal::cubecell::command::ClearFault,
            $crate::cyphal::cubecell::command::Home,
            $crate::cyphal::cubecell::command::Jog,
            $crate::cyphal::cubecell::command::Gripper,
            $crate::cyphal::cubecell::command::Challenge,
            $crate::cyphal::cubecell::command::Authorization,
            $crate::cyphal::cubecell::command::Unlock,
            $crate::cyphal::cubecell::command::Refusal,
        )
    };
}
