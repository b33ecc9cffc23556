//! What is said on a bus: questions and bounded motions of single drives, orders to a controller. Nothing here prints.
//!
//! | module | holds |
//! |---|---|
//! | [`ask`], [`survey`] | a question to a drive; rounds of questions to all |
//! | [`motion`], [`zero_check`] | bounded motions of single drives; whether a drive has lost counts |
//! | [`operator`], `key` | orders to a controller, upload, arming, following a run; the codes that orders need |
//! | [`registers`], [`history`] | settings and past of a controller |

pub mod ask;
pub mod history;
mod key;
pub mod motion;
pub mod operator;
pub mod registers;
pub mod survey;
pub mod zero_check;
