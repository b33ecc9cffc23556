//! One throw in the simulated cell, from a plan to its numbers, with limits checked on the frames of the bus.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::io;
use std::rc::Rc;

use hil_sim::mechanics::{HandPoint, Plane};
use nalgebra::{Matrix2, SMatrix, Vector3, Vector6};
use operator::bus::BusArgs;
use operator::bus::args::Cell;
use operator::bus::settings::settings_of;
use operator::bus::sim::SimSetup;
use operator::job::{Answer, JobError, Judge, Order, perform};
use operator::port::OnBus;
use operator::tap::{Tap, Way};
use planner::flight::FlightModel;
use planner::motion::{Motion, Sample};
use planner::plan::file::PlanFile;
use planner::plan::search::{Best, Budget, Planner, Watch};
use planner::plan::statistics::{Noise, predict};
use planner::plan::{Arm, Confidence, Joints, Options, Problem, seeds};
use planner::store::Index;
use planner::way::Travel;
use protocol::powercube::{AddressedRequest, MotionPosition, Parameter, Reply, Request, Value};
use protocol::{Duration, Frame, Instant};
use robot_model::RobotModel;

/// Answers this far apart show a speed: longer than the steps of the encoder matter, shorter than a ramp.
const SPEED_WINDOW_S: f64 = 0.02;
/// Two steps of 0.02 degrees over the window.
const SPEED_SLACK_RAD_S: f64 = 2.0 * 3.5e-4 / SPEED_WINDOW_S;
/// Rounding of limits to single precision.
const ROUNDING: f64 = 1.0 + 1e-5;

/// Numbers of one throw.
pub(crate) struct Outcome {
    pub(crate) landing_m: Vector3<f64>,
    pub(crate) landing_error_m: f64,
    /// The ball of the simulated world when it became free, and how late that was.
    pub(crate) released: HandPoint,
    pub(crate) late_s: f64,
    /// Ball at the release against the plan at that instant, m and m/s.
    pub(crate) deviation: Vector6<f64>,
    /// Limits that were not kept, as text.
    pub(crate) violations: Vec<String>,
}

#[derive(Clone, Copy)]
struct Limits {
    q_rad: (f64, f64),
    v_rad_s: f64,
    a_rad_s2: f64,
}

/// Looks at every frame: what is commanded, and what is answered.
#[derive(Clone)]
struct Witness {
    limits: BTreeMap<u8, Limits>,
    found: Rc<RefCell<Found>>,
}

#[derive(Default)]
struct Found {
    violations: Vec<String>,
    last: BTreeMap<u8, Vec<(Instant, f64)>>,
}

impl Tap for Witness {
    fn frame(&mut self, at: Instant, _: Way, frame: &Frame) -> io::Result<()> {
        if frame.is_extended() {
            return Ok(());
        }
        let mut found = self.found.borrow_mut();
        if let Ok(request) = AddressedRequest::decode(frame)
            && let Some(limits) = self.limits.get(&request.module.get())
        {
            let module = request.module;
            match request.request {
                Request::Set(Parameter::TargetVel, Value::F32(v))
                    if f64::from(v).abs() > limits.v_rad_s * ROUNDING =>
                {
                    found.violations.push(format!("module {module} at {at}: speed of {v} rad/s commanded"));
                }
                Request::Set(Parameter::TargetAcc, Value::F32(a))
                    if f64::from(a).abs() > limits.a_rad_s2 * ROUNDING =>
                {
                    found.violations.push(format!("module {module} at {at}: {a} rad/s2 commanded"));
                }
                _ => {}
            }
        }
        let Ok((module, reply)) = Reply::decode(frame) else { return Ok(()) };
        let q = match reply {
            Reply::MotionExtended { position: MotionPosition::Radians(rad), .. } => f64::from(rad.get()),
            Reply::Value(_, Value::PosStateDio(all)) => f64::from(all.position_rad),
            _ => return Ok(()),
        };
        let Some(limits) = self.limits.get(&module.get()).copied() else { return Ok(()) };
        if q < limits.q_rad.0 || q > limits.q_rad.1 {
            found.violations.push(format!("module {module} at {at}: stands at {q} rad"));
        }
        let window = found.last.entry(module.get()).or_default();
        window.push((at, q));
        let old =
            window.iter().rposition(|(then, _)| at.saturating_since(*then).as_secs_f64() >= SPEED_WINDOW_S);
        if let Some(old) = old {
            let (then, before) = window[old];
            let v = (q - before) / at.saturating_since(then).as_secs_f64();
            window.drain(..old);
            if v.abs() > limits.v_rad_s + SPEED_SLACK_RAD_S {
                found.violations.push(format!("module {module} at {at}: moves at {v} rad/s"));
            }
        }
        Ok(())
    }
}

