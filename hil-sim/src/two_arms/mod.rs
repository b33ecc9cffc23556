//! A cell: two arms, a ball between them, open cups as hands, a tracker that watches.
//!
//! The cell moves the ball and looks at it; it moves no arm. Whoever moves the arms (drives with mechanics behind
//! them, or a model) gives the cell their joints once per step, at most 1 ms long:
//!
//! ```text
//! joints of both arms ──► TwoArmCell::step ──► ball: held, loose; contacts with cups, links, floor
//!                                    └──► tracker: DTrack datagrams of the ball as a single marker
//! ```
//!
//! The contact model decides whether a ball is caught: [`TwoArmCell::resting_in`] names the cup in which it has come to rest,
//! [`TwoArmCell::events`] lists the contacts before. World frame: that of the cell file.
//!
//! | file | holds |
//! |---|---|
//! | this | options, ball and events, one step |
//! | [`scenario`] | TOML to options; the built-in cell |

pub mod in_step;
pub mod scenario;

use std::net::{IpAddr, Ipv4Addr, SocketAddr};

use nalgebra::{Matrix3, Vector3};
use protocol::{Duration, Instant};
use robot_model::collision::Obb;
use robot_model::{Frames, JointVec, Pose, RobotModel};

use crate::mechanics::loose::{Hit, STEP_MAX_S};
use crate::mechanics::{BallOptions, Cup, LooseBall, Surface};
use crate::tracker::{Tracker, TrackerOptions};

/// The thrower's own hand is no obstacle for this long after a release: the ball starts between its fingers.
const FREE_FROM_S: f64 = 0.020;
/// A ball in a cup that moves slower than this against it for [`REST_FOR_S`] has come to rest, m/s.
const REST_M_S: f64 = 0.1;
const REST_FOR_S: f64 = 0.1;
/// Balls that cross the mouth plane farther from its middle are not reported, m.
const CROSSING_MAX_M: f64 = 0.5;
/// Boxes farther from the ball than this are not looked at: more than they move in a step.
const NEAR_M: f64 = 0.02;
/// A contact that is lost for less than this goes on.
const GAP: Duration = Duration::from_millis(20);
const EVENTS_MAX: usize = 65_536;
const CHANNEL: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 5000);

/// An arm and where it stands.
#[derive(Clone, Debug)]
pub struct ArmPlace {
    pub model: RobotModel,
    /// Pose of its base in the world.
    pub x_wb: Pose,
}

/// The hand's cup. Its axis is the tool axis, z of the end-effector frame.
#[derive(Clone, Debug, PartialEq)]
pub struct CupOptions {
    /// From the end-effector frame to the middle of the mouth, m.
    pub mouth_from_ee_m: f64,
    pub shape: Cup,
    /// Boxes of the robot file that are not there because the cup is.
    pub replaces: Vec<String>,
    /// Of the cup's inside and outside.
    pub surface: Surface,
}

impl TwoArmOptions {
    /// One arm and a ball that comes from elsewhere: the second arm of the cell, without the first.
    #[must_use]
    pub fn without_thrower(mut self) -> Self {
        self.arms[0] = self.arms[1].clone();
        self.alone = true;
        self
    }
}

impl CupOptions {
    /// Where the centre of a ball lies at rest on the bottom, in the end-effector frame, m.
    pub fn rest_e_m(&self, ball_radius_m: f64) -> Vector3<f64> {
        Vector3::new(0.0, 0.0, self.mouth_from_ee_m - self.shape.depth_m + ball_radius_m)
    }
}

/// Everything about a cell.
#[derive(Clone, Debug)]
pub struct TwoArmOptions {
    pub arms: [ArmPlace; 2],
    /// The first arm is not there: a ball that comes from elsewhere passes its place.
    pub alone: bool,
    pub ball: BallOptions,
    /// Both hands.
    pub cup: CupOptions,
    /// Links and floor.
    pub ground: Surface,
    pub tracker: TrackerOptions,
    /// Feeds the tracker's random streams.
    pub seed: u64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BallPlace {
    /// Gripped by an arm, fixed in its end-effector frame.
    Held {
        /// The arm, 0 or 1.
        arm: usize,
        /// Centre in the end-effector frame, m.
        at_e_m: Vector3<f64>,
    },
    /// Anywhere else.
    Loose(LooseBall),
}

/// How a ball crossed the plane of a cup's mouth, inwards.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crossing {
    /// Distance of the ball's centre from the middle of the mouth, m.
    pub miss_m: f64,
    /// Angle between the cup's axis and the reverse of the ball's velocity against the hand, rad.
    pub angle_rad: f64,
    /// Speed of the ball against the hand, m/s.
    pub speed_m_s: f64,
}

