//! The controller that moves the arm for a verb: one that is heard on the bus, or one in this program.

use can_link::BusSpec;
use firmware::settings::Settings;
use protocol::cyphal::cubecell::command::{UNLOCK, Unlock};
use protocol::cyphal::cubecell::group_state::State;
use protocol::cyphal::id::NodeId;
use protocol::cyphal::uavcan::diagnostic::Severity;
use protocol::{Duration, JointIndex, ModuleId};

use crate::error::ExpectedError;
use crate::exit;
use operator::bus::args::Controller;
use operator::bus::key_file::KeyArgs;
use operator::bus::period::{PERIOD_MAX_US, set_period};
use operator::bus::settings::{of_modules, settings_of};
use operator::bus::{BusArgs, Session};
use operator::dialogue::operator::OperatorError;
use operator::dialogue::registers::Numbers;
use operator::node::inbox::Said;

/// Period of a controller for an arm of motors or servos, µs: five set points within the time-out of a motor.
const WHOLE_PERIOD_US: u32 = 10_000;
/// Longest start-up of a controller.
const BOOT_MAX: Duration = Duration::from_secs(20);

/// Which controller moves the arm.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct ControllerArgs {
    #[command(flatten)]
    pub key: KeyArgs,
    /// Controller: `soft` for one in this program, or the Cyphal node-ID of one on the bus. Default: the one that is heard,
    /// else one in this program, for the time of this command.
    #[arg(long, value_name = "soft|NODE-ID")]
    pub controller: Option<Controller>,
}

/// A session with a controller that has found its drives.
pub(super) struct Controlled {
    pub(super) session: Session,
    pub(super) node: NodeId,
    /// The controller runs in this program.
    pub(super) soft: bool,
    /// Its joints, base first, and the address of the drive of each.
    pub(super) joints: Vec<(JointIndex, ModuleId)>,
    /// Number of each of them in the robot, from 1: a controller for some modules has the joints of these alone.
    numbers: Vec<usize>,
    /// Registers that this verb has changed for its own time, with what they held.
    changed: Vec<(&'static str, Numbers)>,
}

impl Controlled {
    /// Opens the bus. A controller in this program is for the drives of the robot that are `named`, all of them by default,
    /// and begins with what `adjust` makes of its settings.
    ///
    /// # Errors
    /// The bus, another host on it, a controller that is not there or reports a fault.
    pub(super) fn open(
        bus: &BusArgs,
        args: &ControllerArgs,
        named: Option<&[ModuleId]>,
        adjust: &dyn Fn(&mut Settings),
    ) -> Result<Self, ExpectedError> {
        let key = args.key.load()?;
        let cell = bus.cell.load()?;
        // Motors and servos are led as a whole: an arm without brakes is held, one SYNC is for all.
        let is_whole = cell.robot.drives().is_none();
        let named = named.filter(|_| !is_whole);
        let soft = is_soft(&bus.bus, args.controller)?;
        let mut addresses = Vec::new();
        let settings = if soft {
            let settings = settings_of(&cell.robot).map_err(|error| ExpectedError::bad_input(&error))?;
            addresses.extend(settings.joints().map(|joint| settings.joint.at(joint).module()));
            let mut settings = match named {
                Some(named) => {
                    of_modules(&settings, named).map_err(|error| ExpectedError::bad_input(&error))?
                }
                None => settings,
            };
            // Homing and jogging need no short period, and a slow machine or adapter must not stop them.
            set_period(&mut settings, if is_whole { WHOLE_PERIOD_US } else { PERIOD_MAX_US });
            adjust(&mut settings);
            // A controller would begin with others instead.
            settings.check().map_err(|refusal| {
                let what = refusal.cause.info().map_or("", |info| info.what);
                ExpectedError::bad_input(&format!(
                    "the limits of this robot and the options make no settings of a controller: {what}"
                ))
                .next("leave the options out; nothing has moved")
            })?;
            Some(settings)
        } else {
            None
        };
        let mut session = bus.open_cell(&cell, settings.as_ref())?;
        session.set_key(key);
        session.watch_stops();
        let wanted = match args.controller {
            Some(Controller::Node(node)) => Some(node),
            Some(Controller::Soft) | None => None,
        };
        let node = session.find_controller(wanted)?;
        // What the controller counts, as the robot counts it.
        let kept =
            addresses.iter().zip(1..).filter(|(module, _)| named.is_none_or(|named| named.contains(module)));
        let numbers = kept.map(|(_, number)| number).collect();
        let mut controlled = Self { session, node, soft, joints: Vec::new(), numbers, changed: Vec::new() };
        controlled
            .session
            .wait_for(BOOT_MAX, &|state| !matches!(state, State::Boot | State::Fault))
            .map_err(|error| controlled.renumbered(error))?;
        controlled.joints = joints_of(&mut controlled.session, node)?;
        Ok(controlled)
    }

