//! Throw, catch, throw back.
//!
//! Both hands are cups of two jaws. A ball that has come to rest in a cup is gripped where it lies, most of the time at the wall; the jaws
//! swing open to both sides for a throw. The next throw is planned from the place where the tracker saw the ball lie, and the ball is
//! thrown from where it lies.
//! Before each throw the arms go from where the last catch left them to the run-up and to the waiting pose.

use hil_sim::court::CourtOptions;
use nalgebra::Vector3;
use operator::ball_catch::trial::{Outcome, Pair, TrialOptions};
use planner::catch::Joints;
use planner::catch::arm::{CatchArm, NotACatcher};
use planner::catch::draw::{Aimed, Window};
use planner::catch::law::{Pieces, State};
use planner::catch::motion::{CatchMotion, Fault, check};
use planner::catch::search::search;
use planner::catch::task::Start;
use robot_model::Pose;
use robot_model::collision::{CollisionChecker, Obb, Scene};

use super::throws::{draw_throws, true_forecast};

/// Throws that are drawn for one exchange; the one that is most surely caught is thrown.
const DRAWS: usize = 24;
/// Transits last from this on, longer by a quarter at each try, s.
const TRANSIT_S: (f64, f64) = (0.4, 6.0);
/// Half of the thickness of the wall between the arms, m.
const WALL_M: f64 = 0.5;
/// A pose from which every other one is near, deg.
const UPRIGHT_DEG: [f64; 6] = [0.0, -90.0, -90.0, 0.0, 0.0, 0.0];

/// One throw and its catch.
#[derive(Debug, Clone)]
pub struct Exchange {
    /// The arm that throws, 0 or 1.
    pub thrower: usize,
    /// How long both arms took to get ready, s.
    pub transit_s: f64,
    pub aimed: Aimed,
    /// From where the ball was thrown, in the thrower's end-effector frame: in truth, and by the plan, m.
    pub gripped_e_m: [Vector3<f64>; 2],
    /// What came of it.
    pub outcome: Outcome,
}

/// Why a rally ended before its number of throws.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RallyEnd {
    Complete,
    /// The last ball was not caught, or the catcher does not know that it was.
    NotCaught,
    /// No throw was found that the other arm catches.
    NoThrow,
    /// An arm found no way to its next pose.
    NoTransit,
}

#[derive(Debug, Clone)]
pub struct Rally {
    /// The exchanges, the last one caught or not.
    pub exchanges: Vec<Exchange>,
    pub end: RallyEnd,
}

impl RallyEnd {
    /// Why no ball was thrown any more, and what to do; `None` if the last ball ended the rally.
    pub const fn not_thrown(self) -> Option<[&'static str; 2]> {
        match self {
            Self::Complete | Self::NotCaught => None,
            Self::NoThrow => Some([
                "no throw was found that the other arm catches",
                "set the arms of the court 2 to 3 m apart, or another --seed",
            ]),
            Self::NoTransit => {
                Some(["an arm found no way to its next pose without contact", "another --seed"])
            }
        }
    }
}

impl Rally {
    pub fn length(&self) -> usize {
        self.exchanges.iter().filter(|exchange| exchange.outcome.known_caught()).count()
    }
}

/// Two arms that throw to each other.
#[derive(Debug, Clone)]
pub struct Partners {
    /// Arm 0 throws; arm 1 throws.
    pairs: [Pair; 2],
    /// For each arm as the catcher of `pairs[k]`: a wall between the arms, which no transit crosses. Both arms move at once.
    walls: [Scene; 2],
    window: Window,
    /// Where the first ball is gripped, in the end-effector frame, m.
    first_e_m: Vector3<f64>,
}

impl Partners {
    /// The arms of a court. The first ball is gripped in the middle of the bottom of the cup.
    pub fn new(mut court: CourtOptions) -> Result<Self, NotACatcher> {
        let first_e_m = court.cup.rest_e_m(court.ball.radius_m);
        for arm in &mut court.arms {
            arm.model = arm.model.clone().with_release_at(first_e_m).with_hand(&court.cup.replaces, []);
        }
        let mut back = court.clone();
        back.arms.swap(0, 1);
        let window = Window { flight_s: (0.6, 0.9), ..Window::default() };
        let pairs = [Pair::new(court)?, Pair::new(back)?];
        let walls = [wall(&pairs[0]), wall(&pairs[1])];
        Ok(Self { pairs, walls, window, first_e_m })
    }

    /// The pair in which arm `thrower` throws.
    pub fn pair(&self, thrower: usize) -> &Pair {
        &self.pairs[thrower]
    }

