//! Collision of one configuration.

use std::fmt;

use nalgebra::Vector3;

use crate::boxes::{Obb, Proximity};
use crate::kinematics::Frames;
use crate::model::RobotModel;
use crate::pose::Pose;

/// What is around the arm besides its own base and the floor, and what it holds.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Scene {
    /// Boxes in the world that no moving link may touch: name and box.
    pub obstacles: Vec<(String, Obb)>,
    /// Whether the ball is in the hand and must not touch anything but the last two links.
    pub ball_held: bool,
}

/// One of the bodies that can touch.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Body {
    /// Box of the arm, by index into the robot's list of boxes.
    Box(usize),
    /// Obstacle, by index into the scene's list.
    Obstacle(usize),
    /// The floor.
    Floor,
    /// The ball, held or flying.
    Ball,
}

/// The nearest pair of bodies.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Clearance {
    /// Distance in m; negative if they overlap.
    pub distance_m: f64,
    /// One body.
    pub a: Body,
    /// The other.
    pub b: Body,
}

impl Clearance {
    fn none() -> Self {
        Self { distance_m: f64::INFINITY, a: Body::Floor, b: Body::Floor }
    }

    fn consider(&mut self, distance_m: f64, a: Body, b: Body) {
        if distance_m < self.distance_m {
            *self = Self { distance_m, a, b };
        }
    }
}

/// Bodies placed by a configuration, and one pair of them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Pair {
    pub(super) a: Body,
    pub(super) b: Body,
    /// Links of both; 0 for what does not move.
    pub(super) link_a: usize,
    pub(super) link_b: usize,
}

/// Tests configurations of one robot in one scene; holds the placed boxes, so that nothing is allocated per test.
#[derive(Debug, Clone)]
pub struct CollisionChecker<'m> {
    pub(super) model: &'m RobotModel,
    pub(super) scene: &'m Scene,
    pub(super) pairs: Vec<Pair>,
    placed: Vec<Obb>,
    ball: Vector3<f64>,
    /// Distance that a motion keeps, m.
    pub(super) keeps_m: f64,
}

impl<'m> CollisionChecker<'m> {
    /// Checker for a robot in a scene.
    #[must_use]
    pub fn new(model: &'m RobotModel, scene: &'m Scene) -> Self {
        let collision = model.collision();
        let placed = collision.boxes().iter().map(|b| Obb::new(b.x_lb, b.half_m)).collect();
        Self { model, scene, pairs: all_pairs(model, scene), placed, ball: Vector3::zeros(), keeps_m: 0.0 }
    }

    /// Sets the distance below which a motion counts as in contact, m; it does not apply to single configurations.
    #[must_use]
    pub fn keeping(mut self, distance_m: f64) -> Self {
        self.keeps_m = distance_m;
        self
    }

