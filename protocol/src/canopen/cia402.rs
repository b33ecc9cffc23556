//! Drives (CiA 402-2): state machine, modes, control and status words.

/// Object 6040: control word.
pub const CONTROL: u16 = 0x6040;
/// Object 6041: status word.
pub const STATUS: u16 = 0x6041;
/// Object 6060: ordered mode.
pub const MODE: u16 = 0x6060;
/// Object 6061: mode that is in force.
pub const MODE_DISPLAY: u16 = 0x6061;
/// Object 6064: position, in units of the drive.
pub const POSITION: u16 = 0x6064;
/// Object 607A: ordered position.
pub const TARGET_POSITION: u16 = 0x607A;
/// Object 60FF: ordered velocity.
pub const TARGET_VELOCITY: u16 = 0x60FF;
/// Object 6071: ordered torque, per mille of the rated one.
pub const TARGET_TORQUE: u16 = 0x6071;
/// Object 60B1: velocity that is fed forward.
pub const VELOCITY_OFFSET: u16 = 0x60B1;
/// Object 60B2: torque that is fed forward, per mille.
pub const TORQUE_OFFSET: u16 = 0x60B2;
/// Object 60FE: digital outputs; sub 1 their state, sub 2 which of them a host switches.
pub const OUTPUTS: u16 = 0x60FE;
/// Object 60C0: how mode 7 interpolates; 0: on straight lines.
pub const INTERPOLATION_SUBMODE: u16 = 0x60C0;
/// Object 60C1: sub 1 the ordered position of mode 7.
pub const INTERPOLATION_DATA: u16 = 0x60C1;
/// Object 60C4: positions of mode 7 that wait; sub 2 how many may.
pub const INTERPOLATION_BUFFER: u16 = 0x60C4;
/// Object 60C2: period of set points: sub 1 times ten to the power of sub 2, s.
pub const INTERPOLATION_TIME: u16 = 0x60C2;
/// Object 6502: modes that the drive has; bit n - 1 for mode n.
pub const SUPPORTED_MODES: u16 = 0x6502;
/// Largest speed of the motor, turns per minute unless [`VELOCITY_UNIT`] has another unit.
pub const MOTOR_SPEED_MAX: u16 = 0x6080;
/// SI unit of velocities.
pub const VELOCITY_UNIT: u16 = 0x60A9;

/// State of a drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum State {
    /// It starts.
    NotReady,
    /// No torque, high voltage may be missing.
    SwitchOnDisabled,
    /// No torque.
    ReadyToSwitchOn,
    /// High voltage, no torque.
    SwitchedOn,
    /// It follows set points.
    OperationEnabled,
    /// It brakes, or has braked.
    QuickStopActive,
    /// It reacts to an error.
    FaultReaction,
    /// An error; no torque.
    Fault,
}

/// Mask, value and state; bits 4 and 9 vary from drive to drive.
const STATES: [(u16, u16, State); 8] = [
    (0x4F, 0x00, State::NotReady),
    (0x4F, 0x40, State::SwitchOnDisabled),
    (0x6F, 0x21, State::ReadyToSwitchOn),
    (0x6F, 0x23, State::SwitchedOn),
    (0x6F, 0x27, State::OperationEnabled),
    (0x6F, 0x07, State::QuickStopActive),
    (0x4F, 0x0F, State::FaultReaction),
    (0x4F, 0x08, State::Fault),
];

/// Status word (object 6041).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Status(pub u16);

impl Status {
    /// The state; `None` if the bits are not a state.
    #[must_use]
    pub fn state(self) -> Option<State> {
        STATES.iter().find(|(mask, value, _)| self.0 & mask == *value).map(|(.., state)| *state)
    }

    /// A status word with the bits of this state only.
    #[must_use]
    pub fn of(state: State) -> Self {
        Self(STATES.iter().find(|(.., own)| *own == state).map_or(0, |(_, value, _)| *value))
    }

    /// Bit 4: high voltage is there.
    #[must_use]
    pub const fn voltage(self) -> bool {
        self.0 & 1 << 4 != 0
    }

    /// Bit 7: warning.
    #[must_use]
    pub const fn warning(self) -> bool {
        self.0 & 1 << 7 != 0
    }

    /// Bit 10: the target is reached; homing has ended.
    #[must_use]
    pub const fn target_reached(self) -> bool {
        self.0 & 1 << 10 != 0
    }

    /// Bit 11: a limit inside the drive binds.
    #[must_use]
    pub const fn internal_limit(self) -> bool {
        self.0 & 1 << 11 != 0
    }

    /// Bit 12: homing found its zero; a cyclic mode follows; interpolation runs.
    #[must_use]
    pub const fn mode_works(self) -> bool {
        self.0 & 1 << 12 != 0
    }

    /// Bit 13: following error; error of homing.
    #[must_use]
    pub const fn mode_fails(self) -> bool {
        self.0 & 1 << 13 != 0
    }
}

/// Control word (object 6040).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Control(pub u16);

