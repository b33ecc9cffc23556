//! Where the bases stand: turns of both arms and the height of the second, found so that most balls have a place.
//!
//! Throws are drawn once for each direction and used for every placement. The first joint turns the whole arm, so a throw can be turned: its
//! ball then passes the middle of the catcher's window at the same lateral distance as before. A ball that is now too high, too low or too
//! late is left out. The value of a placement is the lower end of the 95 % interval of the share of balls with a place. So a placement that
//! few balls reach does not get a high value. The search starts at the given cell. It changes the best placement at random, by smaller steps
//! each time, and keeps a change that has a higher value. [`judge`] draws other balls than the search and counts catches.

use hil_sim::two_arms::TwoArmOptions;
use nalgebra::{Rotation3, Unit, Vector3};
use operator::ball_catch::trial::{Pair, TrialOptions};
use planner::catch::draw::{Aimed, Window, crosses};
use planner::flight::FlightModel;
use planner::plan::rng::SplitMix64;
use planner::throw::Throw;
use rayon::prelude::*;
use robot_model::Pose;
use serde::Serialize;

use super::study::{NoStudy, Share, note, row};
use super::throws::{draw_throws, flight, why_no_place};

/// Standard deviation of the first and of the last change, as shares of the ranges.
const CHANGE: (f64, f64) = (0.6, 0.1);
/// The result is rounded to these steps: turns in deg, heights in m.
const STEP: (f64, f64) = (0.5, 0.005);
/// A throw is turned in at most this many iterations. They end when the lateral error is below `NEAR_M`, m.
const TURNS: usize = 8;
const NEAR_M: f64 = 0.002;
/// Margin to the ends of the joint ranges, rad; the same as in `planner::catch::draw`.
const MARGIN_RAD: f64 = 0.01;

/// Change of a cell.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Placement {
    /// How far each base is turned about its own vertical axis, deg.
    pub yaw_deg: [f64; 2],
    /// Height that is added to the second base, m.
    pub height_m: f64,
}

impl Placement {
    /// The cell with this change. The distance of the bases stays.
    pub fn of(&self, cell: &TwoArmOptions) -> TwoArmOptions {
        let mut cell = cell.clone();
        for (arm, yaw_deg) in cell.arms.iter_mut().zip(self.yaw_deg) {
            arm.x_wb = arm.x_wb * Pose::rot_z(yaw_deg.to_radians());
        }
        let apart = cell.arms[1].x_wb.pos - cell.arms[0].x_wb.pos;
        let high_m = apart.z + self.height_m;
        let along_m = (apart.norm_squared() - high_m * high_m).max(0.0).sqrt();
        let along = apart.xy() * (along_m / apart.xy().norm().max(1e-9));
        cell.arms[1].x_wb.pos = cell.arms[0].x_wb.pos + Vector3::new(along.x, along.y, high_m);
        cell
    }
}

/// How a placement is searched.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Search {
    /// Throws that are drawn for each direction.
    pub throws: usize,
    /// Placements that are tried.
    pub tries: usize,
    /// Each base is turned by at most this angle, to the left or to the right, deg.
    pub yaw_deg: f64,
    /// The second base is raised or lowered by at most this height, m.
    pub height_m: f64,
    /// The first arm throws only.
    pub one_way: bool,
    pub seed: u64,
}

impl Search {
    /// Cells in which arm 0 throws: the cell, and the one with the arms swapped.
    fn directions(&self, cell: &TwoArmOptions) -> Vec<TwoArmOptions> {
        let mut back = cell.clone();
        back.arms.swap(0, 1);
        let mut directions = vec![cell.clone(), back];
        directions.truncate(if self.one_way { 1 } else { 2 });
        directions
    }

    fn changed(&self, from: &Placement, share: f64, rng: &mut SplitMix64) -> Placement {
        let mut change = |value: f64, most: f64, step: f64| {
            let drawn = (value + share * most * rng.normal()).clamp(-most, most);
            (drawn / step).round() * step
        };
        let [first, second] = from.yaw_deg;
        let first = if self.one_way { first } else { change(first, self.yaw_deg, STEP.0) };
        let second = change(second, self.yaw_deg, STEP.0);
        let height_m = change(from.height_m, self.height_m, STEP.1);
        Placement { yaw_deg: [first, second], height_m }
    }
}

/// A throw that was drawn, in the frame of the thrower's base.
#[derive(Debug, Clone, Copy)]
struct InBase {
    throw: Throw,
    p_m: Vector3<f64>,
    v_m_s: Vector3<f64>,
    /// Lateral distance of the ball from the middle of the window, m.
    beside_m: f64,
}

