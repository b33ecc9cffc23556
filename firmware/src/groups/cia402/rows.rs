//! What is compared with a servo and written to it, object by object.

use core::f32::consts::TAU;

use protocol::canopen::Object;
use protocol::canopen::cia402::{self, Control, Mode as DriveMode, State, Status};
use protocol::canopen::pdo::{Direction, ENTRIES_MAX, Transmission, set_up};
use protocol::{Duration, JointIndex};

use super::finding::HEARTBEAT;
use super::options::{Follow, HOST_NODE, Home, Options, Servo};
use crate::settings::Settings;

/// Content of object 60A9 if object 6080 is in turns per minute, as drives are delivered.
const TURNS_PER_MINUTE: u32 = 0x00B4_4700;
/// Time beyond the following window, ms.
const AWAY_MS: u32 = 10;
const NOT_VALID: u32 = 1 << 31;
/// What modules that interpolate may lack. None of these is in the public DCF of SCHUNK's modules (2013).
///
/// | object | what holds without it |
/// |---|---|
/// | 1029, 6007, 605E | the module stops as its maker chose; the proof of the supervision shows that it gives up its torque |
/// | 603F | the newest entry of object 1003 is the error; without one the cause is [`Cause::DriveError`](crate::fault::Cause::DriveError) |
/// | 605A, 6085 | the maker chose how a quick stop brakes and ends; the controller orders one only after a fault |
/// | 6066 | the time beyond the window of object 6065 is the maker's |
/// | 6076 | nobody compares the unit of the torque that is fed forward; a wrong unit shows as a following error |
/// | 608F, 6091 | the unit is fixed, and nobody compares it with the robot file |
const ABSENT_IN_MODULES: [u16; 10] =
    [0x1029, 0x6007, 0x603F, 0x605A, 0x605E, 0x6066, 0x6076, 0x6085, 0x608F, 0x6091];