#[derive(Clone, Debug, PartialEq)]
pub enum TwoArmEvent {
    /// The arm let the ball go.
    Released { arm: usize },
    /// The ball crossed the mouth plane of the arm's cup.
    Crossed { arm: usize, crossing: Crossing },
    /// The ball hit the arm's cup, at this speed along the normal, m/s.
    HitCup { arm: usize, speed_m_s: f64 },
    /// The ball hit a part of the arm that is not its cup.
    HitLink {
        arm: usize,
        /// Link of that part, from 0; link 0 is the base, which no joint moves.
        link: usize,
        /// Name of the box in the robot file.
        part: String,
    },
    /// The ball hit the floor.
    HitFloor,
    /// The ball came to rest in the arm's cup.
    Rests { arm: usize },
    /// A ball that rested in the arm's cup is out of it again.
    FellOut { arm: usize },
    /// The jaws closed around the ball that rested in the arm's cup.
    Gripped { arm: usize },
}

/// Position and speed of an arm's joints, rad and rad/s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointsNow {
    pub q: JointVec,
    pub qd: JointVec,
}

/// A hand in the world, with what else of the arm a ball can hit.
struct HandNow {
    x_we: Pose,
    v_m_s: Vector3<f64>,
    w_rad_s: Vector3<f64>,
    frames: Frames,
    /// Boxes in the world, each with its number in the robot's model.
    boxes: Vec<(usize, Obb)>,
}

pub struct TwoArmCell {
    options: TwoArmOptions,
    place: BallPlace,
    tracker: Tracker,
    now: Instant,
    joints: [JointsNow; 2],
    jaws_open: [bool; 2],
    release: Option<(usize, Instant)>,
    released_at: Option<(usize, Instant)>,
    slow_since: Option<(usize, Instant)>,
    resting: Option<usize>,
    crossed: [bool; 2],
    /// Last contact with the cup of each arm and with its links: a contact goes on over short gaps.
    touched: [Option<Instant>; 4],
    events: Vec<(Instant, TwoArmEvent)>,
}

impl TwoArmCell {
    /// At time zero, the ball gripped by arm `holder` where its gripper holds balls (release frame of the robot file).
    pub fn new(options: TwoArmOptions, holder: usize, joints: [JointsNow; 2]) -> Self {
        let at_e_m = options.arms[holder].model.gripper().x_eb.pos;
        let mut tracker = Tracker::new(options.tracker.clone(), options.seed);
        tracker.set_output(1, Some(CHANNEL));
        Self {
            place: BallPlace::Held { arm: holder, at_e_m },
            tracker,
            now: Instant::ZERO,
            joints,
            // The thrower's jaws are a gripper around the ball, not a cup below it.
            jaws_open: [holder == 0, holder == 1],
            release: None,
            released_at: None,
            slow_since: None,
            resting: None,
            crossed: [false; 2],
            touched: [None; 4],
            events: Vec::new(),
            options,
        }
    }

    /// The ball is gripped there, in the end-effector frame, instead of where the robot file has it, m.
    pub fn grip_at(&mut self, at_e_m: Vector3<f64>) {
        if let BallPlace::Held { at_e_m: held, .. } = &mut self.place {
            *held = at_e_m;
        }
    }

    /// The hand of an arm opens its jaws, or closes them: to a cup, or around a ball that rests in it, where it lies. A ball that is
    /// gripped shows no marker; it leaves the hand with [`TwoArmCell::release_at`].
    pub fn set_jaws(&mut self, arm: usize, open: bool) {
        if self.holder() == Some(arm) {
            return;
        }
        self.jaws_open[arm] = open;
        if open && self.resting == Some(arm) {
            (self.resting, self.slow_since) = (None, None);
            self.record(self.now, TwoArmEvent::FellOut { arm });
        }
        if let (BallPlace::Loose(ball), false, Some(in_cup)) = (self.place, open, self.resting)
            && in_cup == arm
        {
            let at_e_m = self.hand(arm).x_we.inverse_transform_point(&ball.p_m);
            self.place = BallPlace::Held { arm, at_e_m };
            self.record(self.now, TwoArmEvent::Gripped { arm });
        }
    }

