//! The parameter table, as data.
//!
//! One row per parameter gives the enum, its documentation, the codec's types and the DBC file.
//! "From firmware" gates are those of the manufacturer's host library ([`Gate`]); a module outside the
//! gate does not know the parameter or does not accept a write to it.

use core::fmt;

use super::firmware::{FirmwareVersion, Gate};
use super::value::ValueKind;

/// Unit of a parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Unit {
    /// A number without unit, a code or a word of bits.
    None,
    /// rad (linear modules: m).
    Rad,
    /// rad/s (linear modules: m/s).
    RadPerSec,
    /// rad/s² (linear modules: m/s²).
    RadPerSec2,
    /// A.
    Ampere,
    /// V.
    Volt,
    /// °C.
    Celsius,
    /// ms.
    Millis,
    /// Encoder ticks.
    Ticks,
    /// Encoder ticks per second.
    TicksPerSec,
    /// Encoder ticks per second squared.
    TicksPerSec2,
    /// Digits of a converter, -500..=500 for the commanded current.
    Digits,
}

impl Unit {
    /// Symbol, plain ASCII; empty for [`Unit::None`].
    pub const fn symbol(self) -> &'static str {
        match self {
            Self::None => "",
            Self::Rad => "rad",
            Self::RadPerSec => "rad/s",
            Self::RadPerSec2 => "rad/s2",
            Self::Ampere => "A",
            Self::Volt => "V",
            Self::Celsius => "degC",
            Self::Millis => "ms",
            Self::Ticks => "ticks",
            Self::TicksPerSec => "ticks/s",
            Self::TicksPerSec2 => "ticks/s2",
            Self::Digits => "digits",
        }
    }
}

/// One row of the parameter table.
#[derive(Clone, Copy, Debug)]
pub struct ParameterInfo {
    /// The parameter.
    pub parameter: Parameter,
    /// Name as the sources write it.
    pub name: &'static str,
    /// Type on the wire.
    pub kind: ValueKind,
    /// Unit of the value.
    pub unit: Unit,
    /// Firmware that answers GET; `None` if no source reads it.
    pub read: Option<Gate>,
    /// Firmware that accepts SET; `None` if no source writes it.
    pub write: Option<Gate>,
    /// What it is, and where sources disagree.
    pub meaning: &'static str,
}

impl ParameterInfo {
    /// True if a module of this firmware answers GET.
    pub fn readable(&self, version: FirmwareVersion) -> bool {
        self.read.is_some_and(|gate| gate.allows(version))
    }

    /// True if a module of this firmware accepts SET.
    pub fn writable(&self, version: FirmwareVersion) -> bool {
        self.write.is_some_and(|gate| gate.allows(version))
    }
}

macro_rules! parameters {
    (@gate -) => { None };
    (@gate $gate:ident) => { Some(Gate::$gate) };
    ($($code:literal $name:ident $kind:ident $unit:ident $read:tt $write:tt $meaning:literal;)*) => {
        /// Parameter number, byte 1 of GET and SET.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
        #[repr(u8)]
        pub enum Parameter {
            $(
                #[doc = concat!($meaning, ". Type ", stringify!($kind), ", unit ", stringify!($unit),
                    ", read ", stringify!($read), ", write ", stringify!($write), ".")]
                $name = $code,
            )*
        }

        impl Parameter {
            /// The table, in ascending order of the number.
            pub const TABLE: &[ParameterInfo] = &[
                $(ParameterInfo {
                    parameter: Self::$name,
                    name: stringify!($name),
                    kind: ValueKind::$kind,
                    unit: Unit::$unit,
                    read: parameters!(@gate $read),
                    write: parameters!(@gate $write),
                    meaning: $meaning,
                },)*
            ];

            /// From the number on the wire; `None` for numbers no source names.
            pub const fn from_code(code: u8) -> Option<Self> {
                match code {
                    $($code => Some(Self::$name),)*
                    _ => None,
                }
            }

            /// Type on the wire.
            pub const fn kind(self) -> ValueKind {
                match self {
                    $(Self::$name => ValueKind::$kind,)*
                }
            }
        }
    };
}

