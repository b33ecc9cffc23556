//! ODrives that speak CANSimple.

use std::f64::consts::TAU;

use firmware::groups::odrive::{Axis, Endpoints, GripperAxis, Home, Odrive, Options};
use protocol::odrive::{Order, Report, Request};
use protocol::{Frame, Instant};
use robot_model::{Joint, OdriveAxes, OdriveAxis, OdriveEndpoints, RobotModel};

use super::ahead::model_of;
use super::{CanDrives, Family, JointRad, Measured, Seen, alone};

impl Family for OdriveAxes {
    fn group(&self, robot: &RobotModel) -> Result<CanDrives, String> {
        let joints: Vec<Axis> = self.axes.iter().map(axis_of).collect();
        let mut options = Options::new(&joints).and_then(|all| all.with_model(model_of(robot)));
        if let Some(gripper) = self.gripper {
            let gripper = GripperAxis {
                axis: axis_of(&gripper.axis),
                open_rad: gripper.travel.open_rad as f32,
                closed_rad: gripper.travel.closed_rad as f32,
            };
            options = options.and_then(|all| all.with_gripper(gripper));
        }
        let mut options = options.map_err(|error| error.to_string())?;
        if let Some(OdriveEndpoints { firmware, numbers }) = self.endpoints {
            options = options.with_endpoints(Endpoints { firmware, numbers });
        }
        alone(options.ids(), " (ODrives: 1, 2, 4, 9 to 31)")?;
        Ok(CanDrives::Odrive(Odrive::new(options)))
    }

    fn is_order(&self, frame: &Frame) -> bool {
        self.all().any(|axis| {
            let order = Order::decode(frame, axis.version).map(|(node, _)| node);
            let request = Request::decode(frame, axis.version).map(|(node, _)| node);
            order.or(request) == Some(axis.node)
        })
    }

    fn reader<'a>(&'a self, _joints: &'a [Joint]) -> Option<Box<dyn super::Reader + 'a>> {
        Some(Box::new(Reader { axes: &self.axes, read: vec![Read::default(); self.axes.len()] }))
    }
}

fn axis_of(axis: &OdriveAxis) -> Axis {
    Axis {
        node: axis.node,
        version: axis.version,
        gear: axis.gear_ratio as f32,
        home: if axis.is_at_joint { Home::Joint } else { Home::Motor },
        current_max_a: axis.current_max_a as f32,
        position_gain_1_s: axis.position_gain_1_s as f32,
        velocity_gain_nm_s: axis.velocity_gain_nm_s as f32,
        integral_gain_nm: axis.integral_gain_nm as f32,
    }
}

struct Reader<'a> {
    axes: &'a [OdriveAxis],
    read: Vec<Read>,
}

/// What an axis was asked, and what it counts.
#[derive(Clone, Copy, Default)]
struct Read {
    /// End of the last request for estimates.
    asked_at: Option<Instant>,
    /// Last position, of the joint, if whole turns that are counted are right.
    counted_rad: Option<f64>,
    /// Whole turns by which it is wrong, rad: the controller knows the zero.
    shift_rad: f64,
}

impl super::Reader for Reader<'_> {
    /// Estimates of an axis, which hold for the time of the last request.
    fn take(&mut self, Seen { begun, at, frame }: Seen<'_>, joint_rad: JointRad<'_>) -> Option<Measured> {
        for (joint, (axis, read)) in self.axes.iter().zip(&mut self.read).enumerate() {
            if *frame == Request::Estimates.encode(axis.node) {
                read.asked_at = Some(at);
            } else if let Some((node, Report::Estimates { rev, .. })) = Report::decode(frame, axis.version)
                && node == axis.node
            {
                let counted_rad = joint_rad(joint, TAU * f64::from(rev) / axis.counted());
                read.counted_rad = Some(counted_rad).filter(|q_rad| q_rad.is_finite());
                let at = read.asked_at.take().unwrap_or(begun);
                let q_rad = read.counted_rad? + read.shift_rad;
                return Some(Measured { joint, at, q_rad, temperature_c: None });
            }
        }
        None
    }

    /// Finds the whole turns of an axis from the position that the controller reports. Until the report is on the bus, the joint moves by less
    /// than a quarter of such a turn.
    fn align(&mut self, joint: usize, reported_rad: f64) {
        let (Some(axis), Some(read)) = (self.axes.get(joint), self.read.get_mut(joint)) else { return };
        let turn_rad = TAU / axis.counted();
        if let Some(counted_rad) = read.counted_rad {
            let turns = (reported_rad - counted_rad) / turn_rad;
            if (turns - turns.round()).abs() < 0.25 {
                read.shift_rad = turns.round() * turn_rad;
            }
        }
    }
}
