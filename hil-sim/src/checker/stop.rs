//! After a halt the reported position comes to rest in time.

use protocol::powercube::{
    AddressedRequest, Broadcast, MotionPosition, Parameter, Reply, Request, SimpleCommand, Value,
};
use protocol::{Duration, Frame, Instant, ModuleId};

use super::{Checker, Findings};

/// Change of a reported position that still counts as rest: one hundredth of a degree, half the resolution the
/// throwing paper gives for its drives.
const REST_RAD: f64 = 0.000_175;

#[derive(Clone, Copy, Debug, Default)]
struct Axis {
    /// Since when it has to be at rest.
    rest_from: Option<Instant>,
    /// First position reported after that.
    rest_at_rad: Option<f64>,
}

/// Checker that a stopped axis stops and stays. RESET and HOME end its interest.
#[derive(Clone, Debug)]
pub struct Stop {
    within: Duration,
    axes: [Axis; 32],
}

impl Stop {
    /// An axis must be at rest this long after HALT.
    pub fn new(within: Duration) -> Self {
        Self { within, axes: [Axis::default(); 32] }
    }

    fn halt(&mut self, at: Instant, module: ModuleId) {
        let axis = &mut self.axes[usize::from(module.get())];
        // The first halt counts: repeating it gives no more time.
        if axis.rest_from.is_none() {
            *axis = Axis { rest_from: Some(at + self.within), rest_at_rad: None };
        }
    }

    fn position(&mut self, at: Instant, module: ModuleId, position_rad: f64, findings: &mut Findings) {
        let axis = &mut self.axes[usize::from(module.get())];
        if axis.rest_from.is_none_or(|from| at < from) {
            return;
        }
        let Some(rest_rad) = axis.rest_at_rad else {
            axis.rest_at_rad = Some(position_rad);
            return;
        };
        if (position_rad - rest_rad).abs() > REST_RAD {
            axis.rest_at_rad = Some(position_rad);
            findings.add(at, Some(module), || {
                format!("moved from {rest_rad:.6} to {position_rad:.6} rad although halted")
            });
        }
    }
}

impl Checker for Stop {
    fn on_frame(&mut self, at: Instant, frame: &Frame, findings: &mut Findings) {
        match Broadcast::decode(frame) {
            Ok(Broadcast::Halt) => {
                ModuleId::all().for_each(|module| self.halt(at, module));
                return;
            }
            Ok(Broadcast::Reset | Broadcast::Home) => {
                self.axes = [Axis::default(); 32];
                return;
            }
            _ => {}
        }
        if let Ok(AddressedRequest { module, request, .. }) = AddressedRequest::decode(frame) {
            match request {
                Request::Simple(SimpleCommand::Halt) => self.halt(at, module),
                Request::Simple(SimpleCommand::Reset | SimpleCommand::Home) => {
                    self.axes[usize::from(module.get())] = Axis::default();
                }
                _ => {}
            }
            return;
        }
        let position = match Reply::decode(frame) {
            Ok((module, Reply::Value(_, Value::PosStateDio(value)))) => {
                (module, f64::from(value.position_rad))
            }
            Ok((module, Reply::Value(Parameter::ActPos, Value::F32(position)))) => {
                (module, f64::from(position))
            }
            Ok((module, Reply::MotionExtended { position: MotionPosition::Radians(position), .. })) => {
                (module, f64::from(position.get()))
            }
            _ => return,
        };
        self.position(at, position.0, position.1, findings);
    }
}
