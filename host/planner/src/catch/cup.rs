//! The cup at the hand, and what it does to a ball that touches it.

/// Cup at the hand, open along the tool axis.
#[derive(Debug, Clone, PartialEq)]
pub struct Cup {
    /// From the end-effector frame to the middle of the mouth along the tool axis, m.
    pub mouth_m: f64,
    /// Inner radius of mouth and wall, m.
    pub inner_radius_m: f64,
    /// From the mouth to the inner face of the bottom, m.
    pub depth_m: f64,
    /// Thickness of wall and bottom, m.
    pub wall_m: f64,
    /// Boxes of the robot file that are not there because the cup is.
    pub replaces: Vec<String>,
    /// The ball that it catches.
    pub ball: Ball,
    /// Ball against cup.
    pub contact: Contact,
}

/// A ball, as far as a bounce depends on it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ball {
    pub radius_m: f64,
    /// Moment of inertia over m r²: 0.4 solid, 0.667 hollow.
    pub inertia: f64,
}

/// What a ball and a cup do to each other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    /// Speed along the normal after over before a bounce, 0 to 1.
    pub restitution: f64,
    /// Coulomb friction.
    pub friction: f64,
    /// Rolling resistance: with each normal impulse per mass J the ball loses this times J of its speed along the surface.
    pub rolling: f64,
    /// Approach speed below which nothing bounces, m/s.
    pub rest_m_s: f64,
}

impl Cup {
    /// Outer radius, m.
    #[must_use]
    pub fn outer_radius_m(&self) -> f64 {
        self.inner_radius_m + self.wall_m
    }

    /// From the mouth to the outer face of the bottom, m.
    #[must_use]
    pub fn length_m(&self) -> f64 {
        self.depth_m + self.wall_m
    }

    /// Distance of the ball's centre from the axis up to which it passes the rim, m.
    #[must_use]
    pub fn miss_max_m(&self) -> f64 {
        self.inner_radius_m - self.ball.radius_m
    }
}
