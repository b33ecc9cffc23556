//! The hand's end effector as planned and as measured, seen flat, and how far the two are apart.

use nalgebra::Vector3;

use super::super::chart::{Chart, Curve, Pen};
use super::RunReport;

/// Points of a path.
const STEPS: u32 = 400;

/// Axes of the base's frame: the two along which a path extends most.
const PLANES: [([usize; 2], [&str; 2]); 3] =
    [([0, 1], ["x in m", "y in m"]), ([0, 2], ["x in m", "z in m"]), ([1, 2], ["y in m", "z in m"])];

impl RunReport<'_> {
    fn hand_at(&self, t_s: f64) -> Vector3<f64> {
        self.arm.ee_at(&self.ran.motion.at(t_s).q).pos
    }

    fn hand_measured_at(&self, t_s: f64) -> Vector3<f64> {
        self.arm.ee_at(&self.q_at(t_s)).pos
    }

    fn times(&self) -> impl Iterator<Item = f64> {
        let end_s = self.ran.end_s();
        (0..=STEPS).map(move |i| end_s * f64::from(i) / f64::from(STEPS))
    }

    /// Largest distance of the hand from where the plan has it at the same time, m.
    pub(super) fn hand_error_m(&self) -> f64 {
        self.times().map(|t_s| (self.hand_at(t_s) - self.hand_measured_at(t_s)).norm()).fold(0.0, f64::max)
    }

    /// The path of the hand in the plane of the base's axes in which it extends most.
    pub(super) fn hand_seen_flat(&self) -> Chart {
        let planned: Vec<Vector3<f64>> = self.times().map(|t_s| self.hand_at(t_s)).collect();
        let measured: Vec<Vector3<f64>> = self.times().map(|t_s| self.hand_measured_at(t_s)).collect();
        let extent = |axis: usize| {
            let values = || planned.iter().map(|p| p[axis]);
            values().fold(f64::NEG_INFINITY, f64::max) - values().fold(f64::INFINITY, f64::min)
        };
        let area = |([a, b], _): &([usize; 2], [&str; 2])| extent(*a).max(1e-3) * extent(*b).max(1e-3);
        let ([a, b], [x_label, y_label]) =
            PLANES.into_iter().max_by(|one, other| area(one).total_cmp(&area(other))).unwrap_or(PLANES[0]);
        let flat = |path: &[Vector3<f64>]| path.iter().map(|p| (p[a], p[b])).collect();
        Chart {
            title: format!("Path of the hand, at most {:.2} mm beside its plan", 1e3 * self.hand_error_m()),
            x_label: x_label.to_owned(),
            y_label: y_label.to_owned(),
            curves: vec![
                Curve::line("planned", 6, flat(&planned)).drawn(Pen::Dashed),
                Curve::line("measured", 0, flat(&measured)),
            ],
            equal: true,
            ..Chart::default()
        }
    }
}
