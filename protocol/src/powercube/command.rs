//! Byte 0 of every frame to a module.

macro_rules! commands {
    ($($(#[$doc:meta])* $name:ident = $code:literal, $text:literal;)*) => {
        /// Command byte.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        #[repr(u8)]
        pub enum Command {
            $($(#[$doc])* $name = $code,)*
        }

        impl Command {
            /// All commands in ascending order.
            pub const ALL: &[Self] = &[$(Self::$name,)*];

            /// From the byte on the wire.
            pub const fn from_code(code: u8) -> Option<Self> {
                match code {
                    $($code => Some(Self::$name),)*
                    _ => None,
                }
            }

            /// The byte on the wire.
            pub const fn code(self) -> u8 {
                self as u8
            }

            /// Name as the sources write it.
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$name => $text,)*
                }
            }
        }
    };
}

commands! {
    /// Clears the error and halt state where the cause is gone.
    Reset = 0x00, "RESET";
    /// Starts homing; acknowledged at once, the end is seen in the state word.
    Home = 0x01, "HOME";
    /// Emergency stop.
    Halt = 0x02, "HALT";
    /// Known by name only.
    ToggleHome = 0x03, "TOGGLEHOME";
    /// Meaning unknown, seven bytes of data.
    Internal = 0x04, "INTERNAL";
    /// Sign of life of the host; customarily a broadcast.
    Watchdog = 0x07, "WATCHDOG";
    /// Writes a parameter.
    SetParameter = 0x08, "SET_PARAMETER";
    /// Recalculates the position loop (addressed); sets the bit rate (broadcast).
    Recalc = 0x09, "RECALC_OR_BAUD";
    /// Reads a parameter.
    GetParameter = 0x0A, "GET_PARAMETER";
    /// Starts a motion.
    SetMotion = 0x0B, "SET_MOTION";
    /// Step motion in ticks, probably int32 ticks and uint16 ms; length known, layout inferred.
    SetStepInc = 0x0D, "SET_STEP_INC";
    /// Latches the position (broadcast).
    SavePosition = 0x0E, "SAVE_POSITION";
    /// Starts motions that wait for it (broadcast).
    StartMotion = 0x0F, "START_MOTION";
    /// Writes the parameters to permanent storage.
    SaveParameters = 0x10, "SAVE_PARAMETERS";
    /// Resets the internal clock; named by one serial-line host only.
    ResetClock = 0x12, "RESET_CLOCK";
}

/// Addressed commands that are one byte long and answered with the same byte.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum SimpleCommand {
    /// [`Command::Reset`].
    Reset,
    /// [`Command::Home`].
    Home,
    /// [`Command::Halt`].
    Halt,
    /// [`Command::ToggleHome`].
    ToggleHome,
    /// [`Command::Watchdog`] sent to one module, as one host does; it reads no answer.
    Watchdog,
    /// [`Command::Recalc`]: the position loop takes over C0, Damp and A0.
    Recalc,
    /// [`Command::SaveParameters`].
    SaveParameters,
    /// [`Command::ResetClock`].
    ResetClock,
}

impl SimpleCommand {
    /// All of them.
    pub const ALL: &[Self] = &[
        Self::Reset,
        Self::Home,
        Self::Halt,
        Self::ToggleHome,
        Self::Watchdog,
        Self::Recalc,
        Self::SaveParameters,
        Self::ResetClock,
    ];

    /// The command byte.
    pub const fn command(self) -> Command {
        match self {
            Self::Reset => Command::Reset,
            Self::Home => Command::Home,
            Self::Halt => Command::Halt,
            Self::ToggleHome => Command::ToggleHome,
            Self::Watchdog => Command::Watchdog,
            Self::Recalc => Command::Recalc,
            Self::SaveParameters => Command::SaveParameters,
            Self::ResetClock => Command::ResetClock,
        }
    }

    /// The simple form of a command; `None` for commands that carry data.
    pub const fn of(command: Command) -> Option<Self> {
        match command {
            Command::Reset => Some(Self::Reset),
            Command::Home => Some(Self::Home),
            Command::Halt => Some(Self::Halt),
            Command::ToggleHome => Some(Self::ToggleHome),
            Command::Watchdog => Some(Self::Watchdog),
            Command::Recalc => Some(Self::Recalc),
            Command::SaveParameters => Some(Self::SaveParameters),
            Command::ResetClock => Some(Self::ResetClock),
            Command::Internal
            | Command::SetParameter
            | Command::GetParameter
            | Command::SetMotion
            | Command::SetStepInc
            | Command::SavePosition
            | Command::StartMotion => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn command_bytes_round_trip_and_gaps_are_unknown() {
        for code in 0..=255 {
            if let Some(command) = Command::from_code(code) {
                assert_eq!(command.code(), code);
            }
        }
        for gap in [0x05, 0x06, 0x0C, 0x11, 0x13, 0x64] {
            assert_eq!(Command::from_code(gap), None);
        }
        assert!(SimpleCommand::ALL.iter().all(|&simple| SimpleCommand::of(simple.command()) == Some(simple)));
    }
}
