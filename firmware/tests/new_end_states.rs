//! New end states in flight, measured at the drives: a moving catch point at 120 Hz, refusals that change nothing,
//! stops on the way, and which nodes may order them.

use crate::bench::host::Host;
use crate::bench::*;
use firmware::authority::Peer;
use firmware::envelope::Envelope;
use firmware::events::Action;
use firmware::fault::Cause;
use firmware::joints::PerJoint;
use firmware::orders::{Order, Target};
use firmware::retarget::EndState;
use firmware::settings::Settings;
use firmware::state::StateKind;
use firmware::store::FileName;
use firmware::trajectory_format::{Header, rest};
use protocol::cyphal::bits::{Decode, Encode};
use protocol::cyphal::cubecell::command;
use protocol::cyphal::cubecell::target::{self, TargetAnswer, TargetEvent, TargetJoint, TargetState};
use protocol::cyphal::id::{NodeId, Priority, Route};
use protocol::cyphal::rx::Port;
use protocol::cyphal::uavcan::command::Status;
use protocol::{Duration, Instant};

/// Where the arm waits.
const WAIT_RAD: [f64; 6] = [0.0, -0.8, -2.4, 0.1, -0.9, 0.0];
/// Time between two end states.
const UPDATE_US: u64 = 8_333;

/// A plan that stands for 20 s and takes new end states.
fn wait_file() -> Vec<u8> {
    let mut q_rad = PerJoint::default();
    for (i, q) in WAIT_RAD.into_iter().enumerate() {
        q_rad.set(joint(i), q as f32);
    }
    let envelope = Some(Envelope::widest(&Settings::powercube6()));
    let header = Header { joints: 6, period_us: 3_000, envelope, ..Header::default() };
    file(&header, &rest(q_rad, 20_000_000))
}

fn waiting() -> (Bench, FileName) {
    let mut bench = Bench::ready(Options::default(), &WAIT_RAD);
    let name = bench.start(&wait_file());
    bench.run_for(200_000);
    assert_eq!(bench.kind(), StateKind::Running);
    (bench, name)
}

fn target(at: Instant, state: impl Fn(usize) -> (f64, f64)) -> Target {
    let mut target = Target { at, joints: 6, ..Target::default() };
    for i in 0..6 {
        let (q, qd) = state(i);
        target.state.set(joint(i), EndState { q_rad: q as f32, qd_rad_s: qd as f32 });
    }
    target
}

/// A catch half a second from now: a way of up to 0.3 rad, and speeds up to 0.9 rad/s.
const CATCH: [(f64, f64); 6] = [(0.25, 0.6), (-0.6, 0.9), (-2.5, -0.5), (0.2, 0.4), (-1.1, -0.8), (0.3, 0.9)];

/// Motion of the drives.
#[derive(Debug, Default)]
struct Seen {
    fastest: [f64; 6],
    hardest: [f64; 6],
    q: [(f64, f64); 6],
    last_v: Option<[f64; 6]>,
}

impl Seen {
    /// Records a millisecond.
    fn take(&mut self, bench: &Bench) {
        let v: [f64; 6] = core::array::from_fn(|i| bench.drives[i].speed());
        for i in 0..6 {
            let q = bench.drives[i].q;
            self.q[i] = (self.q[i].0.min(q), self.q[i].1.max(q));
            self.fastest[i] = self.fastest[i].max(v[i].abs());
            if let Some(last) = self.last_v {
                self.hardest[i] = self.hardest[i].max((v[i] - last[i]).abs() / 1e-3);
            }
        }
        self.last_v = Some(v);
    }

    fn check(&self, settings: &Settings) {
        for i in 0..6 {
            let limits = settings.joint.at(joint(i));
            assert!(self.fastest[i] <= limits.v_max_rad_s.into(), "joint {i}: {self:?}");
            // The position loop of the drive overshoots a step of the acceleration.
            assert!(self.hardest[i] <= 1.35 * f64::from(limits.a_max_rad_s2), "joint {i}: {self:?}");
            let (low, high) = (f64::from(limits.q_min_rad), f64::from(limits.q_max_rad));
            assert!(self.q[i].0 >= low && self.q[i].1 <= high, "joint {i}: {self:?}");
        }
    }
}

