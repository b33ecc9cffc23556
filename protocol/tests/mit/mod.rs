//! Frames of a public client with their meaning, and properties over all values and frames.

mod golden;
mod properties;
