//! Reports for people: one self-contained HTML file each, and pictures.
//!
//! # Map
//! | module | holds |
//! |---|---|
//! | [`plan`] | summary and HTML report of a plan file |
//! | [`reach`] | map of what a sweep reached |
//! | [`chart`] | line charts as SVG |

pub mod chart;
pub mod plan;
pub mod reach;
