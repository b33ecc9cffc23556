//! No motion before the module has reported its reference.

use protocol::powercube::{
    AddressedRequest, Broadcast, CubeState, Parameter, Reply, Request, ShortState, SimpleCommand, Value,
};
use protocol::{Frame, Instant, ModuleId};

use super::{Checker, Findings};

/// Checks that no module with an unknown reference is moved.
///
/// The reference counts as known when the module has reported it: HOME_OK in its state word, or a short state
/// without NOT_OK (which includes the home bit). HOME makes it unknown again.
#[derive(Clone, Debug, Default)]
pub struct Homing {
    /// Bit per module address.
    known: u32,
}

impl Homing {
    fn set(&mut self, module: ModuleId, known: bool) {
        let bit = 1 << module.get();
        self.known = if known { self.known | bit } else { self.known & !bit };
    }
}

impl Checker for Homing {
    fn on_frame(&mut self, at: Instant, frame: &Frame, findings: &mut Findings) {
        if Broadcast::decode(frame) == Ok(Broadcast::Home) {
            self.known = 0;
            return;
        }
        if let Ok(AddressedRequest { module, request, .. }) = AddressedRequest::decode(frame) {
            match request {
                Request::Simple(SimpleCommand::Home) => self.set(module, false),
                Request::Move(motion) if self.known >> module.get() & 1 == 0 => {
                    findings.add(at, Some(module), || {
                        format!("{:?} before the module reported its reference", motion.command())
                    });
                }
                _ => {}
            }
            return;
        }
        let Ok((module, reply)) = Reply::decode(frame) else { return };
        match reply {
            Reply::Value(Parameter::CubeState, Value::U32(bits)) => {
                self.set(module, CubeState::from_bits(bits).contains(CubeState::HOME_OK));
            }
            Reply::State(state) => self.set(module, state.contains(CubeState::HOME_OK)),
            Reply::Value(_, Value::PosStateDio(value)) if !value.short_state.contains(ShortState::NOT_OK) => {
                self.set(module, true);
            }
            Reply::MotionExtended { short_state, .. } if !short_state.contains(ShortState::NOT_OK) => {
                self.set(module, true);
            }
            _ => {}
        }
    }
}
