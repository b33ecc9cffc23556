//! Frames of a public master, transfers with a simulated node, properties over all frames.

mod blocks;
mod drive;
mod golden;
mod properties;
mod transfers;
