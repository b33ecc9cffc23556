//! Motor and supply currents: eq. (7) to (9) of the throwing paper.

use crate::model::RobotModel;
use crate::per_joint::JointVec;

impl RobotModel {
    /// Motor currents in A for joint speeds in rad/s and torques in N·m: `I = K_B |q̇| + K_M |τ|`, eq. (9).
    ///
    /// `None` if the robot file describes no drives.
    #[must_use]
    pub fn motor_currents(&self, qd: &JointVec, tau: &JointVec) -> Option<JointVec> {
        let drives = self.drives()?;
        Some(JointVec::from_fn(self.n(), |i| {
            drives[i].k_b_a_s_rad * qd[i].abs() + drives[i].k_m_a_nm * tau[i].abs()
        }))
    }

    /// Load of each supply in A, in the order of [`RobotModel::supplies`], for motor currents in A: eq. (8).
    pub fn supply_currents<'a>(&'a self, motor_a: &'a JointVec) -> impl Iterator<Item = f64> + 'a {
        self.supplies
            .iter()
            .map(|s| s.feeds.iter().zip(motor_a.iter()).filter(|(feeds, _)| **feeds).map(|(_, i)| *i).sum())
    }
}