parameters! {
    0x00 DefHomeOffset F32 Rad Always - "default offset of the zero position";
    0x01 DefGearRatio F32 None Always From4601 "gear ratio";
    0x02 DefLinRatio F32 None Always From4601 "rotary to linear ratio";
    0x03 DefMinPos F32 Rad Always - "default lower soft limit";
    0x04 DefMaxPos F32 Rad Always - "default upper soft limit";
    0x05 DefMaxDeltaPos F32 Rad Always - "default largest allowed following error (tow)";
    0x06 DefMaxDeltaVel F32 RadPerSec Always - "default largest velocity error; three hosts, one of which stopped reading it";
    0x07 DefTorqueRatioOrCurOffset F32 None Always - "torque ratio (three hosts) or current offset (manufacturer's library): the sources disagree";
    0x08 DefCurRatio F32 None Always From4601 "scale of the current measurement";
    0x09 DefMinVel F32 RadPerSec Always - "default smallest velocity; not in the manufacturer's library";
    0x0A DefMaxVel F32 RadPerSec Always - "default largest velocity";
    0x0B DefMinAcc F32 RadPerSec2 Always - "default smallest acceleration; not in the manufacturer's library";
    0x0C DefMaxAcc F32 RadPerSec2 Always - "default largest acceleration";
    0x0D DefMinCur F32 Ampere Always - "default smallest current; not in the manufacturer's library";
    0x0E DefMaxCur F32 Ampere Always - "default largest current";
    0x0F DefHomeVel F32 RadPerSec Always - "default homing velocity, its sign is the direction";
    0x10 DefHomeAcc F32 RadPerSec2 Always From4601 "default homing acceleration";
    0x19 DefDioData U32 None Until34xx - "default digital lines; never sent by the manufacturer's library";
    0x1A DefSerialNo U32 None Always From4601 "serial number";
    0x1B DefConfig U32 None Always - "default configuration word";
    0x1C DefIncPerTurn U32 Ticks Always From4601 "encoder ticks per turn of the motor";
    0x1D DefVersion U16 None Always - "firmware version, four BCD digits; every host finds modules with it";
    0x1E DefServiceInterval U16 None Always - "service interval; two hosts";
    0x1F DefBrakeTimeOut U16 Millis Always From4601 "time before the brake is released";
    0x20 DefAddress U8 None Always From4601 "module address, 1..=31";
    0x22 DefCanBaud U8 None Always From4601 "CAN bit rate code";
    0x23 DefRsBaud U8 None Always From4601 "serial line bit rate code";
    0x24 PosCount I32 Ticks Always - "raw position counter";
    0x25 RefPosCount I32 Ticks Always - "raw counter at home; not in the manufacturer's library";
    0x26 DioData U32 None Always Always "bits 0-3 inputs, 4-7 outputs, 8 SWR, 9 SW1, 10 SW2";
    0x27 CubeState U32 None Always - "state word";
    0x28 TargetPosInc I32 Ticks Always Always "target position; uint32 in two hosts";
    0x29 TargetVelInc I32 TicksPerSec Always Always "target velocity; uint32 in two hosts, write only in the manufacturer's library";
    0x2A TargetAccInc I32 TicksPerSec2 Always Always "target acceleration; uint32 in two hosts, write only in the manufacturer's library";
    0x2B StepInc U32 Ticks Always - "step width; two hosts";
    0x2C HomeOffsetInc I32 Ticks Always Always "offset of the zero position";
    0x35 CurInc I16 Digits Always Always "commanded current, -500..=500; one host writes it";
    0x36 HomeToZeroInc I32 Ticks Always - "distance from home switch to encoder index; two hosts";
    0x39 Config U32 None Always Always "configuration word";
    0x3A MoveMode U8 None Always - "motion mode; two hosts";
    0x3B IncRatio F32 None Always - "encoder ticks per rad";
    0x3C ActPos F32 Rad Always - "actual position";
    0x3D PrevPos F32 Rad Always - "previous position; two hosts";
    0x3E IPolPos F32 Rad Always - "interpolated position; two hosts";
    0x3F DeltaPos F32 Rad Always - "actual following error (tow)";
    0x40 MaxDeltaPos F32 Rad Always Always "largest allowed following error (tow)";
    0x41 ActVel F32 RadPerSec Always - "actual velocity";
    0x42 IPolVel F32 RadPerSec Always - "interpolated velocity";
    0x45 MinPos F32 Rad Always Always "lower soft limit";
    0x46 MaxPos F32 Rad Always Always "upper soft limit";
    0x48 MaxVel F32 RadPerSec Always Always "largest velocity";
    0x4A MaxAcc F32 RadPerSec2 Always Always "largest acceleration";
    0x4C MaxCur F32 Ampere Always Always "largest current";
    0x4D Cur F32 Ampere Always - "actual current; one source calls it a pseudo current";
    0x4E TargetPos F32 Rad Always - "target position; access not stated";
    0x4F TargetVel F32 RadPerSec - Always "velocity of the following ramps";
    0x50 TargetAcc F32 RadPerSec2 - Always "acceleration of the following ramps";
    0x51 DefC0 I16 None Always - "default position loop gain C0";
    0x52 DefDamp I16 None Always - "default position loop damping";
    0x53 DefA0 I16 None Always - "default position loop A0";
    0x54 ActC0 I16 None Always Always "position loop gain C0, takes effect with RECALC";
    0x55 ActDamp I16 None Always Always "position loop damping, takes effect with RECALC";
    0x56 ActA0 I16 None Always Always "position loop A0, takes effect with RECALC";
    0x57 DefBurnCount U8 None Always - "times the permanent storage was written";
    0x58 DefSetup U32 None From3500 From4601 "set-up word";
    0x59 HomeOffset F32 Rad Always Always "offset of the zero position; 0x89 in one host is a decimal 89 misread";
    0x5A PosInc I32 Ticks Always - "actual position";
    0x5B MaxDeltaPosInc I32 Ticks Always Always "largest allowed following error (tow)";
    0x5C MinPosInc I32 Ticks Always Always "lower soft limit";
    0x5D MaxPosInc I32 Ticks Always Always "upper soft limit";
    0x5E MaxVelInc I32 TicksPerSec Always Always "largest velocity";
    0x5F MaxAccInc I32 TicksPerSec2 Always Always "largest acceleration";
    0x60 VelInc I32 TicksPerSec Always - "actual velocity";
    0x61 DeltaPosInc I32 Ticks Always - "actual following error (tow)";
    0x62 PosStateDio PosStateDio None From2518Or3518 - "actual position (rad), short state, digital lines";
    0x63 SavePos F32 Rad From2518Or3518 - "position latched by the save position broadcast";
    0x64 HomeVel F32 RadPerSec From2518Or3518 From2518Or3518 "homing velocity, its sign is the direction";
    0x65 HomeVelInc I32 TicksPerSec From2518Or3518 From2518Or3518 "homing velocity, its sign is the direction";
    0x66 SyncTime I16 None From3602 From3602 "synchronous transmission time; unit not stated";
    0x67 LoadLimit I32 None From351A From351A "load limit; unit not stated";
    0x68 MaxLoadGradient I32 None From351A From351A "largest load gradient; unit not stated";
    0x69 LoadDeltaTime U16 None From351A From351A "load time window; unit not stated";
    0x6C RawMotorCurrent I16 Digits From3602 - "motor current, raw";
    0x6D RawMotorSupply I16 Digits From3602 - "motor supply, raw";
    0x6E RawTemperature I16 Digits From3602 - "temperature, raw";
    0x6F RawLogicSupply I16 Digits From3602 - "logic supply, raw";
    0x70 MotorCurrent F32 Ampere From4601 - "motor current; near 0 on one arm";
    0x71 MotorSupply F32 Volt From4601 - "motor supply; constant on one arm";
    0x72 Temperature F32 Celsius From4601 - "temperature";
    0x73 LogicSupply F32 Volt From4601 - "logic supply";
    0x74 MinLogicVoltage F32 Volt From4601 From4601 "lowest logic voltage";
    0x75 MaxLogicVoltage F32 Volt From4601 From4601 "highest logic voltage";
    0x76 MinMotorVoltage F32 Volt From4601 From4601 "lowest motor voltage";
    0x77 MaxMotorVoltage F32 Volt From4601 From4601 "highest motor voltage";
    0x78 NominalMotorCurrent F32 Ampere From4601 From4601 "nominal motor current";
    0x79 MaximumMotorCurrent F32 Ampere From4601 From4601 "maximum motor current";
    0x7A LogicUndershootTime I32 None From4601 From4601 "tolerated time below the lowest logic voltage; unit not stated";
    0x7B LogicOvershootTime I32 None From4601 From4601 "tolerated time above the highest logic voltage; unit not stated";
    0x7C MotorUndershootTime I32 None From4601 From4601 "tolerated time below the lowest motor voltage; unit not stated";
    0x7D MotorOvershootTime I32 None From4601 From4601 "tolerated time above the highest motor voltage; unit not stated";
    0x7E NominalCurrentTime I32 None From4601 From4601 "tolerated time above the nominal current; unit not stated";
    0x7F MaximumCurrentTime I32 None From4601 From4601 "tolerated time at the maximum current; unit not stated";
    0x80 KpPwmLimit I32 None From4601 From4601 "proportional gain of the PWM limit";
    0x81 CurrentLimit F32 Ampere From4601 From4601 "current limit";
    0x82 MaxPwmOutput I32 None From4601 - "largest PWM output";
}

