//! What a search found, or why it found nothing.

use std::fmt;

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::clear::Contact;
use super::hand::HandLaw;
use super::motion::FollowMotion;
use super::parabola::Parabola;

/// Where a candidate ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// No parabola leaves under this angle and meets the target.
    Flight,
    /// No posture has the hand there.
    Reach,
    /// The posture is singular.
    Singular,
    /// A joint would be too fast.
    Speed,
    /// The start is outside of the joint ranges.
    StartRange,
    /// The start is too near to the floor.
    StartFloor,
    /// The stop is outside of the joint ranges.
    StopRange,
    /// The stop is too near to the floor.
    StopFloor,
    /// The commands would cut the robot out by acceleration or jerk, or leave what its program passes.
    CutOut,
    /// A start that the search without a grid could not bring inside all limits.
    Unsolved,
    /// The arm would meet itself or the floor on its way.
    Contact,
    /// The ball would meet arm or hand.
    Ball,
    /// Feasible as far as tested, but no better than the best so far.
    Dominated,
    /// Feasible, and the best when it was found.
    Feasible,
}

impl Stage {
    /// All, in the order of the tests.
    pub const ALL: [Self; 14] = [
        Self::Flight,
        Self::Reach,
        Self::Singular,
        Self::Speed,
        Self::StartRange,
        Self::StartFloor,
        Self::StopRange,
        Self::StopFloor,
        Self::CutOut,
        Self::Unsolved,
        Self::Contact,
        Self::Ball,
        Self::Dominated,
        Self::Feasible,
    ];

    /// What refused the candidate.
    #[must_use]
    pub fn reason(self) -> &'static str {
        match self {
            Self::Flight => "no parabola under this angle",
            Self::Reach => "out of reach of the hand",
            Self::Singular => "singular posture",
            Self::Speed => "joint speed",
            Self::StartRange => "start outside of the joint ranges",
            Self::StartFloor => "start too near to the floor",
            Self::StopRange => "stop outside of the joint ranges",
            Self::StopFloor => "stop too near to the floor",
            Self::CutOut => "acceleration, jerk or range of the commands",
            Self::Unsolved => "no motion from this start keeps all limits at once",
            Self::Contact => "contact of the arm",
            Self::Ball => "ball meets the arm",
            Self::Dominated => "not better than the best",
            Self::Feasible => "feasible",
        }
    }

    /// The stage at which a contact is found.
    #[must_use]
    pub fn of(contact: &Contact) -> Self {
        match contact {
            Contact::Floor { .. } | Contact::Boxes { .. } => Self::Contact,
            Contact::Ball { .. } => Self::Ball,
        }
    }
}

/// How many candidates ended at each stage.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, schemars::JsonSchema)]
pub struct StageCounts([u64; Stage::ALL.len()]);

impl StageCounts {
    /// Counts `count` candidates.
    pub fn add(&mut self, stage: Stage, count: u64) {
        self.0[stage as usize] += count;
    }

    /// Candidates that ended at `stage`.
    #[must_use]
    pub fn of(&self, stage: Stage) -> u64 {
        self.0[stage as usize]
    }

    /// Sum of both.
    #[must_use]
    pub fn plus(mut self, other: &Self) -> Self {
        for (own, other) in self.0.iter_mut().zip(other.0) {
            *own += other;
        }
        self
    }

    /// All candidates.
    #[must_use]
    pub fn total(&self) -> u64 {
        self.0.iter().sum()
    }

    /// The last test that candidates reached and did not pass, with their number: the obstacle between these throws
    /// and a feasible one.
    #[must_use]
    pub(crate) fn last_obstacle(&self) -> Option<(Stage, u64)> {
        let refusing = Stage::ALL.into_iter().filter(|s| !matches!(s, Stage::Dominated | Stage::Feasible));
        refusing.map(|s| (s, self.of(s))).rfind(|(_, count)| *count > 0)
    }
}

/// How much was searched.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, schemars::JsonSchema)]
pub struct SearchSize {
    /// Releases in the grid, or starts of the search without one.
    pub releases: u64,
    /// Postures of these releases by the stage at which they ended.
    pub counts: StageCounts,
}

/// A planned throw.
#[derive(Debug, Clone)]
pub struct Found {
    /// The flight; t = 0 at the first step on the parabola.
    pub flight: Parabola,
    /// The hand; its time is that of the search, not of `flight`.
    pub hand: HandLaw,
    pub motion: FollowMotion,
    /// Number of the release among the steps on the parabola.
    pub release: usize,
    /// First criterion at the release, in rad²/s².
    pub j1: f64,
    /// Second criterion.
    pub j2: f64,
    /// What was searched.
    pub size: SearchSize,
}

/// No throw was found.
#[derive(Debug, Clone, PartialEq)]
pub struct NotFound {
    /// What was searched.
    pub size: SearchSize,
    /// The nearest target to which the same search finds a throw, as far as it is searched: whole centimetres.
    pub nearest: Option<Vector3<f64>>,
}

impl fmt::Display for NotFound {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "no throw found among {} releases", self.size.releases)?;
        if let Some((stage, count)) = self.size.counts.last_obstacle() {
            write!(f, "; the last {count} were refused by: {}", stage.reason())?;
        }
        Ok(())
    }
}

impl std::error::Error for NotFound {}
