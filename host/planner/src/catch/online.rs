//! A catch in progress: forecasts in, motions out.
//!
//! Sans-IO: time comes with the forecast. Each forecast may change the motion under way; what is given out is for the
//! executor, which may refuse it. A motion always ends at rest, so an executor that hears nothing more stays safe.

use nalgebra::Vector3;

use super::Joints;
use super::arm::CatchArm;
use super::bounce::{CupPath, Flights, chance_to_stay};
use super::clear::move_clear;
use super::forecast::Forecast;
use super::motion::CatchMotion;
use super::search::{Choice, search};
use super::task::{Count, Decline, Settings, Start, passes_rim};

/// The cup is moved only for errors above this, m: below it the motion under way is as good.
const CORRECT_FROM_M: f64 = 0.0015;
/// Forecasts in a row without a catch before the arm moves out of the way: the next samples may still show a catch.
const CLEAR_AFTER: usize = 3;
/// Forecasts in a row in which a catch under way is as good as missed and cannot be corrected, before it is given up.
const GIVE_UP_AFTER: usize = 8;

/// What a forecast led to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Decision {
    /// No catch, for now.
    Declined(Decline),
    /// No catch; the arm moves out of the ball's way.
    MovedClear(Decline),
    /// The first motion.
    Begun,
    /// The motion was replaced.
    Corrected,
    /// The motion under way is good enough.
    Kept,
    /// The motion under way should be replaced but cannot be.
    NotCorrected(Decline),
    /// The catch under way has become hopeless: there is none any more.
    GivenUp(Decline),
    /// Too late for any change.
    Frozen,
}

/// One line of the decision log.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Logged {
    /// When, s.
    pub at_s: f64,
    pub decision: Decision,
    /// Time of the catch under way, s.
    pub catch_s: Option<f64>,
    /// Predicted probability of the catch under way.
    pub probability: f64,
    /// Standard deviation across the flight at the catch, m.
    pub sigma_m: f64,
    /// Predicted distance of the ball from the cup's axis at the catch under way, before this decision, m.
    pub off_m: f64,
    /// Candidates.
    pub count: Count,
}

#[derive(Debug)]
pub struct Catcher<'a> {
    arm: &'a CatchArm,
    settings: Settings,
    motion: CatchMotion,
    before: Option<(CatchMotion, Option<Choice>)>,
    choice: Option<Choice>,
    declines: usize,
    hopeless: usize,
    log: Vec<Logged>,
}

impl<'a> Catcher<'a> {
    /// The arm stands at `q`.
    #[must_use]
    pub fn new(arm: &'a CatchArm, settings: Settings, q: &Joints) -> Self {
        Self {
            arm,
            settings,
            motion: CatchMotion::rest(q),
            before: None,
            choice: None,
            declines: 0,
            hopeless: 0,
            log: Vec::new(),
        }
    }

    /// Takes a forecast at `now_s`; the motion that replaces the one under way from its start on, if there is one.
    pub fn observe(&mut self, forecast: &Forecast, now_s: f64) -> Option<&CatchMotion> {
        let start_s = now_s + self.settings.actuation_s;
        let off_m = self.choice.as_ref().map_or(0.0, |choice| off_axis_m(choice, forecast));
        let (decision, count) = self.decide(forecast, start_s, off_m);
        let foreseen = self.choice.as_ref().and_then(|choice| forecast.at(choice.t_s));
        self.log.push(Logged {
            at_s: now_s,
            decision,
            catch_s: self.choice.as_ref().map(|choice| choice.t_s),
            probability: self.choice.as_ref().map_or(0.0, |choice| choice.probability),
            sigma_m: foreseen.map_or(f64::NAN, |ball| ball.lateral_sigma_m()),
            off_m,
            count,
        });
        let moved = matches!(decision, Decision::Begun | Decision::Corrected | Decision::MovedClear(_));
        moved.then_some(&self.motion)
    }

    fn decide(&mut self, forecast: &Forecast, start_s: f64, off_m: f64) -> (Decision, Count) {
        let state = self.motion.at(start_s);
        let under_way = self.choice.as_ref().map(|choice| (choice.t_s, &choice.axis, choice.mode));
        if let Some((t_s, ..)) = under_way {
            if start_s > t_s - self.settings.freeze_s {
                return (Decision::Frozen, Count::default());
            }
            if off_m < CORRECT_FROM_M {
                self.judge_again(forecast, off_m);
                return (Decision::Kept, Count::default());
            }
        }
        let start = Start { at_s: start_s, state: &state, under_way };
        let (found, count) = search(self.arm, &self.settings, &start, forecast);
        let free = Start { under_way: None, at_s: start_s, state: &state };
        match found {
            Ok(choice) => {
                let begun = self.choice.is_none();
                if !begun && choice.probability < self.kept_probability(forecast, off_m) {
                    self.judge_again(forecast, off_m);
                    return (Decision::Kept, count);
                }
                let motion = choice.motion.clone();
                self.replace(motion, Some(choice));
                (self.declines, self.hopeless) = (0, 0);
                (if begun { Decision::Begun } else { Decision::Corrected }, count)
            }
            Err(why) if self.choice.is_some() => {
                self.judge_again(forecast, off_m);
                let probability = self.choice.as_ref().map_or(0.0, |choice| choice.probability);
                let hopeless = probability < self.settings.probability_min;
                self.hopeless = if hopeless { self.hopeless + 1 } else { 0 };
                if self.hopeless < GIVE_UP_AFTER {
                    return (Decision::NotCorrected(why), count);
                }
                (self.choice, self.before, self.hopeless) = (None, None, 0);
                self.declines = CLEAR_AFTER;
                let moved = self.moves_clear(&free, forecast, why);
                (if moved { Decision::MovedClear(why) } else { Decision::GivenUp(why) }, count)
            }
            Err(why) => {
                self.declines += 1;
                let moved = self.moves_clear(&free, forecast, why);
                (if moved { Decision::MovedClear(why) } else { Decision::Declined(why) }, count)
            }
        }
    }

