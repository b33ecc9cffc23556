//! Guarantees of sessions: a recording that fails stops the arm first, a session that is dropped leaves it standing.

use std::cell::RefCell;
use std::io;
use std::rc::Rc;

use operator::bus::BusArgs;
use operator::bus::BusFailure;
use operator::bus::Session;
use operator::dialogue::jogging::JOG_HOLD;
use operator::dialogue::registers::Numbers;
use operator::tap::{Tap, Way};
use protocol::cyphal::cubecell::group_state::State;
use protocol::cyphal::id::NodeId;
use protocol::powercube::{Broadcast, Parameter};
use protocol::{Duration, Frame, Instant, JointIndex, ModuleId};

/// A disk with room for this many frames; further frames are seen all the same.
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

/// A session whose soft controller has found its drives.
fn controlled() -> (Session, NodeId) {
    let mut session = BusArgs::default().open_with_controller().unwrap();
    let node = session.find_controller(None).unwrap();
    session.wait_for(Duration::from_secs(10), &|state| state != State::Boot).unwrap();
    (session, node)
}

/// Position of the link of joint 3, from the plant.
fn third_rad(session: &mut Session) -> f64 {
    session.sim().unwrap().cell().plant().link_q_rad(2)
}

fn third() -> JointIndex {
    JointIndex::new(2).unwrap()
}

#[test]
fn a_disk_that_fills_up_while_a_joint_is_jogged_halts_it_and_says_so() {
    let (mut session, node) = controlled();
    let sent = Rc::new(RefCell::new(Vec::new()));
    session.add_tap(Box::new(Disk { room: 600, sent: Rc::clone(&sent) }));
    let started_rad = third_rad(&mut session);
    let error = session.jog_joint(node, third(), 0.2, &mut |_| true).unwrap_err();
    let text = format!("{error} {}", error.next().unwrap());
    assert!(
        text.contains("recording") && text.contains("halted first") && text.contains("free space"),
        "{text}"
    );
    assert!((third_rad(&mut session) - started_rad).abs() > 1e-3, "it never moved");
    session.pass(Duration::from_millis(500)).unwrap();
    let before = third_rad(&mut session);
    session.pass(Duration::from_millis(200)).unwrap();
    let after = third_rad(&mut session);
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

/// The joint may continue for as long as the last order is valid, and then brakes. `dies` is the action of the
/// session when the host is to die.
fn runs_on_after(dies: impl Fn(&mut Session)) {
    const V_RAD_S: f64 = 0.2;
    let (mut session, node) = controlled();
    let until = session.now() + Duration::from_millis(800);
    // Dies without a message: nothing is sent after this.
    let died = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
        session.jog_joint(node, third(), V_RAD_S, &mut |now| {
            assert!(now < until, "the host dies here");
            true
        })
    }));
    assert!(died.is_err());
    session.host_node().listen_only();
    dies(&mut session);
    let at_death = third_rad(&mut session);
    session.pass(JOG_HOLD + Duration::from_millis(400)).unwrap();
    let at_rest = third_rad(&mut session);
    session.pass(Duration::from_millis(200)).unwrap();
    let later = third_rad(&mut session);
    let ran_on = at_rest - at_death;
    // Braking from 0.2 rad/s at 1 rad/s² takes 0.02 rad.
    let most = V_RAD_S * JOG_HOLD.as_secs_f64() + 0.02 + 0.005;
    assert!(ran_on > 0.001 && ran_on < most, "ran on for {ran_on} rad, at most {most} allowed");
    assert!((later - at_rest).abs() < 1e-3, "still moving: {at_rest} -> {later}");
    session.release_motion();
}

#[test]
fn a_host_that_dies_in_a_jog_leaves_a_joint_that_stops_when_its_last_order_ends() {
    runs_on_after(|_| {});
}

#[test]
fn a_program_that_dies_in_a_jog_with_its_controller_leaves_a_joint_that_stops_all_the_same() {
    runs_on_after(Session::switch_controller_off);
}

#[test]
fn a_jog_ends_at_the_soft_limit_of_a_homed_joint_and_says_so() {
    let (mut session, node) = controlled();
    session.home_group(node, 0x3F, Duration::from_secs(120)).unwrap();
    let Numbers::Real(limits) = session.register(node, "joint.q_max_rad").unwrap() else { panic!() };
    // As near to it as a few seconds of a jog.
    let limit_rad = third_rad(&mut session) as f32 + 0.1;
    let narrow: Vec<f32> =
        limits.iter().enumerate().map(|(j, q)| if j == 2 { limit_rad } else { *q }).collect();
    session.set_register(node, "joint.q_max_rad", &Numbers::Real(narrow)).unwrap();
    let begun = session.now();
    let jogged =
        session.jog_joint(node, third(), 0.2, &mut |now| now < begun + Duration::from_secs(5)).unwrap();
    assert!(jogged.at_limit && jogged.held < Duration::from_secs(2), "{jogged:?}");
    assert!((third_rad(&mut session) - f64::from(limit_rad)).abs() < 3e-3, "{jogged:?}");
    assert_eq!(session.group().unwrap().state, State::Ready);
}

#[test]
fn a_full_disk_is_noticed_when_the_log_is_flushed() {
    // The device that is always full.
    let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
    let mut log = operator::log::candump::Log::new(full, "sim".to_owned(), Duration::ZERO);
    let written = log
        .frame(Instant::ZERO, Way::Sent, &Broadcast::Halt.encode())
        .and_then(|()| log.flush())
        .unwrap_err();
    assert_eq!(written.kind(), io::ErrorKind::StorageFull);
    let error = BusFailure::Recording { source: written, halted: true };
    assert!(error.to_string().contains("halted first"), "{error}");
    assert!(error.next().unwrap().starts_with("free space"), "{error}");
}