impl InBase {
    fn of(aimed: &Aimed, pair: &Pair, flight: &FlightModel, window: &Window) -> Option<Self> {
        let [thrower, catcher] = &pair.cell.arms;
        let (_, at) = crosses(flight, &aimed.p_m, &aimed.v_m_s, &catcher.x_wb.inverse(), window)?;
        let p_m = thrower.x_wb.inverse_transform_point(&aimed.p_m);
        let v_m_s = thrower.x_wb.rot.tr_mul(&aimed.v_m_s);
        Some(Self { throw: aimed.throw, p_m, v_m_s, beside_m: at.y })
    }

    /// The throw turned so that its ball passes the window of this pair at the same lateral distance; `None` if it passes too high, too low
    /// or too early, or if the turn leaves the range of the first joint.
    fn aimed(&self, pair: &Pair, flight: &FlightModel, window: &Window) -> Option<Aimed> {
        let [thrower, catcher] = &pair.cell.arms;
        let x_cw = catcher.x_wb.inverse();
        let frames = thrower.model.fk(&self.throw.q_rad);
        let (axis, about) = (Unit::new_normalize(frames.axis(0)), frames.origin(0));
        let mut turn_rad = 0.0;
        for _ in 0..TURNS {
            let turn = Rotation3::from_axis_angle(&axis, turn_rad);
            let p_m = thrower.x_wb.transform_point(&(about + turn * (self.p_m - about)));
            let v_m_s = thrower.x_wb.rot * (turn * self.v_m_s);
            let (flight_s, at) = crosses(flight, &p_m, &v_m_s, &x_cw, window)?;
            if (at.y - self.beside_m).abs() > NEAR_M {
                let wanted = Vector3::new(at.x, self.beside_m, at.z);
                let [now, then] = [at, wanted].map(|p_c| {
                    let p = thrower.x_wb.inverse_transform_point(&catcher.x_wb.transform_point(&p_c)) - about;
                    p - *axis * p.dot(&axis)
                });
                turn_rad += now.cross(&then).dot(&axis).atan2(now.dot(&then));
                continue;
            }
            let inside = at.z >= window.z_m.0 && at.z <= window.z_m.1 && flight_s >= window.flight_s.0;
            let mut throw = Throw { flight_s, ..self.throw };
            throw.q_rad[0] += turn_rad;
            let turns = [throw.start(), throw.stop()].iter().all(|q| thrower.model.in_range(q, -MARGIN_RAD));
            return (inside && turns).then_some(Aimed { throw, p_m, v_m_s, flight_s });
        }
        None
    }
}

fn apart_m(cell: &TwoArmOptions) -> f64 {
    (cell.arms[1].x_wb.pos - cell.arms[0].x_wb.pos).norm()
}

/// Searches the placement with the highest value, mean of the directions. `observe` gets the number of placements tried, the best placement
/// and its value, each time a better one is found. The same arguments give the same placement.
///
/// # Errors
/// An arm cannot catch, or cannot throw to the other.
pub fn find_place(
    cell: &TwoArmOptions,
    options: &TrialOptions,
    search: &Search,
    mut observe: impl FnMut(usize, &Placement, f64),
) -> Result<Placement, NoStudy> {
    let refused = || NoStudy::OutOfReach { distance_m: apart_m(cell) };
    let (low_m, high_m) = Window::high().z_m;
    let around = Window { z_m: (low_m - search.height_m, high_m + search.height_m), ..Window::high() };
    let mut drawn = Vec::new();
    for (cell, seed) in search.directions(cell).into_iter().zip(search.seed..) {
        let pair = Pair::new(cell)?;
        let flight = flight(&pair).ok_or_else(refused)?;
        let throws = draw_throws(&pair, &around, search.throws, seed).ok_or_else(refused)?;
        let throws = throws.iter().filter_map(|aimed| InBase::of(aimed, &pair, &flight, &around));
        drawn.push((flight, throws.collect::<Vec<_>>()));
    }
    let value = |placement: &Placement| -> Result<f64, NoStudy> {
        let mut sum = 0.0;
        for (cell, (flight, throws)) in search.directions(&placement.of(cell)).into_iter().zip(&drawn) {
            let pair = Pair::new(cell)?;
            let judged = throws.par_iter().filter_map(|throw| {
                let aimed = throw.aimed(&pair, flight, &Window::high())?;
                Some(why_no_place(&pair, &aimed, options).is_none())
            });
            sum += Share::of(&judged.collect::<Vec<bool>>()).wilson().0;
        }
        Ok(sum / drawn.len() as f64)
    };
    let mut best = (Placement::default(), value(&Placement::default())?);
    observe(0, &best.0, best.1);
    let mut rng = SplitMix64::stream(search.seed, 0x0070_6c61_6365);
    for k in 0..search.tries {
        let width = CHANGE.0 * (CHANGE.1 / CHANGE.0).powf(k as f64 / search.tries as f64);
        let placement = search.changed(&best.0, width, &mut rng);
        let value = value(&placement)?;
        if value > best.1 {
            best = (placement, value);
            observe(k + 1, &best.0, best.1);
        }
    }
    Ok(best.0)
}

