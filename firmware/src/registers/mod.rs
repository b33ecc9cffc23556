//! Settings by name: typed, bounded, with the unit in the name; and their form in permanent storage.
//!
//! The table is data: names, ranges and texts are made from one list, so what a host sees, what is
//! checked and what is stored cannot differ. A register of the joints holds one number per joint in use.

mod digest;
pub(crate) mod family;

use protocol::{JOINTS_MAX, JointIndex};

pub use self::digest::{certificate_crc32, run_digest};
pub use self::family::{FAMILY_MAX, FamilyRegisters, FamilySetting, FamilySettings};
use crate::crc::Crc32;
use crate::fault::{Cause, Refusal};
use crate::settings::Settings;

/// Type of a register's numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// f32.
    Real32,
    /// u32.
    Natural32,
    /// Yes or no.
    Bit,
}

/// One number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Number {
    /// f32.
    Real32(f32),
    /// u32.
    Natural32(u32),
    /// Yes or no.
    Bit(bool),
}

/// When a register may be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Writable {
    /// Never: it holds what the controller was started with.
    Never,
    /// Also during a motion: it does not shape motion.
    Always,
    /// Only while nothing moves and nothing is armed.
    AtRest,
    /// Makes the controller search its drives again. Writable while nothing moves, but not in Stopped and Fault:
    /// only an order ends the halt of the drives.
    NextStart,
    /// Takes effect when the controller is switched on the next time, if it was saved.
    NextPowerOn,
}

/// Which new values let the arm do more than before. They need the unlock, and any change voids the commit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wider {
    /// Nothing: not a limit.
    No,
    /// Larger values than the controller was started with; put back when the unlock ends.
    More,
    /// Smaller values than the controller was started with; put back when the unlock ends.
    Less,
    /// Any other value, because it moves all limits in space. A value set during the unlock stays.
    Other,
}

/// The loop that the gains are certified for depends on it: it is part of [`certificate_crc32`], and a change voids the
/// certificate.
const PROVEN: bool = true;
const FREE: bool = false;

/// Row of the table. Only the table holds when a register may be written, which values need the unlock and what a
/// change voids.
#[derive(Clone, Copy, Debug)]
pub struct RegisterInfo {
    /// Name, with the unit.
    pub name: &'static str,
    /// Type.
    pub kind: Kind,
    /// One number per joint, not one for the group.
    pub per_joint: bool,
    /// Smallest value.
    pub min: f32,
    /// Largest value.
    pub max: f32,
    /// When it may be written.
    pub writable: Writable,
    /// Which values need the unlock.
    pub wider: Wider,
    /// A change voids the certificate of the gains.
    pub is_proven: bool,
    place: Place,
}

/// Where a register's numbers are.
#[derive(Clone, Copy, Debug)]
enum Place {
    Group(Group),
    Joint(Joint),
    /// Row of the family's list.
    Family(usize),
}

impl RegisterInfo {
    /// Row of a family's list.
    #[allow(private_bounds)]
    pub(crate) const fn of_family<T: Field>(
        name: &'static str,
        per_joint: bool,
        (min, max): (f32, f32),
        (writable, wider): (Writable, Wider),
        row: usize,
    ) -> Self {
        let place = Place::Family(row);
        Self { name, kind: T::KIND, per_joint, min, max, writable, wider, is_proven: FREE, place }
    }

    /// Numbers the register has.
    const fn count(&self, settings: &Settings) -> usize {
        if self.per_joint { settings.joints as usize } else { 1 }
    }

    /// True if the register accepts the number. Subnormal numbers mean nothing in any unit, and cost time in arithmetic.
    fn allows(&self, number: Number) -> bool {
        let x = number.magnitude();
        // Written so that NaN fails.
        number.kind() == self.kind && x >= self.min && x <= self.max && !x.is_subnormal()
    }

    /// True for a limit of motion or of its supervision, and for an origin of limits: a change voids the commit.
    pub const fn is_limit(&self) -> bool {
        !matches!(self.wider, Wider::No)
    }

    /// True for gains, for everything that their certificate depends on, and for its checksum.
    pub fn is_of_gains(&self) -> bool {
        self.is_proven || self.name == "gains.certificate_crc32"
    }

    /// True if [`run_digest`] covers it: everything that a run depends on.
    pub const fn is_in_digest(&self) -> bool {
        !matches!(self.writable, Writable::Always | Writable::NextPowerOn)
    }

