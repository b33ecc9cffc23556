//! The tests of this package as one program: it is linked once.

mod folder;
mod targets;