impl Control {
    /// No voltage.
    pub const DISABLE_VOLTAGE: Self = Self(0x00);
    /// Brakes as object 605A says.
    pub const QUICK_STOP: Self = Self(0x02);
    /// To ready to switch on.
    pub const SHUT_DOWN: Self = Self(0x06);
    /// To switched on.
    pub const SWITCH_ON: Self = Self(0x07);
    /// To operation enabled.
    pub const ENABLE: Self = Self(0x0F);
    /// Its rising edge clears an error.
    pub const FAULT_RESET: Self = Self(0x80);

    /// The same with bit 4: homing starts, interpolation runs, a new set point of mode 1.
    #[must_use]
    pub const fn with_mode_bit(self) -> Self {
        Self(self.0 | 1 << 4)
    }

    /// The next control word on the way to operation enabled. `None` if the drive is there, is on its way by
    /// itself, or has a fault: a person must order to clear a fault.
    #[must_use]
    pub const fn towards_enabled(state: State) -> Option<Self> {
        match state {
            State::SwitchOnDisabled => Some(Self::SHUT_DOWN),
            State::ReadyToSwitchOn => Some(Self::SWITCH_ON),
            State::SwitchedOn => Some(Self::ENABLE),
            // After a quick stop a drive goes through switch on disabled, so that it does not continue its last motion.
            State::QuickStopActive => Some(Self::DISABLE_VOLTAGE),
            State::OperationEnabled | State::NotReady | State::FaultReaction | State::Fault => None,
        }
    }

    /// State of a drive after this word, from state `before`; for programs that simulate a drive. Transitions that
    /// a drive makes by itself are not included.
    #[must_use]
    pub const fn takes(self, state: State, before: Self) -> State {
        let rises = self.0 & 0x80 != 0 && before.0 & 0x80 == 0;
        match (state, self.0 & 0x0F) {
            (State::Fault, _) if rises => State::SwitchOnDisabled,
            (State::NotReady | State::Fault | State::FaultReaction, _) => state,
            // Bit 1 off: no voltage, in every state.
            (_, word) if word & 0b0010 == 0 => State::SwitchOnDisabled,
            // Bit 2 is 0: quick stop. Without torque there is nothing to brake.
            (State::OperationEnabled | State::QuickStopActive, word) if word & 0b0100 == 0 => {
                State::QuickStopActive
            }
            (_, word) if word & 0b0100 == 0 => State::SwitchOnDisabled,
            (State::QuickStopActive, _) => State::QuickStopActive,
            // Shut down.
            (_, word) if word & 0b0001 == 0 => State::ReadyToSwitchOn,
            (State::ReadyToSwitchOn, _) => State::SwitchedOn,
            (State::SwitchedOn, 0x0F) => State::OperationEnabled,
            (State::OperationEnabled, 0x07) => State::SwitchedOn,
            (state, _) => state,
        }
    }
}

/// Mode of operation (objects 6060 and 6061).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Mode {
    /// 1: to a position by the drive's own profile.
    ProfilePosition,
    /// 3: at a velocity by the drive's own profile.
    ProfileVelocity,
    /// 4: torque by the drive's own profile.
    ProfileTorque,
    /// 6: looks for its zero.
    Homing,
    /// 7: positions that the drive interpolates.
    InterpolatedPosition,
    /// 8: a position with each SYNC.
    CyclicPosition,
    /// 9: a velocity with each SYNC.
    CyclicVelocity,
    /// 10: a torque with each SYNC.
    CyclicTorque,
}

impl Mode {
    /// All of them.
    pub const ALL: [Self; 8] = [
        Self::ProfilePosition,
        Self::ProfileVelocity,
        Self::ProfileTorque,
        Self::Homing,
        Self::InterpolatedPosition,
        Self::CyclicPosition,
        Self::CyclicVelocity,
        Self::CyclicTorque,
    ];

    /// Its number.
    #[must_use]
    pub const fn number(self) -> i8 {
        match self {
            Self::ProfilePosition => 1,
            Self::ProfileVelocity => 3,
            Self::ProfileTorque => 4,
            Self::Homing => 6,
            Self::InterpolatedPosition => 7,
            Self::CyclicPosition => 8,
            Self::CyclicVelocity => 9,
            Self::CyclicTorque => 10,
        }
    }

    /// The mode with this number.
    #[must_use]
    pub fn of(number: i8) -> Option<Self> {
        Self::ALL.into_iter().find(|mode| mode.number() == number)
    }

    /// Whether a drive with these bits in object 6502 has it.
    #[must_use]
    pub const fn is_in(self, supported: u32) -> bool {
        supported >> (self.number() - 1) & 1 != 0
    }
}

/// Object 60C2 for a period in microseconds: mantissa and exponent to the base ten, s. `None` for 0 and for periods that this
/// form cannot hold.
#[must_use]
pub fn interpolation_time(period_us: u32) -> Option<(u8, i8)> {
    let (mut mantissa, mut exponent) = (period_us, -6_i8);
    // Ten divisions bring every u32 to zero.
    for _ in 0..10 {
        if mantissa == 0 || mantissa % 10 != 0 {
            break;
        }
        mantissa /= 10;
        exponent += 1;
    }
    u8::try_from(mantissa).ok().filter(|mantissa| *mantissa > 0).map(|mantissa| (mantissa, exponent))
}