    /// True if motion depends on it.
    pub const fn shapes_motion(&self) -> bool {
        !matches!(self.writable, Writable::Never | Writable::Always)
    }

    /// True if a limit is beyond another one.
    fn is_wider(&self, number: Number, ceiling: Number) -> bool {
        match self.wider {
            Wider::More => number.magnitude() > ceiling.magnitude(),
            Wider::Less => number.magnitude() < ceiling.magnitude(),
            Wider::No | Wider::Other => false,
        }
    }

    /// True if the change from `old` to `number` needs the unlock.
    fn widens(&self, number: Number, old: Number, ceiling: Number) -> bool {
        match self.wider {
            Wider::Other => number != old,
            // A limit that is already wide, by another node's unlock, may be narrowed.
            _ => self.is_wider(number, ceiling) && self.is_wider(number, old),
        }
    }
}

/// Numbers of one register.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Numbers {
    numbers: [Number; JOINTS_MAX],
    count: usize,
}

impl Numbers {
    /// The numbers.
    pub fn as_slice(&self) -> &[Number] {
        self.numbers.get(..self.count).unwrap_or(&[])
    }
}

impl Number {
    /// As a float, to compare with a range.
    fn magnitude(self) -> f32 {
        match self {
            Self::Real32(x) => x,
            Self::Natural32(x) => x as f32,
            Self::Bit(x) => f32::from(u8::from(x)),
        }
    }

    const fn kind(self) -> Kind {
        match self {
            Self::Real32(_) => Kind::Real32,
            Self::Natural32(_) => Kind::Natural32,
            Self::Bit(_) => Kind::Bit,
        }
    }

    const fn to_bits(self) -> u32 {
        match self {
            Self::Real32(x) => x.to_bits(),
            Self::Natural32(x) => x,
            Self::Bit(x) => x as u32,
        }
    }

    const fn from_bits(kind: Kind, bits: u32) -> Self {
        match kind {
            Kind::Real32 => Self::Real32(f32::from_bits(bits)),
            Kind::Natural32 => Self::Natural32(bits),
            Kind::Bit => Self::Bit(bits != 0),
        }
    }
}

/// Types a field can have.
pub(crate) trait Field: Copy {
    const KIND: Kind;
    fn number(self) -> Number;
    fn of(number: Number) -> Option<Self>;
    fn from_bits(bits: u32) -> Self;
}

macro_rules! field {
    ($type:ty, $kind:ident, $from_bits:expr) => {
        impl Field for $type {
            const KIND: Kind = Kind::$kind;
            fn number(self) -> Number {
                Number::$kind(self)
            }
            fn of(number: Number) -> Option<Self> {
                if let Number::$kind(x) = number { Some(x) } else { None }
            }
            fn from_bits(bits: u32) -> Self {
                $from_bits(bits)
            }
        }
    };
}
field!(f32, Real32, f32::from_bits);
field!(u32, Natural32, core::convert::identity);
field!(bool, Bit, |bits| bits != 0);

macro_rules! registers {
    (group { $($gname:literal $gfield:ident: $gtype:ty, $gmin:expr, $gmax:expr, $gwhen:ident, $gwider:ident, $gproven:ident, $gtext:literal;)* }
     joint { $($jname:literal $jfield:ident: $jtype:ty, $jmin:expr, $jmax:expr, $jwhen:ident, $jwider:ident, $jproven:ident, $jtext:literal;)* }) => {
        /// Fields of [`Settings`].
        #[derive(Clone, Copy, Debug)]
        #[allow(non_camel_case_types)]
        enum Group { $($gfield,)* }

        /// Fields of [`JointSettings`](crate::settings::JointSettings).
        #[derive(Clone, Copy, Debug)]
        #[allow(non_camel_case_types)]
        enum Joint { $($jfield,)* }

        /// Registers of the controller itself. Their numbers are the places here; those of the family follow.
        pub const TABLE: &[RegisterInfo] = &[
            $(RegisterInfo { name: $gname, kind: <$gtype as Field>::KIND, per_joint: false, min: $gmin, max: $gmax,
                writable: Writable::$gwhen, wider: Wider::$gwider, is_proven: $gproven, place: Place::Group(Group::$gfield) },)*
            $(RegisterInfo { name: $jname, kind: <$jtype as Field>::KIND, per_joint: true, min: $jmin, max: $jmax,
                writable: Writable::$jwhen, wider: Wider::$jwider, is_proven: $jproven, place: Place::Joint(Joint::$jfield) },)*
        ];

        /// What each register is, in the order of [`TABLE`]; separate from it, because a board does not need the texts.
        pub const MEANINGS: &[&str] = &[$($gtext,)* $($jtext,)*];

        /// One number of a register.
        fn get(settings: &Settings, info: &RegisterInfo, joint: JointIndex) -> Number {
            let limits = settings.joint.at(joint);
            match info.place {
                $(Place::Group(Group::$gfield) => settings.$gfield.number(),)*
                $(Place::Joint(Joint::$jfield) => limits.$jfield.number(),)*
                Place::Family(row) => settings.family.number(row, info.kind, joint),
            }
        }

        /// Sets one number; `None` if its type is not that of the register.
        fn set(settings: &mut Settings, info: &RegisterInfo, joint: JointIndex, number: Number) -> Option<()> {
            let limits = settings.joint.at_mut(joint);
            match info.place {
                $(Place::Group(Group::$gfield) => settings.$gfield = Field::of(number)?,)*
                $(Place::Joint(Joint::$jfield) => limits.$jfield = Field::of(number)?,)*
                Place::Family(row) => settings.family.set_number(row, info.kind, joint, number)?,
            }
            Some(())
        }
    };
}

