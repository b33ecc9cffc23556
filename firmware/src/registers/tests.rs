//! Ranges, ceilings and stored rows of the registers.

use super::*;

use crate::groups::powercube::settings::{HOME_V_RAD_S, REGISTERS, SLOW_CURRENT_A};

/// Settings with registers of a family.
fn powercubes() -> Settings {
    let mut settings = Settings::powercube6();
    settings.take_family(&REGISTERS);
    settings
}

fn write_named(settings: &mut Settings, name: &str, numbers: &[Number]) -> Result<(), Refusal> {
    let index = find(settings, name).unwrap_or(usize::MAX);
    write(settings, index, numbers)
}

#[test]
fn every_register_reads_writes_back_and_has_its_default_in_range() {
    let mut settings = powercubes();
    for (index, info) in all(&settings).enumerate() {
        let numbers = read(&settings, index).unwrap();
        assert_eq!(numbers.as_slice().len(), if info.per_joint { 6 } else { 1 }, "{}", info.name);
        assert_eq!(write_named(&mut settings, info.name, numbers.as_slice()), Ok(()), "{}", info.name);
    }
    assert_eq!(settings, powercubes());
}

#[test]
fn every_register_has_its_meaning() {
    assert_eq!(MEANINGS.len(), TABLE.len());
    assert_eq!(REGISTERS.meanings.len(), REGISTERS.table.len());
}

#[test]
fn a_controller_has_only_the_registers_of_its_own_drives() {
    let (without, with) = (Settings::powercube6(), powercubes());
    assert_eq!(all(&without).count(), TABLE.len());
    assert_eq!(all(&with).count(), TABLE.len() + REGISTERS.table.len());
    assert_eq!(find(&without, "joint.home_v_rad_s"), None);
    assert_eq!((info(&without, TABLE.len()).is_none(), read(&without, TABLE.len())), (true, None));
    assert_ne!(with, without);
    // A row that was stored for other drives is skipped.
    let row = to_row(&with, find(&with, "joint.home_v_rad_s").unwrap()).unwrap();
    let mut other = without;
    assert!(!take_row(&mut other, &row));
    assert_eq!(other, without);
}

#[test]
fn a_familys_own_numbers_are_checked_against_those_of_the_joints() {
    let third = JointIndex::new(2).unwrap();
    for (setting, x) in [(HOME_V_RAD_S, -0.4), (SLOW_CURRENT_A, 31.0)] {
        let mut settings = powercubes();
        settings.joint.at_mut(third).v_max_rad_s = 0.3;
        settings.joint.at_mut(third).jog_v_rad_s = 0.1;
        assert_eq!(settings.check(), Ok(()));
        setting.set_at(&mut settings, third, x);
        assert_eq!(setting.at(&settings, third), x);
        assert_eq!(settings.check(), Err(Refusal::at(Cause::SettingsInvalid, third)), "{x}");
    }
}

#[test]
fn a_part_of_the_joints_keeps_its_own_numbers() {
    let mut settings = powercubes();
    for joint in JointIndex::first(6) {
        HOME_V_RAD_S.set_at(&mut settings, joint, 0.125 * joint.get() as f32);
    }
    let kept = [4, 1].map(|joint| JointIndex::new(joint).unwrap());
    settings.family = settings.family.of_joints(&kept.into_iter());
    let first = JointIndex::first(2).map(|joint| HOME_V_RAD_S.at(&settings, joint));
    assert_eq!(first.collect::<Vec<_>>(), [0.5, 0.125]);
}

#[test]
fn names_are_unique_and_carry_their_unit() {
    let settings = powercubes();
    for (i, info) in all(&settings).enumerate() {
        assert_eq!(find(&settings, info.name), Some(i));
        let dimensionless = [
            "late_max",
            "missed_max",
            "in_flight_max",
            "share",
            "alpha",
            "beta",
            "k_last",
            "joints",
            "line",
            "address",
            ".id",
        ];
        let unit = ["_us", "_rad", "_rad_s", "_rad_s2", "_a", "_1_s", "_1_s2", "_crc32"];
        let fine = info.kind == Kind::Bit
            || dimensionless.iter().chain(&unit).any(|suffix| info.name.ends_with(suffix));
        assert!(fine, "{} has no unit", info.name);
    }
}

#[test]
fn write_is_all_or_nothing_and_says_which_number() {
    let mut settings = Settings::powercube6();
    let before = settings;
    let mut six = [Number::Real32(1.0); 6];
    six[4] = Number::Real32(f32::NAN);
    let refused = write_named(&mut settings, "joint.v_max_rad_s", &six).unwrap_err();
    assert_eq!((refused.cause, refused.index), (Cause::BadValue, 4));
    assert_eq!(settings, before);
    for wrong in [
        write_named(&mut settings, "joint.v_max_rad_s", &six[..3]),
        write_named(&mut settings, "no.such", &[Number::Bit(true)]),
        write_named(&mut settings, "cycle.period_us", &[Number::Real32(3000.0)]),
        write_named(&mut settings, "cycle.period_us", &[Number::Natural32(999)]),
    ] {
        assert_eq!(wrong.unwrap_err().cause, Cause::BadValue);
    }
    let crossed = [Number::Real32(3.2); 6];
    assert_eq!(
        write_named(&mut settings, "joint.q_min_rad", &crossed).unwrap_err().cause,
        Cause::SettingsInvalid
    );
    assert_eq!(settings, before);
}