    /// Moves out of the ball's way if it will not be caught and would come too near.
    fn moves_clear(&mut self, start: &Start<'_>, forecast: &Forecast, why: Decline) -> bool {
        // Of a flight that is not known well nobody knows where it is clear.
        let sure = self.settings.keep_clear && self.declines >= CLEAR_AFTER && why != Decline::TooUncertain;
        let clear = sure.then(|| move_clear(self.arm, start, &self.motion, forecast)).flatten();
        let moves = clear.is_some();
        if let Some(motion) = clear {
            self.replace(motion, None);
        }
        moves
    }

    fn replace(&mut self, motion: CatchMotion, choice: Option<Choice>) {
        let motion = std::mem::replace(&mut self.motion, motion);
        let choice = std::mem::replace(&mut self.choice, choice);
        self.before = Some((motion, choice));
    }

    /// Probability of the catch under way if nothing changes any more. If the ball comes as planned, the chance to stay is that
    /// of the plan. If it comes beside the cup, flights about that place are judged.
    fn kept_probability(&self, forecast: &Forecast, off_m: f64) -> f64 {
        let Some(choice) = &self.choice else { return 0.0 };
        let Some(ball) = forecast.at(choice.t_s) else { return 0.0 };
        let sigma_m = ball.lateral_sigma_m().hypot(self.settings.tracking_sigma_m);
        let enters = passes_rim(self.arm.cup().miss_max_m(), off_m, sigma_m);
        if off_m < CORRECT_FROM_M {
            return choice.stays * enters;
        }
        let path = CupPath::of(self.arm, &choice.motion, choice.t_s);
        let comes = (ball.p_m - choice.p_m, &ball.v_m_s);
        chance_to_stay(self.arm.cup(), &path, comes, sigma_m, Flights::Judging).min(enters)
    }

    fn judge_again(&mut self, forecast: &Forecast, off_m: f64) {
        let probability = self.kept_probability(forecast, off_m);
        if let Some(choice) = &mut self.choice {
            choice.probability = probability;
        }
    }

    /// The executor refused the motion given last: the one before goes on, with its catch if it had one.
    pub fn refused(&mut self) {
        if let Some((motion, choice)) = self.before.take() {
            self.motion = motion;
            self.choice = choice;
        }
    }

    #[must_use]
    pub fn arm(&self) -> &'a CatchArm {
        self.arm
    }

    /// The motion under way.
    #[must_use]
    pub fn motion(&self) -> &CatchMotion {
        &self.motion
    }

    /// The catch under way.
    #[must_use]
    pub fn choice(&self) -> Option<&Choice> {
        self.choice.as_ref()
    }

    /// All decisions.
    #[must_use]
    pub fn log(&self) -> &[Logged] {
        &self.log
    }

    /// Why there is no catch; `None` if there is one, or nothing was foreseen yet.
    ///
    /// A ball that would bounce out is too late in the end, too: the first of both counts.
    /// A ball that has passed is out of reach, of whatever kind it was, and no posture points at it: the last reason counts that a
    /// search with postures to judge gave; without one, the last that is neither of these two; then the last that is not
    /// [`Decline::OutOfReach`].
    #[must_use]
    pub fn declined(&self) -> Option<Decline> {
        if self.choice.is_some() {
            return None;
        }
        let reasons = || {
            self.log.iter().rev().filter_map(|logged| match logged.decision {
                Decision::Declined(why) | Decision::MovedClear(why) | Decision::GivenUp(why) => {
                    Some((why, logged.count.posture > 0))
                }
                _ => None,
            })
        };
        let passed = [Decline::OutOfReach, Decline::NoPosture];
        let with_postures = reasons().find(|(_, postures)| *postures);
        let before = || reasons().find(|(why, _)| !passed.contains(why));
        let in_reach = || reasons().find(|(why, _)| *why != Decline::OutOfReach);
        let bounces = || reasons().find(|(why, _)| *why == Decline::BouncesOut);
        let with_postures = with_postures.map(|last| match last.0 {
            Decline::TooLate => bounces().unwrap_or(last),
            _ => last,
        });
        with_postures.or_else(before).or_else(in_reach).or_else(|| reasons().next()).map(|(why, _)| why)
    }
}

/// Where the forecast ball passes the cup's axis at the catch, m.
fn off_axis_m(choice: &Choice, forecast: &Forecast) -> f64 {
    let Some(ball) = forecast.at(choice.t_s) else { return f64::INFINITY };
    let u: Vector3<f64> = ball.v_m_s.normalize();
    let off = ball.p_m - choice.p_m;
    (off - u * off.dot(&u)).norm()
}