/// Results of the balls that one arm throws.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Judged {
    /// Balls for which a place exists.
    pub with_place: Share,
    /// Balls that lay in the cup at the end.
    pub caught: Share,
    /// Why the others have no place, the most frequent reason first.
    pub reasons: Vec<(String, usize)>,
    /// Lateral miss of the balls that crossed the mouth plane, mm: 95 %.
    pub miss_mm: f64,
    /// Throws in which something else was reported than happened, or a limit was passed.
    pub wrong: usize,
}

/// Throws new balls in this cell, in each direction of the search.
///
/// # Errors
/// An arm cannot catch, or cannot throw to the other.
pub fn judge(
    cell: &TwoArmOptions,
    options: &TrialOptions,
    search: &Search,
    seed: u64,
) -> Result<Vec<Judged>, NoStudy> {
    let judged = search.directions(cell).into_iter().zip(seed..).map(|(cell, seed)| {
        let refused = NoStudy::OutOfReach { distance_m: apart_m(&cell) };
        let pair = Pair::new(cell)?;
        let throws = draw_throws(&pair, &Window::high(), search.throws, seed).ok_or(refused)?;
        let why: Vec<_> = throws.par_iter().map(|aimed| why_no_place(&pair, aimed, options)).collect();
        let exists: Vec<bool> = why.iter().map(Option::is_none).collect();
        let row = row("", &pair, &throws, &|_| options.clone(), &exists, seed);
        let mut reasons = Vec::new();
        why.into_iter().flatten().for_each(|why| note(&mut reasons, why));
        reasons.sort_by_key(|(_, n)| std::cmp::Reverse(*n));
        let wrong = row.silent.len() + row.limit_passed.len();
        Ok(Judged {
            with_place: Share::of(&exists),
            caught: row.caught,
            reasons,
            miss_mm: row.miss_mm.1,
            wrong,
        })
    });
    judged.collect()
}

#[cfg(test)]
mod tests {
    use planner::catch::draw::released;

    use super::*;

    fn cell() -> TwoArmOptions {
        TwoArmOptions::two_arms().unwrap()
    }

    #[test]
    fn a_placement_keeps_the_distance_and_turns_each_base_about_itself() {
        let placed = Placement { yaw_deg: [10.0, -20.0], height_m: 0.3 }.of(&cell());
        let [first, second] = &placed.arms;
        assert!((apart_m(&placed) - 2.5).abs() < 1e-12 && (second.x_wb.pos.z - 0.3).abs() < 1e-12);
        assert_eq!(first.x_wb.pos, Vector3::zeros());
        let yaw = [first, second].map(|arm| arm.x_wb.rpy_rad()[2].to_degrees());
        assert!((yaw[0] - 10.0).abs() < 1e-9 && (yaw[1] - 160.0).abs() < 1e-9, "{yaw:?}");
        assert_eq!(Placement::default().of(&cell()).arms[1].x_wb.pos, cell().arms[1].x_wb.pos);
    }

    /// Forward kinematics of the turned motion give the turned ball, and the ball passes the window at the drawn lateral distance.
    #[test]
    fn a_drawn_throw_is_turned_to_where_the_window_stands() {
        let pair = Pair::new(cell()).unwrap();
        let flight = flight(&pair).unwrap();
        let throws = draw_throws(&pair, &Window::high(), 24, 1).unwrap();
        let placed = Pair::new(Placement { yaw_deg: [30.0, 25.0], height_m: -0.05 }.of(&cell())).unwrap();
        let [thrower, catcher] = &placed.cell.arms;
        let mut turned = 0;
        for drawn in &throws {
            let in_base = InBase::of(drawn, &pair, &flight, &Window::high()).unwrap();
            let same = in_base.aimed(&pair, &flight, &Window::high()).unwrap();
            assert!((same.p_m - drawn.p_m).norm() < 1e-12 && same.throw.q_rad == drawn.throw.q_rad);
            let Some(aimed) = in_base.aimed(&placed, &flight, &Window::high()) else { continue };
            let (p_m, v_m_s) = released(&thrower.model, &thrower.x_wb, &aimed.throw, 0.0);
            assert!((p_m - aimed.p_m).norm() < 1e-9 && (v_m_s - aimed.v_m_s).norm() < 1e-9);
            let (_, at) = crosses(&flight, &p_m, &v_m_s, &catcher.x_wb.inverse(), &Window::high()).unwrap();
            assert!((at.y - in_base.beside_m).abs() <= NEAR_M && (0.0..=0.7).contains(&at.z), "{at}");
            turned += 1;
        }
        assert!(turned >= 4, "{turned}");
    }
}