    /// Up to `throws` throws; arm 0 begins. The same seed gives the same rally. `observe` gets the number of each throw, from 0,
    /// and what became of it, as soon as it is over.
    pub fn play(
        &self,
        throws: usize,
        options: &TrialOptions,
        seed: u64,
        mut observe: impl FnMut(usize, &Exchange),
    ) -> Rally {
        let mut q = [options.wait; 2];
        let mut gripped_e_m = [self.first_e_m; 2];
        let mut exchanges = Vec::new();
        for k in 0..throws {
            let thrower = k % 2;
            let [true_e_m, planned_e_m] = gripped_e_m;
            let pair = &self.pairs[thrower].clone().gripped_at(planned_e_m);
            let options = &TrialOptions { grip_off_m: true_e_m - planned_e_m, ..options.clone() };
            let seed = seed.wrapping_mul(1_000_003).wrapping_add(k as u64);
            // The catcher's side of the other pair is the arm that throws now.
            let arms = [self.pairs[1 - thrower].catcher(options.jerk), pair.catcher(options.jerk)];
            let walls = [&self.walls[1 - thrower], &self.walls[thrower]];
            let mut throws = self.best_throws(pair, options, seed);
            // The jaws are open during a throw and closed to a cup before and after it.
            throws.retain(|aimed| {
                let ends = [aimed.throw.start(), aimed.throw.stop()];
                ends.iter().all(|q| stands(arms[0], walls[0], q))
            });
            if throws.is_empty() {
                return Rally { exchanges, end: RallyEnd::NoThrow };
            }
            let wait_s = transit(arms[1], walls[1], &q[1 - thrower], &options.wait, &options.wait);
            let ready = throws.into_iter().find_map(|aimed| {
                let run_up_s = transit(arms[0], walls[0], &q[thrower], &aimed.throw.start(), &options.wait)?;
                Some((aimed, run_up_s.max(wait_s?)))
            });
            let Some((aimed, transit_s)) = ready else {
                return Rally { exchanges, end: RallyEnd::NoTransit };
            };
            let outcome = pair.run(&aimed, options, seed);
            q[thrower] = aimed.throw.stop();
            // Without a catch the arm may have moved out of the way, and the ball have fallen into its cup all the same.
            let stands = || outcome.trace.last().map_or(options.wait, |last| last.q[1]);
            q[1 - thrower] = outcome.choice.as_ref().map_or_else(stands, |choice| end_of(&choice.motion));
            let caught = outcome.known_caught();
            let lies_e_m = outcome.lies_e_m;
            let exchange = Exchange { thrower, transit_s, aimed, gripped_e_m, outcome };
            observe(k, &exchange);
            exchanges.push(exchange);
            let Some(lies_e_m) = lies_e_m.filter(|_| caught) else {
                return Rally { exchanges, end: RallyEnd::NotCaught };
            };
            gripped_e_m = lies_e_m;
        }
        Rally { exchanges, end: RallyEnd::Complete }
    }

    /// Throws that the other arm can catch, the one with the largest margin first.
    fn best_throws(&self, pair: &Pair, options: &TrialOptions, seed: u64) -> Vec<Aimed> {
        let throws = draw_throws(pair, &self.window, DRAWS, seed).unwrap_or_default();
        let state = std::array::from_fn(|i| State::rest(options.wait[i]));
        let start = Start { at_s: 0.0, state: &state, under_way: None };
        let gravity_m_s2 = pair.court.arms[0].model.world().gravity_m_s2;
        let judged = throws.into_iter().filter_map(|aimed| {
            let release_s = aimed.throw.ha_s.max(0.3);
            let forecast = true_forecast(&pair.court.ball, &aimed, release_s, gravity_m_s2);
            let choice = search(pair.catcher(options.jerk), &options.settings, &start, &forecast).0.ok()?;
            // What a correction can still use, late in a long flight.
            let score = choice.probability - 0.5 * choice.used + 0.3 * (choice.t_s - release_s);
            Some((score, aimed))
        });
        let mut judged: Vec<(f64, Aimed)> = judged.collect();
        judged.sort_by(|a, b| b.0.total_cmp(&a.0));
        judged.into_iter().map(|(_, aimed)| aimed).collect()
    }
}

fn stands(arm: &CatchArm, wall: &Scene, q: &Joints) -> bool {
    check(arm, &mut CollisionChecker::new(arm.model(), wall), &CatchMotion::rest(q), None).is_ok()
}

/// A wall in the middle between the arms of a pair, in the base frame of its catcher.
fn wall(pair: &Pair) -> Scene {
    let [thrower, catcher] = &pair.court.arms;
    let ahead = catcher.x_wb.inverse_transform_point(&thrower.x_wb.pos);
    let turned = Pose::rot_z(ahead.y.atan2(ahead.x));
    let middle = ahead * 0.5 + turned.rot.column(0) * WALL_M;
    let half = Vector3::new(WALL_M, WALL_M * 4.0, WALL_M * 4.0);
    Scene {
        obstacles: vec![("wall".to_owned(), Obb::new(Pose::new(turned.rot, middle), half))],
        ball_held: false,
    }
}

fn end_of(motion: &CatchMotion) -> Joints {
    motion.joints_at(motion.end_s()).0
}

/// How long the way from one posture at rest to another takes: straight, by `via`, or upright; `None` if all touch something.
fn transit(arm: &CatchArm, wall: &Scene, from: &Joints, to: &Joints, via: &Joints) -> Option<f64> {
    let upright = Joints::from(UPRIGHT_DEG.map(f64::to_radians));
    let by = |via: &Joints| Some(leg(arm, wall, from, via)? + leg(arm, wall, via, to)?);
    leg(arm, wall, from, to).or_else(|| by(via)).or_else(|| by(&upright))
}

fn leg(arm: &CatchArm, wall: &Scene, from: &Joints, to: &Joints) -> Option<f64> {
    let mut checker = CollisionChecker::new(arm.model(), wall);
    let limits = arm.limits(false);
    let mut t_s = TRANSIT_S.0;
    while t_s < TRANSIT_S.1 {
        let mut joints = std::array::from_fn(|i| Pieces::starting(State::rest(from[i])));
        let moved = joints.iter_mut().enumerate().all(|(i, pieces): (usize, &mut Pieces)| {
            let fit = arm.law().fit(&limits[i], &State::rest(from[i]), to[i], 0.0, t_s);
            fit.is_some_and(|fit| {
                arm.law().append(&fit, t_s, pieces);
                true
            })
        });
        if moved {
            let motion = CatchMotion { start_s: 0.0, joints };
            match check(arm, &mut checker, &motion, None) {
                Ok(()) => return Some(t_s),
                // More time helps against currents, not against contacts.
                Err(Fault::Current) => {}
                Err(_) => return None,
            }
        }
        t_s *= 1.25;
    }
    None
}
