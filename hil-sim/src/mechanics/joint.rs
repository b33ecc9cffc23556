//! Parts of one joint besides the rigid body: rotor, friction, brake, end stops, elastic gear.

/// Torsion between gear and link.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Elasticity {
    /// Stiffness, N·m/rad.
    pub stiffness_nm_rad: f64,
    /// Damping, N·m·s/rad.
    pub damping_nms_rad: f64,
}

/// One joint; all values at the joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointMechanics {
    /// Inertia of rotor and gear at the joint, kg·m²; positive.
    pub rotor_kg_m2: f64,
    /// Coulomb friction, N·m.
    pub coulomb_nm: f64,
    /// Viscous friction, N·m·s/rad.
    pub viscous_nms_rad: f64,
    /// Torque that the closed brake holds, N·m.
    pub brake_nm: f64,
    /// End stops, rad.
    pub stop_min_rad: f64,
    /// Upper end stop, rad.
    pub stop_max_rad: f64,
    /// Stiffness of the end stops, N·m/rad.
    pub stop_stiffness_nm_rad: f64,
    /// Damping of the end stops, N·m·s/rad.
    pub stop_damping_nms_rad: f64,
    /// Elasticity of the gear; `None` for a stiff one.
    pub elasticity: Option<Elasticity>,
}

impl JointMechanics {
    /// No friction, no stops, stiff gear: for closed forms.
    pub fn ideal(rotor_kg_m2: f64) -> Self {
        Self {
            rotor_kg_m2,
            coulomb_nm: 0.0,
            viscous_nms_rad: 0.0,
            brake_nm: 0.0,
            stop_min_rad: f64::NEG_INFINITY,
            stop_max_rad: f64::INFINITY,
            stop_stiffness_nm_rad: 0.0,
            stop_damping_nms_rad: 0.0,
            elasticity: None,
        }
    }
}