registers! {
    group {
        "group.joints" joints: u32, 1.0, 8.0, NextStart, Other, FREE, "joints in use";
        "group.robot_crc32" robot_crc32: u32, 0.0, 4_294_967_295.0, AtRest, No, FREE, "checksum of the robot file that plans must be for, 0 accepts any";
        "cycle.period_us" cycle_period_us: u32, 1_000.0, 40_000.0, AtRest, No, FREE, "control period";
        "cycle.monitor_us" monitor_period_us: u32, 4_000.0, 40_000.0, AtRest, No, FREE, "period of looking at the drives while nothing moves";
        "cycle.late_max" cycle_late_max: u32, 1.0, 100.0, AtRest, More, FREE, "late cycles in a row that stop the group";
        "host.timeout_us" host_timeout_us: u32, 20_000.0, 500_000.0, AtRest, More, FREE, "age of the host's last sign of life at which a motion stops; a host sends uavcan.node.Heartbeat at least three times in this time, not once a second, while anything is armed or moves";
        "reply.deadline_us" reply_deadline_us: u32, 500.0, 20_000.0, AtRest, More, FREE, "a reply that takes longer is missed";
        "reply.missed_max" reply_missed_max: u32, 1.0, 10.0, AtRest, More, FREE, "missed replies in a row that stop the group";
        "reply.age_us" reply_age_us: u32, 0.0, 5_000.0, AtRest, No, PROVEN, "time from a drive's measurement to the end of its reply";
        "drives.lag_us" drive_lag_us: u32, 0.0, 20_000.0, AtRest, No, PROVEN, "how far a drive's position runs behind its ramp generator";
        "watchdog.prove" watchdog_prove: bool, 0.0, 1.0, NextStart, Less, FREE, "let the watchdogs expire once at start-up";
        "watchdog.refresh_us" watchdog_refresh_us: u32, 2_000.0, 100_000.0, AtRest, More, FREE, "time between signs of life to the drives";
        "watchdog.timeout_us" watchdog_timeout_us: u32, 10_000.0, 1_000_000.0, AtRest, More, FREE, "time after which the drives' watchdogs expire";
        "gains.period_us" gains_period_us: u32, 1_000.0, 40_000.0, AtRest, No, PROVEN, "period the gains were designed for";
        "gains.delay_min_us" gains_delay_min_us: u32, 0.0, 40_000.0, AtRest, No, PROVEN, "smallest delay from measurement to action the gains were designed for";
        "gains.delay_max_us" gains_delay_max_us: u32, 0.0, 40_000.0, AtRest, No, PROVEN, "largest delay from measurement to action the gains were designed for: a controller acts one period after it measures";
        "gains.robot_crc32" gains_robot_crc32: u32, 0.0, 4_294_967_295.0, AtRest, No, PROVEN, "checksum of the robot file the gains were designed for";
        "gains.certificate_crc32" gains_certificate_crc32: u32, 0.0, 4_294_967_295.0, AtRest, No, FREE, "checksum over all that the certificate of the gains is about (gains, weights, period, delay, lag, acceleration, robot), 0 for none; write it last";
        "limits.robot_crc32" limits_robot_crc32: u32, 0.0, 4_294_967_295.0, Never, No, FREE, "checksum of the robot file whose limits the controller was started with";
        "estimator.alpha" estimator_alpha: f32, 0.05, 1.0, AtRest, No, PROVEN, "weight of a measurement on the error, 1 takes it as it is";
        "estimator.beta" estimator_beta: f32, 0.01, 1.0, AtRest, No, PROVEN, "weight of a measurement on the rate of the error, 1 is the plain difference";
        "stop.share" stop_share: f32, 0.1, 1.0, AtRest, No, FREE, "share of the acceleration that a stop along the path may use";
        "stop.path_max_us" stop_path_max_us: u32, 50_000.0, 5_000_000.0, AtRest, More, FREE, "a stop along the path that takes longer becomes a quick stop";
        "gripper.inverted" gripper_inverted: bool, 0.0, 1.0, AtRest, No, FREE, "output on means closed";
        "gripper.opening_us" gripper_opening_us: u32, 0.0, 200_000.0, AtRest, No, FREE, "time from switching the output to the ball being free";
        "telemetry.period_us" telemetry_period_us: u32, 1_000.0, 10_000_000.0, Always, No, FREE, "time between telemetry samples";
        "home.timeout_us" home_timeout_us: u32, 1_000_000.0, 60_000_000.0, AtRest, No, FREE, "longest homing of one joint";
        "uavcan.node.id" node_id: u32, 0.0, 127.0, NextPowerOn, No, FREE, "node-ID on the host link";
        "uavcan.sub.stop.id" stop_subject: u32, 0.0, 6_143.0, NextPowerOn, No, FREE, "subject of the stop message";
        "uavcan.pub.group_state.id" group_state_subject: u32, 0.0, 6_143.0, NextPowerOn, No, FREE, "subject of the group state";
        "uavcan.pub.joint_state.id" joint_state_subject: u32, 0.0, 6_143.0, NextPowerOn, No, FREE, "subject of the joint state";
        "uavcan.sub.target.id" target_subject: u32, 0.0, 6_143.0, NextPowerOn, No, FREE, "subject of new end states";
        "uavcan.pub.target_answer.id" target_answer_subject: u32, 0.0, 6_143.0, NextPowerOn, No, FREE, "subject of the answers to them";
    }
    joint {
        "joint.address" address: u32, 1.0, 31.0, NextStart, Other, FREE, "address of the drive";
        "joint.inverted" inverted: bool, 0.0, 1.0, NextStart, Other, FREE, "joint turns against the drive";
        "joint.offset_rad" offset_rad: f32, -6.3, 6.3, NextStart, Other, FREE, "position of the joint where the drive reads zero";
        "joint.q_min_rad" q_min_rad: f32, -9.5, 9.5, AtRest, Less, FREE, "lower soft limit";
        "joint.q_max_rad" q_max_rad: f32, -9.5, 9.5, AtRest, More, FREE, "upper soft limit";
        "joint.v_max_rad_s" v_max_rad_s: f32, 0.01, 10.0, AtRest, More, FREE, "highest speed, commanded and measured";
        "joint.a_max_rad_s2" a_max_rad_s2: f32, 0.1, 100.0, AtRest, More, PROVEN, "highest commanded acceleration";
        "joint.error_max_rad" error_max_rad: f32, 0.001, 1.0, AtRest, More, FREE, "largest following error";
        "joint.start_tolerance_rad" start_tolerance_rad: f32, 0.001, 0.5, AtRest, More, FREE, "largest distance from the start of a plan at which it may start";
        "joint.current_max_a" current_max_a: f32, 0.1, 60.0, AtRest, More, FREE, "largest current";
        "joint.jog_v_rad_s" jog_v_rad_s: f32, 0.005, 0.5, AtRest, More, FREE, "speed of jogging";
        "joint.jog_a_rad_s2" jog_a_rad_s2: f32, 0.05, 5.0, AtRest, More, FREE, "acceleration of jogging";
        "joint.k_error_1_s2" k_error_1_s2: f32, -20_000.0, 0.0, AtRest, No, PROVEN, "feedback on the position error";
        "joint.k_rate_1_s" k_rate_1_s: f32, -1_000.0, 0.0, AtRest, No, PROVEN, "feedback on the rate of the error";
        "joint.k_last" k_last: f32, -2.5, 2.5, AtRest, No, PROVEN, "feedback on the input that acts meanwhile";
    }
}

