//! Arms of CANopen servos and of ODrives in the simulated cell, judged by their plant, and what a drive may do wrong.

use firmware::fault::Cause;
use firmware::group::DriveGroup as _;
use firmware::groups::odrive::Parameter;
use firmware::state::StateKind;
use hil_sim::bus::BusConfig;
use hil_sim::drive::cia402::CanopenServo;
use hil_sim::drive::odrive::OdriveAxis;
use hil_sim::participants::Solo;
use hil_sim::{CellOptions, World};
use operator::bus::BusArgs;
use operator::bus::BusFailure;
use operator::bus::args::{Cell, CellArgs};
use operator::bus::period::{set_period, settings_with_gains};
use operator::bus::session::Session;
use operator::bus::sim::{SimSetup, soft_controller};
use operator::drives::{CanDrives, difference_text};
use operator::job::{Answer, Judge, Order, Program, perform};
use operator::port::{OnBus, Operator};
use planner::plan::Joints;
use planner::store::fingerprint_of;
use planner::way::{Travel, way};
use protocol::cyphal::cubecell::group_state::State;
use protocol::odrive::{Sdo, Version};
use protocol::{Duration, JointIndex, Node};
use robot_model::collision::Scene;
use robot_model::{OdriveEndpoints, RobotModel};

const JOINTS: usize = 6;

/// An arm of drives that follow positions.
#[derive(Clone, Copy)]
enum Arm {
    Cia402,
    Odrive,
}

const ARMS: [Arm; 2] = [Arm::Cia402, Arm::Odrive];

impl Arm {
    fn cell(self) -> Cell {
        let file = match self {
            Self::Cia402 => "canopen6.toml",
            Self::Odrive => "odrive6.toml",
        };
        let robot = format!("{}/../../robots/{file}", env!("CARGO_MANIFEST_DIR"));
        CellArgs { robot: Some(robot), ..CellArgs::default() }.load().unwrap()
    }

    /// Control periods, µs.
    const fn periods(self) -> [u32; 2] {
        match self {
            Self::Cia402 => [2_000, 3_000],
            Self::Odrive => [3_000, 5_000],
        }
    }
}

/// Found and at home.
fn ready(cell: &Cell, period_us: u32) -> Session {
    let mut settings = settings_with_gains(&cell.robot, &cell.setup).unwrap();
    set_period(&mut settings, period_us);
    let mut session = BusArgs::default().open_cell(cell, Some(&settings)).unwrap();
    let mut operator = OnBus::new(&mut session, None);
    operator.connect().unwrap();
    operator.wait_for(Duration::from_secs(5), &|state| state == State::Idle).unwrap();
    operator.home(0x3F, Duration::from_secs(5)).unwrap();
    session
}

fn plant_rad(session: &mut Session) -> Vec<f64> {
    let cell = session.sim().unwrap().cell();
    (0..JOINTS).map(|axis| cell.plant().link_q_rad(axis)).collect()
}

#[test]
fn the_reported_pose_is_the_pose_of_the_plant_and_the_arm_is_held_at_each_period() {
    for arm in ARMS {
        for period_us in arm.periods() {
            let cell = arm.cell();
            let mut session = ready(&cell, period_us);
            let before = plant_rad(&mut session);
            let until = session.now() + Duration::from_secs(2);
            session.run(until, &mut |_| false).unwrap();
            let mut operator = OnBus::new(&mut session, None);
            operator.connect().unwrap();
            let reported = operator.pose().unwrap();
            for ((plant, before), reported) in plant_rad(&mut session).iter().zip(&before).zip(&reported) {
                assert!((plant - before).abs() < 5e-4, "{period_us}: {plant} {before}");
                assert!((plant - reported).abs() < 5e-4, "{period_us}: {plant} {reported}");
            }
        }
    }
}

