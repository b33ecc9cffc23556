//! The way from one pose of the arm to another: around everything, rounded, and as fast as a share of the limits allows.
//!
//! ```text
//! Goal ──► poses of the joints (goal) ──► straight line, or corners around what is in the way (search)
//!                                             └──► Path with rounded corners, each proven free ──► timing ──► Motion
//! straight line of the hand (line) ──────────────────────────────────▲
//! ```
//!
//! | module | holds |
//! |---|---|
//! | here | the request, and the way |
//! | `goal` | joint angles for a place of the hand |
//! | `search` | corners of a free path in joint space |
//! | `line` | a straight line of the hand |
//!
//! All bodies are checked at every instant of the path, not at samples: [`robot_model::collision`]. What the cubics of the motion add
//! is below 0.1 mrad.

mod free;
mod goal;
mod line;
mod search;

pub use free::require_free_motion;
pub(crate) use goal::at_point;
pub use goal::{Goal, NoGoal};
pub use line::{LineBreak, LineError};

use robot_model::collision::{Body, CollisionChecker, MotionVerdict, Scene, StraightMove};
use robot_model::{JointVec, RobotModel};

use crate::motion::Motion;
use crate::timing::{Limits, Path, along, straight, thinned};
use search::Space;

/// Bodies that come nearer than this count as touching, m.
const TOLERANCE_M: f64 = 1e-3;
/// Distance from the ends of the joint ranges at corners, rad.
const MARGIN_RAD: f64 = 0.03;
/// A pose outside its range by this is still one to start from, rad.
const OUTSIDE_RAD: f64 = 0.02;
/// A pose nearer than this is reached, rad.
const THERE_RAD: f64 = 1e-3;
/// Corners are rounded by as much as this at first; below the second number not at all, rad.
const BLEND_RAD: f64 = 0.4;
const BLEND_MIN_RAD: f64 = 0.01;
/// A line of the hand consists of many short pieces; a cubic that is at most this far beside them, rad, follows several.
const THIN_RAD: f64 = 5e-5;

/// How an arm goes from one rest to another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Travel {
    /// Share of the robot's speeds, accelerations and jerks, above 0 and at most 1.
    pub share: f64,
    /// Seed of the search.
    pub seed: u64,
    /// Least and largest angles of corners, rad; the joint ranges with a margin if `None`. Between two corners each joint moves one way
    /// only, so the whole way is inside if both ends are.
    pub range: Option<(JointVec, JointVec)>,
}

impl Default for Travel {
    fn default() -> Self {
        Self { share: 0.3, seed: 1, range: None }
    }
}

