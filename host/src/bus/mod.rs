//! Access to a bus: from the `--bus` string to answers of drives.
//!
//! # Map
//!
//! | layer | modules | is | must not |
//! |---|---|---|---|
//! | options | [`args`] | what every verb that touches a bus takes on its command line | open anything |
//! | nodes | [`drive_client`], [`desk`] | the host's side of the bus, without IO: requests to drives with deadlines; what was heard | read a clock |
//! | pace | [`pace`] | which control period machine and bus hold: measured | decide what to do about it |
//! | entropy, key | [`entropy`], [`key`] | random bytes of the operating system; key files, and the codes of orders | be used for tokens in virtual time |
//! | storage | [`storage`] | what a controller on this machine keeps, in a file | know what it means |
//! | session | [`session`], [`sim`], [`live`], [`soft`] | supplies time and frames to the desk: the embedded cell in virtual time, or a link in real time; and a controller where the bus has none | know what a verb wants |
//! | dialogue | [`ask`], [`survey`], [`motion`], [`operator`], [`registers`], [`history`] | questions, rounds of questions, bounded motions of single drives; orders to a controller, its settings, its past | print |
//!
//! # Invariants
//!
//! * One node, [`desk::Desk`], speaks for the host. The same verb therefore runs unchanged against the simulated
//!   cell and against drives.
//! * Every frame in either direction passes the [`session::Tap`]s of the session, in order.
//! * What moves is bounded: by a deadline, by reduced speed, by current; and a session that fails or is
//!   interrupted stops it before it returns.

pub mod args;
pub mod ask;
pub mod desk;
pub mod drive_client;
pub mod entropy;
pub mod history;
pub mod key;
pub mod live;
pub mod motion;
pub mod operator;
pub mod pace;
pub mod registers;
pub mod session;
pub mod settings;
pub mod sim;
pub mod soft;
pub mod storage;
pub mod survey;
pub mod zero_check;

pub use args::BusArgs;
pub use session::{BusFailure, Ended, Session};
