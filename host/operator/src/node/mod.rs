//! The host's node on the bus, without IO: frames and times in, frames and deadlines out.
//!
//! | module | holds |
//! |---|---|
//! | [`host_node`] | the node: sends requests and orders, keeps the answers |
//! | [`inbox`] | its Cyphal half: heartbeat, and what arrives from a controller |
//! | [`drive_client`] | requests to drives with deadlines |
//! | [`stop_watch`] | stops that this program did not give |

pub mod drive_client;
pub mod host_node;
pub mod inbox;
pub mod stop_watch;
