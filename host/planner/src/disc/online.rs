//! Catches a disc that is seen while it flies: estimate, plan, correct.
//!
//! Sans-IO: views come in with the time at which they arrive; the motion is read out. The first catch that can be planned
//! is begun; each further view moves it to where the disc is then expected, until the hand's motion is frozen.

use super::Joints;
use super::arm::DiscArm;
use super::estimate::{Estimate, Model, View};
use super::intercept::local::Effort;
use super::intercept::{self, Decline, Plan, Settings};
use super::motion::DiscMotion;
use crate::motion_law::State;

/// How views become motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Timing {
    /// Views before the first plan.
    pub first_views: usize,
    /// From the arrival of a view to the first motion because of it, s.
    pub actuation_s: f64,
    /// No correction in the last time before the disc comes in, s.
    pub freeze_s: f64,
    /// Longest flight that is looked at, s.
    pub horizon_s: f64,
}

impl Default for Timing {
    fn default() -> Self {
        Self { first_views: 8, actuation_s: 0.008, freeze_s: 0.03, horizon_s: 1.5 }
    }
}

/// A catch in progress.
#[derive(Debug)]
pub struct Catcher<'a> {
    arm: &'a DiscArm,
    model: Model,
    settings: Settings,
    timing: Timing,
    rest: Joints,
    views: Vec<View>,
    estimate: Option<Estimate>,
    plan: Option<Plan>,
    /// What was done from when on.
    motions: Vec<DiscMotion>,
    last_decline: Option<Decline>,
    /// Corrections that were taken and that were not possible.
    pub corrections: (usize, usize),
}

impl<'a> Catcher<'a> {
    /// Arm at rest at `rest`.
    #[must_use]
    pub fn new(arm: &'a DiscArm, model: Model, settings: Settings, timing: Timing, rest: Joints) -> Self {
        Self {
            arm,
            model,
            settings,
            timing,
            rest,
            views: Vec::new(),
            estimate: None,
            plan: None,
            motions: Vec::new(),
            last_decline: None,
            corrections: (0, 0),
        }
    }

    /// Takes a view that arrives at `arrived_s`.
    pub fn observe(&mut self, view: View, arrived_s: f64) {
        self.views.push(view);
        if self.views.len() < self.timing.first_views {
            return;
        }
        let now_s = arrived_s + self.timing.actuation_s;
        let settings = Settings { now_s, between: Effort::NOT_AT_ALL, ..self.settings };
        let Some(estimate) = Estimate::refit(&self.model, &self.views, self.estimate.as_ref()) else {
            return;
        };
        let path = estimate.path(self.timing.horizon_s);
        self.estimate = Some(estimate);
        let now = self.state(settings.now_s);
        let next = match &self.plan {
            None => intercept::plan(self.arm, &path, &now, &settings),
            Some(plan) => {
                let comes_in_s = plan.choice.t_s - plan.choice.lead_s - plan.reach.half_dwell_s;
                if settings.now_s > comes_in_s - self.timing.freeze_s {
                    return;
                }
                intercept::refine(self.arm, &path, &now, plan, &settings)
            }
        };
        match next {
            Ok(next) => {
                self.corrections.0 += usize::from(self.plan.is_some());
                self.motions.push(next.motion.clone());
                self.plan = Some(next);
            }
            Err(_) if self.plan.is_some() => self.corrections.1 += 1,
            Err(why) => self.last_decline = Some(why),
        }
    }

    /// Angle and speed of each joint at a time.
    #[must_use]
    pub fn state(&self, t_s: f64) -> [State; 4] {
        let current = self.motions.iter().rev().find(|m| m.from_s <= t_s);
        std::array::from_fn(|j| current.map_or(State::rest(self.rest[j]), |m| m.at(j, t_s)))
    }

    /// Joint angles at a time, rad.
    #[must_use]
    pub fn q(&self, t_s: f64) -> Joints {
        Joints::from_fn(|j, _| self.state(t_s)[j].q)
    }

    /// The plan under way, or why there is none.
    ///
    /// # Errors
    /// The last refusal; `None` before there were enough views.
    pub fn plan(&self) -> Result<&Plan, Option<Decline>> {
        self.plan.as_ref().ok_or(self.last_decline)
    }

    /// When the arm stands again, s.
    #[must_use]
    pub fn end_s(&self) -> f64 {
        self.motions.last().map_or(0.0, DiscMotion::end_s)
    }
}
