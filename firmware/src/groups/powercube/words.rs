//! What a drive's state words say (pure): each function gives the cause of what is wrong, or none.

use protocol::powercube::{CubeState, ShortState};

use crate::fault::Cause;

/// The gravest thing that a state word reports. `halted_is_fine`: the controller halted the drive.
pub fn check_state_word(state: CubeState, halted_is_fine: bool) -> Option<Cause> {
    let table = [
        (CubeState::POW_VOLT_ERR, Cause::DriveSupply),
        (CubeState::POWERFAULT, Cause::DrivePowerFault),
        (CubeState::POW_FET_TEMP, Cause::DrivePowerFault),
        (CubeState::POW_WDG_TEMP, Cause::DrivePowerFault),
        (CubeState::POW_SHORTCUR, Cause::DrivePowerFault),
        (CubeState::POW_HALLERR, Cause::DrivePowerFault),
        (CubeState::POW_INTEGRALERR, Cause::DrivePowerFault),
        (CubeState::CPU_OVERLOAD, Cause::DrivePowerFault),
        (CubeState::BEYOND_HARD, Cause::DriveHardLimit),
        (CubeState::TOW_ERROR, Cause::DriveTowError),
        (CubeState::BEYOND_SOFT, Cause::DriveSoftLimit),
        (CubeState::COMM_ERROR, Cause::DriveWatchdog),
        (CubeState::ERROR, Cause::DriveError),
    ];
    let cause = table.into_iter().find(|(bits, _)| state.intersects(*bits)).map(|(_, cause)| cause);
    let halted = state.intersects(CubeState::HALTED) && !halted_is_fine;
    cause.or(halted.then_some(Cause::DriveError))
}

/// Error or halt of a drive that has found its zero, from the byte in every motion answer.
pub fn check_short_state(short: ShortState) -> Option<Cause> {
    short.intersects(ShortState::NOT_OK).then_some(Cause::DriveError)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_error_bit_of_the_state_word_has_a_cause() {
        for bit in 0..32 {
            let state = CubeState::from_bits(1 << bit);
            let is_error = state.intersects(CubeState::CAUSES) || state.intersects(CubeState::ERROR);
            if is_error && !state.intersects(CubeState::SETUP_OR_LOGIC_VOLT) {
                assert!(check_state_word(state, true).is_some(), "{state}");
            }
        }
        assert_eq!(check_state_word(CubeState::HALTED, true), None);
        assert_eq!(check_state_word(CubeState::HALTED, false), Some(Cause::DriveError));
        assert_eq!(check_state_word(CubeState::HOME_OK.union(CubeState::RAMP_END), false), None);
        let many = CubeState::ERROR.union(CubeState::TOW_ERROR).union(CubeState::POWERFAULT);
        assert_eq!(check_state_word(many, false), Some(Cause::DrivePowerFault));
    }
}
