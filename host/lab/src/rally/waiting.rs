//! Where the catcher waits: one pose for all throws of a kind, found by a search.
//!
//! A pose is worth the mean probability of the catches that are found from it when the arm learns of them: 70 ms after the release for an arm that
//! sees the ball only, 0.3 s before it for a partner that knows the plan. Where the motions leave much of the accelerations, the arm may
//! learn later: that is worth a little more. The search climbs from given poses: it changes all joints at random, less and less, and
//! keeps what is not worse.

use operator::ball_catch::trial::{Pair, TrialOptions, WAIT_HOLD_DEG, WAIT_MATCHED_DEG};
use planner::catch::Joints;
use planner::catch::draw::Aimed;
use planner::plan::rng::SplitMix64;
use rayon::prelude::*;

use super::throws::reached_from;

/// When the arm learns of a throw, s after its release: alone, as a partner.
const LEARNS_S: (f64, f64) = (0.07, -0.3);
/// Poses that are tried, and the standard deviation of their changes at first and at last, rad.
const TRIES: usize = 160;
const CHANGE_RAD: (f64, f64) = (0.6, 0.05);

/// What the accelerations that a motion leaves are worth, of what the catch is worth.
const SPARE_WORTH: f64 = 0.1;

/// A waiting pose, and what it is worth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wait {
    /// Joint angles, rad.
    pub q_rad: Joints,
    /// Of each throw 0 if it cannot be caught from there, else its probability times 1 to 1.1; the mean.
    worth: f64,
}

/// The best waiting pose that the search finds for these throws; at least as good as that of `options` and the built-in ones. The same
/// arguments give the same pose.
pub fn find_wait(pair: &Pair, options: &TrialOptions, throws: &[Aimed], seed: u64) -> Wait {
    let worth = |q: &Joints| worth(pair, options, throws, q);
    let given = [WAIT_MATCHED_DEG, WAIT_HOLD_DEG].map(|deg| Joints::from(deg.map(f64::to_radians)));
    let mut best = Wait { q_rad: options.wait, worth: worth(&options.wait) };
    for q_rad in given {
        let worth = worth(&q_rad);
        if worth > best.worth {
            best = Wait { q_rad, worth };
        }
    }
    let joints = pair.catcher(options.jerk).model().joints();
    let mut rng = SplitMix64::stream(seed, 0x0077_6169_7400);
    for k in 0..TRIES {
        let sigma = CHANGE_RAD.0 * (CHANGE_RAD.1 / CHANGE_RAD.0).powf(k as f64 / TRIES as f64);
        let q_rad = Joints::from_fn(6, |i| {
            let limits = &joints[i].limits;
            // The roll about the cup's axis changes nothing.
            let change = if i == 5 { 0.0 } else { sigma * rng.normal() };
            (best.q_rad[i] + change).clamp(limits.q_min_rad + 0.05, limits.q_max_rad - 0.05)
        });
        let worth = worth(&q_rad);
        if worth >= best.worth {
            best = Wait { q_rad, worth };
        }
    }
    best
}

fn worth(pair: &Pair, options: &TrialOptions, throws: &[Aimed], q: &Joints) -> f64 {
    let known_s = if options.cooperative { LEARNS_S.1 } else { LEARNS_S.0 };
    let of_each = throws.par_iter().map(|aimed| {
        let reached = reached_from(pair, aimed, options, q, known_s);
        reached.map_or(0.0, |(probability, used)| probability * (1.0 + SPARE_WORTH * (1.0 - used)))
    });
    // In the order of the throws: the sum does not depend on the threads.
    of_each.collect::<Vec<f64>>().iter().sum::<f64>() / throws.len().max(1) as f64
}
