//! The two-link arm in a plane that most families contain, with angles as complex numbers.
//!
//! Directions in the plane are measured from z towards x, so a point (x, z) is the complex number z + i x.

/// cos + i sin of an angle, or any vector of the plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Complex {
    pub(super) re: f64,
    pub(super) im: f64,
}

impl Complex {
    pub(super) fn new(re: f64, im: f64) -> Self {
        Self { re, im }
    }

    pub(super) fn turn(angle_rad: f64) -> Self {
        let (s, c) = angle_rad.sin_cos();
        Self::new(c, s)
    }

    pub(super) fn times(self, o: Self) -> Self {
        Self::new(self.re * o.re - self.im * o.im, self.re * o.im + self.im * o.re)
    }

    pub(super) fn conj(self) -> Self {
        Self::new(self.re, -self.im)
    }

    pub(super) fn norm(self) -> f64 {
        (self.re * self.re + self.im * self.im).sqrt()
    }

    /// Same direction, `norm` times shorter.
    pub(super) fn unit(self, norm: f64) -> Self {
        let s = 1.0 / norm;
        Self::new(self.re * s, self.im * s)
    }

    pub(super) fn angle(self) -> f64 {
        self.im.atan2(self.re)
    }
}

/// Tolerance of a cosine at the edge of the reach: a pose computed from joint angles with a stretched elbow must be
/// found again although rounding puts it 1e-16 outside.
pub(super) const EDGE_SLACK: f64 = 1e-12;
/// A point this close to a free axis (relative to the arm's reach) leaves that axis' angle undefined.
pub(super) const ON_AXIS: f64 = 1e-12;

/// Two links in a plane: lengths in m.
#[derive(Debug, Clone, Copy)]
pub(super) struct TwoLinks {
    pub(super) upper_m: f64,
    pub(super) fore_m: f64,
}

/// Angles that bring the end of the fore link to a target.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bend {
    /// Direction of the upper link.
    pub(super) upper: Complex,
    /// Direction of the fore link seen from the upper one.
    pub(super) elbow: Complex,
    /// The same as an angle in (-π, π].
    pub(super) elbow_rad: f64,
}

impl TwoLinks {
    /// How far inside the reach a target is, in m; negative outside.
    pub(super) fn margin_m(&self, target: Complex) -> f64 {
        let distance = target.norm();
        (self.upper_m + self.fore_m - distance).min(distance - (self.upper_m - self.fore_m).abs())
    }

    /// Whether the target is on the axis of the upper link, which is then free.
    pub(super) fn is_free(&self, target: Complex) -> bool {
        target.norm() <= ON_AXIS * (self.upper_m + self.fore_m)
    }

    /// Both bends, positive elbow first; `None` out of reach. A free upper link takes the direction `free_rad`.
    pub(super) fn bends(&self, target: Complex, free_rad: f64) -> Option<[Bend; 2]> {
        let (a, b) = (self.upper_m, self.fore_m);
        let distance = target.norm();
        let cosine = (distance * distance - a * a - b * b) / (2.0 * a * b);
        // False for NaN, too.
        let in_reach = cosine.abs() <= 1.0 + EDGE_SLACK;
        if !in_reach {
            return None;
        }
        let cosine = cosine.clamp(-1.0, 1.0);
        let sine = (1.0 - cosine * cosine).sqrt();
        let elbow_rad = sine.atan2(cosine);
        let free = self.is_free(target);
        Some([1.0, -1.0].map(|sign| {
            let elbow = Complex::new(cosine, sign * sine);
            let upper = if free {
                Complex::turn(free_rad)
            } else {
                let v = target.times(Complex::new(a + b * elbow.re, b * elbow.im).conj());
                v.unit(v.norm())
            };
            Bend { upper, elbow, elbow_rad: sign * elbow_rad }
        }))
    }
}
