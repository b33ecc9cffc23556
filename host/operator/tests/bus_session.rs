//! What sessions promise: a recording that fails stops the arm first, a session that is dropped leaves it standing.

use std::cell::RefCell;
use std::io;
use std::rc::Rc;

use operator::bus::BusArgs;
use operator::bus::BusFailure;
use operator::dialogue::motion;
use operator::tap::{Tap, Way};
use protocol::powercube::{Broadcast, Parameter};
use protocol::{Duration, Frame, Instant, ModuleId};

/// A disk with room for so many frames; what passes is seen all the same.
struct Disk {
    room: usize,
    sent: Rc<RefCell<Vec<Frame>>>,
}

impl Tap for Disk {
    fn frame(&mut self, _: Instant, way: Way, frame: &Frame) -> io::Result<()> {
        if way == Way::Sent {
            self.sent.borrow_mut().push(*frame);
        }
        self.room = self.room.checked_sub(1).ok_or(io::ErrorKind::StorageFull)?;
        Ok(())
    }
}

#[test]
fn a_disk_that_fills_up_while_a_module_is_jogged_halts_it_and_says_so() {
    let module = ModuleId::new(3).unwrap();
    let mut session = BusArgs::default().open().unwrap();
    let sent = Rc::new(RefCell::new(Vec::new()));
    session.add_tap(Box::new(Disk { room: 60, sent: Rc::clone(&sent) }));
    let error = motion::jog(&mut session, module, 0.2, &mut |_| true).unwrap_err();
    let text = error.to_string();
    assert!(
        text.contains("recording") && text.contains("halted first") && text.contains("free space"),
        "{text}"
    );
    session.pass(Duration::from_millis(500)).unwrap();
    let before = session.get_f64(module, Parameter::ActPos).unwrap();
    session.pass(Duration::from_millis(200)).unwrap();
    let after = session.get_f64(module, Parameter::ActPos).unwrap();
    assert!((before - after).abs() < 1e-3, "still moving: {before} -> {after}");
}

#[test]
fn a_recording_that_fails_while_nothing_moves_sends_no_halt() {
    let mut session = BusArgs::default().open().unwrap();
    let sent = Rc::new(RefCell::new(Vec::new()));
    session.add_tap(Box::new(Disk { room: 3, sent: Rc::clone(&sent) }));
    let failed = session
        .get_f64(ModuleId::new(1).unwrap(), Parameter::ActPos)
        .and_then(|_| session.get_f64(ModuleId::new(2).unwrap(), Parameter::ActPos));
    let operator::dialogue::ask::AskError::Bus(BusFailure::Recording { halted, .. }) = failed.unwrap_err()
    else {
        panic!("another error")
    };
    assert!(!halted);
    assert!(!sent.borrow().contains(&Broadcast::Halt.encode()));
}

#[test]
fn a_host_that_dies_in_a_jog_leaves_a_module_that_stops_within_the_horizon() {
    const V_RAD_S: f64 = 0.2;
    let module = ModuleId::new(3).unwrap();
    let mut session = BusArgs::default().open().unwrap();
    let until = session.now() + Duration::from_millis(600);
    // Dies without a word: nothing is sent after this.
    let died = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
        motion::jog(&mut session, module, V_RAD_S, &mut |now| {
            assert!(now < until, "the host dies here");
            true
        })
    }));
    assert!(died.is_err());
    session.desk().drives.cancel_all();
    let at_death = session.get_f64(module, Parameter::ActPos).unwrap();
    session.pass(motion::JOG_HORIZON + Duration::from_millis(150)).unwrap();
    let at_rest = session.get_f64(module, Parameter::ActPos).unwrap();
    session.pass(Duration::from_millis(200)).unwrap();
    let later = session.get_f64(module, Parameter::ActPos).unwrap();
    let ran_on = at_rest - at_death;
    let most = V_RAD_S * motion::JOG_HORIZON.as_secs_f64() + 0.005;
    assert!(ran_on > 0.001 && ran_on < most, "ran on for {ran_on} rad, at most {most} allowed");
    assert!((later - at_rest).abs() < 1e-3, "still moving: {at_rest} -> {later}");
}

#[test]
fn a_full_disk_is_noticed_when_the_log_is_flushed() {
    // The device that is always full.
    let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
    let mut log = operator::log::candump::Log::new(full, "sim".to_owned());
    let written = log
        .frame(Instant::ZERO, Way::Sent, &Broadcast::Halt.encode())
        .and_then(|()| log.flush())
        .unwrap_err();
    assert_eq!(written.kind(), io::ErrorKind::StorageFull);
    let text = BusFailure::Recording { source: written, halted: true }.to_string();
    assert!(text.contains("halted first") && text.contains("next: free space"), "{text}");
}
