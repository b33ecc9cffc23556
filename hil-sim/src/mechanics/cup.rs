//! Shape of an open cup, and its contacts with a ball.
//!
//! ```text
//!  z ^        mouth plane z = 0; frame C: origin in the middle of the mouth, z outwards
//!    |  U         U   rim, rounded with half the wall's thickness
//!    |  U         U
//!    |  U  R      U   wall: inner radius R, thickness w
//!    |  UUUUUUUUUUU   bottom: inner face at z = -depth
//!    +--------------> rho
//! ```
//!
//! The cup is a solid of revolution, so a contact is found in the half plane (rho, z): wall and bottom are segments
//! thickened by w / 2.

use nalgebra::{Vector2, Vector3};

/// Dimensions, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cup {
    /// Inner radius of mouth and wall.
    pub inner_radius_m: f64,
    /// From the mouth plane to the inner face of the bottom.
    pub depth_m: f64,
    /// Thickness of wall and bottom.
    pub wall_m: f64,
}

/// A place where the ball is in the material.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    /// Unit normal from the material to the ball's centre, in the cup's frame.
    pub normal_c: Vector3<f64>,
    /// How deep the ball is in the material, m, positive.
    pub depth_m: f64,
}

impl Cup {
    /// Contacts with wall (or rim) and bottom of a ball whose centre is at `center_c` in the cup's frame.
    pub fn contacts(&self, center_c: &Vector3<f64>, ball_radius_m: f64) -> [Option<Contact>; 2] {
        let half = 0.5 * self.wall_m;
        let rho = center_c.x.hypot(center_c.y);
        let radial =
            if rho > 1e-12 { Vector3::new(center_c.x / rho, center_c.y / rho, 0.0) } else { Vector3::x() };
        let at = Vector2::new(rho, center_c.z);
        let wall_rho = self.inner_radius_m + half;
        let wall = (Vector2::new(wall_rho, -half), Vector2::new(wall_rho, -self.depth_m - half));
        let bottom_z = -self.depth_m - half;
        let bottom = (Vector2::new(0.0, bottom_z), Vector2::new(wall_rho, bottom_z));
        [wall, bottom].map(|(from, to)| {
            let along = to - from;
            let share = ((at - from).dot(&along) / along.norm_squared()).clamp(0.0, 1.0);
            let off = at - (from + along * share);
            let distance = off.norm();
            let depth_m = ball_radius_m + half - distance;
            (depth_m > 0.0 && distance > 1e-9)
                .then(|| Contact { normal_c: (radial * off.x + Vector3::z() * off.y) / distance, depth_m })
        })
    }

    /// Whether a point is in the cavity, below the mouth plane.
    pub fn contains(&self, point_c: &Vector3<f64>) -> bool {
        point_c.z <= 0.0 && point_c.z >= -self.depth_m && point_c.x.hypot(point_c.y) <= self.inner_radius_m
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CUP: Cup = Cup { inner_radius_m: 0.07, depth_m: 0.08, wall_m: 0.006 };
    const R: f64 = 0.03;

    #[test]
    fn a_ball_in_the_middle_touches_nothing_and_at_wall_bottom_and_rim_it_touches_each() {
        assert_eq!(CUP.contacts(&Vector3::new(0.0, 0.0, -0.04), R), [None, None]);
        let [wall, bottom] = CUP.contacts(&Vector3::new(0.0, 0.042, -0.04), R);
        let wall = wall.unwrap();
        assert!(bottom.is_none() && (wall.depth_m - 0.002).abs() < 1e-12);
        assert!((wall.normal_c + Vector3::y()).norm() < 1e-12);
        let [wall, bottom] = CUP.contacts(&Vector3::new(0.0, 0.0, -0.051), R);
        assert!(wall.is_none() && (bottom.unwrap().depth_m - 0.001).abs() < 1e-12);
        assert!((bottom.unwrap().normal_c - Vector3::z()).norm() < 1e-12);
        // On the rim: 45 degrees above the centre of its rounding.
        let off = (R + 0.003 - 0.001) / 2.0_f64.sqrt();
        let [rim, _] = CUP.contacts(&Vector3::new(0.073 - off, 0.0, -0.003 + off), R);
        let rim = rim.unwrap();
        assert!((rim.depth_m - 0.001).abs() < 1e-12);
        assert!((rim.normal_c - Vector3::new(-1.0, 0.0, 1.0).normalize()).norm() < 1e-12);
    }

    #[test]
    fn the_wall_is_solid_from_outside_too() {
        let [wall, _] = CUP.contacts(&Vector3::new(0.105, 0.0, -0.04), R);
        assert!((wall.unwrap().normal_c - Vector3::x()).norm() < 1e-12);
        assert!(!CUP.contains(&Vector3::new(0.105, 0.0, -0.04)));
        assert!(CUP.contains(&Vector3::new(0.0, 0.05, -0.01)));
        assert!(!CUP.contains(&Vector3::new(0.0, 0.0, 0.001)));
    }
}