/// Cells of one kind, and the throws for them.
pub(crate) struct Rig {
    arm: Arm,
    index: Index,
    setup: SimSetup,
}

impl Rig {
    fn new(setup: SimSetup) -> Self {
        let arm = RobotModel::load("powercube6").unwrap();
        let index = seeds::built_in(&arm);
        Self { arm, index, setup }
    }

    /// The cell as the model says, gripper within ± 1 ms.
    pub(crate) fn nominal() -> Self {
        let mut setup = SimSetup::default();
        setup.cell.drive.starts_homed = true;
        Self::new(setup)
    }

    /// Masses ± 10 %, friction ± 50 %, answers after 50 to 400 µs, gripper ± 2 ms.
    pub(crate) fn perturbed() -> Self {
        let mut rig = Self::nominal();
        let cell = &mut rig.setup.cell;
        cell.scatter.mass_share = 0.1;
        cell.scatter.friction_share = 0.5;
        cell.drive.processing_delay = Duration::from_micros(225);
        cell.scatter.delay_share = 175.0 / 225.0;
        cell.gripper.jitter = Duration::from_millis(2);
        rig
    }

    /// The ball leaves between fingers that open.
    pub(crate) fn with_fingers() -> Self {
        let mut rig = Self::nominal();
        rig.setup.cell.finger_release = true;
        rig
    }

