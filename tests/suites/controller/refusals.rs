//! Gains file, plan and settings that do not go together are refused with the reason, before anything moves.

use cell_tests::published_throw;
use firmware::fault::{Cause, Refusal};
use firmware::orders::{Done, Order};
use firmware::registers::{Number, certificate_crc32};
use firmware::settings::Settings;
use firmware::store::FileName;
use protocol::Duration;
use protocol::cyphal::crc::Crc64;
use tuner::gains::gains_file::{GainsFile, GainsFileError};

use super::lab::{Lab, Situation};

const GAINS: &str = include_str!("../../../host/tuner/gains/powercube6-3ms.toml");
const VALID: Duration = Duration::from_secs(5);

/// A lab that is ready, with the gains of the file written the way a host does it.
fn ready(gains: &GainsFile) -> Lab {
    let mut lab = Lab::new(&Settings::powercube6(), &Situation::nominal(1));
    lab.wait_ready();
    for (which, name) in ["joint.k_error_1_s2", "joint.k_rate_1_s", "joint.k_last"].into_iter().enumerate() {
        let numbers: Vec<Number> = gains.joint.iter().map(|j| Number::Real32(j.gains()[which])).collect();
        lab.write(name, &numbers).unwrap();
    }
    lab.write("gains.period_us", &[Number::Natural32((gains.period_s * 1e6).round() as u32)]).unwrap();
    let mut wanted = Settings::powercube6();
    gains.enter(wanted.gains_robot_crc32, &mut wanted);
    let certificate = wanted.gains_certificate_crc32;
    lab.write("gains.certificate_crc32", &[Number::Natural32(certificate)]).unwrap();
    assert_eq!(lab.controller().settings().gains_certificate_crc32, certificate);
    lab
}

/// Writes the certificate of what is in force.
fn certify(lab: &mut Lab) {
    let certificate = certificate_crc32(lab.controller().settings());
    lab.write("gains.certificate_crc32", &[Number::Natural32(certificate)]).unwrap();
}

fn commit(lab: &mut Lab, file: &[u8]) -> Result<FileName, Refusal> {
    lab.upload(file);
    let name = FileName { crc64: Crc64::of(file), len: file.len() as u32 };
    lab.try_order(Order::Commit(name)).map(|_| name)
}

/// Both steps of arming.
fn arm(lab: &mut Lab, name: FileName) -> Result<Done, Refusal> {
    let Done::Offer { token, .. } = lab.try_order(Order::ArmPrepare { crc64: name.crc64, valid: VALID })?
    else {
        panic!("no offer")
    };
    lab.run(60_000);
    lab.try_order(Order::ArmConfirm { token, valid: VALID })
}

fn gains() -> GainsFile {
    GainsFile::from_toml(GAINS, "powercube6").unwrap()
}

#[test]
fn gains_file_of_another_robot_or_changed_after_its_proof_is_refused() {
    let other = GainsFile::from_toml(GAINS, "kr16_2").unwrap_err();
    assert!(matches!(other, GainsFileError::OtherRobot { .. }), "{other}");
    let mut changed = gains();
    changed.joint[2].k_vel_1_s *= 0.3;
    let refused = GainsFile::from_toml(&changed.to_toml(), "powercube6").unwrap_err();
    println!("{refused}");
    assert!(
        matches!(
            refused,
            GainsFileError::Saturated { joint: 3, .. } | GainsFileError::GainsChanged { joint: 3 }
        ),
        "{refused}"
    );
}

#[test]
fn gains_that_fit_are_armed_with_their_certificate() {
    let mut lab = ready(&gains());
    let name = commit(&mut lab, &published_throw::file(3_000)).unwrap();
    assert_eq!(arm(&mut lab, name), Ok(Done::Taken));
}

#[test]
fn gains_of_another_period_are_refused_when_the_group_is_armed() {
    let mut lab = ready(&gains());
    let name = commit(&mut lab, &published_throw::file(3_000)).unwrap();
    lab.write("gains.period_us", &[Number::Natural32(4_000)]).unwrap();
    assert_eq!(
        arm(&mut lab, name).unwrap_err().cause,
        Cause::GainsUncertified,
        "no certificate covers the change"
    );
    certify(&mut lab);
    assert_eq!(arm(&mut lab, name).unwrap_err().cause, Cause::GainPeriod);
    // The controller's own period moved away from under gains and plan: the plan says so first.
    lab.write("cycle.period_us", &[Number::Natural32(4_000)]).unwrap();
    assert_eq!(arm(&mut lab, name).unwrap_err().cause, Cause::FilePeriod);
    assert_eq!(lab.watch.motions, 0);
}

#[test]
fn plan_for_another_robot_or_period_or_damaged_is_refused() {
    let mut lab = ready(&gains());
    let wrong_period = commit(&mut lab, &published_throw::file(17_000)).unwrap_err();
    assert_eq!(wrong_period.cause, Cause::FilePeriod);
    let mut damaged = published_throw::file(3_000);
    damaged[40] ^= 1;
    assert_eq!(commit(&mut lab, &damaged).unwrap_err().cause, Cause::FileChecksum);
    let name = commit(&mut lab, &published_throw::file_for(3_000, 0x1234_5678)).unwrap();
    // The robot of the settings changes after the commit.
    lab.write("group.robot_crc32", &[Number::Natural32(0x8765_4321)]).unwrap();
    assert_eq!(arm(&mut lab, name).unwrap_err().cause, Cause::FileOtherRobot);
    lab.write("group.robot_crc32", &[Number::Natural32(0x1234_5678)]).unwrap();
    assert_eq!(arm(&mut lab, name).unwrap_err().cause, Cause::GainsOtherRobot);
    lab.write("gains.robot_crc32", &[Number::Natural32(0x1234_5678)]).unwrap();
    certify(&mut lab);
    assert_eq!(arm(&mut lab, name), Ok(Done::Taken));
    assert_eq!(lab.watch.motions, 0);
}