/// Newest entry of the error history; its upper half is the maker's. A servo without errors has none.
pub(super) const LAST_ERROR: Object = Object::new(0x1003, 1);
/// A bit of ids that servos may set by themselves: no remote frames.
const NO_REMOTE: u32 = 1 << 30;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Kind {
    /// It holds this.
    Is,
    /// As `Is`; a servo without this object is fine.
    IsIfThere,
    /// At most this; a servo without this object is fine.
    AtMostIfThere,
    /// It has these bits.
    Has,
    /// One of the numbers that give the counts per turn. When the last one is read, the result is compared.
    Unit(u8),
    /// Last error, if none is known yet.
    Error,
    /// State of the drive.
    State,
    /// Written.
    Write,
    /// Written, then read.
    Set,
    /// As `Set`; a servo without this object is fine.
    Off,
    /// As `Off`, for a speed. The row has the speed of the joint, 1e-3 turns per minute; the object gets the speed of the motor, turns per
    /// minute.
    OfMotor,
    /// Read until it holds this.
    Shows,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Row {
    pub(super) object: Object,
    pub(super) kind: Kind,
    pub(super) value: u32,
    pub(super) bytes: u8,
}

pub(super) const fn row(kind: Kind, index: u16, sub: u8, bytes: u8, value: u32) -> Row {
    Row { object: Object::new(index, sub), kind, value, bytes }
}

const fn mode_number(mode: DriveMode) -> u32 {
    mode.number() as u8 as u32
}

/// Time without a heartbeat of the controller after which a servo stops by itself.
pub(super) fn time_out(settings: &Settings) -> Duration {
    Duration::from_millis(u64::from(settings.watchdog_timeout_us / 1_000).max(1))
}

/// What is compared and written before a servo gets process data, in order.
pub(super) fn all(
    options: &Options,
    servo: Servo,
    settings: &Settings,
    joint: JointIndex,
) -> impl Iterator<Item = Row> {
    use Kind::{AtMostIfThere, Error, Has, Is, IsIfThere, OfMotor, Off, Set, Shows, Unit, Write};
    let limits = settings.joint.at(joint);
    let counts = |rad: f32| (rad * servo.counts_per_turn as f32 / TAU) as u32;
    let turns_per_minute = limits.v_max_rad_s * 60.0 / TAU;
    let homing = if servo.home == Home::Here { 1 << (mode_number(DriveMode::Homing) - 1) } else { 0 };
    let mode = mode_number(servo.follow.mode());
    let modes = 1 << (mode - 1) | homing;
    // A period without such a form is refused by the servo: no mantissa is zero.
    let (mantissa, exponent) = cia402::interpolation_time(settings.cycle_period_us).unwrap_or((0, 0));
    let supervised = (u32::from(HOST_NODE) << 16) | (time_out(settings).as_micros() as u32 / 1_000);
    let control = |word: Control| row(Write, cia402::CONTROL, 0, 2, word.0.into());
    let compared = [
        // A supervision that is left from before would expire while the servo is being set up.
        row(Set, 0x1016, 1, 4, 0),
        row(Has, cia402::SUPPORTED_MODES, 0, 4, modes),
        row(Unit(0), 0x608F, 1, 4, 0),
        row(Unit(1), 0x608F, 2, 4, 0),
        row(Unit(2), 0x6091, 1, 4, 0),
        row(Unit(3), 0x6091, 2, 4, 0),
        row(Is, 0x6076, 0, 4, servo.rated_mnm),
        row(Error, 0x603F, 0, 2, 0),
        row(Error, LAST_ERROR.index, LAST_ERROR.sub, 4, 0),
        row(Kind::State, cia402::STATUS, 0, 2, 0),
        // No torque; then the rising bit that clears an error.
        control(Control::DISABLE_VOLTAGE),
        control(Control::FAULT_RESET),
        control(Control::DISABLE_VOLTAGE),
        row(Shows, cia402::STATUS, 0, 2, Status::of(State::SwitchOnDisabled).0.into()),
        // On a lost link process data go on: they show the fault. Without this object the node goes pre-operational.
        row(Set, 0x1029, 1, 1, 1),
        row(Set, 0x1016, 1, 4, supervised),
        row(Set, 0x1017, 0, 2, HEARTBEAT.as_micros() as u32 / 1_000),
        // Lost link: fault. Fault: quick-stop ramp, then brake. Quick stop: ramp, and stay there.
        row(Set, 0x6007, 0, 2, 1),
        row(Set, 0x605E, 0, 2, 2),
        row(Set, 0x605A, 0, 2, 6),
        row(Set, 0x6085, 0, 4, counts(limits.a_max_rad_s2)),
        row(Set, 0x6065, 0, 4, counts(limits.error_max_rad)),
        row(Set, 0x6066, 0, 2, AWAY_MS),
        row(Set, cia402::INTERPOLATION_TIME, 1, 1, mantissa.into()),
        row(Set, cia402::INTERPOLATION_TIME, 2, 1, (exponent as u8).into()),
    ];
    let gripper = options.gripper().filter(|gripper| gripper.joint == joint);
    let unused = [0x1401, 0x1402, 0x1403, 0x1801, 0x1802, 0x1803].into_iter();
    let others = unused.filter(move |index| *index != 0x1401 || gripper.is_none()).map(move |index: u16| {
        let base = if index < 0x1800 { 0x200 } else { 0x180 };
        let id = base + 0x100 * u32::from(index & 3) + u32::from(servo.node.get());
        row(Off, index, 1, 4, NOT_VALID | id)
    });
    let ways = [
        (Direction::Receive, 1, options.to_servo(servo), Transmission::Sync(1)),
        (Direction::Transmit, 1, Options::from_servo(), Transmission::Sync(1)),
        // An output is switched when it is ordered.
        (Direction::Receive, 2, gripper.and_then(|_| Options::to_outputs()), Transmission::Event),
    ];
    let ways = ways.into_iter().filter_map(|(way, number, map, when)| Some((way, number, map?, when)));
    let maps = ways.flat_map(move |(direction, number, map, when)| {
        set_up(servo.node, direction, number, map, when).map(|(object, value)| {
            let bytes = value.get().len() as u8;
            Row { object, kind: Set, value: little_endian(value.get()), bytes }
        })
    });
    let output = gripper.map(|gripper| row(Set, cia402::OUTPUTS, 2, 4, gripper.mask()));
    // Straight from point to point, of which one waits: a longer queue would delay each of them.
    let interpolated = [
        row(Set, cia402::INTERPOLATION_SUBMODE, 0, 2, 0),
        row(AtMostIfThere, cia402::INTERPOLATION_BUFFER, 2, 4, 1),
    ];
    let interpolated = interpolated.into_iter().filter(move |_| servo.follow == Follow::Interpolated);
    // After lost set points the next one is far away. This limit keeps the servo from running there faster than its joint may. Plans are
    // slower (at most 98 %), so the servo catches up.
    let limited = [
        row(IsIfThere, cia402::VELOCITY_UNIT, 0, 4, TURNS_PER_MINUTE),
        row(OfMotor, cia402::MOTOR_SPEED_MAX, 0, 4, libm::roundf(turns_per_minute * 1e3) as u32),
    ];
    let limited = limited.into_iter().filter(move |_| servo.follow == Follow::Cyclic);
    let last = [row(Set, cia402::MODE, 0, 1, mode), row(Shows, cia402::MODE_DISPLAY, 0, 1, mode)];
    compared
        .into_iter()
        .chain(limited)
        .chain(interpolated)
        .chain(others)
        .chain(maps)
        .chain(output)
        .chain(last)
}

/// What the group does with an object.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Use {
    /// It reads it.
    Read,
    /// It writes this.
    Written(u32),
    /// It stands in process data.
    Mapped,
}

/// An object that the group uses while it sets a servo up, or in process data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Need {
    /// Which one.
    pub object: Object,
    /// Its length, bytes.
    pub bytes: u8,
    /// What for.
    pub purpose: Use,
    /// A servo without it is fine.
    pub may_be_absent: bool,
}

