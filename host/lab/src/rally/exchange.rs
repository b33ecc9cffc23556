//! Throw, catch, throw back.
//!
//! Both hands are cups of two jaws. A ball that has come to rest in a cup is gripped where it lies, most of the time at the wall; the jaws
//! swing open to both sides for a throw. The next throw is planned from the place where the tracker saw the ball lie, and the ball is
//! thrown from where it lies.
//! Before each throw the arms go from where the last catch left them to the run-up and to the waiting pose.

use hil_sim::two_arms::TwoArmOptions;
use nalgebra::Vector3;
use operator::ball_catch::trial::{Outcome, Pair, TrialOptions};
use planner::catch::Joints;
use planner::catch::arm::{CatchArm, NotACatcher};
use planner::catch::draw::{Aimed, Window};
use planner::catch::motion::{CatchMotion, check};
use planner::catch::search::search;
use planner::catch::task::Start;
use planner::motion::Motion;
use planner::motion_law::State;
use planner::way::{Travel, WayError, way};
use robot_model::Pose;
use robot_model::collision::{CollisionChecker, Obb, Scene};

use super::throws::{draw_from, true_forecast};

/// Throws that are drawn for one exchange; the one that is most surely caught is thrown.
const DRAWS: usize = 24;
/// Random releases tried for each throw. At 3 m about one in some hundred thousand is possible.
const TRIES: usize = 400_000;
/// A throw is as sure as can be if its catch is foreseen with this probability.
const SURE: f64 = 0.95;
/// From this distance between the arms on, m, balls pass so much farther before the catcher, of what the arms are farther apart: at 3 m
/// a ball that leaves a cup does not get to where a catcher at 2.5 m has it.
const FARTHER: (f64, f64) = (2.5, 0.4);
/// Half of the thickness of the wall between the arms, m.
const WALL_M: f64 = 0.5;
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
#[derive(Debug, Clone, PartialEq)]
pub enum RallyEnd {
    Complete,
    /// The last ball was not caught, or the catcher does not know that it was.
    NotCaught,
    /// No throw was found that the other arm catches.
    NoThrow,
    /// An arm found no way to its next pose.
    NoTransit {
        /// 0 or 1.
        arm: usize,
        why: WayError,
    },
    /// Over the wire: an arm or the tracker failed.
    Broken {
        what: String,
        next: String,
    },
}

/// What both arms do for one throw.
#[derive(Debug, Clone)]
pub struct Planned {
    /// Thrower and catcher, the ball gripped where the plan has it.
    pub pair: Pair,
    pub aimed: Aimed,
    /// Ways of thrower and catcher to the run-up and to the waiting pose, free of contact; `None` for an arm that is there.
    pub ways: [Option<Motion>; 2],
}

impl Planned {
    /// How long both arms take to get ready, s.
    #[must_use]
    pub fn transit_s(&self) -> f64 {
        self.ways.iter().flatten().map(Motion::duration_s).fold(0.0, f64::max)
    }
}

#[derive(Debug, Clone)]
pub struct Rally {
    /// The exchanges, the last one caught or not.
    pub exchanges: Vec<Exchange>,
    pub end: RallyEnd,
}