    /// Number of a joint of the controller in the robot, from 1.
    pub(super) fn number(&self, joint: JointIndex) -> usize {
        self.numbers.get(joint.get()).copied().unwrap_or(joint.get() + 1)
    }

    /// An error with the joint's number in the robot in the place of that in the controller.
    pub(super) fn renumbered(&self, mut error: OperatorError) -> OperatorError {
        let place = match &mut error {
            OperatorError::Stopped { joint, .. } => joint,
            OperatorError::Refused { refusal: Some(refusal), .. } => &mut refusal.joint,
            _ => return error,
        };
        let joint = usize::from(*place).checked_sub(1).and_then(|index| JointIndex::new(index).ok());
        if let Some(number) = joint.and_then(|joint| u8::try_from(self.number(joint)).ok()) {
            *place = number;
        }
        error
    }

    /// Changes registers for the time of this verb; [`Controlled::put_back`] is to follow, whatever comes of it.
    ///
    /// # Errors
    /// [`OperatorError`]; some may be changed.
    pub(super) fn change(&mut self, wishes: Vec<(&'static str, Numbers)>) -> Result<(), OperatorError> {
        for (name, wanted) in wishes {
            let before = self.session.register(self.node, name)?;
            self.changed.push((name, before));
            self.session.set_register(self.node, name, &wanted)?;
        }
        Ok(())
    }

    /// Puts back what [`Controlled::change`] has changed, also after a signal, a stop or an error, once the arm stands.
    ///
    /// # Errors
    /// Names what could not be put back, and how to do it by hand.
    pub(super) fn put_back(&mut self) -> Result<(), ExpectedError> {
        let changed = std::mem::take(&mut self.changed);
        if changed.is_empty() {
            return Ok(());
        }
        let node = self.node;
        let mut left = Vec::new();
        let ended = self.session.put_back(|session| {
            for (name, before) in &changed {
                if let Err(why) = session.set_register(node, name, before) {
                    left.push((name, before, why.to_string()));
                }
            }
        });
        if let Err(why) = ended {
            left.extend(changed.iter().map(|(name, before)| (name, before, why.to_string())));
        }
        let Some((_, _, why)) = left.first() else { return Ok(()) };
        let words: Vec<String> =
            left.iter().map(|(name, before, _)| format!("{name}={}", before.list())).collect();
        Err(ExpectedError::new(
            exit::DRIVE,
            format!("controller {} keeps registers that were changed for this command: {why}", node.get()),
        )
        .next(format!(
            "`cubectl controller registers set {}` on this bus once the arm stands",
            words.join(" ")
        )))
    }

    /// The joints whose drives are `named`, all by default.
    ///
    /// # Errors
    /// No joint of the controller has such a drive.
    pub(super) fn select(
        &self,
        named: Option<&[ModuleId]>,
    ) -> Result<Vec<(JointIndex, ModuleId)>, ExpectedError> {
        let Some(named) = named else { return Ok(self.joints.clone()) };
        let known = |module: &ModuleId| self.joints.iter().find(|(_, address)| address == module).copied();
        named.iter().map(|module| known(module).ok_or_else(|| self.unknown(*module))).collect()
    }

    fn unknown(&self, module: ModuleId) -> ExpectedError {
        let known: Vec<String> = self.joints.iter().map(|(_, module)| module.to_string()).collect();
        ExpectedError::bad_input(&format!(
            "controller {}: module {module} is the drive of no joint; it has modules {}",
            self.node.get(),
            known.join(", ")
        ))
        .next("name one of these, or the robot of this arm with --robot")
    }

    /// Ends in order. A controller in this program switches the watchdogs of its drives off first, so that they do not
    /// stop for want of it. After a stop or a fault the drives are halted and stay so: nothing is written to them.
    pub(super) fn finish(mut self) -> Result<(), ExpectedError> {
        let state = self.session.group().map(|group| group.state);
        if self.soft
            && matches!(state, Some(State::Idle | State::Ready))
            && self.session.find_register(self.node, "watchdog.enable")?.is_some()
        {
            // Without watchdogs nothing supervises the drives: a limit like the others.
            let robot_crc32 = self.session.natural(self.node, "limits.robot_crc32")? as u32;
            let unlock = Unlock { robot_crc32, valid_s: 60 };
            self.session.order(self.node, "to switch the watchdogs off", UNLOCK, &unlock)?;
            self.session.set_register(self.node, "watchdog.enable", &Numbers::Bit(vec![false]))?;
            self.session.wait_for(BOOT_MAX, &|state| state != State::Boot)?;
        }
        tell_warnings(&mut self.session);
        Ok(self.session.finish()?)
    }
}

/// Prints what the controller warned of: a host that is nearly too slow, for one.
pub(super) fn tell_warnings(session: &mut Session) {
    for (at, said) in session.take_said() {
        if said.severity >= Severity::Warning {
            let Said { from, text, .. } = said;
            console::note!("{:.3} s: controller {} warns: {text}", at.as_secs_f64(), from.get());
        }
    }
}

/// Whether a controller in this program does it. Listens on the bus to decide.
///
/// # Errors
/// Another host or another `cubectl` is on the bus, or a second controller would be.
pub(super) fn is_soft(spec: &BusSpec, wanted: Option<Controller>) -> Result<bool, ExpectedError> {
    match (wanted, spec) {
        (Some(Controller::Node(_)), BusSpec::Sim) => {
            return Err(ExpectedError::bad_input(&"the bus sim has no controller but the soft one")
                .next("leave --controller out, or name another bus"));
        }
        (_, BusSpec::Sim) => return Ok(true),
        _ => {}
    }
    let mut session = BusArgs { bus: spec.clone(), ..BusArgs::default() }.open()?;
    let present = session.claim()?;
    session.finish()?;
    let in_use = |who: &str, next: &str| {
        Err(ExpectedError::new(exit::BUS, format!("{spec}: {who}; nothing was sent to the modules"))
            .next(next))
    };
    match (wanted, present.controller) {
        _ if present.tool => in_use(
            "another cubectl speaks to a controller on this bus",
            "end it; `cubectl arm monitor` watches beside it",
        ),
        (Some(Controller::Soft), Some(node)) => in_use(
            &format!("controller {} is on this bus already", node.get()),
            "leave --controller out to use it, or end it",
        ),
        (Some(Controller::Node(_)), _) | (None, Some(_)) => Ok(false),
        (_, None) if present.drives_are_asked => in_use(
            "another host speaks to the modules, and no controller is heard",
            "end the other program, which did not give way; `cubectl arm monitor` does, and `cubectl stop` stops",
        ),
        (_, None) => Ok(true),
    }
}

/// Joints of a controller with the addresses of their drives.
fn joints_of(session: &mut Session, node: NodeId) -> Result<Vec<(JointIndex, ModuleId)>, OperatorError> {
    let unreadable = || OperatorError::Unreadable { node };
    let Numbers::Natural(addresses) = session.register(node, "joint.address")? else {
        return Err(unreadable());
    };
    let joint = |(k, address): (usize, &u64)| {
        let module = u8::try_from(*address).ok().and_then(|address| ModuleId::new(address).ok())?;
        Some((JointIndex::new(k).ok()?, module))
    };
    addresses.iter().enumerate().map(joint).collect::<Option<_>>().ok_or_else(unreadable)
}