impl Options {
    /// The objects that the group uses of the servo of a joint.
    pub fn needs<'a>(&'a self, settings: &'a Settings, joint: JointIndex) -> impl Iterator<Item = Need> + 'a {
        let servo = self.servo(joint);
        let set_up = servo.into_iter().flat_map(move |servo| {
            // A history of errors may be empty: nothing is compared with it.
            let rows = all(self, servo, settings, joint).filter(|row| row.object != LAST_ERROR);
            rows.map(move |row| Need {
                object: row.object,
                bytes: row.bytes,
                purpose: match row.kind {
                    Kind::Write | Kind::Set | Kind::Off => Use::Written(row.value),
                    // What is written depends on the gear, which the servo reports.
                    _ => Use::Read,
                },
                may_be_absent: row.may_be_absent(servo),
            })
        });
        let gripper = self.gripper().filter(|gripper| gripper.joint == joint);
        let maps = [
            servo.and_then(|servo| self.to_servo(servo)),
            servo.and_then(|_| Options::from_servo()),
            gripper.and_then(|_| Options::to_outputs()),
        ];
        let mapped = maps.into_iter().flatten().flat_map(|map| {
            (0..ENTRIES_MAX).filter_map(move |at| {
                let entry = map.entries().get(at)?;
                let (object, bytes) = (entry.object, entry.bytes);
                Some(Need { object, bytes, purpose: Use::Mapped, may_be_absent: false })
            })
        });
        set_up.chain(mapped)
    }
}

/// The place where the joint stands becomes zero, between these rows: [`Step::Zero`] follows the fourth.
pub(super) fn homing_rows() -> [Row; 6] {
    use Kind::{Set, Shows};
    let (homing, follow) = (mode_number(DriveMode::Homing), mode_number(DriveMode::CyclicPosition));
    [
        row(Set, 0x6098, 0, 1, 37),
        row(Set, 0x607C, 0, 4, 0),
        row(Set, cia402::MODE, 0, 1, homing),
        row(Shows, cia402::MODE_DISPLAY, 0, 1, homing),
        row(Set, cia402::MODE, 0, 1, follow),
        row(Shows, cia402::MODE_DISPLAY, 0, 1, follow),
    ]
}

/// Rows of [`homing_rows`] before [`Step::Zero`].
pub(super) const BEFORE_ZERO: u8 = 4;

pub(super) fn little_endian(bytes: &[u8]) -> u32 {
    bytes.iter().rev().fold(0, |value, byte| value << 8 | u32::from(*byte))
}

impl Row {
    /// A servo without the object is fine.
    pub(super) fn may_be_absent(&self, servo: Servo) -> bool {
        let of_modules = || ABSENT_IN_MODULES.contains(&self.object.index);
        matches!(self.kind, Kind::Off | Kind::IsIfThere | Kind::AtMostIfThere | Kind::OfMotor)
            || self.object == LAST_ERROR
            || servo.follow == Follow::Interpolated && of_modules()
    }

    /// The row for a servo with these [`Kind::Unit`]s.
    pub(super) fn with_units(self, [_, _, motor, shaft]: [u32; 4]) -> Self {
        if self.kind != Kind::OfMotor {
            return self;
        }
        let of_motor = u64::from(self.value) * u64::from(motor);
        // Rounded up, so that set points at the limit of the joint stay possible.
        let value = of_motor.div_ceil(u64::from(shaft.max(1)) * 1_000);
        Self { value: u32::try_from(value).unwrap_or(u32::MAX), ..self }
    }

    /// Written before it is read.
    pub(super) const fn is_set(&self) -> bool {
        matches!(self.kind, Kind::Set | Kind::Off | Kind::OfMotor)
    }

    /// Whether a value that was read is as it should be.
    pub(super) fn holds(&self, found: u32) -> bool {
        match (self.kind, self.object.index) {
            (Kind::Has, _) => found & self.value == self.value,
            (Kind::AtMostIfThere, _) => found <= self.value,
            (_, cia402::STATUS) => found & 0x4F == self.value & 0x4F,
            (_, 0x1800..=0x19FF) => found & !NO_REMOTE == self.value & !NO_REMOTE,
            _ => found == self.value,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_id_may_come_back_with_the_bit_against_remote_frames() {
        let own = row(Kind::Set, 0x1800, 1, 4, 0x183);
        assert!(own.holds(0x4000_0183) && !own.holds(0x8000_0183) && !own.holds(0x184));
        let to_servo = row(Kind::Set, 0x1400, 1, 4, 0x203);
        assert!(!to_servo.holds(0x4000_0203));
    }

    #[test]
    fn the_limit_of_speed_is_that_of_the_joint_behind_its_gear() {
        // 72 degrees in a second.
        let limit = row(Kind::OfMotor, cia402::MOTOR_SPEED_MAX, 0, 4, 12_000);
        assert_eq!(limit.with_units([4_096, 1, 160, 1]).value, 1_920);
        assert_eq!(limit.with_units([4_096, 1, 501, 5]).value, 1_203, "1 202.4 is rounded up");
    }

    #[test]
    fn bytes_are_read_with_the_lowest_first() {
        assert_eq!(little_endian(&[0x92, 1, 2, 0]), 0x0002_0192);
    }
}