/// NaN, infinities, numbers far outside, and numbers too small to mean anything.
#[test]
fn no_register_takes_a_number_without_a_physical_meaning() {
    let hostile = [
        f32::NAN,
        f32::INFINITY,
        f32::NEG_INFINITY,
        1e9,
        -1e9,
        f32::MAX,
        f32::MIN,
        1e-40,
        -1e-40,
        f32::from_bits(1),
    ];
    let mut settings = powercubes();
    let before = settings;
    for (index, info) in all(&before).enumerate() {
        let count = read(&settings, index).unwrap().as_slice().len();
        for x in hostile.into_iter().filter(|_| info.kind == Kind::Real32) {
            for at in 0..count {
                let mut numbers = read(&before, index).unwrap();
                numbers.numbers[at] = Number::Real32(x);
                let refused = write(&mut settings, index, numbers.as_slice()).unwrap_err();
                assert_eq!((refused.cause, refused.index), (Cause::BadValue, at as u16), "{} {x}", info.name);
                // The same number in settings that do not come through the register.
                let mut loaded = before;
                put(&mut loaded, info, numbers.as_slice());
                assert_eq!(loaded.check().unwrap_err().cause, Cause::SettingsInvalid, "{} {x}", info.name);
            }
        }
        // A checksum holds any number.
        let open = info.name.ends_with("_crc32") || info.kind != Kind::Natural32;
        for x in [u32::MAX, 1_000_000_000].into_iter().filter(|_| !open) {
            let numbers = vec![Number::Natural32(x); count];
            assert!(write(&mut settings, index, &numbers).is_err(), "{} {x}", info.name);
        }
        assert_eq!(settings, before, "{}", info.name);
    }
}

#[test]
fn limits_beyond_the_ceiling_are_found_and_put_back_to_it() {
    let ceiling = powercubes();
    for (index, info) in
        all(&ceiling).enumerate().filter(|(_, i)| matches!(i.wider, Wider::More | Wider::Less))
    {
        let joint = JointIndex::new(if info.per_joint { 2 } else { 0 }).unwrap();
        let limit = get(&ceiling, info, joint);
        let up = info.wider == Wider::More;
        let moved = |up: bool, by: f32| match limit {
            Number::Real32(x) => Number::Real32(if up { x + by } else { x - by }),
            Number::Natural32(n) => Number::Natural32(if up { n + 1 } else { n - 1 }),
            Number::Bit(on) => Number::Bit(on == up),
        };
        let (wide, narrow_one) = (moved(up, 0.01), moved(!up, 0.001));
        let mut settings = ceiling;
        set(&mut settings, info, joint, wide).unwrap();
        let found = check_widening(&settings, &ceiling, &ceiling, index).unwrap_err();
        let at = info.per_joint.then_some(joint);
        assert_eq!((found.cause, found.joint), (Cause::LimitCeiling, at), "{}", info.name);
        assert!(narrow(&mut settings, &ceiling));
        assert_eq!(settings, ceiling, "{}", info.name);
        set(&mut settings, info, joint, narrow_one).unwrap();
        assert_eq!(check_widening(&settings, &ceiling, &ceiling, index), Ok(()), "{}", info.name);
        assert!(!narrow(&mut settings, &ceiling), "{}", info.name);
    }
}

#[test]
fn a_range_wholly_outside_the_ceiling_is_replaced_by_the_ceiling() {
    let ceiling = Settings::powercube6();
    let mut settings = ceiling;
    let joint = JointIndex::new(4).unwrap();
    (settings.joint.at_mut(joint).q_min_rad, settings.joint.at_mut(joint).q_max_rad) = (2.5, 3.0);
    assert!(narrow(&mut settings, &ceiling));
    assert_eq!(settings, ceiling);
}

#[test]
fn stored_rows_restore_every_setting() {
    let mut changed = powercubes();
    changed.cycle_period_us = 5_000;
    changed.watchdog_prove = false;
    HOME_V_RAD_S.set_at(&mut changed, JointIndex::new(1).unwrap(), 0.2);
    changed.joint.at_mut(JointIndex::new(3).unwrap()).k_error_1_s2 = -123.5;
    let mut restored = powercubes();
    for (index, info) in all(&changed).enumerate() {
        let taken = take_row(&mut restored, &to_row(&changed, index).unwrap());
        assert_eq!(taken, info.writable != Writable::Never, "{}", info.name);
    }
    assert_eq!(restored, changed);
}

#[test]
fn stored_row_that_is_unknown_or_out_of_range_changes_nothing_it_should_not() {
    let mut settings = Settings::powercube6();
    let before = settings;
    assert!(!take_row(&mut settings, &[0xFF; ROW_LEN]));
    let index = find(&settings, "cycle.period_us").unwrap();
    let mut row = to_row(&settings, index).unwrap();
    row[8..12].copy_from_slice(&1u32.to_le_bytes());
    assert!(!take_row(&mut settings, &row));
    assert_eq!(settings, before);
}
