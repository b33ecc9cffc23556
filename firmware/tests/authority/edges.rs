//! Sessions and unlocks at the edges of their times, and what a restarted host must do first.

use super::*;

/// No deadline of the controller falls on these times.
const OFFER_US: u64 = 1_003_217;

fn unlock(bench: &mut Bench, valid: Duration) -> Result<Done, Refusal> {
    let robot_crc32 = bench.controller.settings().limits_robot_crc32;
    bench.order_of(FIRST, Order::Unlock { robot_crc32, valid })
}

#[test]
fn offer_keeps_other_nodes_out_until_it_ends() {
    for (after_us, refused) in [(OFFER_US - 1, Some(Cause::OtherHost)), (OFFER_US, None)] {
        let (mut bench, name) = committed();
        let valid = Duration::from_micros(OFFER_US);
        bench.order_of(FIRST, Order::ArmPrepare { crc64: name.crc64, valid }).unwrap();
        bench.run_for(after_us);
        hear(&mut bench, SECOND);
        let order = Order::ArmPrepare { crc64: name.crc64, valid };
        let outcome = bench.order_of(SECOND, order).map_err(|refusal| refusal.cause);
        assert_eq!(outcome.err(), refused, "after {after_us} us");
    }
}

#[test]
fn unlock_lasts_an_hour_at_most_counts_down_and_ends_at_its_microsecond() {
    let (mut bench, _) = committed();
    let hour = Duration::from_secs(3_600);
    assert_eq!(cause(unlock(&mut bench, hour + Duration::from_micros(1))), Cause::BadValue);
    unlock(&mut bench, hour).unwrap();

    let valid = Duration::from_micros(OFFER_US);
    unlock(&mut bench, valid).unwrap();
    let from = bench.instant();
    let left = |bench: &Bench| bench.controller.unlock_left(bench.instant());
    assert_eq!(left(&bench), valid);
    bench.run_for(OFFER_US - 1);
    assert_eq!(left(&bench), Duration::from_micros(1));
    let wide = |bench: &mut Bench, x: f32| write(bench, FIRST, "joint.v_max_rad_s", &[Number::Real32(x); 6]);
    wide(&mut bench, 6.0).unwrap();
    bench.run_for(1);
    assert_eq!(bench.instant(), from + valid);
    assert_eq!(left(&bench), Duration::ZERO);
    assert_eq!(cause(wide(&mut bench, 7.0)), Cause::LimitCeiling);
}

#[test]
fn host_that_has_started_again_is_no_host_until_it_is_heard_and_gives_an_order() {
    let (mut bench, name) = committed();
    assert_eq!(bench.controller.host(), Some(FIRST));
    let now = bench.instant();
    bench.controller.host_restarted(now, SECOND);
    assert_eq!(bench.controller.host(), Some(FIRST), "another node");
    bench.controller.host_restarted(now, FIRST);
    assert_eq!(bench.controller.host(), None);
    let order = Order::ArmPrepare { crc64: name.crc64, valid: VALID };
    assert_eq!(cause(bench.order_of(FIRST, order)), Cause::NoHost, "not heard since");
    bench.run_for(30_000);
    bench.order_of(FIRST, order).unwrap();
    assert_eq!(bench.controller.host(), Some(FIRST));
}
