//! Reports for people: one self-contained HTML file each, and pictures.
//!
//! # Map
//! | module | holds |
//! |---|---|
//! | [`plan`] | summary and HTML report of a plan file |
//! | [`follow`] | the same for a throw that follows the flight |
//! | [`industrial`] | HTML report of a throw with an industrial robot |
//! | [`motion`] | its motion as a table |
//! | `frame` | head and foot of the page of a job |
//! | `hand` | path of the hand, planned and measured |
//! | [`run`] | HTML report of a recorded run against its plan |
//! | [`program`] | HTML report of a program that was done again and again |
//! | [`identify`] | HTML report of an identification |
//! | [`tune`] | HTML report of a gain design |
//! | [`catch`] | HTML report of catching a disc |
//! | [`ball_catch`] | HTML report of catching a ball |
//! | [`live`] | page of the live view of a bus |
//! | [`reach`] | map of what a sweep reached |
//! | [`robot`] | a robot at zero and in a pose, as a picture |
//! | [`page`] | an HTML page: style, scripts, tiles, tables |
//! | [`chart`] | line charts as SVG |
//! | [`scene`] | the arm, its hand path and the flight in space |
//! | [`landing`] | landing about the target |
//! | [`timeline`] | frames on the bus |

pub mod ball_catch;
pub mod catch;
pub mod chart;
pub mod follow;
mod frame;
mod hand;
pub mod identify;
pub mod industrial;
pub mod landing;
pub mod live;
pub mod motion;
pub mod page;
pub mod plan;
pub mod program;
pub mod reach;
pub mod robot;
pub mod run;
pub mod scene;
pub mod timeline;
pub mod tune;
