//! The flight of a ball from the markers of a tracker.
//!
//! | module | holds |
//! |---|---|
//! | [`fit`] | position, velocity and drag from samples: Gauss-Newton over the whole batch, with a prior |
//! | [`stream`] | tracker datagrams to samples: stamps, order, several markers per frame |
//! | [`watch`] | which marker is the ball, when its flight began, which samples are left out; the forecast for the planner |
//!
//! Samples count by the time of their exposure, in any order of arrival. Times are seconds on the tracker's clock.

pub mod fit;
pub mod stream;
pub mod watch;

pub use fit::{Flight, FlightPrior};
pub use stream::MarkerStream;
pub use watch::{BallWatch, WatchOptions};