impl Parameter {
    /// The number on the wire.
    pub const fn code(self) -> u8 {
        self as u8
    }

    /// The parameter's row.
    pub fn info(self) -> &'static ParameterInfo {
        // Every variant has a row (tested), so the fallback never answers.
        Self::TABLE.iter().find(|row| row.parameter == self).unwrap_or(&FIRST_ROW)
    }

    /// Name as the sources write it.
    pub fn name(self) -> &'static str {
        self.info().name
    }
}

static FIRST_ROW: ParameterInfo = match Parameter::TABLE.first() {
    Some(row) => *row,
    None => panic!("the parameter table has rows"),
};

impl fmt::Display for Parameter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn accessible(version: u16, code: u8) -> (bool, bool) {
        let info = Parameter::from_code(code).unwrap().info();
        (info.readable(FirmwareVersion(version)), info.writable(FirmwareVersion(version)))
    }

    #[test]
    fn table_is_ascending_and_complete() {
        assert_eq!(Parameter::TABLE.len(), 105);
        assert!(Parameter::TABLE.windows(2).all(|pair| pair[0].parameter < pair[1].parameter));
        for row in Parameter::TABLE {
            assert_eq!(Parameter::from_code(row.parameter.code()), Some(row.parameter));
            assert_eq!(row.parameter.kind(), row.kind);
            assert_eq!(row.parameter.info().name, row.name);
        }
        for gap in [0x11, 0x18, 0x21, 0x2D, 0x43, 0x47, 0x6A, 0x6B, 0x83, 0x89, 0xFF] {
            assert_eq!(Parameter::from_code(gap), None);
        }
    }

    /// The gates of section 8 of the protocol reference, version by version.
    #[test]
    fn gates_refuse_what_the_manufacturers_library_refuses() {
        let refused = |version: u16| -> Vec<u8> {
            Parameter::TABLE
                .iter()
                .filter(|row| !row.readable(FirmwareVersion(version)) && row.read.is_some())
                .map(|row| row.parameter.code())
                .collect()
        };
        let range = |a: u8, b: u8| (a..=b).collect::<Vec<u8>>();
        let sync_and_raw = [vec![0x66], range(0x6C, 0x6F)].concat();
        let load = range(0x67, 0x69);
        let from_4601 = range(0x70, 0x82);
        let sorted = |mut list: Vec<u8>| {
            list.sort_unstable();
            list
        };
        let newest = [from_4601.clone(), sync_and_raw.clone(), load.clone()].concat();
        let saved = range(0x62, 0x65);
        assert_eq!(refused(0x2517), sorted([vec![0x58], saved.clone(), newest.clone()].concat()));
        assert_eq!(refused(0x2518), sorted([vec![0x58], newest.clone()].concat()));
        assert_eq!(refused(0x3500), sorted([vec![0x19], saved, newest.clone()].concat()));
        assert_eq!(refused(0x3519), sorted([vec![0x19], newest].concat()));
        assert_eq!(refused(0x351A), sorted([vec![0x19], sync_and_raw, from_4601.clone()].concat()));
        assert_eq!(refused(0x3602), sorted([vec![0x19], from_4601].concat()));
        assert_eq!(refused(0x4614), [0x19]);
    }

    #[test]
    fn defaults_are_writable_from_4601_only() {
        assert_eq!(accessible(0x4600, 0x01), (true, false));
        assert_eq!(accessible(0x4601, 0x01), (true, true));
        assert_eq!(accessible(0x4614, 0x3C), (true, false));
        assert_eq!(accessible(0x3519, 0x4F), (false, true));
    }
}
