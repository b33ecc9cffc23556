//! PowerCube drives on a CAN bus: requests and replies, the order of requests in a control cycle, commands as ramps, and
//! what a drive should do with them.

pub mod drive_model;
pub mod drives;
pub mod order;
pub mod pace;
pub mod ramp;
pub mod schedule;
pub mod slots;
pub mod transmit;