    /// What is around the arm.
    #[must_use]
    pub fn scene(&self) -> &'m Scene {
        self.scene
    }

    /// Places all boxes for a configuration; the base stays where it is.
    pub(super) fn place(&mut self, frames: &Frames) {
        for (placed, body) in self.placed.iter_mut().zip(self.model.collision().boxes()) {
            if let Some(i) = body.link.checked_sub(1) {
                placed.pose = frames.x_w[i] * body.x_lb;
            }
        }
        self.ball = self.model.ball(frames).pos;
    }

    /// Whether any tested pair of bodies overlaps or touches.
    pub fn collides(&mut self, frames: &Frames) -> bool {
        self.first_contact(frames).is_some()
    }

    /// The first pair that overlaps or touches, in the order of the pairs.
    pub fn first_contact(&mut self, frames: &Frames) -> Option<(Body, Body)> {
        self.place(frames);
        self.pairs.iter().find(|pair| self.touch(pair)).map(|pair| (pair.a, pair.b))
    }

    /// The nearest tested pair with its exact distance.
    ///
    /// Infinite distance if nothing is tested (a robot without boxes).
    pub fn clearance(&mut self, frames: &Frames) -> Clearance {
        self.nearest_pair(frames, f64::INFINITY).map_or_else(Clearance::none, |(pair, near)| Clearance {
            distance_m: near.distance_m,
            a: pair.a,
            b: pair.b,
        })
    }

    /// Distance of the nearest pair, or `most_m` if that is less; cheaper than [`Self::clearance`] if no pair is near.
    pub fn distance_up_to(&mut self, frames: &Frames, most_m: f64) -> f64 {
        self.nearest_pair(frames, most_m).map_or(most_m, |(_, near)| near.distance_m)
    }

    /// The nearest pair, if it is nearer than `so_far`.
    fn nearest_pair(&mut self, frames: &Frames, mut so_far: f64) -> Option<(Pair, Proximity)> {
        self.place(frames);
        let mut nearest: Option<(Pair, Proximity)> = None;
        // Start with the pair of the nearest spheres: a small first distance excludes most of the other pairs, by
        // their spheres first and by their separating axes second.
        let first = self.nearest_spheres();
        for k in first.into_iter().chain(0..self.pairs.len()) {
            let pair = &self.pairs[k];
            if self.sphere_gap(pair) < so_far && self.separation(pair) < so_far {
                let near = self.proximity(pair);
                if near.distance_m < so_far {
                    so_far = near.distance_m;
                    nearest = Some((*pair, near));
                }
            }
        }
        nearest
    }

    fn nearest_spheres(&self) -> Option<usize> {
        let gaps = self.pairs.iter().map(|pair| self.sphere_gap(pair)).enumerate();
        gaps.filter(|(_, gap)| gap.is_finite()).min_by(|a, b| a.1.total_cmp(&b.1)).map(|(k, _)| k)
    }

    /// The box of the arm nearest to a ball in flight with its centre at `center_w`.
    ///
    /// All boxes count, also base and hand: after the release the ball must stay clear of the hand too.
    pub fn ball_clearance(&mut self, frames: &Frames, center_w: &Vector3<f64>) -> Clearance {
        self.place(frames);
        let radius_m = self.model.gripper().ball_radius_m;
        let mut nearest = Clearance::none();
        for (k, placed) in self.placed.iter().enumerate() {
            let distance_m = placed.proximity_to_sphere(center_w, radius_m).distance_m;
            nearest.consider(distance_m, Body::Box(k), Body::Ball);
        }
        nearest
    }

    /// Boxes of the last tested configuration in the world, in the order of the robot's list.
    #[must_use]
    pub fn placed_boxes(&self) -> &[Obb] {
        &self.placed
    }

    /// Name of a body for people.
    #[must_use]
    pub fn name(&self, body: Body) -> BodyName<'_> {
        BodyName(match body {
            Body::Box(k) => self.model.collision().boxes().get(k).map_or("unknown box", |b| b.name.as_str()),
            Body::Obstacle(k) => self.scene.obstacles.get(k).map_or("unknown obstacle", |o| o.0.as_str()),
            Body::Floor => "floor",
            Body::Ball => "ball",
        })
    }

    fn obb(&self, body: Body) -> Option<&Obb> {
        match body {
            Body::Box(k) => self.placed.get(k),
            Body::Obstacle(k) => self.scene.obstacles.get(k).map(|o| &o.1),
            Body::Floor | Body::Ball => None,
        }
    }

    fn touch(&self, pair: &Pair) -> bool {
        match (self.obb(pair.a), self.obb(pair.b)) {
            (Some(a), Some(b)) => a.overlaps(b),
            _ => self.proximity(pair).distance_m <= 0.0,
        }
    }

    /// Nearest points of a pair in the placed configuration, from the pair's first body to its second.
    pub(super) fn proximity(&self, pair: &Pair) -> Proximity {
        let floor_z_m = self.model.world().floor_z_m;
        let radius_m = self.model.gripper().ball_radius_m;
        match (self.obb(pair.a), self.obb(pair.b)) {
            (Some(a), Some(b)) => a.proximity(b),
            (Some(a), None) => a.proximity_to_sphere(&self.ball, radius_m),
            (None, Some(b)) => b.proximity_to_floor(floor_z_m),
            (None, None) => {
                let point = self.ball - Vector3::z() * radius_m;
                Proximity { distance_m: point.z - floor_z_m, normal: Vector3::z(), point }
            }
        }
    }

    /// A lower bound of the distance of a pair, positive exactly where the pair is apart.
    pub(super) fn separation(&self, pair: &Pair) -> f64 {
        match (self.obb(pair.a), self.obb(pair.b)) {
            (Some(a), Some(b)) => a.separation(b),
            _ => self.proximity(pair).distance_m,
        }
    }

    /// A cheap lower bound of the distance of a pair.
    pub(super) fn sphere_gap(&self, pair: &Pair) -> f64 {
        match (self.obb(pair.a), self.obb(pair.b)) {
            (Some(a), Some(b)) => (a.pose.pos - b.pose.pos).norm() - a.radius_m() - b.radius_m(),
            _ => f64::NEG_INFINITY,
        }
    }
}

/// Name of a body.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BodyName<'a>(&'a str);

impl fmt::Display for BodyName<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.0)
    }
}

/// Arm against itself by the robot's rule; floor; moving links against obstacles; held ball against everything but
/// the last two links, which hold it or are too near to be distinguished from it.
fn all_pairs(model: &RobotModel, scene: &Scene) -> Vec<Pair> {
    let n = model.n();
    let collision = model.collision();
    let boxes = collision.boxes();
    let of_boxes = collision.pairs().iter().map(|&(a, b)| {
        let (a, b) = (usize::from(a), usize::from(b));
        Pair { a: Body::Box(a), b: Body::Box(b), link_a: boxes[a].link, link_b: boxes[b].link }
    });
    let mut pairs: Vec<Pair> = of_boxes.collect();
    for (k, body) in boxes.iter().enumerate() {
        let link_b = body.link;
        if body.link >= collision.rule().floor_from_link {
            pairs.push(Pair { a: Body::Floor, b: Body::Box(k), link_a: 0, link_b });
        }
        if body.link > 0 {
            let with_obstacles = (0..scene.obstacles.len()).map(|o| Pair {
                a: Body::Obstacle(o),
                b: Body::Box(k),
                link_a: 0,
                link_b,
            });
            pairs.extend(with_obstacles);
        }
        if scene.ball_held && body.link + 1 < n {
            pairs.push(Pair { a: Body::Box(k), b: Body::Ball, link_a: body.link, link_b: n });
        }
    }
    if scene.ball_held {
        pairs.push(Pair { a: Body::Floor, b: Body::Ball, link_a: 0, link_b: n });
        let with_obstacles = (0..scene.obstacles.len()).map(|o| Pair {
            a: Body::Obstacle(o),
            b: Body::Ball,
            link_a: 0,
            link_b: n,
        });
        pairs.extend(with_obstacles);
    }
    pairs
}

/// The pose of a box of the arm in the world, for drawing.
impl RobotModel {
    /// All boxes of the arm in the world for a configuration, in the order of the robot's list.
    ///
    /// Allocates; for reports and pictures.
    #[must_use]
    pub fn boxes_at(&self, frames: &Frames) -> Vec<Obb> {
        let place = |link: usize| if link == 0 { Pose::identity() } else { frames.x_w[link - 1] };
        self.collision().boxes().iter().map(|b| Obb::new(place(b.link) * b.x_lb, b.half_m)).collect()
    }
}
