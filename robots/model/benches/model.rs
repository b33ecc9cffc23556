//! Cost of the operations of the planner's inner loop: `cargo bench -p robot-model`.
//!
//! Prints the median and the smallest over batches, in ns per call, over the same seeded random configurations for all
//! operations; compare figures of one run only, and the smallest ones if the machine is shared. A reference loop (sine and cosine of six angles) shows the machine's speed.

use std::hint::black_box;
use std::time::Instant;

use rand_xoshiro::SplitMix64;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use robot_model::collision::{CollisionChecker, Scene, StraightMove};
use robot_model::jacobian::joint_rates;
use robot_model::{JointVec, RobotModel};

const CONFIGURATIONS: usize = 256;
const BATCHES: usize = 201;

struct Seeded(SplitMix64);

impl Seeded {
    fn uniform(&mut self) -> f64 {
        self.0.next_u64() as f64 / u64::MAX as f64
    }
}

/// Median ns per call over the configurations; each batch calls `op` once per configuration.
fn bench<T>(name: &str, mut op: impl FnMut(usize) -> T) {
    let mut per_call_ns: Vec<f64> = (0..BATCHES)
        .map(|_| {
            let start = Instant::now();
            for k in 0..CONFIGURATIONS {
                black_box(op(k));
            }
            start.elapsed().as_nanos() as f64 / CONFIGURATIONS as f64
        })
        .collect();
    per_call_ns.sort_by(f64::total_cmp);
    println!("{name:<58} {:>9.0} {:>9.0}", per_call_ns[BATCHES / 2], per_call_ns[0]);
}

fn main() {
    let arm: RobotModel = RobotModel::load("powercube6").expect("the built-in robot loads");
    let mut rng = Seeded(SplitMix64::seed_from_u64(1));
    let (min, max) = (arm.q_min(), arm.q_max());
    let mut vector =
        |low: JointVec, high: JointVec| JointVec::from_fn(6, |i| low[i] + rng.uniform() * (high[i] - low[i]));
    let q: Vec<_> = (0..CONFIGURATIONS).map(|_| vector(min, max)).collect();
    let qd: Vec<_> =
        (0..CONFIGURATIONS).map(|_| vector(JointVec::repeat(6, -2.0), JointVec::repeat(6, 2.0))).collect();
    let qdd: Vec<_> =
        (0..CONFIGURATIONS).map(|_| vector(JointVec::repeat(6, -9.0), JointVec::repeat(6, 9.0))).collect();
    let frames: Vec<_> = q.iter().map(|q| arm.fk(q)).collect();
    let ball: Vec<_> = frames.iter().map(|f| arm.ball(f).pos).collect();
    let jacobians: Vec<_> = frames.iter().zip(&ball).map(|(f, p)| f.jacobian(p)).collect();
    let poses: Vec<_> = frames.iter().map(|f| arm.ee(f)).collect();
    let tau: Vec<_> = (0..CONFIGURATIONS).map(|k| arm.inverse_dynamics(&q[k], &qd[k], &qdd[k])).collect();

    println!("{} with {} boxes, {BATCHES} batches", arm.name(), arm.collision().boxes().len());
    println!("{:<58} {:>9} {:>9}", "ns per call", "median", "smallest");
    bench("reference: sine and cosine of six angles", |k| q[k].map(|v| v.sin() + v.cos()));
    println!("-- kinematics");
    bench("forward kinematics, all frames", |k| arm.fk(&q[k]));
    bench("Jacobian at the ball", |k| frames[k].jacobian(&ball[k]));
    bench("J̇ q̇", |k| frames[k].bias_acceleration(&jacobians[k], &qd[k]));
    bench("∂(J q̇)/∂q", |k| frames[k].twist_gradient(&jacobians[k], &qd[k]));
    bench("q̇ = J⁻¹ V", |k| joint_rates(&jacobians[k], &(jacobians[k] * qd[k])));
    bench("inverse kinematics, all branches with ranges", |k| arm.ik(&poses[k]));
    println!("-- dynamics");
    bench("gravity torques", |k| arm.gravity_torques(&q[k]));
    bench("inverse dynamics (RNEA)", |k| arm.inverse_dynamics(&q[k], &qd[k], &qdd[k]));
    bench("inverse dynamics with ∂τ/∂q, ∂τ/∂q̇ and M", |k| {
        arm.inverse_dynamics_gradient(&q[k], &qd[k], &qdd[k])
    });
    bench("the same from known frames", |k| arm.inverse_dynamics_gradient_at(&frames[k], &qd[k], &qdd[k]));
    bench("mass matrix", |k| arm.mass_matrix(&q[k]));
    bench("forward dynamics", |k| arm.forward_dynamics(&q[k], &qd[k], &tau[k]));
    println!("-- collision");
    let boxes: Vec<_> = frames.iter().map(|f| arm.boxes_at(f)).collect();
    let pairs = arm.collision().pairs();
    let pair = |k: usize| {
        let (a, b) = pairs[k % pairs.len()];
        (&boxes[k][usize::from(a)], &boxes[k][usize::from(b)])
    };
    bench("two boxes overlap", |k| pair(k).0.overlaps(pair(k).1));
    bench("distance of two boxes", |k| pair(k).0.proximity(pair(k).1));
    let scene = Scene::default();
    let mut checker = CollisionChecker::new(&arm, &scene);
    bench("whole arm: any contact", |k| checker.collides(&frames[k]));
    bench("whole arm: exact clearance", |k| checker.clearance(&frames[k]));
    let free: Vec<usize> = (0..CONFIGURATIONS).filter(|k| !checker.collides(&frames[*k])).collect();
    bench("whole arm: any contact, free configurations", |k| checker.collides(&frames[free[k % free.len()]]));
    let motions: Vec<_> =
        free.iter().map(|k| StraightMove { from: q[*k], to: q[*k] + qd[*k] * 0.3 }).collect();
    bench("motion of 0.3 s checked between samples too", |k| {
        checker.check_motion(&motions[k % motions.len()], 0.0, 1.0, 1e-4)
    });
}
