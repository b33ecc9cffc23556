//! The tests of this package as one program: it is linked once.

mod common;
mod crowd;
mod runner;
mod slcan;
mod socketcand;
