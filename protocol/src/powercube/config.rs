//! Configuration word (parameters 0x39 and 0x1B) and set-up word (0x58).

use super::state::bit_word;

bit_word! {
    /// Configuration of a module.
    Config(u32) {
        0 ENCODER_FEEDBACK "incremental encoder (25xx; in the set-up word from 35xx)";
        1 RESOLVER_FEEDBACK "resolver (25xx; in the set-up word from 35xx)";
        2 ABSOLUTE_FEEDBACK "absolute encoder (25xx; in the set-up word from 35xx)";
        3 BRAKE_PRESENT "the module has a brake";
        4 BRAKE_AT_POWERON "brake stays on at power on (0: released)";
        5 SWR_WITH_ENCODERZERO "homing ends on the encoder index";
        6 SWR_AT_FALLING_EDGE "homing takes the falling edge of the home switch";
        7 CHANGE_SWR_TO_LIMIT "home switch is a limit switch after homing";
        8 SWR_ENABLED "home switch used";
        9 SWR_LOW_ACTIVE "home switch active low";
        10 SWR_USE_EXTERNAL "home switch from an input line (25xx: equals the positive limit)";
        11 SW1_ENABLED "limit switch 1 used";
        12 SW1_LOW_ACTIVE "limit switch 1 active low";
        13 SW1_USE_EXTERNAL "limit switch 1 from an input line";
        14 SW2_ENABLED "limit switch 2 used";
        15 SW2_LOW_ACTIVE "limit switch 2 active low";
        16 SW2_USE_EXTERNAL "limit switch 2 from an input line";
        17 LINEAR "linear module: metres instead of radians";
        18 OPENBRAKE_ON_SW2 "switch 2 opens the brake (25xx)";
        19 ALLOW_FULL_CUR "current motion may exceed the nominal current";
        20 M3_COMPATIBLE "behaves as the older generation: motion needs homing";
        21 LINEAR_SCREW "linear module with a screw";
        23 DISABLE_ON_HALT "motor current off on error";
        24 WATCHDOG_ENABLE "emergency stop when the host's sign of life stays away";
        25 ZERO_MOVE_AFTER_HOK "goes to zero after homing (35xx)";
        26 DISABLE_ACK "no answer to SET and commands, GET is still answered (CAN)";
        27 SYNC_MOTION "motions wait for the start broadcast (CAN)";
        28 SYNC_TRANSMIT "synchronous transmission (36xx); meaning unknown";
        30 CAN_RS232_COMM "CAN or serial line (25xx)";
        31 PROFI_RS485_COMM "PROFIBUS or RS-485 (25xx)";
    }
}

bit_word! {
    /// Set-up of a module: feedback, connectors, protocol.
    Setup(u32) {
        0 ENCODER_FEEDBACK "incremental encoder";
        1 RESOLVER_FEEDBACK "resolver";
        2 ABSOLUTE_FEEDBACK "absolute encoder";
        3 IO_4IN_4OUT "four inputs, four outputs";
        4 IO_3IN_ENCODER_IN "three inputs, encoder in";
        5 IO_3IN_ENCODER_OUT "three inputs, encoder out";
        6 RS232 "serial line";
        7 RS485_HALF_DUPLEX "RS-485 half duplex (older list)";
        8 RS485_FULL_DUPLEX "RS-485 full duplex (older list)";
        9 CAN "CAN";
        10 PROFIBUS "PROFIBUS";
        11 USE_M3ID "CAN ids of the older generation";
        12 USE_M4ID "CAN ids of this generation";
        13 USE_CANOPEN "CANopen";
        14 INVERT_MOTORDIR "motor direction inverted";
        15 USE_SW2_AS_ENABLE "switch 2 enables";
        16 USE_SW2_AS_BRAKE "switch 2 releases the brake";
        17 ERROR_TO_OUT0 "output 0 shows errors";
        18 INVERT_COUNTER "counter inverted (older list)";
        19 IO_GRIPPER_CONTROL "digital lines drive a gripper";
    }
}

impl Setup {
    /// True for modules that know their position at power on and start homed (the PRL series).
    pub const fn is_absolute(self) -> bool {
        self.intersects(Self::RESOLVER_FEEDBACK.union(Self::ABSOLUTE_FEEDBACK))
    }
}
