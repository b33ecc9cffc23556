//! A plan on seven motors.

use firmware::group::DriveGroup;
use firmware::state::StateKind;
use protocol::{Duration, Instant};

use crate::rig::{JOINTS, PERIOD_US, Rig, joint, quintic, quintic_file};

/// Largest distance of the shafts from the plan, rad.
pub(crate) fn away_rad(rig: &Rig, start: Instant) -> [f64; JOINTS] {
    rig.away_from(start, |i, t_s| quintic(i, t_s).0)
}

#[test]
fn seven_joints_follow_a_plan_at_3_ms_on_a_classical_bus() {
    let mut rig = Rig::ready();
    let start = rig.start(&quintic_file());
    rig.run_us(1_000_000);
    rig.run_to(1_500, StateKind::Ready);
    for (i, away) in away_rad(&rig, start).into_iter().enumerate() {
        // Without torque ahead the gains pay for the inertia: J a / kp is 5.8 mrad at 5.8 rad/s2, of which the law takes a part.
        assert!((5e-4..4e-3).contains(&away), "joint {i}: {away} rad");
    }
    assert_eq!(rig.controller().counters().cycles_late, 0);
    assert_eq!(rig.controller().counters().replies_missed, 0);
    // One command and one answer per motor and period.
    let frames = rig.frames(start, |_| true).len() as f64;
    let periods = rig.now().saturating_since(start).as_micros() as f64 / PERIOD_US as f64;
    assert!((frames / periods - 14.0).abs() < 0.2, "{}", frames / periods);
}

#[test]
fn soft_gains_follow_less_closely_and_lost_answers_are_bridged() {
    let mut rig = Rig::ready();
    rig.motor(3, |motor| motor.faults_mut().answer_lost_every = 7);
    let start = rig.start(&quintic_file());
    rig.run_us(1_000_000);
    rig.run_to(1_500, StateKind::Ready);
    assert!(rig.controller().counters().replies_missed > 40);
    let away = away_rad(&rig, start)[3];
    assert!((5e-4..8e-3).contains(&away), "{away} rad");
}

#[test]
fn a_late_answer_is_no_measurement() {
    let mut rig = Rig::ready();
    let start = rig.start(&quintic_file());
    rig.delay_answers(6, Duration::from_micros(2_600), Duration::from_millis(3));
    let mut samples = Vec::new();
    for _ in 0..1_000 {
        rig.run_us(1_000);
        samples.extend(rig.controller().group().position(joint(6)));
    }
    rig.run_to(1_500, StateKind::Ready);
    let missed = rig.controller().counters().replies_missed;
    assert!((10..40).contains(&missed), "{missed}");
    // Half a step of the position, and 0.2 ms of stuffed bits at 1.9 rad/s. One of the period before is 5 mrad off.
    let shaft_rad = |at: Instant| {
        let next = rig.track.iter().position(|(time, _)| *time >= at).unwrap();
        let ((from, a), (to, b)) = (rig.track[next - 1], rig.track[next]);
        let share = (at.as_secs_f64() - from.as_secs_f64()) / (to.as_secs_f64() - from.as_secs_f64());
        a[6] + share * (b[6] - a[6])
    };
    let worst = samples.iter().map(|s| (f64::from(s.q_rad) - shaft_rad(s.at)).abs()).fold(0.0, f64::max);
    assert!((1e-4..8e-4).contains(&worst), "{worst}");
    let away = away_rad(&rig, start)[6];
    assert!((5e-4..4e-3).contains(&away), "{away} rad");
}
