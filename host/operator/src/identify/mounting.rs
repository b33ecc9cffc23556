//! Mounting of a robot's drives on their joints, and the source of this knowledge.

use std::fmt;

use firmware::joints::PerJoint;
use firmware::registers::RegisterInfo;
use firmware::settings::{JointSettings, Settings};
use protocol::ModuleId;
use protocol::cyphal::id::NodeId;

use crate::bus::Session;
use crate::dialogue::operator::OperatorError;
use crate::dialogue::registers::{Numbers, settings_of};

/// Source of the mounting of the drives.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Source {
    Controller(NodeId),
    /// A file of `cubectl controller registers export`.
    File(String),
    Assumed,
}

impl fmt::Display for Source {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Controller(node) => write!(f, "the registers of controller {}", node.get()),
            Self::File(name) => write!(f, "the registers in {name}"),
            Self::Assumed => f.write_str("nobody"),
        }
    }
}

/// See the [module](self).
#[derive(Clone, Debug)]
pub struct Mounting {
    settings: Settings,
    source: Source,
}

const fn is_of_mounting(info: &RegisterInfo) -> bool {
    matches!(info.name.as_bytes(), b"joint.address" | b"joint.inverted" | b"joint.offset_rad")
}

impl Mounting {
    /// Every drive reads the angle of its joint.
    #[must_use]
    pub const fn assumed() -> Self {
        Self { settings: Settings::BUILT_IN, source: Source::Assumed }
    }

    /// From registers, by name, read by `read`.
    ///
    /// # Errors
    /// Errors of `read`, or a register with a value that this program does not know.
    pub fn of(
        source: Source,
        read: &mut dyn FnMut(&str) -> Result<Numbers, OperatorError>,
    ) -> Result<Self, OperatorError> {
        Ok(Self { settings: settings_of(is_of_mounting, read)?, source })
    }

    pub fn of_controller(session: &mut Session, node: NodeId) -> Result<Self, OperatorError> {
        Self::of(Source::Controller(node), &mut |name| session.register(node, name))
    }

    #[must_use]
    pub const fn source(&self) -> &Source {
        &self.source
    }

    /// The drive with this address on its joint; `None` if it is on none.
    #[must_use]
    pub fn joint(&self, address: u8) -> Option<JointSettings> {
        let module = ModuleId::new(address).ok()?;
        let PerJoint(first) = &self.settings.joint;
        if self.source == Source::Assumed {
            return first.first().map(|joint| JointSettings {
                address: address.into(),
                inverted: false,
                offset_rad: 0.0,
                ..*joint
            });
        }
        self.settings
            .joints()
            .map(|joint| *self.settings.joint.at(joint))
            .find(|joint| joint.module() == module)
    }
}

impl fmt::Display for Mounting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.source == Source::Assumed {
            return f.write_str(
                "assumed, because no controller was heard and --registers names no file: every drive reads the angle of its joint",
            );
        }
        write!(f, "from {}:", self.source)?;
        let mut is_plain = true;
        for joint in self.settings.joints() {
            let JointSettings { inverted, offset_rad, .. } = *self.settings.joint.at(joint);
            if inverted || offset_rad != 0.0 {
                let separator = if is_plain { "" } else { ";" };
                let turned = if inverted { "against its drive, " } else { "" };
                write!(f, "{separator} joint {} {turned}offset {offset_rad} rad", joint.get() + 1)?;
                is_plain = false;
            }
        }
        if is_plain { f.write_str(" every drive reads the angle of its joint") } else { Ok(()) }
    }
}
