//! Fingers that a motor turns from closed to open.

/// Where the fingers are closed and open.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FingerTravel {
    /// Angle of open fingers, rad.
    pub open_rad: f64,
    /// Angle of closed fingers, rad; another one.
    pub closed_rad: f64,
}

impl FingerTravel {
    /// Share of the way from closed to open after which the ball is free: 4 mm of each finger of an OpenArm.
    pub const FREE_SHARE: f64 = 0.1;

    /// How far the fingers are open at an angle: 0 closed, 1 open.
    #[must_use]
    pub fn open_share(&self, q_rad: f64) -> f64 {
        (q_rad - self.closed_rad) / (self.open_rad - self.closed_rad)
    }
}