/// End states at 120 Hz for half a second, with an estimate that converges; position and speed errors at the arrival.
fn catch(seed: u64) -> ([f64; 6], [f64; 6], Seen, Bench) {
    let (mut bench, _) = waiting();
    let mut rng = Rng(seed);
    let arrive = bench.instant() + Duration::from_millis(620);
    let mut seen = Seen::default();
    let mut taken = 0;
    for update in 0..60u64 {
        // 20 mm on half a metre, and less with every sample.
        let scale = 0.04 / (1.0 + update as f64 / 6.0);
        let noise: [f64; 12] = core::array::from_fn(|_| scale * (rng.below(2_001) as f64 * 1e-3 - 1.0));
        let aim = target(arrive, |i| (CATCH[i].0 + noise[i], CATCH[i].1 + noise[6 + i]));
        bench.order(Order::Retarget(aim)).unwrap_or_else(|refusal| panic!("update {update}: {refusal:?}"));
        taken += 1;
        let next = bench.now + UPDATE_US;
        while bench.now < next {
            bench.run_for(1_000.min(next - bench.now));
            if bench.now < next {
                seen.take(&bench);
            } else {
                seen.last_v = None;
            }
        }
    }
    let last = target(arrive, |i| CATCH[i]);
    bench.order(Order::Retarget(last)).unwrap();
    taken += 1;
    let at = bench.instant();
    assert_eq!(bench.controller.take_sample(at).targets_taken, taken);
    seen.last_v = None;
    while bench.instant() < arrive {
        bench.run_for(1_000.min(arrive.as_micros() - bench.now));
        seen.take(&bench);
    }
    let errors = core::array::from_fn(|i| bench.drives[i].q - CATCH[i].0);
    let rates = core::array::from_fn(|i| bench.drives[i].speed() - CATCH[i].1);
    seen.last_v = None;
    while bench.kind() == StateKind::Running {
        bench.run_for(1_000);
        seen.take(&bench);
    }
    (errors, rates, seen, bench)
}

#[test]
fn end_states_at_120_hz_are_followed_without_a_jump_and_met_in_time_and_the_arm_then_rests() {
    for seed in 1..=5 {
        let (errors, rates, seen, bench) = catch(seed);
        println!("seed {seed}: {errors:.5?} rad, {rates:.4?} rad/s, {:.2?} rad/s2", seen.hardest);
        let settings = Settings::powercube6();
        seen.check(&settings);
        assert!(errors.iter().all(|e| e.abs() < 3e-3), "{errors:?}");
        assert!(rates.iter().all(|e| e.abs() < 0.05), "{rates:?}");
        assert_eq!(bench.kind(), StateKind::Ready, "{:?}", bench.controller.state());
        // At rest where braking with the acceleration of the envelope ends.
        for (i, (q, qd)) in CATCH.into_iter().enumerate() {
            let a = 0.95 * f64::from(settings.joint.at(joint(i)).a_max_rad_s2);
            let rest = q + 0.5 * qd * qd.abs() / a;
            assert!((bench.drives[i].q - rest).abs() < 2e-3, "joint {i}: {} for {rest}", bench.drives[i].q);
        }
    }
}

#[test]
fn the_committed_trajectory_runs_again_after_a_run_with_other_end_states() {
    let (_, _, _, mut bench) = catch(1);
    // An end state to return to the begin would need another run: the drives are put there instead.
    for (drive, q) in bench.drives.iter_mut().zip(WAIT_RAD) {
        drive.place(q);
    }
    bench.run_for(200_000);
    let committed = bench.controller.take_sample(Instant::from_micros(bench.now)).committed.unwrap();
    // First the group notices that a joint was moved.
    assert_eq!(bench.kind(), StateKind::Fault);
    bench.order(Order::ClearFault { code: Cause::MovesUnordered.code() }).unwrap();
    bench.run_until(3_000_000, |bench| bench.kind() == StateKind::Ready);
    bench.run_for(60_000);
    bench.arm(committed);
    bench.order(Order::Run(committed)).unwrap();
    bench.run_for(500_000);
    assert_eq!(bench.kind(), StateKind::Running);
    let at = bench.instant();
    assert_eq!(bench.controller.take_sample(at).targets_taken, 0);
    for (drive, q) in bench.drives.iter().zip(WAIT_RAD) {
        assert!((drive.q - q).abs() < 1e-3, "it stands where the plan stands");
    }
}

