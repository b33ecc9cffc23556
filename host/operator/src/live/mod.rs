//! Live view: the traffic of a bus, for a page in a browser and for the viewers of robotics, over one port of this machine.
//!
//! | module | holds |
//! |---|---|
//! | [`age`] | old data: one rule for every display |
//! | [`state`] | the latest data, as one snapshot; without IO |
//! | [`events`] | events: repeats in one line, stops and faults kept |
//! | [`gate`] | which requests are answered: requests from other places are refused |
//! | [`viewer`] | the WebSocket protocol of robotics viewers: channels and messages; without IO |
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
pub mod viewer;

pub use serve::{LiveServer, ServeError};
pub use state::{LiveState, LiveTap};
