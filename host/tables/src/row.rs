//! One row of results.

/// How a target came out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// A throw that keeps all that was asked for.
    Thrown,
    /// A throw without some of what was asked for; the note says what.
    Relaxed,
    /// No throw; the note says why.
    Refused,
}

impl Outcome {
    /// As the table says it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Thrown => "thrown",
            Self::Relaxed => "relaxed",
            Self::Refused => "refused",
        }
    }
}

/// A row: a target with its throw. Coordinates are those of the base of the arm, z up.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// Number of the row in the whole sweep, from 0.
    pub number: u64,
    /// The target in m.
    pub target_m: [f64; 3],
    pub outcome: Outcome,
    /// What was given up, or why there is no throw; empty for [`Outcome::Thrown`].
    pub note: String,
    /// The throw; none for [`Outcome::Refused`].
    pub throw: Option<Thrown>,
}

/// What a table keeps of a throw.
#[derive(Debug, Clone, PartialEq)]
pub struct Thrown {
    /// What the search made small.
    pub objective: f64,
    /// Time of the release in s from the start of the motion.
    pub release_s: f64,
    /// Duration of the motion in s.
    pub duration_s: f64,
    /// Time of flight in s.
    pub flight_s: f64,
    /// Root of the trace of the landing's covariance in m.
    pub spread_m: f64,
    /// Probability of a hit, if a region was given.
    pub hit_probability: Option<f64>,
    /// The ball at the release in m.
    pub position_m: [f64; 3],
    /// The ball at the release in m/s.
    pub velocity_m_s: [f64; 3],
    /// Joint angles at the release in rad.
    pub q_rad: Vec<f64>,
    /// Joint speeds at the release in rad/s.
    pub qd_rad_s: Vec<f64>,
    /// Joint accelerations at the release in rad/s².
    pub qdd_rad_s2: Vec<f64>,
    /// CRC-32 (IEEE 802.3) of the plan file.
    pub plan_crc32: u32,
    /// Landings of disturbed throws, if any were drawn.
    pub landings: Option<Landings>,
}

/// Landings of disturbed throws to a target (Monte Carlo).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Landings {
    /// Balls that came down on the plane of the target.
    pub landed: u64,
    /// Of them, those in the region that counts as a hit; none without a region.
    pub hits: Option<u64>,
    /// Root mean square distance of the landings from the target in m; none if no ball landed.
    pub miss_rms_m: Option<f64>,
    /// Largest distance of a landing from the target in m; none if no ball landed.
    pub miss_max_m: Option<f64>,
}
