//! Frames that were made from the DBC files of `odrive-can` 2.1.0, and properties over all values and frames.

mod golden;
mod properties;