/// Registers of a controller with these settings: its own, then those of its drives. The place is the register's number.
pub fn all(settings: &Settings) -> impl Iterator<Item = &'static RegisterInfo> + Clone + use<> {
    TABLE.iter().chain(settings.family.list().table)
}

/// Register number `index`.
pub fn info(settings: &Settings, index: usize) -> Option<&'static RegisterInfo> {
    let family = || settings.family.list().table.get(index.checked_sub(TABLE.len())?);
    TABLE.get(index).or_else(family)
}

/// Number of the register with this name.
pub fn find(settings: &Settings, name: &str) -> Option<usize> {
    all(settings).position(|info| info.name == name)
}

/// Numbers of register number `index`; `None` if there is no such register.
pub fn read(settings: &Settings, index: usize) -> Option<Numbers> {
    let info = info(settings, index)?;
    let mut numbers = Numbers { numbers: [Number::Natural32(0); JOINTS_MAX], count: info.count(settings) };
    for (joint, number) in JointIndex::first(numbers.count).zip(&mut numbers.numbers) {
        *number = get(settings, info, joint);
    }
    Some(numbers)
}

/// Writes register number `index`: all of its numbers, or nothing.
///
/// # Errors
///
/// [`Cause::BadValue`] for an unknown register, another type, another count or a number out of the
/// register's range (index: which number); [`Cause::SettingsInvalid`] if it does not go with the
/// other settings.
pub fn write(settings: &mut Settings, index: usize, numbers: &[Number]) -> Result<(), Refusal> {
    let info = info(settings, index).ok_or(Refusal::of(Cause::BadValue))?;
    let before = read(settings, index).ok_or(Refusal::of(Cause::BadValue))?;
    if numbers.len() != info.count(settings) {
        return Err(Refusal::of(Cause::BadValue));
    }
    if let Some(wrong) = numbers.iter().position(|number| !info.allows(*number)) {
        return Err(Refusal::in_file(Cause::BadValue, JointIndex::new(wrong).ok(), wrong));
    }
    put(settings, info, numbers);
    let outcome = settings.check();
    if outcome.is_err() {
        put(settings, info, before.as_slice());
    }
    outcome
}

