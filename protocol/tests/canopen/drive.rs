//! The state machine of a drive, against its table in the reference.

use protocol::canopen::cia402::{Control, Mode, State, Status, interpolation_time};

const STATES: [State; 8] = [
    State::NotReady,
    State::SwitchOnDisabled,
    State::ReadyToSwitchOn,
    State::SwitchedOn,
    State::OperationEnabled,
    State::QuickStopActive,
    State::FaultReaction,
    State::Fault,
];

#[test]
fn status_words_of_real_drives_are_read_with_their_other_bits() {
    for (word, state) in [
        (0x0250, State::SwitchOnDisabled),
        (0x0231, State::ReadyToSwitchOn),
        (0x0233, State::SwitchedOn),
        (0x1637, State::OperationEnabled),
        (0x0217, State::QuickStopActive),
        (0x021F, State::FaultReaction),
        (0x0218, State::Fault),
        (0x0000, State::NotReady),
    ] {
        assert_eq!(Status(word).state(), Some(state), "{word:04X}");
    }
    // Each word is at most one state, for all values of the other bits.
    for word in 0..=u16::MAX {
        if let Some(state) = Status(word).state() {
            assert_eq!(Status(word & 0x6F | Status::of(state).0 & 0x20).state(), Some(state), "{word:04X}");
        }
    }
    for state in STATES {
        assert_eq!(Status::of(state).state(), Some(state));
    }
    let follows = Status(0x1637);
    assert!(follows.mode_works() && follows.target_reached() && follows.voltage() && !follows.mode_fails());
}

#[test]
fn a_drive_is_enabled_step_by_step_and_a_fault_only_by_an_edge() {
    let (mut state, mut last) = (State::SwitchOnDisabled, Control(0));
    let mut seen = vec![state];
    while let Some(control) = Control::towards_enabled(state) {
        (state, last) = (control.takes(state, last), control);
        seen.push(state);
    }
    assert_eq!(
        seen,
        [State::SwitchOnDisabled, State::ReadyToSwitchOn, State::SwitchedOn, State::OperationEnabled]
    );
    // A quick stop of a drive that holds, and the way back.
    let stopped = Control::QUICK_STOP.takes(State::OperationEnabled, last);
    assert_eq!(stopped, State::QuickStopActive);
    assert_eq!(Control::ENABLE.takes(stopped, Control::QUICK_STOP), stopped);
    assert_eq!(Control::towards_enabled(stopped).unwrap().takes(stopped, last), State::SwitchOnDisabled);
    // Only the rising edge of bit 7 clears a fault, and no word on the way to enabled has it.
    assert_eq!(Control::towards_enabled(State::Fault), None);
    for word in 0..=u16::MAX {
        for before in [0, 0x80] {
            let cleared = Control(word).takes(State::Fault, Control(before)) != State::Fault;
            assert_eq!(cleared, word & 0x80 != 0 && before == 0, "{word:04X}");
        }
    }
}

#[test]
fn no_word_leads_to_torque_but_through_switched_on() {
    for state in STATES {
        for word in 0..=0xFF {
            let next = Control(word).takes(state, Control(0));
            if next == State::OperationEnabled {
                assert!(matches!(state, State::SwitchedOn | State::OperationEnabled), "{state:?} {word:02X}");
            }
            // Without voltage there is no torque, wherever the drive was.
            if word & 0b10 == 0 {
                assert!(!matches!(next, State::SwitchedOn | State::OperationEnabled), "{state:?} {word:02X}");
            }
        }
    }
}

#[test]
fn modes_and_periods_have_their_numbers() {
    for (number, mode) in [
        (1, Mode::ProfilePosition),
        (6, Mode::Homing),
        (7, Mode::InterpolatedPosition),
        (8, Mode::CyclicPosition),
    ] {
        assert_eq!((mode.number(), Mode::of(number)), (number, Some(mode)));
    }
    assert_eq!(Mode::of(0), None);
    // A SCHUNK module reports 0x43: modes 1, 2 and 7.
    let modes: Vec<Mode> = Mode::ALL.into_iter().filter(|mode| mode.is_in(0x43)).collect();
    assert_eq!(modes, [Mode::ProfilePosition, Mode::InterpolatedPosition]);
    assert_eq!(interpolation_time(2000), Some((2, -3)));
    assert_eq!(interpolation_time(10_000), Some((1, -2)));
    assert_eq!(interpolation_time(1500), Some((15, -4)));
    assert_eq!(interpolation_time(1_000_000), Some((1, 0)));
    assert_eq!((interpolation_time(0), interpolation_time(2_551_000)), (None, None));
}