    fn problem(&self, target_m: [f64; 3]) -> Option<Problem<'_>> {
        Problem::new(&self.arm, Vector3::from(target_m), Options::best()).ok()
    }

    /// A throw to the target; `None` if it is out of reach.
    pub(crate) fn plan(&self, target_m: [f64; 3]) -> Option<PlanFile> {
        let problem = self.problem(target_m)?;
        let planner = Planner::new(&problem);
        let budget = Budget { starts: 12, all: false, time: None, seed: 1 };
        // Between the stored throws a few random starts may be needed.
        let search = || planner.attempt(&self.index, &budget, &Watch::default()).ok().map(|best| best.found);
        let found = planner.from_index(&self.index, 6).or_else(search)?;
        let best = Best {
            found,
            starts: 1,
            solved: 1,
            interrupted: false,
            confidence: Confidence::default(),
            others: vec![found],
        };
        PlanFile::of(&problem, &best, "powercube6", 1, &Noise::default(), None)
    }

    /// As [`Rig::plan`], with random starts where the stored throws do not lead.
    pub(crate) fn plan_thoroughly(&self, target_m: [f64; 3]) -> Option<PlanFile> {
        let search = || {
            let problem = self.problem(target_m)?;
            let budget = Budget { starts: 24, all: false, time: None, seed: 1 };
            let best = Planner::new(&problem).search(&self.index, &budget, &Watch::default()).ok()?;
            PlanFile::of(&problem, &best, "powercube6", 1, &Noise::default(), None)
        };
        self.plan(target_m).or_else(search)
    }

    /// A throw to a target with options of its own.
    pub(crate) fn plan_with(&self, target_m: [f64; 3], options: Options) -> PlanFile {
        let problem = Problem::new(&self.arm, Vector3::from(target_m), options).unwrap();
        let budget = Budget { starts: 16, ..Budget::default() };
        let best = Planner::new(&problem).search(&self.index, &budget, &Watch::default()).unwrap();
        PlanFile::of(&problem, &best, "powercube6", 1, &Noise::default(), None).unwrap()
    }

    /// As [`Rig::try_throw`], which must come to its end.
    pub(crate) fn throw(&self, plan: &PlanFile, seed: u64) -> Outcome {
        self.try_throw(plan, seed)
            .unwrap_or_else(|error| panic!("seed {seed}, {:?}: {error}", plan.target.position_m))
    }

    /// Throws in a fresh cell whose arm stands at the start of the plan.
    pub(crate) fn try_throw(&self, plan: &PlanFile, seed: u64) -> Result<Outcome, JobError> {
        let motion: Motion = plan.motion.to_motion();
        let mut setup = self.setup.clone();
        setup.cell.start_q_rad = Some(motion.start_rad().iter().copied().collect());
        let met_m = plan.meeting_m();
        setup.cell.gripper.landing_z_m = Some(met_m[2]);
        setup.cell.gripper.landing_plane = plan
            .target
            .opening
            .map(|o| Plane { point_m: Vector3::from(met_m), normal: Vector3::from(o.normal) });
        let robot = RobotModel::load("powercube6").unwrap();
        let settings = settings_of(&robot).unwrap();
        let cell = Cell { robot_source: "powercube6".to_owned(), robot, seed, setup };
        let mut session = BusArgs::default().open_cell(&cell, Some(&settings)).unwrap();
        let witness = self.witness();
        session.add_tap(Box::new(witness.clone()));
        let order = Order {
            judge: Judge::Throw { plan, tolerance_m: 0.01 },
            ..Order::throw(&self.arm, plan, Travel { seed, ..Travel::default() })
        };
        let record = perform(&mut OnBus::new(&mut session, None), &order, &mut |_| Answer::Yes);
        if let Some(error) = record.ended {
            return Err(error);
        }
        let report = session.sim().unwrap().cell().throw().clone();
        let released = report.release.expect("the ball was released");
        let late_s = record.landing.and_then(|landed| landed.release_late_s).expect("and landed");
        let (p, v) = self.ball(&motion, plan.release_time_s + late_s);
        let (dp, dv) = (released.p_m - p, released.v_m_s - v);
        let landed = record.landing.expect("the ball landed");
        let violations = std::mem::take(&mut witness.found.borrow_mut().violations);
        Ok(Outcome {
            landing_m: landed.position_m,
            landing_error_m: landed.error_m,
            released,
            late_s,
            deviation: Vector6::new(dp.x, dp.y, dp.z, dv.x, dv.y, dv.z),
            violations,
        })
    }

    fn witness(&self) -> Witness {
        let drives = self.arm.drives().unwrap();
        let limits = self.arm.joints().iter().zip(drives).map(|(joint, drive)| {
            let l = &joint.limits;
            let limits = Limits {
                q_rad: (l.q_min_rad, l.q_max_rad),
                v_rad_s: l.v_max_rad_s,
                a_rad_s2: l.a_control_max_rad_s2,
            };
            (drive.address, limits)
        });
        Witness { limits: limits.collect(), found: Rc::default() }
    }

    fn ball(&self, motion: &Motion, t_s: f64) -> (Vector3<f64>, Vector3<f64>) {
        let Sample { q, qd, .. }: Sample = motion.at(t_s);
        let frames = self.arm.fk(&q);
        let p = self.arm.ball(&frames).pos;
        let twist = frames.jacobian(&p) * qd;
        (p, Vector3::new(twist[0], twist[1], twist[2]))
    }

    /// By how much the landing moves with position and velocity of the ball at the release.
    pub(crate) fn landing_jacobian(&self, plan: &PlanFile) -> SMatrix<f64, 2, 6> {
        let flight = FlightModel::vacuum(plan.landing.gravity_m_s2).unwrap();
        let (p, v) = (Vector3::from(plan.release.position_m), Vector3::from(plan.release.velocity_m_s));
        let landing = flight.land(&p, &v, plan.target.position_m[2]).unwrap();
        flight.landing_jacobian(&landing)
    }

    /// Spread of the landing by a release that is evenly distributed within ± `half` of the planned time, as the
    /// planner's statistics have it (normal, of the same variance).
    pub(crate) fn jitter_covariance(&self, plan: &PlanFile, half: Duration) -> Matrix2<f64> {
        let problem = self.problem(plan.target.position_m).unwrap();
        let throw = planner::plan::Throw {
            q_rad: Joints::from_slice(&plan.release.q_rad),
            qd_rad_s: Joints::from_slice(&plan.release.qd_rad_s),
            qdd_rad_s2: Joints::from_slice(&plan.release.qdd_rad_s2),
            flight_s: plan.landing.flight_s,
            ha_s: plan.release_time_s,
            hb_s: plan.end_time_s - plan.release_time_s,
        };
        let noise = Noise {
            release_time_s: half.as_secs_f64() / 3_f64.sqrt(),
            position_rad: 0.0,
            speed_rad_s: 0.0,
            drag_per_m: 0.0,
            release_nodes: None,
        };
        predict(&problem, &throw, &noise).unwrap().covariance_m2
    }
}
