//! Reports for people: one self-contained HTML file each. A report is data ([`page`]); the scripts in `assets` draw it in the browser.
//!
//! # Map
//! | module | holds |
//! |---|---|
//! | [`plan`] | summary and page of a plan file |
//! | [`follow`] | the same for a throw that follows the flight |
//! | [`industrial`] | page of a throw with an industrial robot |
//! | [`motion`] | its motion as a table |
//! | `frame` | head and foot of the page of a job |
//! | `hand` | path of the hand, planned and measured |
//! | [`run`] | page of a recorded run against its plan |
//! | [`program`] | page of a program that was done again and again |
//! | [`identify`] | page of an identification |
//! | [`tune`] | page of a gain design |
//! | [`catch`] | page of catching a disc |
//! | [`ball_catch`] | page of catching a ball |
//! | [`live`] | page of the live view of a bus |
//! | [`reach`] | page with the map of what a sweep reached |
//! | [`robot`] | page of a robot at zero and in a pose |
//! | [`page`] | a page: tiles, tables, charts; the file of it |
//! | [`chart`] | line charts |
//! | [`scene`] | the arm, its hand path and the flight in space |
//! | [`landing`] | landing about the target |
//! | `timeline` | frames on the bus |
//!
//! | script | draws |
//! |---|---|
//! | `assets/page.js` | headings, tiles, tables, frames on the bus, map |
//! | `assets/chart.js` | charts, of reports and of the live view |
//! | `assets/scene.js` | the picture in space |
//! | `assets/paper.js` | what paper shows |
//! | `assets/live.js` | the live view |

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
mod timeline;
pub mod tune;
