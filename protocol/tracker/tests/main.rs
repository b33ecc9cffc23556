//! The tests of this package as one program: it is linked once.

mod dtrack_commands;
mod dtrack_data;
mod vrpn_stream;