/// Why there is no way.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum WayError {
    /// One end touches something or is not a pose of this arm.
    #[error("at {} {what}", if *.at_start { "its present pose the arm" } else { "the end of the motion the arm" })]
    Blocked {
        at_start: bool,
        /// What is wrong there.
        what: String,
    },
    /// No way was found.
    #[error("no free way was found in {tries} tries")]
    NoWay { tries: usize },
    #[error(transparent)]
    Goal(#[from] NoGoal),
    #[error(transparent)]
    Line(#[from] LineError),
    /// Two bodies touch on a motion that was given.
    #[error("after {t_s:.2} s {a} and {b} touch")]
    Contact { t_s: f64, a: String, b: String },
    /// Two bodies touch on a line between corners that were given, which count from 1.
    #[error("on the line from corner {leg} to the next {a} and {b} touch")]
    Leg { leg: usize, a: String, b: String },
    /// The share is not a number above 0 and at most 1.
    #[error("a share of {share} of the limits is not above 0 and at most 1")]
    Share { share: f64 },
}

/// Motion from `from` to `to` (rad), at rest at both ends; `None` if the arm is there.
///
/// # Errors
/// [`WayError`].
pub fn way(
    arm: &RobotModel,
    scene: &Scene,
    travel: &Travel,
    from: &JointVec,
    to: &JointVec,
) -> Result<Option<Motion>, WayError> {
    let limits = limits(arm, travel.share)?;
    if (from - to).amax() < THERE_RAD {
        return Ok(None);
    }
    let mut space = Space::new(arm, scene, travel);
    for (q, at_start) in [(from, true), (to, false)] {
        require_free(arm, &mut space.checker, q, at_start)?;
    }
    if space.is_free(from, to) {
        return Ok(straight(from.as_slice(), to.as_slice(), &limits));
    }
    let corners = space.corners(from, to).ok_or(WayError::NoWay { tries: search::SAMPLES_MAX })?;
    rounded(&mut space.checker, &corners, &limits)
        .map(Some)
        .ok_or(WayError::NoWay { tries: search::SAMPLES_MAX })
}

/// Motion along lines in joint space through `corners`, for example from another search, each corner rounded as
/// much as is proven free; `None` if all are one place.
///
/// # Errors
/// [`WayError::Leg`], [`WayError::Share`].
pub fn through(
    arm: &RobotModel,
    scene: &Scene,
    share: f64,
    corners: &[JointVec],
) -> Result<Option<Motion>, WayError> {
    let limits = limits(arm, share)?;
    let mut checker = CollisionChecker::new(arm, scene);
    for (leg, pair) in corners.windows(2).enumerate() {
        let line = StraightMove { from: pair[0], to: pair[1] };
        if let MotionVerdict::Contact { clearance, .. } = checker.check_motion(&line, 0.0, 1.0, TOLERANCE_M) {
            let [a, b] = [clearance.a, clearance.b].map(|body| name(arm, scene, body));
            return Err(WayError::Leg { leg: leg + 1, a, b });
        }
    }
    Ok(match corners {
        [from, to] => straight(from.as_slice(), to.as_slice(), &limits),
        corners => rounded(&mut checker, corners, &limits),
    })
}

/// Whether the motion is a line in joint space: nothing was in the way of it.
#[must_use]
pub fn is_straight(motion: &Motion) -> bool {
    let (from, to) = (motion.start_rad(), motion.stop_rad());
    let along = to - from;
    motion.knots.iter().all(|knot| {
        let off = knot.q_rad - from;
        (off - along * (off.dot(&along) / along.norm_squared().max(f64::MIN_POSITIVE))).amax() < THERE_RAD
    })
}

/// As [`way`], to the cheapest of the poses in which the hand is where `goal` says.
///
/// # Errors
/// [`WayError`].
pub fn way_to(
    arm: &RobotModel,
    scene: &Scene,
    travel: &Travel,
    from: &JointVec,
    goal: &Goal,
) -> Result<Option<Motion>, WayError> {
    let limits = limits(arm, travel.share)?;
    let mut checker = CollisionChecker::new(arm, scene);
    require_free(arm, &mut checker, from, true)?;
    let poses = goal::poses(arm, &mut checker, from, goal)?;
    // A line that is free is the shortest way there is to a pose; the first of them is to the nearest pose.
    for q in &poses {
        if (q - from).amax() < THERE_RAD {
            return Ok(None);
        }
        if is_free_line(&mut checker, from, q) {
            return Ok(straight(from.as_slice(), q.as_slice(), &limits));
        }
    }
    let mut shortest: Option<Motion> = None;
    let mut failed = WayError::NoWay { tries: 0 };
    for q in poses.iter().take(goal::POSES_MAX) {
        match way(arm, scene, travel, from, q) {
            Ok(Some(motion)) => {
                if shortest.as_ref().is_none_or(|best| motion.duration_s() < best.duration_s()) {
                    shortest = Some(motion);
                }
            }
            Ok(None) => return Ok(None),
            Err(error) => failed = error,
        }
    }
    shortest.map(Some).ok_or(failed)
}

/// The hand goes to `goal` on a straight line, and turns evenly on the way.
///
/// # Errors
/// [`WayError::Line`] with the place where the line breaks.
pub fn straight_to(
    arm: &RobotModel,
    scene: &Scene,
    travel: &Travel,
    from: &JointVec,
    goal: &Goal,
) -> Result<Option<Motion>, WayError> {
    let limits = limits(arm, travel.share)?;
    let mut checker = CollisionChecker::new(arm, scene);
    require_free(arm, &mut checker, from, true)?;
    let Some(path) = line::path(arm, &mut checker, from, goal)? else { return Ok(None) };
    Ok(along(&path, &limits).map(|motion| thinned(&motion, &limits, THIN_RAD)))
}

/// The hand goes from place to place on straight lines and stops at each. Of the poses that the first place allows, the one nearest to
/// `near` is taken from which all lines can be gone.
///
/// # Errors
/// [`WayError`] with the number of the place, from 1, to which the hand does not come.
pub fn along_places(
    arm: &RobotModel,
    scene: &Scene,
    travel: &Travel,
    near: &JointVec,
    places: &[Goal],
) -> Result<Motion, (usize, WayError)> {
    let (first, rest) = places.split_first().ok_or((1, WayError::Goal(NoGoal::OutOfReach)))?;
    let mut checker = CollisionChecker::new(arm, scene);
    let starts = goal::poses(arm, &mut checker, near, first).map_err(|error| (1, error.into()))?;
    let mut farthest = (0, WayError::Goal(NoGoal::OutOfReach));
    for start in starts {
        let mut motion = Motion::at_rest(start);
        let lines: Result<(), (usize, WayError)> = rest.iter().zip(2..).try_for_each(|(place, number)| {
            let line = straight_to(arm, scene, travel, &motion.stop_rad(), place);
            motion.then(line.map_err(|error| (number, error))?);
            Ok(())
        });
        match lines {
            Ok(()) => return Ok(motion),
            Err(failed) if failed.0 > farthest.0 => farthest = failed,
            Err(_) => {}
        }
    }
    Err(farthest)
}

fn limits(arm: &RobotModel, share: f64) -> Result<Limits, WayError> {
    let fits = share > 0.0 && share <= 1.0;
    fits.then(|| Limits::of_arm(arm, share)).flatten().ok_or(WayError::Share { share })
}

/// Checks that the arm at `q` is inside its ranges and touches nothing.
///
/// # Errors
/// [`WayError::Blocked`].
pub fn require_free_pose(arm: &RobotModel, scene: &Scene, q: &JointVec) -> Result<(), WayError> {
    require_free(arm, &mut CollisionChecker::new(arm, scene), q, false)
}

/// Refuses a pose that is outside the ranges or touches something.
fn require_free(
    arm: &RobotModel,
    checker: &mut CollisionChecker<'_>,
    q: &JointVec,
    at_start: bool,
) -> Result<(), WayError> {
    let outside =
        |j: &usize| !(q[*j] >= arm.q_min()[*j] - OUTSIDE_RAD && q[*j] <= arm.q_max()[*j] + OUTSIDE_RAD);
    if let Some(j) = (0..arm.joints().len()).find(outside) {
        let (deg, low, high) = (q[j].to_degrees(), arm.q_min()[j].to_degrees(), arm.q_max()[j].to_degrees());
        let what = format!(
            "is outside its joint ranges: joint {} at {deg:.1} deg of {low:.1} to {high:.1} deg",
            j + 1
        );
        return Err(WayError::Blocked { at_start, what });
    }
    if let Some((a, b)) = checker.first_contact(&arm.fk(q)) {
        let what = format!(
            "touches something: {} and {}",
            name(arm, checker.scene(), a),
            name(arm, checker.scene(), b)
        );
        return Err(WayError::Blocked { at_start, what });
    }
    Ok(())
}

/// Name of a body for people.
fn name(arm: &RobotModel, scene: &Scene, body: Body) -> String {
    match body {
        Body::Box(index) => {
            arm.collision().boxes().get(index).map_or_else(|| "?".to_owned(), |b| b.name.clone())
        }
        Body::Obstacle(index) => {
            scene.obstacles.get(index).map_or_else(|| "?".to_owned(), |(name, _)| name.clone())
        }
        Body::Floor => "floor".to_owned(),
        Body::Ball => "ball".to_owned(),
    }
}

/// Whether no two bodies touch while the joints go evenly from one pose to another.
pub fn is_free_line(checker: &mut CollisionChecker<'_>, from: &JointVec, to: &JointVec) -> bool {
    let line = StraightMove { from: *from, to: *to };
    checker.check_motion(&line, 0.0, 1.0, TOLERANCE_M).is_free()
}

/// The motion along the corners, each rounded as much as is proven free; `None` where two of them are one place.
fn rounded(checker: &mut CollisionChecker<'_>, corners: &[JointVec], limits: &Limits) -> Option<Motion> {
    let points: Vec<&[f64]> = corners.iter().map(JointVec::as_slice).collect();
    let mut blends = vec![BLEND_RAD; points.len()];
    loop {
        let path = Path::rounding(&points, &blends).ok()?;
        // The lines between the corners are parts of those that were proven free.
        let touches =
            |(s0, s1, _): &(f64, f64, usize)| !checker.check_motion(&path, *s0, *s1, TOLERANCE_M).is_free();
        let rounded_too_much: Vec<_> = path.corners().filter(touches).collect();
        if rounded_too_much.is_empty() {
            return along(&path, limits);
        }
        for (.., corner) in rounded_too_much {
            let blend = &mut blends[corner];
            *blend = if *blend > BLEND_MIN_RAD { 0.5 * *blend } else { 0.0 };
        }
    }
}