#[test]
fn a_jog_turns_the_joint_of_the_plant_against_gravity_and_no_other() {
    for arm in ARMS {
        let cell = arm.cell();
        let mut session = ready(&cell, 3_000);
        let before = plant_rad(&mut session);
        let node = session.find_controller(None).unwrap();
        let end = session.now() + Duration::from_secs(1);
        let shoulder = JointIndex::new(1).unwrap();
        let jogged = session.jog_joint(node, shoulder, 0.2, &mut |now| now < end).unwrap();
        let after = plant_rad(&mut session);
        let way_rad = after[1] - before[1];
        assert!((0.1..0.25).contains(&way_rad), "{way_rad}");
        assert!((jogged.to_rad - after[1]).abs() < 5e-4, "{jogged:?} {}", after[1]);
        for joint in [0, 2, 3, 4, 5] {
            assert!((after[joint] - before[joint]).abs() < 5e-4, "joint {}: {}", joint + 1, after[joint]);
        }
    }
}

#[test]
fn a_drive_without_power_is_a_fault_of_its_joint_and_brakes_hold_the_arm() {
    for arm in ARMS {
        let cell = arm.cell();
        let mut session = ready(&cell, 3_000);
        let before = plant_rad(&mut session);
        let world = session.sim().unwrap().world();
        world
            .with_participants(|all, now| match arm {
                Arm::Cia402 => all.0.0.0.motors_mut::<CanopenServo>().nth(1).unwrap().set_power(now, false),
                Arm::Odrive => all.0.0.0.motors_mut::<OdriveAxis>().nth(1).unwrap().set_power(now, false),
            })
            .unwrap();
        let until = session.now() + Duration::from_secs(1);
        let Err(BusFailure::StoppedByOther(seen)) = session.run(until, &mut |_| false) else {
            panic!("the controller goes on without a drive")
        };
        let group = seen.group.unwrap();
        assert_eq!((group.fault_cause, group.fault_joint), (Cause::DriveSilent.code(), 2));
        session.sim().unwrap().world().run_until(until, &mut ()).unwrap();
        for (plant, before) in plant_rad(&mut session).iter().zip(&before) {
            assert!((plant - before).abs() < 2e-3, "{plant} {before}");
        }
    }
}

/// The report of a motion comes from the frames of the drives; the plant confirms it.
#[test]
fn motion_is_judged_by_what_the_drives_measured() {
    for arm in ARMS {
        let cell = arm.cell();
        let mut session = ready(&cell, 3_000);
        let mut operator = OnBus::new(&mut session, None);
        operator.connect().unwrap();
        let from = Joints::from_slice(&operator.pose().unwrap());
        let to = from.map(|q| q + 0.3);
        let travel = Travel { share: 0.5, ..Travel::default() };
        let motion = way(&cell.robot, &Scene::default(), &travel, &from, &to).unwrap().unwrap();
        let fingerprint = fingerprint_of(&cell.robot);
        let order = Order::new(&cell.robot, &fingerprint, Program::Motion(motion), Judge::Reach);
        let record = perform(&mut operator, &order, &mut |_| Answer::Yes);
        assert!(record.ended.is_none(), "{:?}", record.ended);
        let reached = record.reached.unwrap();
        assert!(reached.samples > 1_000 && (1e-7..2e-3).contains(&reached.off_rad), "{reached:?}");
        for (plant, to) in plant_rad(&mut session).iter().zip(to.as_slice()) {
            assert!((plant - to).abs() < reached.end_off_rad + 5e-4, "{plant} {to} {reached:?}");
        }
    }
}

#[test]
fn a_node_with_ids_of_powercubes_is_refused_at_the_start_with_numbers_that_do() {
    let text = include_str!("../../../robots/odrive6.toml");
    for (node, fits) in [(4, true), (5, false), (8, false), (3, false), (31, true)] {
        let text = text.replacen("node = 9", &format!("node = {node}"), 1);
        let robot = RobotModel::from_toml("arm.toml", &text).unwrap();
        match CanDrives::of(&robot) {
            Ok(_) => assert!(fits, "{node}"),
            Err(error) => {
                assert!(!fits, "{error}");
                assert!(error.to_string().contains("1, 2, 4, 9 to 31"), "{error}");
            }
        }
    }
    let text = include_str!("../../../robots/canopen6.toml").replacen("node = 3", "node = 33", 1);
    assert!(
        CanDrives::of(&RobotModel::from_toml("arm.toml", &text).unwrap()).is_err(),
        "its emergencies are at 0xA1"
    );
}

