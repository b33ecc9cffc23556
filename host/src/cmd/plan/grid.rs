//! Grids of targets.

use planner::plan::problem::short;

/// Values along one axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Axis {
    from: f64,
    to: f64,
    step: f64,
}

impl Axis {
    fn count(&self) -> u64 {
        // At most 10001: it was looked at when the axis was read.
        ((self.to - self.from) / self.step + 1e-9).floor() as u64 + 1
    }

    fn value(&self, at: u64) -> f64 {
        // Rounded, so that the same target has the same name in every run.
        ((self.from + at as f64 * self.step) * 1e6).round() / 1e6
    }

    /// From `FROM,TO,STEP`.
    ///
    /// # Errors
    /// Not three numbers, a range that ends before it begins, or more than 10000 steps.
    pub fn read(text: &str) -> Result<Self, String> {
        let p: Vec<f64> = text
            .split(',')
            .map(|p| p.trim().parse().map_err(|_| format!("\"{p}\" is not a number")))
            .collect::<Result<_, _>>()?;
        let [from, to, step] = p[..] else { return Err("expected FROM,TO,STEP".to_owned()) };
        let sensible = from.is_finite() && to >= from && step > 0.0 && (to - from) / step <= 1e4;
        if sensible {
            Ok(Self { from, to, step })
        } else {
            let [from, to, step] = [from, to, step].map(short);
            Err(format!("range from {from} to {to} in steps of {step}"))
        }
    }
}

/// A grid: x changes first, then y, then z.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grid {
    pub x: Axis,
    pub y: Axis,
    pub z: Axis,
}

impl Grid {
    /// Number of targets.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.x.count() * self.y.count() * self.z.count()
    }

    /// Target `number`, from 0, in m.
    #[must_use]
    pub fn target(&self, number: u64) -> [f64; 3] {
        let (nx, ny) = (self.x.count(), self.y.count());
        [self.x.value(number % nx), self.y.value(number / nx % ny), self.z.value(number / nx / ny)]
    }

    /// All targets in order, in m.
    pub fn targets(&self) -> impl Iterator<Item = [f64; 3]> + '_ {
        (0..self.count()).map(|number| self.target(number))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_grid_has_its_targets_in_order_with_round_numbers() {
        let axis = |text| Axis::read(text).unwrap();
        let grid = Grid { x: axis("0.1,0.3,0.1"), y: axis("0,0,1"), z: axis("-1,1,2") };
        let expected = [
            [0.1, 0.0, -1.0],
            [0.2, 0.0, -1.0],
            [0.3, 0.0, -1.0],
            [0.1, 0.0, 1.0],
            [0.2, 0.0, 1.0],
            [0.3, 0.0, 1.0],
        ];
        assert_eq!(grid.targets().collect::<Vec<_>>(), expected);
        for refused in ["1,2", "2,1,1", "0,1,0", "0,1,1e-9", "nan,1,1", "a,1,1"] {
            assert!(Axis::read(refused).is_err(), "{refused}");
        }
    }
}
