//! Aerodynamic coefficients of a flying disc and its body.
//!
//! Source of the coefficients: J. R. Potts and W. J. Crowther, "Frisbee Aerodynamics", AIAA 2002-3150 (wind tunnel,
//! angle of attack -10° to 30°), as tabulated in S. A. Hummel, "Frisbee Flight Simulation and Throw Biomechanics",
//! MSc thesis, University of California Davis, 2003. Body and damping of the standard disc (0.175 kg, 0.2694 m) are from
//! the same thesis (long flight f2302).
//!
//! Chosen here, without a source: beyond -10° and 30° the normal and axial force coefficients go linearly in the angle
//! to those of a flat disc across the stream (1.17 and 0; S. F. Hoerner, "Fluid-Dynamic Drag", 1965), and the pitching
//! moment goes to 0. The rolling moment that spin causes is left out. The disc of paper 001 has no mass: it is the standard
//! disc scaled to its radius at equal mass per area.

use std::f64::consts::{FRAC_PI_2, PI};

/// Air density of the source, kg/m³.
pub(crate) const AIR_KG_M3: f64 = 1.23;
/// Normal force coefficient of a flat disc across the stream (Hoerner).
pub const ACROSS: f64 = 1.17;

/// Lift and drag by angle of attack: degrees, CL, CD.
const FORCES: [(f64, f64, f64); 9] = [
    (-10.0, -0.225, 0.150),
    (-3.0, 0.0, 0.080),
    (0.0, 0.150, 0.100),
    (5.0, 0.450, 0.150),
    (10.0, 0.725, 0.260),
    (15.0, 0.975, 0.390),
    (20.0, 1.200, 0.570),
    (25.0, 1.450, 0.750),
    (30.0, 1.675, 0.920),
];

/// Pitching moment by angle of attack: degrees, CM (nose up positive, reference length is the diameter).
const MOMENT: [(f64, f64); 13] = [
    (-10.0, -0.038),
    (-5.0, -0.022),
    (-3.0, -0.014),
    (0.0, -0.006),
    (3.0, -0.006),
    (6.0, -0.002),
    (9.0, 0.0),
    (12.0, 0.010),
    (15.0, 0.022),
    (20.0, 0.044),
    (23.0, 0.060),
    (26.0, 0.084),
    (30.0, 0.110),
];

/// Force and moment coefficients at an angle of attack.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Coefficients {
    /// Lift, across the stream, towards the upper side.
    pub lift: f64,
    /// Drag, along the stream.
    pub drag: f64,
    /// Pitching moment, nose up.
    pub pitch: f64,
}

fn between(x: f64, (x0, y0): (f64, f64), (x1, y1): (f64, f64)) -> f64 {
    y0 + (y1 - y0) * (x - x0) / (x1 - x0)
}

fn interpolated(table: impl Iterator<Item = (f64, f64)> + Clone, x: f64) -> f64 {
    let pairs = table.clone().zip(table.skip(1));
    pairs.filter(|(low, _)| low.0 <= x).last().map_or(0.0, |(low, high)| between(x, low, high))
}

/// Coefficients at an angle of attack in [-π/2, π/2]; positive where the stream meets the lower side.
#[must_use]
pub fn coefficients(alpha_rad: f64) -> Coefficients {
    let degrees = alpha_rad.to_degrees();
    let (first, last) = (FORCES[0].0, FORCES[FORCES.len() - 1].0);
    let edge = degrees.clamp(first, last);
    let lift = interpolated(FORCES.iter().map(|f| (f.0, f.1)), edge);
    let drag = interpolated(FORCES.iter().map(|f| (f.0, f.2)), edge);
    let pitch = interpolated(MOMENT.iter().copied(), edge);
    if degrees == edge {
        return Coefficients { lift, drag, pitch };
    }
    let (s, c) = edge.to_radians().sin_cos();
    let (normal, axial) = (lift * c + drag * s, drag * c - lift * s);
    let across = FRAC_PI_2.copysign(alpha_rad).to_degrees();
    let normal = between(degrees, (edge, normal), (across, ACROSS.copysign(alpha_rad)));
    let axial = between(degrees, (edge, axial), (across, 0.0));
    let (s, c) = alpha_rad.sin_cos();
    Coefficients {
        lift: normal * c - axial * s,
        drag: normal * s + axial * c,
        pitch: between(degrees, (edge, pitch), (across, 0.0)),
    }
}

/// The body of a disc.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Body {
    pub radius_m: f64,
    /// Half of its height, m.
    pub half_height_m: f64,
    pub mass_kg: f64,
    /// Moment of inertia about the axis of symmetry, kg·m².
    pub about_axis_kg_m2: f64,
    /// Moment of inertia about a diameter, kg·m².
    pub about_diameter_kg_m2: f64,
    /// Damping of pitch and roll: moment coefficient per rad/s (mean of the published -0.0144 and -0.0125).
    pub damping_s: f64,
    /// Damping of the spin: moment coefficient per rad/s.
    pub spin_damping_s: f64,
}

impl Body {
    /// The standard disc of the source.
    #[must_use]
    pub fn standard() -> Self {
        Self {
            radius_m: (0.057 / PI).sqrt(),
            half_height_m: 0.016,
            mass_kg: 0.175,
            about_axis_kg_m2: 0.002_352,
            about_diameter_kg_m2: 0.001_219,
            damping_s: -0.013_45,
            spin_damping_s: -3.41e-5,
        }
    }

    /// The disc of paper 001: radius 10 cm, height 1 cm; mass and inertia scaled from the standard disc.
    #[must_use]
    pub fn of_paper() -> Self {
        let standard = Self::standard();
        let radius_m = 0.10;
        let size2 = (radius_m / standard.radius_m).powi(2);
        Self {
            radius_m,
            half_height_m: 0.005,
            mass_kg: standard.mass_kg * size2,
            about_axis_kg_m2: standard.about_axis_kg_m2 * size2 * size2,
            about_diameter_kg_m2: standard.about_diameter_kg_m2 * size2 * size2,
            ..standard
        }
    }

    #[must_use]
    pub(crate) fn area_m2(&self) -> f64 {
        PI * self.radius_m * self.radius_m
    }

    /// Speed at which a disc that falls flat side down falls steadily, m/s.
    #[must_use]
    pub fn terminal_speed_m_s(&self, gravity_m_s2: f64) -> f64 {
        (2.0 * self.mass_kg * gravity_m_s2 / (AIR_KG_M3 * self.area_m2() * ACROSS)).sqrt()
    }
}