#[test]
fn a_refused_end_state_names_joint_and_cause_and_the_motion_before_goes_on() {
    // The same run with and without the refused ones: the drives do the same.
    let run = |with_refused: bool| {
        let (mut bench, _) = waiting();
        let arrive = bench.instant() + Duration::from_millis(500);
        bench.order(Order::Retarget(target(arrive, |i| CATCH[i]))).unwrap();
        bench.run_for(150_000);
        if with_refused {
            let settings = Settings::powercube6();
            let limits = |i: usize| settings.joint.at(joint(i));
            let spoilt =
                |i: usize, state: (f64, f64)| target(arrive, move |j| if i == j { state } else { CATCH[j] });
            let now = bench.instant();
            let table = [
                (spoilt(3, (f64::NAN, 0.0)), Cause::BadValue, Some(3)),
                (spoilt(2, (CATCH[2].0, 1.9)), Cause::TargetAcceleration, Some(2)),
                (spoilt(4, (CATCH[4].0, 9.0)), Cause::TargetVelocity, Some(4)),
                (spoilt(0, (1.4, 0.0)), Cause::TargetVelocity, Some(0)),
                (target(now + Duration::from_millis(15), |i| CATCH[i]), Cause::TargetTooSoon, None),
                (target(Instant::ZERO, |i| CATCH[i]), Cause::TargetTooSoon, None),
                (target(now + Duration::from_secs(11), |i| CATCH[i]), Cause::TargetTooFar, None),
                (Target { joints: 5, ..target(arrive, |i| CATCH[i]) }, Cause::BadValue, None),
                (
                    Target { events: [Some((now, Action::Open)), None], ..target(arrive, |i| CATCH[i]) },
                    Cause::TargetEvent,
                    None,
                ),
                (
                    Target {
                        events: [None, Some((now + Duration::from_secs(9), Action::Close))],
                        ..target(arrive, |i| CATCH[i])
                    },
                    Cause::TargetEvent,
                    None,
                ),
            ];
            for (index, (aim, cause, at)) in table.into_iter().enumerate() {
                let refusal = bench.order(Order::Retarget(aim)).unwrap_err();
                assert_eq!((refusal.cause, refusal.joint), (cause, at.map(joint)), "{index}");
            }
            let reach = target(bench.instant() + Duration::from_secs(2), |i| {
                if i == 1 { (f64::from(limits(1).q_max_rad) - 1e-4, 0.0) } else { (WAIT_RAD[i], 0.0) }
            });
            let refusal = bench.order(Order::Retarget(reach)).unwrap_err();
            assert_eq!((refusal.cause, refusal.joint), (Cause::TargetPosition, Some(joint(1))));
        }
        bench.run_for(1_500_000);
        assert_eq!(bench.kind(), StateKind::Ready);
        bench.drives.iter().map(|drive| drive.q).collect::<Vec<_>>()
    };
    assert_eq!(run(true), run(false));
}

#[test]
fn a_trajectory_without_an_envelope_and_a_group_that_does_not_run_take_no_end_state() {
    let mut bench = Bench::ready(Options::default(), &throw_start());
    let aim =
        |bench: &Bench| target(bench.instant() + Duration::from_millis(400), |i| (throw_start()[i], 0.0));
    let name = bench.upload(&throw_file(3_000, false));
    let cause = |bench: &mut Bench| {
        let aim = aim(bench);
        bench.order(Order::Retarget(aim)).unwrap_err().cause
    };
    assert_eq!(cause(&mut bench), Cause::OrderNotNow, "Ready");
    bench.arm(name);
    assert_eq!(cause(&mut bench), Cause::OrderNotNow, "Armed");
    bench.order(Order::Run(name)).unwrap();
    bench.run_for(100_000);
    assert_eq!(cause(&mut bench), Cause::NoEnvelope);
    bench.order(Order::Stop).unwrap();
    assert_eq!(cause(&mut bench), Cause::OrderNotNow, "Stopping");
}

#[test]
fn only_the_node_that_armed_the_group_moves_the_end_state() {
    let (mut bench, _) = waiting();
    let aim = target(bench.instant() + Duration::from_millis(500), |i| CATCH[i]);
    let refusal = bench.order_of(Peer::new(99), Order::Retarget(aim)).unwrap_err();
    assert_eq!(refusal.cause, Cause::OtherHost);
    bench.run_for(600_000);
    assert!(bench.drives.iter().zip(WAIT_RAD).all(|(drive, q)| (drive.q - q).abs() < 1e-3));
}

