//! The hand's end effector as planned and as measured, seen flat, and how far the two are apart.

use nalgebra::Vector3;

use super::chart::{Chart, Curve, Pen};
use operator::analysis::tracking::interpolate;
use planner::motion::Motion;
use planner::throw::{Arm, Joints};

/// Axes of the base's frame, two and two.
const PLANES: [([usize; 2], [&str; 2]); 3] =
    [([0, 1], ["x in m", "y in m"]), ([0, 2], ["x in m", "z in m"]), ([1, 2], ["y in m", "z in m"])];

/// Measured joint angles: reference less the interpolated error, which is straighter than the angle.
///
/// `samples` are those of a joint, `error` has the time of one, s, and its error, rad.
pub(super) fn measured<'a, S: 'a>(
    motion: &Motion,
    samples: impl Fn(usize) -> &'a [S],
    error: impl Fn(&S) -> (f64, f64),
    t_s: f64,
) -> Joints {
    let reference = motion.at(t_s).q;
    Joints::from_fn(reference.len(), |j| {
        let samples = samples(j);
        let within = interpolate(samples, t_s, |s| error(s).0, |s| error(s).1);
        // Before the first sample as far off as there, after the last one where that was.
        let before = samples.first().map(&error).filter(|first| t_s < first.0).map(|first| first.1);
        let last = || {
            let last = samples.last().map(&error);
            last.map_or(reference[j], |(t_s, error_rad)| motion.at(t_s).q[j] - error_rad)
        };
        within.or(before).map_or_else(last, |error_rad| reference[j] - error_rad)
    })
}

/// A path of the hand to draw, from 0 to `end_s`.
pub(super) struct Led<'a> {
    pub(super) name: &'a str,
    pub(super) end_s: f64,
    pub(super) planned: &'a dyn Fn(f64) -> Joints,
    pub(super) measured: &'a dyn Fn(f64) -> Joints,
}

/// Places of the hand at the same times, planned and measured, of each path.
pub(super) struct HandPath(Vec<(String, [Vec<Vector3<f64>>; 2])>);

impl HandPath {
    /// At `steps` times of each path.
    pub(super) fn of(arm: &Arm, steps: u32, paths: &[Led<'_>]) -> Self {
        let path = |led: &Led<'_>| {
            let time = |i: u32| led.end_s * f64::from(i) / f64::from(steps);
            let places = |q_at: &dyn Fn(f64) -> Joints| {
                (0..=steps).map(|i| arm.ee_at(&q_at(time(i))).pos).collect::<Vec<_>>()
            };
            (led.name.to_owned(), [led.planned, led.measured].map(places))
        };
        Self(paths.iter().map(path).collect())
    }

    /// Largest distance of the hand from where the plan has it at the same time, m.
    pub(super) fn error_m(&self) -> f64 {
        let places = self.0.iter().flat_map(|(_, [planned, measured])| planned.iter().zip(measured));
        places.map(|(p, m)| (p - m).norm()).fold(0.0, f64::max)
    }

    /// The path in planes of the base's axes, the one in which it extends most first.
    pub(super) fn seen_flat(&self) -> [Chart; 3] {
        let extent = |axis: usize| {
            let values = || self.0.iter().flat_map(|(_, [planned, _])| planned).map(|p| p[axis]);
            values().fold(f64::NEG_INFINITY, f64::max) - values().fold(f64::INFINITY, f64::min)
        };
        let area = |([a, b], _): &([usize; 2], [&str; 2])| extent(*a).max(1e-3) * extent(*b).max(1e-3);
        let mut planes = PLANES;
        planes.sort_by(|one, other| area(other).total_cmp(&area(one)));
        planes.map(|([a, b], [x_label, y_label])| {
            let flat = |path: &[Vector3<f64>]| path.iter().map(|p| (p[a], p[b])).collect();
            // All plans first: what was measured is drawn over them.
            let planned = self.0.iter().enumerate().map(|(k, (_, [planned, _]))| {
                Curve::line(if k == 0 { "planned" } else { "" }, 6, flat(planned)).drawn(Pen::Dashed)
            });
            let measured = self.0.iter().enumerate();
            let measured = measured.map(|(k, (name, [_, path]))| Curve::line(name.clone(), k, flat(path)));
            let title = format!("Path of the hand, at most {:.2} mm beside its plan", 1e3 * self.error_m());
            Chart::new(title, x_label, y_label, planned.chain(measured).collect()).equal()
        })
    }
}
