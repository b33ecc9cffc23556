//! Exit codes of `cubectl`, stable across versions.

use operator::job::Outcome;

/// Done.
pub const OK: u8 = 0;
pub const BUG: u8 = 1;
/// The command line makes no sense (given by the argument parser).
pub const USAGE: u8 = 2;
/// No throw reaches the target, or no catch is possible.
pub const NO_THROW: u8 = 3;
/// A file cannot be read, is damaged, newer, or for another robot; or a value in it or on the command line is refused.
pub const BAD_INPUT: u8 = 4;
/// A plan does not hold what it claims.
pub const CHECK_FAILED: u8 = 5;
/// Interrupted by a signal before there was a result; what moved was stopped.
pub const INTERRUPTED: u8 = operator::interrupt::INTERRUPTED;
/// The bus cannot be reached, or was lost.
pub const BUS: u8 = 7;
/// A drive does not answer, refuses, is in error, or did not do what it should.
pub const DRIVE: u8 = 8;
/// It was looked at, and something is wrong: doctor found a problem, a replay or a configuration differs.
pub const FINDINGS: u8 = 9;
/// A result or a recording cannot be written.
pub const OUTPUT: u8 = 10;

/// The throw ran to its end; the ball landed beyond the tolerance, or touched the arm.
pub const MISSED: u8 = 11;
/// The throw ran to its end; the ball did not leave the hand.
pub const NOT_RELEASED: u8 = 12;
/// The controller stopped the arm while it moved, or somebody stopped it at any time.
pub const STOPPED: u8 = 13;

/// Code, meaning and next step of each, for `cubectl explain` and the help.
pub const TABLE: &[(u8, &str, &str)] = &[
    (
        OK,
        "done; of a throw: the ball was seen to land within the tolerance, or nobody watched it",
        "read which of the two",
    ),
    (BUG, "a bug in cubectl", "report it with the command line and the recording"),
    (USAGE, "the command line makes no sense", "see `cubectl help VERB`"),
    (
        NO_THROW,
        "no throw reaches the target, or no catch is possible",
        "choose a nearer target or relax a limit; throw the disc slower or from farther away",
    ),
    (BAD_INPUT, "a file or a value is refused", "the message names file, key and what would be right"),
    (CHECK_FAILED, "a plan does not hold what it claims", "plan again; do not run it"),
    (INTERRUPTED, "interrupted before there was a result", "run it again; what moved was stopped first"),
    (BUS, "the bus cannot be reached, or was lost", "do what the message says, then `cubectl doctor`"),
    (DRIVE, "a drive does not answer, refuses or is in error", "`cubectl doctor` names module and cause"),
    (FINDINGS, "it was looked at, and something is wrong", "the output lists what and where"),
    (OUTPUT, "a result or a recording cannot be written", "free space, or write to another place"),
    (
        MISSED,
        "the ball landed beyond the tolerance or touched the arm",
        "`cubectl log report` on the folder shows tracking and release; `cubectl home --verify` looks for lost counts",
    ),
    (
        NOT_RELEASED,
        "the ball did not leave the hand",
        "take the ball out; check the gripper, its supply and its output",
    ),
    (
        STOPPED,
        "the controller stopped the arm while it moved, or somebody stopped it at any time",
        "the message names joint, cause and folder; `cubectl explain CODE`, then `cubectl controller clear`",
    ),
];

/// Exit code of a job; `None`: that of the cause.
#[must_use]
pub const fn of_outcome(outcome: Outcome) -> Option<u8> {
    match outcome {
        Outcome::Landed | Outcome::NotObserved | Outcome::Reached | Outcome::Stored => Some(OK),
        Outcome::Missed => Some(MISSED),
        Outcome::NotReleased => Some(NOT_RELEASED),
        Outcome::Stopped => Some(STOPPED),
        Outcome::NotReached => Some(DRIVE),
        Outcome::NotThrown | Outcome::NotRun => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_exit_code_of_every_outcome_is_documented() {
        for code in Outcome::ALL.into_iter().filter_map(of_outcome) {
            assert!(TABLE.iter().any(|row| row.0 == code), "{code}");
        }
    }

    #[test]
    fn every_code_is_in_the_table_once_and_in_order() {
        let codes: Vec<u8> = TABLE.iter().map(|row| row.0).collect();
        assert_eq!(codes, (0..=13).collect::<Vec<u8>>());
    }
}