#[test]
fn a_stop_or_a_lost_host_on_the_way_stops_along_the_new_way() {
    type End = fn(&mut Bench);
    let ends: [(End, StateKind); 3] = [
        (|bench| _ = bench.order(Order::Stop).unwrap(), StateKind::Stopped),
        (|bench| bench.heartbeat = false, StateKind::Fault),
        (|bench| bench.stop_now(), StateKind::Stopped),
    ];
    for (after_us, (end, expected)) in
        [100_000, 250_000, 430_000].into_iter().flat_map(|t| ends.map(|e| (t, e)))
    {
        let (mut bench, _) = waiting();
        let arrive = bench.instant() + Duration::from_millis(500);
        let close = (arrive, Action::Close);
        let aim = Target { events: [Some(close), None], ..target(arrive, |i| CATCH[i]) };
        bench.order(Order::Retarget(aim)).unwrap();
        bench.run_for(after_us);
        end(&mut bench);
        let mut seen = Seen::default();
        for _ in 0..1_500 {
            bench.run_for(1_000);
            seen.take(&bench);
        }
        assert_eq!(bench.kind(), expected, "after {after_us} us");
        let closed = bench
            .controller
            .trace()
            .iter()
            .any(|(at, event)| at >= arrive && matches!(event, firmware::trace::TraceEvent::Gripper(_)));
        let stopped_in_time = bench.left(StateKind::Running, 0).unwrap() < arrive.as_micros();
        assert_eq!(closed, !stopped_in_time, "a stop forgets events that are to come");
        for (drive, i) in bench.drives.iter().zip(0..) {
            assert!(drive.speed().abs() < 1e-3);
            let (low, high) = (WAIT_RAD[i].min(CATCH[i].0) - 0.15, WAIT_RAD[i].max(CATCH[i].0) + 0.15);
            assert!((low..high).contains(&drive.q), "joint {i} at {} after {after_us} us", drive.q);
        }
    }
}

#[test]
fn events_of_an_end_state_come_at_their_times_and_those_of_an_older_one_do_not() {
    let (mut bench, _) = waiting();
    let arrive = bench.instant() + Duration::from_millis(500);
    let with =
        |at: Instant, action| Target { events: [Some((at, action)), None], ..target(arrive, |i| CATCH[i]) };
    bench
        .order(Order::Retarget(with(arrive.saturating_sub(Duration::from_millis(200)), Action::Open)))
        .unwrap();
    bench.run_for(100_000);
    bench.order(Order::Retarget(with(arrive, Action::Open))).unwrap();
    let opening = u64::from(bench.controller.settings().gripper_opening_us);
    while bench.drives[5].dio == 0 && bench.now < arrive.as_micros() + 100_000 {
        bench.run_for(50);
    }
    let due = arrive.as_micros() - opening;
    assert!((due..due + 1_500).contains(&bench.now), "{} for {due}", bench.now);
}

/// A host over the wire, with its run of [`wait_file`] under way.
fn waiting_over_the_wire() -> Host {
    let mut host = Host::new();
    for (drive, q) in host.bench.drives.iter_mut().zip(WAIT_RAD) {
        drive.place(q);
    }
    host.run(800_000, |_, _| {});
    let name = host.arm(&wait_file());
    assert_eq!(host.command(command::RUN, &name).0, Status::SUCCESS);
    host.run(200_000, |_, _| {});
    host
}

/// Answers of the controller since a place in the log.
fn answers(host: &Host, from: usize) -> Vec<(Instant, TargetAnswer)> {
    let frames = host.bench.log[from..].iter().filter(|l| l.by_controller && l.frame.is_extended());
    let mut rx = protocol::cyphal::rx::Receiver::<8, 4, 600>::new();
    let port = Port::message(target::ANSWER_SUBJECT, target::ANSWER_EXTENT);
    let taken = frames.filter_map(|l| {
        let transfer = rx.accept(l.at, None, &l.frame, &[&[port]])?;
        Some((l.at, TargetAnswer::from_bytes(transfer.payload).unwrap()))
    });
    taken.collect()
}

