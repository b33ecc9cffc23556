//! Reports for people: one self-contained HTML file each, and pictures.
//!
//! # Map
//! | module | holds |
//! |---|---|
//! | [`plan`] | summary and HTML report of a plan file |
//! | [`follow`] | the same for a throw that follows the flight |
//! | [`run`] | HTML report of a recorded run against its plan |
//! | [`identify`] | HTML report of an identification |
//! | [`catch`] | HTML report of catching a disc |
//! | [`reach`] | map of what a sweep reached |
//! | [`page`] | an HTML page: style, scripts, tiles, tables |
//! | [`chart`] | line charts as SVG |
//! | [`scene`] | the arm, its hand path and the flight in space |
//! | [`landing`] | landing about the target |
//! | [`timeline`] | frames on the bus |

pub mod catch;
pub mod chart;
pub mod follow;
pub mod identify;
pub mod landing;
pub mod page;
pub mod plan;
pub mod reach;
pub mod run;
pub mod scene;
pub mod timeline;