impl Settings {
    /// Checks that each value is in the range of its register, and the conditions between values.
    ///
    /// # Errors
    ///
    /// The first joint with a value out of range, whose limits are not in order or whose address is taken.
    pub fn check(&self) -> Result<(), Refusal> {
        check_ranges(self)?;
        (self.family.list().check)(self)?;
        for joint in self.joints() {
            let j = self.joint.at(joint);
            // Written so that NaN fails.
            let in_order = j.q_min_rad < j.q_max_rad
                && j.jog_v_rad_s <= j.v_max_rad_s
                && j.jog_a_rad_s2 <= j.a_max_rad_s2;
            if !in_order {
                return Err(Refusal::at(Cause::SettingsInvalid, joint));
            }
            let taken =
                self.joints().any(|other| other != joint && self.joint.at(other).address == j.address);
            if taken {
                return Err(Refusal::at(Cause::DuplicateAddress, joint));
            }
        }
        let timing = self.reply_deadline_us <= self.cycle_period_us.max(self.monitor_period_us)
            && self.watchdog_refresh_us < self.watchdog_timeout_us
            && self.cycle_period_us < self.watchdog_timeout_us;
        if timing { Ok(()) } else { Err(Refusal::of(Cause::SettingsInvalid)) }
    }
}

/// True if every number of every register is in its range.
///
/// # Errors
///
/// [`Cause::SettingsInvalid`] with the joint of the first number out of range (`None`: of the group); index: the register.
pub fn check_ranges(settings: &Settings) -> Result<(), Refusal> {
    for (index, info) in all(settings).enumerate() {
        for joint in JointIndex::first(info.count(settings)) {
            if !info.allows(get(settings, info, joint)) {
                let joint = info.per_joint.then_some(joint);
                return Err(Refusal::in_file(Cause::SettingsInvalid, joint, index));
            }
        }
    }
    Ok(())
}

/// Checks that the change of register `index` from `old` to `settings` needs no unlock.
///
/// # Errors
///
/// [`Cause::LimitCeiling`] with the first joint whose limit becomes wider; index: the register.
pub fn check_widening(
    settings: &Settings,
    old: &Settings,
    ceiling: &Settings,
    index: usize,
) -> Result<(), Refusal> {
    let Some(info) = info(settings, index) else { return Ok(()) };
    let number = |settings: &Settings, joint| get(settings, info, joint);
    let widened = JointIndex::first(info.count(settings))
        .find(|&joint| info.widens(number(settings, joint), number(old, joint), number(ceiling, joint)));
    match widened {
        Some(joint) => Err(Refusal::in_file(Cause::LimitCeiling, info.per_joint.then_some(joint), index)),
        None => Ok(()),
    }
}

