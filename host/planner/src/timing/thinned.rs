//! The same motion with fewer knots.
//!
//! A path of many short pieces gives a motion with knots for each of them, although one cubic could follow several
//! pieces. From each knot the cubic goes to the last one with which it stays near the motion and within the limits.

use super::{At, Limits, motion_of, padded, use_of_cubics};
use crate::motion::Motion;

/// Places of each cubic of the motion at which the distance is looked at, as shares of its duration.
const LOOKS: [f64; 3] = [0.25, 0.5, 0.75];

/// The motion with fewer knots, at most `off_rad` (each joint) beside it; its cubics use no more of the limits than it did, or all of
/// them.
#[must_use]
pub fn thinned(motion: &Motion, limits: &Limits, off_rad: f64) -> Motion {
    let all: Vec<At> = motion.knots.iter().map(at).collect();
    let used = use_of_cubics(&all, limits).stretch().max(1.0);
    let fits = |from: usize, to: usize| {
        let pair = [all[from], all[to]];
        let cubic = motion_of(&pair, limits.n);
        use_of_cubics(&pair, limits).stretch() <= used
            && motion.knots[from..=to].windows(2).all(|knots| {
                let h = knots[1].t_s - knots[0].t_s;
                LOOKS.iter().chain(&[1.0]).all(|share| {
                    let t_s = knots[0].t_s + share * h;
                    (cubic.at(t_s).q - motion.at(t_s).q).amax() <= off_rad
                })
            })
    };
    let mut kept = vec![0];
    while let Some(&from) = kept.last().filter(|from| **from + 1 < all.len()) {
        // Double the distance until it does not fit, then halve the rest.
        let (mut good, mut step) = (from + 1, 1);
        while step > 0 {
            let next = (good + step).min(all.len() - 1);
            if next > good && fits(from, next) {
                (good, step) = (next, 2 * step);
            } else {
                step /= 2;
            }
        }
        kept.push(good);
    }
    Motion { knots: kept.into_iter().map(|k| motion.knots[k]).collect(), events: motion.events.clone() }
}

fn at(knot: &crate::motion::Knot) -> At {
    At { t_s: knot.t_s, q: padded(knot.q_rad.as_slice()), qd: padded(knot.qd_rad_s.as_slice()) }
}
