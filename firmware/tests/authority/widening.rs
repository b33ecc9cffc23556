//! Registers that let the arm do more: a write needs the unlock, voids the commit, and changes the digest of an arming.

use super::*;
use firmware::joints::PerJoint;
use firmware::trajectory_format::{Header, rest};

fn joints(settings: &Settings, of: impl Fn(&firmware::settings::JointSettings) -> Number) -> Vec<Number> {
    settings.joint.0[..6].iter().map(of).collect()
}

/// For each register of supervision, a value that is more permissive than the value the controller was started with.
const WIDER: [(&str, Number); 9] = [
    ("watchdog.enable", Number::Bit(false)),
    ("watchdog.prove", Number::Bit(false)),
    ("watchdog.timeout_us", Number::Natural32(1_000_000)),
    ("reply.missed_max", Number::Natural32(10)),
    ("reply.deadline_us", Number::Natural32(3_000)),
    ("cycle.late_max", Number::Natural32(100)),
    ("host.timeout_us", Number::Natural32(500_000)),
    ("stop.path_max_us", Number::Natural32(5_000_000)),
    ("ramp.reach_rad", Number::Real32(6.3)),
];

/// A plan that stays at the start of the throw.
fn standing() -> Vec<u8> {
    let mut pose = PerJoint::default();
    for (i, q) in throw_start().iter().enumerate() {
        pose.set(joint(i), *q as f32);
    }
    file(&Header { joints: 6, period_us: 3_000, ..Header::default() }, &rest(pose, 500_000))
}

fn unlock(bench: &mut Bench) {
    let robot_crc32 = bench.controller.settings().limits_robot_crc32;
    bench.order_of(FIRST, Order::Unlock { robot_crc32, valid: Duration::from_secs(2) }).unwrap();
}

fn runnable(bench: &mut Bench, name: FileName) -> Result<Done, Refusal> {
    bench.order_of(FIRST, Order::ArmPrepare { crc64: name.crc64, valid: VALID })
}

#[test]
fn supervision_is_widened_only_while_unlocked_voids_the_commit_and_is_put_back() {
    let (mut bench, name) = committed();
    let before = *bench.controller.settings();
    for (register, number) in WIDER {
        assert_eq!(cause(write(&mut bench, FIRST, register, &[number])), Cause::LimitCeiling, "{register}");
    }
    assert!(runnable(&mut bench, name).is_ok(), "nothing has changed");
    for (register, number) in WIDER {
        unlock(&mut bench);
        write(&mut bench, FIRST, register, &[number]).unwrap();
        assert_eq!(cause(runnable_at_rest(&mut bench, name)), Cause::NoTrajectory, "{register}");
        bench.run_for(2_100_000);
        assert_eq!(*bench.controller.settings(), before, "{register} is put back with the end of the unlock");
        bench.run_until(3_000_000, |bench| bench.kind() == StateKind::Ready);
        bench.order_of(FIRST, Order::Commit(name)).unwrap();
    }
}

/// The group searches its drives again after some writes.
fn runnable_at_rest(bench: &mut Bench, name: FileName) -> Result<Done, Refusal> {
    bench.run_until(3_000_000, |bench| bench.kind() == StateKind::Ready);
    runnable(bench, name)
}

/// An offset of 1 rad moves every soft limit by 1 rad in space.
#[test]
fn an_offset_or_an_inversion_changes_only_while_unlocked_and_voids_the_commit() {
    for (register, of) in [
        ("joint.offset_rad", (|_| Number::Real32(0.01)) as fn(&firmware::settings::JointSettings) -> Number),
        ("joint.inverted", |j| Number::Bit(!j.inverted)),
        ("joint.address", |j| Number::Natural32(j.address + 1)),
    ] {
        let (mut bench, name) = committed();
        let other = joints(bench.controller.settings(), of);
        assert_eq!(cause(write(&mut bench, FIRST, register, &other)), Cause::LimitCeiling, "{register}");
        assert_eq!(bench.kind(), StateKind::Ready, "{register}");
        assert!(runnable(&mut bench, name).is_ok(), "{register}: nothing has changed");
        unlock(&mut bench);
        write(&mut bench, FIRST, register, &other).unwrap();
        let held = bench.controller.register_named(register).unwrap();
        assert_eq!(held.as_slice(), other);
        assert!(bench.controller.trace().iter().any(|(_, event)| event == TraceEvent::LimitsChanged));
        if register == "joint.offset_rad" {
            assert_eq!(cause(runnable_at_rest(&mut bench, name)), Cause::NoTrajectory, "{register}");
            bench.order_of(FIRST, Order::SaveSettings).unwrap();
            bench.run_for(2_100_000);
            assert_eq!(
                bench.controller.settings().joint.0[0].offset_rad,
                0.01,
                "a calibration outlives the unlock"
            );
            let storage = bench.controller.storage().clone();
            let again =
                Controller::<_, _, PowerCubes>::new(storage, &Settings::powercube6(), Seed::FORESEEABLE);
            assert_eq!(again.settings().joint.0[0].offset_rad, 0.01, "and the power");
        }
    }
}

#[test]
fn a_change_of_the_proven_loop_voids_the_certificate() {
    for (register, of) in [
        (
            "joint.a_max_rad_s2",
            (|s| joints(s, |j| Number::Real32(0.9 * j.a_max_rad_s2))) as fn(&Settings) -> Vec<Number>,
        ),
        ("drives.lag_us", |_| vec![Number::Natural32(4_000)]),
        ("reply.age_us", |_| vec![Number::Natural32(500)]),
        ("estimator.alpha", |_| vec![Number::Real32(0.5)]),
    ] {
        let (mut bench, name) = committed();
        let number = bench.controller.settings().gains_certificate_crc32;
        let other = of(bench.controller.settings());
        write(&mut bench, FIRST, register, &other).unwrap();
        assert_eq!(bench.controller.settings().gains_certificate_crc32, 0, "{register}");
        // The throw uses more than 0.9 of the acceleration: another file, at rest.
        let name = if register == "joint.a_max_rad_s2" { bench.upload(&standing()) } else { name };
        write(&mut bench, FIRST, "gains.certificate_crc32", &[Number::Natural32(number)]).unwrap();
        let token = offer(&mut bench, FIRST, name);
        bench.run_for(60_000);
        let confirm = Order::ArmConfirm { token, valid: VALID };
        assert_eq!(cause(bench.order_of(FIRST, confirm)), Cause::GainsUncertified, "{register}");
    }
}
