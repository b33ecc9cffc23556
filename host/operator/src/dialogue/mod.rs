//! Communication on a bus: requests to drives, orders to a controller. Nothing here prints.
//!
//! | module | holds |
//! |---|---|
//! | [`ask`], [`survey`] | a request to a drive; rounds of requests to all |
//! | `objects` | objects of CANopen nodes |
//! | [`presence`] | other nodes on the bus, found by listening |
//! | [`homing`], [`jogging`], [`zero_check`] | bounded motions of one joint by a controller; whether a drive has lost counts |
//! | [`operator`], `following`, `extending`, `key` | orders to a controller, upload, arming, following a run, the segments of a long one; the codes that orders need |
//! | `error` | why an order was not carried out |
//! | [`registers`], [`history`] | settings and past of a controller |

pub mod ask;
pub mod clock;
mod error;
pub(crate) mod extending;
pub(crate) mod following;
pub mod history;
pub mod homing;
pub mod jogging;
mod key;
pub mod objects;
pub mod online;
pub mod operator;
pub mod presence;
pub mod registers;
pub mod survey;
pub mod zero_check;