    /// The ball leaves its hand at `at`, within a later step.
    pub fn release_at(&mut self, at: Instant) {
        if let BallPlace::Held { arm, .. } = self.place {
            self.release = Some((arm, at));
        }
    }

    /// Puts a loose ball somewhere: a throw by hand.
    pub fn throw_in(&mut self, ball: LooseBall) {
        self.place = BallPlace::Loose(ball);
        (self.crossed, self.resting, self.slow_since) = ([false; 2], None, None);
    }

    /// The arm that grips the ball.
    pub fn holder(&self) -> Option<usize> {
        match self.place {
            BallPlace::Held { arm, .. } => Some(arm),
            BallPlace::Loose(_) => None,
        }
    }

    /// The cup in which the ball rests now, gripped or not.
    pub fn resting_in(&self) -> Option<usize> {
        self.resting
    }

    /// What happened, in order.
    pub fn events(&self) -> &[(Instant, TwoArmEvent)] {
        &self.events
    }

    /// The ball: centre (m) and velocity (m/s) in the world.
    pub fn ball(&self) -> (Vector3<f64>, Vector3<f64>) {
        match self.place {
            BallPlace::Loose(ball) => (ball.p_m, ball.v_m_s),
            BallPlace::Held { arm, at_e_m } => {
                let hand = self.hand(arm);
                let off = hand.x_we.rot * at_e_m;
                (hand.x_we.pos + off, hand.v_m_s + hand.w_rad_s.cross(&off))
            }
        }
    }

    pub fn place(&self) -> &BallPlace {
        &self.place
    }

    /// When the ball was released last, and by whom.
    pub fn released_at(&self) -> Option<(usize, Instant)> {
        self.released_at
    }

    pub fn options(&self) -> &TwoArmOptions {
        &self.options
    }

    /// Time of the last step.
    pub fn now(&self) -> Instant {
        self.now
    }

    /// A tracker datagram that has arrived by now.
    pub fn poll_datagram(&mut self) -> Option<Vec<u8>> {
        self.tracker.poll_data(self.now).map(|(_, bytes)| bytes)
    }

    /// A datagram that has arrived by `now`, which may be some milliseconds after the last step: for a cell that runs in real time
    /// and gets the joints a little later.
    pub fn poll_datagram_by(&mut self, now: Instant) -> Option<Vec<u8>> {
        self.tracker.poll_data(now.max(self.now)).map(|(_, bytes)| bytes)
    }

    /// Moves on to `to`, at most 1 ms later; `joints` is where both arms are then.
    pub fn step(&mut self, to: Instant, joints: [JointsNow; 2]) {
        let total_s = to.saturating_since(self.now).as_secs_f64();
        self.joints = joints;
        let hands = [self.hand(0), self.hand(1)];
        let steps = (total_s / STEP_MAX_S - 1e-9).ceil().max(0.0) as usize;
        let h_s = if steps == 0 { 0.0 } else { total_s / steps as f64 };
        let begin = self.now;
        for k in 0..steps {
            let at = begin + Duration::from_secs_f64(h_s * (k + 1) as f64);
            let back_s = h_s * (steps - 1 - k) as f64;
            self.now = at;
            self.sub_step(h_s, back_s, &hands);
            self.flash(at);
        }
        self.now = to;
    }

    fn flash(&mut self, at: Instant) {
        while let Some(flash) = self.tracker.next_flash().filter(|flash| *flash <= at) {
            let early_s = at.saturating_since(flash).as_secs_f64();
            let seen = match &self.place {
                BallPlace::Loose(ball) => Some(ball.p_m - ball.v_m_s * early_s),
                // A ball in a hand shows no marker.
                BallPlace::Held { .. } => None,
            };
            let marker = seen.map(|p| [p.x * 1e3, p.y * 1e3, p.z * 1e3]);
            self.tracker.place_markers(marker.as_slice());
            self.tracker.handle_timeout(flash);
        }
    }

    fn hand(&self, arm: usize) -> HandNow {
        let ArmPlace { model, x_wb } = &self.options.arms[arm];
        let JointsNow { q, qd } = &self.joints[arm];
        let frames = model.fk(q);
        let x_be = model.ee(&frames);
        let mut v = Vector3::zeros();
        let mut w = Vector3::zeros();
        for i in 0..frames.n() {
            let axis = frames.axis(i) * qd[i];
            v += axis.cross(&(x_be.pos - frames.origin(i)));
            w += axis;
        }
        let replaced = |name: &String| self.options.cup.replaces.contains(name);
        let absent = arm == 0 && self.options.alone;
        let boxes = model.collision().boxes().iter().enumerate();
        let boxes = boxes.filter(|(_, b)| !absent && !replaced(&b.name));
        let boxes = boxes.map(|(number, b)| {
            let x_bl = match b.link.checked_sub(1) {
                None => b.x_lb,
                Some(link) => frames.x_w[link] * b.x_lb,
            };
            (number, Obb::new(*x_wb * x_bl, b.half_m))
        });
        HandNow {
            x_we: *x_wb * x_be,
            v_m_s: x_wb.rot * v,
            w_rad_s: x_wb.rot * w,
            boxes: boxes.collect(),
            frames,
        }
    }