#[test]
fn end_states_at_120_hz_fit_on_the_bus_beside_the_cycle_and_each_is_answered() {
    let mut host = waiting_over_the_wire();
    let late = |host: &Host| host.bench.controller.core().counters().cycles_late;
    let before = late(&host);
    host.run(500_000, |_, _| {});
    let (quiet, from) = (late(&host) - before, host.bench.log.len());
    let arrive_us = host.bench.now + 620_000;
    let (mut sent, mut taken_after_us) = (Vec::new(), Vec::new());
    for sequence in 0..60u8 {
        let scale = 0.04 / (1.0 + f64::from(sequence) / 6.0) * if sequence % 2 == 0 { 1.0 } else { -1.0 };
        let (begin, next) = (host.bench.now, host.bench.now + UPDATE_US);
        host.send_target(sequence, arrive_us, CATCH.map(|(q, qd)| (q + scale, qd - scale)));
        sent.push(begin);
        while host.bench.controller.core().targets_taken() <= u16::from(sequence) {
            assert!(host.bench.now < next, "end state {sequence} is taken before the next one comes");
            host.run(100, |_, _| {});
        }
        taken_after_us.push(host.bench.now - begin);
        host.run(next - host.bench.now, |_, _| {});
    }
    let busy = late(&host) - before - quiet;
    host.run(30_000, |_, _| {});
    let got = answers(&host, from);
    assert_eq!(got.len(), 60);
    for (sequence, (_, answer)) in got.iter().enumerate() {
        assert_eq!(*answer, TargetAnswer { sequence: sequence as u8, ..TargetAnswer::default() });
    }
    let mut answered_us: Vec<_> =
        got.iter().zip(&sent).map(|((at, _), sent)| at.as_micros() - sent).collect();
    taken_after_us.sort_unstable();
    answered_us.sort_unstable();
    println!(
        "60 end states: taken after {} us (median), {} us (worst); answered after {} us, {} us; late cycles of 167: {busy}, \
         without end states {quiet}",
        taken_after_us[30], taken_after_us[59], answered_us[30], answered_us[59],
    );
    assert_eq!(host.bench.kind(), StateKind::Running, "{:?}", host.bench.controller.core().state());
    host.run(1_500_000, |_, _| {});
    assert_eq!(host.bench.kind(), StateKind::Ready);
    assert_eq!(host.group.unwrap().targets_taken, 60);
}

#[test]
fn messages_of_strangers_and_of_nonsense_are_answered_with_their_cause_or_ignored() {
    let mut host = waiting_over_the_wire();
    let from = host.bench.log.len();
    let joints = CATCH.map(|(q, qd)| TargetJoint { q_urad: (q * 1e6) as i32, qd_rad_s: qd as f32 });
    let arrive_us = host.bench.now + 500_000;
    let stranger = Route::Message { subject: target::SUBJECT, source: NodeId::from_low_bits(99) };
    let ours = Route::Message { subject: target::SUBJECT, source: host.address };
    let unknown = TargetEvent { action: 7, offset_us: 0 };
    let messages: [(Route, TargetState, Cause); 4] = [
        (stranger, TargetState::new(arrive_us, 1, &joints, &[]), Cause::OtherHost),
        (ours, TargetState::new(arrive_us, 2, &joints[..4], &[]), Cause::BadValue),
        (ours, TargetState::new(arrive_us, 3, &joints, &[unknown]), Cause::TargetEvent),
        (ours, TargetState::new(0, 4, &joints, &[]), Cause::TargetTooSoon),
    ];
    for (route, message, _) in &messages {
        host.send(*route, Priority::Fast, message);
        host.run(20_000, |_, _| {});
    }
    // Cut in the middle of the joints: no message at all.
    struct Cut;
    impl Encode for Cut {
        fn encode(&self, out: &mut protocol::cyphal::bits::Writer<'_>) {
            out.bytes(&[0, 0, 0, 0, 0, 0, 0, 5, 200, 1]);
        }
    }
    host.send(ours, Priority::Fast, &Cut);
    host.run(50_000, |_, _| {});
    let got: Vec<_> = answers(&host, from).iter().map(|(_, a)| (a.sequence, a.cause)).collect();
    let expected: Vec<_> = messages.iter().map(|(_, m, cause)| (m.sequence, cause.code())).collect();
    assert_eq!(got, expected);
    assert!(host.bench.drives.iter().zip(WAIT_RAD).all(|(drive, q)| (drive.q - q).abs() < 1e-3));
    assert_eq!(host.bench.kind(), StateKind::Running);
}

#[test]
fn the_clock_of_the_controller_can_be_asked_while_it_runs() {
    let mut host = waiting_over_the_wire();
    let asked = host.bench.now;
    let (status, output) = host.command(command::CLOCK, &());
    let reading = command::ClockReading::from_bytes(&output).unwrap();
    assert_eq!(status, Status::SUCCESS);
    assert!((asked..=host.bench.now).contains(&reading.uptime_us), "{reading:?}");
}
