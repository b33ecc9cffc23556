//! Live view: the traffic of a bus, for a page in a browser, over one port of this machine.
//!
//! | module | holds |
//! |---|---|
//! | [`age`] | old data: one rule for every display |
//! | [`state`] | the latest data, as one snapshot; without IO |
//! | [`events`] | events: repeats in one line, stops and faults kept |
//! | [`gate`] | which requests are answered: requests from other places are refused |
//! | [`stopping`] | which joints obey a stop, and after how long |
//! | [`serve`] | the port, its connections and their threads |
//!
//! # What a page can do
//!
//! A page can read, and it can stop. No other input here moves anything.

pub mod age;
pub mod events;
pub mod gate;
pub mod serve;
pub mod state;
pub mod stopping;

pub use serve::{LiveServer, ServeError};
pub use state::{LiveState, LiveTap};