/// Made-up endpoints.
const ENDPOINTS: &str = "[odrive_endpoints]\nfirmware = \"0.6.9\"\nencoder_msg_rate_ms = 210\ninput_vel_scale = 211\ninput_torque_scale = 212\n\
                         watchdog_timeout = 300\nenable_watchdog = 301\ncontrol_mode = 402\ninput_mode = 403\n\n[gripper]\n";

/// Runs a controller for 3 s on the axes of a robot file with [`ENDPOINTS`], after `change` has acted on the axes. Returns the state of the
/// controller and the mismatch that it found.
fn looked_at(change: impl FnOnce(&mut [&mut OdriveAxis])) -> (StateKind, Option<String>) {
    let text = include_str!("../../../robots/odrive6.toml").replacen("[gripper]\n", ENDPOINTS, 1);
    let robot = RobotModel::from_toml("arm.toml", &text).unwrap();
    let settings = settings_with_gains(&robot, &SimSetup::default()).unwrap();
    let cell = hil_sim::Cell::new(&robot, &CellOptions::default(), 1).unwrap();
    let controller = soft_controller(&settings, CanDrives::of(&robot).unwrap());
    let parts = (cell, Solo::new("controller", controller));
    let mut world = World::new(parts, BusConfig::default(), 1, Vec::new()).unwrap();
    world
        .with_participants(|all, _| change(&mut all.0.motors_mut::<OdriveAxis>().collect::<Vec<_>>()))
        .unwrap();
    world.run_until(protocol::Instant::ZERO + Duration::from_secs(3), &mut ()).unwrap();
    let controller = world.participants().1.node.controller();
    let mismatch = controller.group().difference().map(|(joint, reported)| {
        format!("joint {}: {}", joint.get() + 1, difference_text(reported).unwrap())
    });
    (controller.state().kind(), mismatch)
}

#[test]
fn endpoints_of_a_robot_file_find_a_parameter_that_differs_and_name_it() {
    // In the order of the keys of a robot file.
    let paths = Parameter::ALL.map(|parameter| parameter.path().rsplit('.').next().unwrap());
    assert_eq!(paths, OdriveEndpoints::KEYS);
    assert_eq!(looked_at(|_| ()), (StateKind::Idle, None));
    let write = |axis: &mut OdriveAxis, endpoint, value| {
        let node = axis.options().node;
        let (frame, _) = protocol::odrive::Order::Sdo(Sdo { endpoint, value: Some(value) })
            .encode(node, Version::V06)
            .unwrap();
        axis.handle_frame(protocol::Instant::ZERO, &frame);
        axis.faults_mut().parameters_are_fixed = true;
    };
    for (endpoint, value, said) in [
        (210, 10, "encoder_msg_rate_ms holds 0xa, the settings need 0x0"),
        (211, 500, "input_vel_scale holds 0x1f4, the settings need 0x3e8"),
        (212, 100, "input_torque_scale holds 0x64, the settings need 0x3e8"),
    ] {
        let (state, mismatch) = looked_at(|axes| write(axes[2], endpoint, u32::to_le_bytes(value)));
        assert_eq!((state, mismatch), (StateKind::Fault, Some(format!("joint 3: axis0.config.can.{said}"))));
    }
    let (_, mismatch) = looked_at(|axes| write(axes[0], 300, 0.5_f32.to_le_bytes()));
    let said = mismatch.unwrap();
    assert!(said.starts_with("joint 1: axis0.config.watchdog_timeout holds 0x3f000000"), "{said}");
}

/// The port of a controller sends in the order in which it was given frames: those of the host link must not pile up before set points.
#[test]
fn a_host_that_reads_every_register_does_not_stop_an_arm_that_is_held_at_its_shortest_period() {
    for arm in ARMS {
        let cell = arm.cell();
        let mut session = ready(&cell, arm.periods()[0]);
        let node = session.find_controller(None).unwrap();
        let names = session.register_names(node).unwrap();
        assert!(names.len() > 50, "{names:?}");
        for name in &names {
            session.register(node, name).unwrap();
        }
        assert_eq!(session.group().unwrap().state, State::Ready);
    }
}
