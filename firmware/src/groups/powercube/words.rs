//! What a drive's state words say (pure): each function gives the cause of what is wrong, or none.

use protocol::powercube::{CubeState, ShortState};

use crate::fault::Cause;

/// The gravest error that a state word reports; a halt is none.
pub fn error_of(state: CubeState) -> Option<Cause> {
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
    table.into_iter().find(|(bits, _)| state.intersects(*bits)).map(|(_, cause)| cause)
}

/// [`error_of`], or a halt.
pub fn check_state_word(state: CubeState) -> Option<Cause> {
    error_of(state).or(state.intersects(CubeState::HALTED).then_some(Cause::DriveError))
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
                assert!(error_of(state).is_some(), "{state}");
            }
        }
        assert_eq!(error_of(CubeState::HALTED), None);
        assert_eq!(check_state_word(CubeState::HALTED), Some(Cause::DriveError));
        assert_eq!(check_state_word(CubeState::HOME_OK.union(CubeState::RAMP_END)), None);
        let many = CubeState::ERROR.union(CubeState::TOW_ERROR).union(CubeState::POWERFAULT);
        assert_eq!(check_state_word(many), Some(Cause::DrivePowerFault));
    }
}