/// Puts every limit that is wider than in `ceiling` back to it; true if there was one. If the settings are then
/// inconsistent, all limits are set to those of `ceiling`; if they still are, all settings.
pub fn narrow(settings: &mut Settings, ceiling: &Settings) -> bool {
    let put_back = |settings: &mut Settings, every: bool| {
        let mut any = false;
        for info in all(settings).filter(|info| matches!(info.wider, Wider::More | Wider::Less)) {
            for joint in JointIndex::first(info.count(settings)) {
                let limit = get(ceiling, info, joint);
                if every || info.is_wider(get(settings, info, joint), limit) {
                    any = true;
                    // From the same register, so the type is right.
                    let _ = set(settings, info, joint, limit);
                }
            }
        }
        any
    };
    let any = put_back(settings, false);
    if any && settings.check().is_err() {
        put_back(settings, true);
        if settings.check().is_err() {
            *settings = *ceiling;
        }
    }
    any
}

/// Sets register number `index` to what a controller holds, or has stored. The numbers are checked on their own and
/// not against the other registers, since limits may pass through an inconsistent state. False if the numbers are
/// not allowed; then nothing changes.
pub fn set_held(settings: &mut Settings, index: usize, numbers: &[Number]) -> bool {
    let Some(info) = info(settings, index) else { return false };
    let fits = !numbers.is_empty() && (info.per_joint || numbers.len() == 1);
    let taken = fits && numbers.iter().all(|number| info.allows(*number));
    if taken {
        put(settings, info, numbers);
    }
    taken
}

/// Sets numbers of the register's type.
fn put(settings: &mut Settings, info: &RegisterInfo, numbers: &[Number]) {
    for (joint, number) in JointIndex::first(numbers.len()).zip(numbers) {
        // A number of another type changes nothing; the callers have checked the type.
        let _ = set(settings, info, joint, *number);
    }
}

/// Bytes of one stored register: key, count, eight numbers.
pub const ROW_LEN: usize = 8 + 4 * JOINTS_MAX;
/// Most registers of a controller.
pub const REGISTERS_MAX: usize = TABLE.len() + FAMILY_MAX;
/// Most bytes of the stored settings.
pub const STORED_LEN: usize = REGISTERS_MAX * ROW_LEN;

/// Key of a register in storage: the checksum of its name, so that a later version finds the registers that it
/// knows and skips the others.
fn key(info: &RegisterInfo) -> u32 {
    Crc32::of(info.name.as_bytes())
}

/// Stored form of register number `index`.
pub fn to_row(settings: &Settings, index: usize) -> Option<[u8; ROW_LEN]> {
    let info = info(settings, index)?;
    let numbers = read(settings, index)?;
    let mut row = [0; ROW_LEN];
    let (head, tail) = row.split_first_chunk_mut::<8>()?;
    let [k0, k1, k2, k3] = key(info).to_le_bytes();
    *head = [k0, k1, k2, k3, numbers.count as u8, 0, 0, 0];
    for (to, number) in tail.as_chunks_mut::<4>().0.iter_mut().zip(numbers.as_slice()) {
        *to = number.to_bits().to_le_bytes();
    }
    Some(row)
}

/// Takes a stored row; false if the register is unknown or its numbers are not allowed any more (the setting keeps
/// its value).
pub fn take_row(settings: &mut Settings, row: &[u8; ROW_LEN]) -> bool {
    let Some((head, tail)) = row.split_first_chunk::<8>() else { return false };
    let [k0, k1, k2, k3, count, ..] = *head;
    let wanted = u32::from_le_bytes([k0, k1, k2, k3]);
    let mut known = all(settings).enumerate().filter(|(_, info)| info.writable != Writable::Never);
    let Some((index, info)) = known.find(|(_, info)| key(info) == wanted) else { return false };
    let mut numbers = [Number::Natural32(0); JOINTS_MAX];
    for (number, bytes) in numbers.iter_mut().zip(tail.as_chunks::<4>().0) {
        *number = Number::from_bits(info.kind, u32::from_le_bytes(*bytes));
    }
    numbers.get(..usize::from(count)).is_some_and(|numbers| set_held(settings, index, numbers))
}

#[cfg(test)]
mod tests;
