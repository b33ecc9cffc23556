//! Live view: what passes on a bus, for a page in a browser and for the viewers of robotics, over one port of this machine.
//!
//! | module | holds |
//! |---|---|
//! | [`age`] | what is old: one rule for every display |
//! | [`state`] | what was heard last, as one snapshot; without IO |
//! | [`events`] | what happened: repeats in one line, stops and faults kept |
//! | [`gate`] | which requests are answered: nothing from another place reaches the page |
//! | [`viewer`] | the WebSocket protocol of robotics viewers: channels and messages; without IO |
//! | [`stopping`] | who obeys a stop, and after how long |
//! | [`serve`] | the port, its connections and their threads |
//!
//! # What a page can do
//!
//! It can look, and it can stop. Nothing that arrives here moves anything.

pub mod age;
pub mod events;
pub mod gate;
pub mod serve;
pub mod state;
pub mod stopping;
pub mod viewer;

pub use serve::{LiveServer, ServeError};
pub use state::{LiveState, LiveTap};