    fn record(&mut self, at: Instant, event: TwoArmEvent) {
        if self.events.len() < EVENTS_MAX {
            self.events.push((at, event));
        }
    }

    fn sub_step(&mut self, h_s: f64, back_s: f64, hands: &[HandNow; 2]) {
        let at = self.now;
        if let (BallPlace::Held { arm, at_e_m }, Some((_, due))) = (self.place, self.release)
            && due <= at
        {
            // The instant lies within this sub-step.
            let hand = &hands[arm];
            let off = hand.x_we.rot * at_e_m;
            let v_m_s = hand.v_m_s + hand.w_rad_s.cross(&off);
            let since_s = at.saturating_since(due).as_secs_f64();
            let mut ball = LooseBall {
                p_m: hand.x_we.pos + off - v_m_s * (back_s + since_s),
                v_m_s,
                spin_rad_s: hand.w_rad_s,
            };
            ball.fly(&self.options.ball, self.gravity(), since_s);
            self.place = BallPlace::Loose(ball);
            self.release = None;
            self.released_at = Some((arm, due));
            self.jaws_open[arm] = true;
            (self.crossed, self.resting, self.slow_since) = ([false; 2], None, None);
            self.record(due, TwoArmEvent::Released { arm });
            return;
        }
        let BallPlace::Loose(mut ball) = self.place else { return };
        let before = ball;
        ball.fly(&self.options.ball, self.gravity(), h_s);
        for (arm, hand) in hands.iter().enumerate() {
            self.touch_cup(arm, hand, back_s, h_s, &before, &mut ball);
            self.touch_links(arm, hand, back_s, &mut ball);
        }
        self.touch_floor(&mut ball);
        self.place = BallPlace::Loose(ball);
    }

    fn gravity(&self) -> f64 {
        self.options.arms[0].model.world().gravity_m_s2
    }

    /// Pose and velocity of the cup's mouth, `back_s` before the end of the step.
    fn mouth(&self, hand: &HandNow, back_s: f64) -> (Pose, Vector3<f64>) {
        let turn = Matrix3::identity() - hand.w_rad_s.cross_matrix() * back_s;
        let rot = turn * hand.x_we.rot;
        let off = rot.column(2) * self.options.cup.mouth_from_ee_m;
        let pos = hand.x_we.pos - hand.v_m_s * back_s + off;
        (Pose::new(rot, pos), hand.v_m_s + hand.w_rad_s.cross(&off))
    }

