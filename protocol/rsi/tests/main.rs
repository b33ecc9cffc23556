//! The tests of this package as one program: it is linked once.

mod configuration;
mod properties;
mod tcp_stream;
mod wire_examples;
