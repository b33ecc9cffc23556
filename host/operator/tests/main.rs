//! The tests of this package as one program: it is linked once.

mod analysis;
mod bus_operator;
mod bus_session;
mod common;
mod disc;
mod live;
mod mit_arm;
mod online;
mod operators;
mod position_drives;
mod rsi_common;
mod rsi_faults;
mod rsi_files;
mod rsi_identify;
mod rsi_link;
mod rsi_moves;
mod rsi_outcome;
mod rsi_start;
mod rsi_stops;
mod rsi_throw;
mod rsi_wire;
mod servo;
mod stops;
mod tracker_frames;
mod tracker_sockets;
