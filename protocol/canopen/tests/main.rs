//! Frames of a public master, transfers with a node that is played here, properties over all frames.

mod drive;
mod golden;
mod properties;
mod transfers;