impl RallyEnd {
    /// Why no ball was thrown any more, and what to do; `None` if the last ball ended the rally.
    pub fn not_thrown(&self) -> Option<[String; 2]> {
        match self {
            Self::Complete | Self::NotCaught => None,
            Self::NoThrow => Some([
                "no throw was found that the other arm catches".to_owned(),
                "set the arms of the cell 2 to 3 m apart, or another --seed".to_owned(),
            ]),
            Self::NoTransit { arm, why } => Some([
                format!("arm {} found no way to its next pose without contact: {why}", arm + 1),
                "bring it to a pose that is free, on its own side of the cell; or another --seed".to_owned(),
            ]),
            Self::Broken { what, next } => Some([what.clone(), next.clone()]),
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
    /// The arms of a cell. The first ball is gripped in the middle of the bottom of the cup.
    pub fn new(mut cell: TwoArmOptions) -> Result<Self, NotACatcher> {
        let first_e_m = cell.cup.rest_e_m(cell.ball.radius_m);
        for arm in &mut cell.arms {
            arm.model = arm.model.clone().with_release_at(first_e_m).with_hand(&cell.cup.replaces, []);
        }
        let mut back = cell.clone();
        back.arms.swap(0, 1);
        let apart_m = (cell.arms[1].x_wb.pos - cell.arms[0].x_wb.pos).norm();
        let x_m = Window::default().x_m + FARTHER.1 * (apart_m - FARTHER.0).max(0.0);
        let window = Window { x_m, flight_s: (0.6, 0.9), ..Window::default() };
        let pairs = [Pair::new(cell)?, Pair::new(back)?];
        let walls = [wall(&pairs[0]), wall(&pairs[1])];
        Ok(Self { pairs, walls, window, first_e_m })
    }

    /// Where the first ball is gripped, in the end-effector frame, m.
    #[must_use]
    pub const fn first_e_m(&self) -> Vector3<f64> {
        self.first_e_m
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
            let options = &TrialOptions { grip_off_m: true_e_m - planned_e_m, ..options.clone() };
            let planned = match self.plan(k, &q, planned_e_m, options, seed) {
                Ok(planned) => planned,
                Err(end) => return Rally { exchanges, end },
            };
            let transit_s = planned.transit_s();
            let Planned { pair, aimed, .. } = planned;
            let outcome = pair.run(&aimed, options, of_throw(seed, k));
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

    /// Throw number `k`, from 0, from where the arms stand (joints of arm 0 and 1, rad) and where the ball is gripped (in the
    /// end-effector frame of the arm that throws, m). The first throw is the slowest of those that are surely caught.
    ///
    /// # Errors
    /// Why there is none.
    pub fn plan(
        &self,
        k: usize,
        q: &[Joints; 2],
        gripped_e_m: Vector3<f64>,
        options: &TrialOptions,
        seed: u64,
    ) -> Result<Planned, RallyEnd> {
        let thrower = k % 2;
        let pair = self.pairs[thrower].clone().gripped_at(gripped_e_m);
        // The catcher's side of the other pair is the arm that throws now.
        let arms = [self.pairs[1 - thrower].catcher(options.jerk), pair.catcher(options.jerk)];
        let walls = [&self.walls[1 - thrower], &self.walls[thrower]];
        let mut throws = self.best_throws(&pair, options, k == 0, of_throw(seed, k));
        // The jaws are open during a throw and closed to a cup before and after it.
        throws.retain(|aimed| {
            let ends = [aimed.throw.start(), aimed.throw.stop()];
            ends.iter().all(|q| stands(arms[0], walls[0], q))
        });
        let go = |side: usize, to: &Joints| {
            let arm = [thrower, 1 - thrower][side];
            way(arms[side].model(), walls[side], &Travel::default(), &q[arm], to)
                .map_err(|why| RallyEnd::NoTransit { arm, why })
        };
        let to_wait = go(1, &options.wait)?;
        let mut end = RallyEnd::NoThrow;
        for aimed in throws {
            match go(0, &aimed.throw.start()) {
                Ok(run_up) => return Ok(Planned { pair, aimed, ways: [run_up, to_wait] }),
                Err(why) => end = why,
            }
        }
        Err(end)
    }

    /// Throws that the other arm can catch, the one with the largest margin first; with `slow` the slowest of the sure ones.
    fn best_throws(&self, pair: &Pair, options: &TrialOptions, slow: bool, seed: u64) -> Vec<Aimed> {
        let throws = draw_from(pair, &self.window, 0..DRAWS, seed, TRIES).unwrap_or_default();
        let state = std::array::from_fn(|i| State::rest(options.wait[i]));
        let start = Start { at_s: 0.0, state: &state, under_way: None };
        let thrower = &pair.cell.arms[0].model;
        let v_max_rad_s = thrower.limit(|limits| limits.v_max_rad_s);
        let judged = throws.into_iter().filter_map(|aimed| {
            let release_s = aimed.throw.ha_s.max(0.3);
            let forecast = true_forecast(&pair.cell.ball, &aimed, release_s, thrower.world().gravity_m_s2);
            let choice = search(pair.catcher(options.jerk), &options.settings, &start, &forecast).0.ok()?;
            let speed = aimed.throw.qd_rad_s.component_div(&v_max_rad_s).amax();
            // What a correction can still use, late in a long flight.
            let margin = choice.probability - 0.5 * choice.used + 0.3 * (choice.t_s - release_s);
            let score =
                if slow && choice.probability >= SURE { 2.0 - speed.max(choice.used) } else { margin };
            Some((score, aimed))
        });
        let mut judged: Vec<(f64, Aimed)> = judged.collect();
        judged.sort_by(|a, b| b.0.total_cmp(&a.0));
        judged.into_iter().map(|(_, aimed)| aimed).collect()
    }
}

/// Seed of all chance of throw number `k`.
const fn of_throw(seed: u64, k: usize) -> u64 {
    seed.wrapping_mul(1_000_003).wrapping_add(k as u64)
}

fn stands(arm: &CatchArm, wall: &Scene, q: &Joints) -> bool {
    check(arm, &mut CollisionChecker::new(arm.model(), wall), &CatchMotion::rest(q), None).is_ok()
}

/// A wall in the middle between the arms of a pair, in the base frame of its catcher.
fn wall(pair: &Pair) -> Scene {
    let [thrower, catcher] = &pair.cell.arms;
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