    fn touch_cup(
        &mut self,
        arm: usize,
        hand: &HandNow,
        back_s: f64,
        h_s: f64,
        before: &LooseBall,
        ball: &mut LooseBall,
    ) {
        let (x_wc, v_c) = self.mouth(hand, back_s);
        let was = self.mouth(hand, back_s + h_s).0.inverse_transform_point(&before.p_m);
        let is = x_wc.inverse_transform_point(&ball.p_m);
        if was.z > 0.0 && is.z <= 0.0 && is.x.hypot(is.y) < CROSSING_MAX_M && !self.crossed[arm] {
            // Told once per flight: the first time.
            self.crossed[arm] = true;
            let relative = ball.v_m_s - v_c;
            let speed_m_s = relative.norm();
            let along = -relative.dot(&x_wc.rot.column(2)) / speed_m_s.max(1e-9);
            let crossing =
                Crossing { miss_m: is.x.hypot(is.y), angle_rad: along.clamp(-1.0, 1.0).acos(), speed_m_s };
            self.record(self.now, TwoArmEvent::Crossed { arm, crossing });
        }
        if self.jaws_open[arm] {
            return;
        }
        let mut touches = false;
        for k in 0..2 {
            let at_c = x_wc.inverse_transform_point(&ball.p_m);
            let Some(contact) = self.options.cup.shape.contacts(&at_c, self.options.ball.radius_m)[k] else {
                continue;
            };
            let normal = x_wc.rot * contact.normal_c;
            let point = ball.p_m - normal * self.options.ball.radius_m;
            let surface_v_m_s = v_c + hand.w_rad_s.cross(&(point - x_wc.pos));
            let surface = self.options.cup.surface;
            let hit = Hit { normal, depth_m: contact.depth_m, surface_v_m_s, surface };
            let speed_m_s = ball.hit(&self.options.ball, &hit);
            if speed_m_s > surface.rest_m_s && self.is_new(arm) {
                self.record(self.now, TwoArmEvent::HitCup { arm, speed_m_s });
            }
            touches = true;
        }
        if touches {
            self.touched[arm] = Some(self.now);
        }
        let inside = self.options.cup.shape.contains(&x_wc.inverse_transform_point(&ball.p_m));
        let surface_v = v_c + hand.w_rad_s.cross(&(ball.p_m - x_wc.pos));
        let slow = inside && (ball.v_m_s - surface_v).norm() < REST_M_S;
        match self.slow_since {
            Some((of, since)) if of == arm => {
                if !slow {
                    self.slow_since = None;
                } else if self.resting.is_none()
                    && self.now.saturating_since(since).as_secs_f64() >= REST_FOR_S
                {
                    self.resting = Some(arm);
                    self.record(self.now, TwoArmEvent::Rests { arm });
                }
            }
            None if slow => self.slow_since = Some((arm, self.now)),
            _ => {}
        }
        if self.resting == Some(arm) && !inside {
            self.resting = None;
            self.record(self.now, TwoArmEvent::FellOut { arm });
        }
    }

    /// Whether a contact begins, and is not the one of a moment ago.
    fn is_new(&self, place: usize) -> bool {
        self.touched[place].is_none_or(|last| self.now.saturating_since(last) > GAP)
    }

    fn touch_links(&mut self, arm: usize, hand: &HandNow, back_s: f64, ball: &mut LooseBall) {
        if let Some((thrower, at)) = self.released_at
            && thrower == arm
            && self.now.saturating_since(at).as_secs_f64() < FREE_FROM_S
        {
            return;
        }
        let radius_m = self.options.ball.radius_m;
        let x_wb = self.options.arms[arm].x_wb;
        let mut hit_box = None;
        for (number, obb) in &hand.boxes {
            if (obb.pose.pos - ball.p_m).norm() > obb.radius_m() + radius_m + NEAR_M {
                continue;
            }
            let p_b = x_wb.inverse_transform_point(&ball.p_m);
            let mut surface_v = Vector3::zeros();
            let link = self.options.arms[arm].model.collision().boxes()[*number].link;
            for i in 0..link {
                let arm_m = p_b - hand.frames.origin(i);
                surface_v += hand.frames.axis(i).cross(&arm_m) * self.joints[arm].qd[i];
            }
            let surface_v_m_s = x_wb.rot * surface_v;
            // The boxes are where they are at the end of the step: the ball is seen from there.
            let near = obb.proximity_to_sphere(&(ball.p_m + surface_v_m_s * back_s), radius_m);
            if near.distance_m < 0.0 {
                let hit = Hit {
                    normal: near.normal,
                    depth_m: -near.distance_m,
                    surface_v_m_s,
                    surface: self.options.ground,
                };
                ball.hit(&self.options.ball, &hit);
                hit_box = Some(*number);
            }
        }
        if let Some(number) = hit_box {
            let new = self.is_new(2 + arm);
            self.touched[2 + arm] = Some(self.now);
            if !new {
                return;
            }
            let hit = &self.options.arms[arm].model.collision().boxes()[number];
            let (link, part) = (hit.link, hit.name.clone());
            self.record(self.now, TwoArmEvent::HitLink { arm, link, part });
        }
    }

    fn touch_floor(&mut self, ball: &mut LooseBall) {
        let floor_z = self.options.arms[0].model.world().floor_z_m + self.options.arms[0].x_wb.pos.z;
        let depth_m = self.options.ball.radius_m + floor_z - ball.p_m.z;
        if depth_m > 0.0 {
            let hit = Hit {
                normal: Vector3::z(),
                depth_m,
                surface_v_m_s: Vector3::zeros(),
                surface: self.options.ground,
            };
            if ball.hit(&self.options.ball, &hit) > self.options.ground.rest_m_s {
                self.record(self.now, TwoArmEvent::HitFloor);
            }
        }
    }
}

#[cfg(test)]
mod tests;
