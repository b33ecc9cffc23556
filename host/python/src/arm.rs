//! An arm that stays connected: one thread owns the session and carries out one order after the other.
//!
//! A call waits for its order, and the arm stands when it returns. A stop, from another thread or by Ctrl-C, brings the arm to rest
//! along its path, and ends all orders until it is carried out.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, SyncSender, TryRecvError, channel, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration as WallTime;

use host::cmd::connected::Connected as OneArm;
use host::cmd::link::{Link, Machine};
use host::cmd::move_arm::no_way;
use host::cmd::target::{Target as On, scene};
use host::error::{Cause, ExpectedError};
use host::exit;
use nalgebra::Vector3;
use operator::bus::BusArgs;
use operator::bus::key_file::KeyArgs;
use operator::dialogue::operator::OperatorError;
use operator::job::{Answer, Extent, OnProgress, Order, Progress, Target};
use planner::motion::Motion;
use planner::store::fingerprint_of;
use planner::timing::{Limits, Path, Row, along, motion_of_rows};
use planner::way::{Goal, Travel, require_free_motion};
use protocol::Duration;
use protocol::cyphal::cubecell::group_state::State;
use protocol::cyphal::id::NodeId;
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use robot_model::collision::Scene;
use robot_model::{JointVec, Pose, RobotModel};
use serde_json::json;

use crate::arrays::doubles;
use crate::bus::Joined;
use crate::errors::{bad, refused};

/// Time between two looks at signals, and of one look at a bus without orders.
pub(crate) const LOOK: WallTime = WallTime::from_millis(50);
const IDLE: Duration = Duration::from_millis(20);
/// Longest start-up of a controller.
const BOOT_MAX: Duration = Duration::from_secs(20);

/// How an arm is connected.
#[derive(FromPyObject)]
pub(crate) struct Connection {
    #[pyo3(item)]
    bus: Joined,
    #[pyo3(item)]
    controller: Option<u8>,
    #[pyo3(item)]
    key_file: Option<PathBuf>,
    #[pyo3(item)]
    record: Option<PathBuf>,
    #[pyo3(item)]
    rsi: Option<String>,
}

type Answered = Result<String, ExpectedError>;
type Work = Box<dyn FnOnce(&mut Connected<'_>) -> Answered + Send>;

/// An order, and where its result goes.
struct Asked {
    work: Work,
    answer: SyncSender<Answered>,
}

/// What the thread has.
pub(crate) struct Connected<'a> {
    pub(crate) arm: OneArm<'a, 'a>,
    step: &'a Mutex<String>,
    stop: &'a AtomicBool,
}

/// An arm on a bus.
#[pyclass]
pub(crate) struct Arm {
    orders: Option<Sender<Asked>>,
    stop: Arc<AtomicBool>,
    step: Arc<Mutex<String>>,
    joints: usize,
    is_simulated: bool,
}

#[pymethods]
impl Arm {
    /// Joins the bus.
    #[new]
    fn connect(py: Python<'_>, connection: Connection) -> PyResult<Self> {
        let (stop, step) = (Arc::new(AtomicBool::new(false)), Arc::new(Mutex::new(String::new())));
        let (orders, asked) = channel();
        let is_simulated = connection.bus.is_simulated();
        let (ready, opened) = sync_channel(1);
        let (stopped, shown) = (Arc::clone(&stop), Arc::clone(&step));
        let thread = thread::Builder::new().name("arm".to_owned()).stack_size(8 << 20);
        let thread = thread.spawn(move || serve(&connection, &stopped, &shown, &asked, &ready));
        drop(thread.map_err(|error| PyRuntimeError::new_err(error.to_string()))?);
        let mut opened = opened;
        let waiting = &mut opened;
        let joints = py
            .detach(move || waiting.recv())
            .unwrap_or_else(|_| Err(lost()))
            .map_err(|error| refused(&error))?;
        Ok(Self { orders: Some(orders), stop, step, joints, is_simulated })
    }

    #[getter]
    const fn joints(&self) -> usize {
        self.joints
    }

    /// The step at work, as people read it.
    fn progress(&self) -> String {
        self.step.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn home(&self, py: Python<'_>) -> PyResult<String> {
        self.order(py, |arm| {
            arm.arm.forget_end();
            Ok(json!({ "q_rad": arm.ready(true)?.as_slice() }).to_string())
        })
    }

    /// To joint angles.
    fn move_joints(&self, py: Python<'_>, q_rad: &[u8], how: How) -> PyResult<String> {
        let q_rad = doubles(q_rad)?;
        self.order(py, move |arm| {
            let target = Target::joints(arm.arm.robot, &q_rad).map_err(|e| ExpectedError::bad_input(&e))?;
            arm.go(&target, &how)
        })
    }

    /// Joints, from 0, turned by angles in rad.
    fn move_by(&self, py: Python<'_>, turned: Vec<(usize, f64)>, how: How) -> PyResult<String> {
        self.order(py, move |arm| {
            let target = Target::by(arm.arm.robot, &turned).map_err(|e| ExpectedError::bad_input(&e))?;
            arm.go(&target, &how)
        })
    }

    /// The hand to a place (three numbers, m) or a pose (with roll, pitch and yaw, rad).
    fn move_hand(&self, py: Python<'_>, to: &[u8], straight: bool, how: How) -> PyResult<String> {
        let to = doubles(to)?;
        let goal = match to[..] {
            [x, y, z] => Goal::Point(Vector3::new(x, y, z)),
            [x, y, z, roll, pitch, yaw] => {
                Goal::Pose(Pose::from_rpy([roll, pitch, yaw], Vector3::new(x, y, z)))
            }
            _ => return Err(bad(&"a place of the hand is x, y, z, or x, y, z, roll, pitch, yaw")),
        };
        if !to.iter().all(|value| value.is_finite()) {
            return Err(bad(&"a place of the hand has finite numbers"));
        }
        self.order(py, move |arm| arm.go(&Target::Hand { goal, straight }, &how))
    }

    /// Through rows of joint angles, at times if there are any.
    #[pyo3(signature = (t_s, q_rad, blend_rad, how))]
    fn run(
        &self,
        py: Python<'_>,
        t_s: Option<&[u8]>,
        q_rad: &[u8],
        blend_rad: f64,
        how: How,
    ) -> PyResult<String> {
        let (t_s, q_rad) = (t_s.map(doubles).transpose()?, doubles(q_rad)?);
        self.order(py, move |arm| arm.follow(t_s.as_deref(), &q_rad, blend_rad, &how))
    }

    fn gripper(&self, py: Python<'_>, open: bool) -> PyResult<String> {
        self.order(py, move |arm| {
            arm.arm.operator.connect()?;
            arm.arm.operator.heed_stops()?;
            arm.arm.operator.set_gripper(open)?;
            Ok(String::new())
        })
    }

    fn state(&self, py: Python<'_>) -> PyResult<String> {
        self.order(py, |arm| {
            arm.arm.operator.connect()?;
            if arm.arm.operator.group().state == State::Boot
                && let Err(error) = arm.arm.operator.wait_for(BOOT_MAX, &|state| state != State::Boot)
                && !matches!(error, OperatorError::Stopped { .. })
            {
                return Err(error.into());
            }
            let group = arm.arm.operator.group();
            let known = !matches!(group.state, State::Boot | State::Fault);
            let q_rad = known.then(|| arm.arm.operator.pose()).transpose()?;
            Ok(json!({
                "state": format!("{:?}", group.state).to_lowercase(),
                "fault": (group.fault_cause != 0).then_some(group.fault_cause),
                "homed": (0..arm.arm.robot.n()).map(|j| group.homed_mask >> j & 1 == 1).collect::<Vec<_>>(),
                "q_rad": q_rad,
            })
            .to_string())
        })
    }

    fn clear(&self, py: Python<'_>) -> PyResult<String> {
        self.order(py, |arm| {
            arm.arm.operator.clear_fault()?;
            Ok(String::new())
        })
    }

    /// Brings the arm to rest: what is at work ends along its path, and what waits is not begun.
    fn stop(&self, py: Python<'_>) -> PyResult<()> {
        self.stop.store(true, Ordering::Relaxed);
        self.carry_out_stop(py)
    }

    /// Ends the connection; the arm stands.
    fn close(&mut self, py: Python<'_>) -> PyResult<()> {
        let Some(orders) = self.orders.take() else { return Ok(()) };
        let (answer, mut ended) = sync_channel(1);
        // A thread that is gone has ended its session.
        let _ = orders.send(Asked { work: Box::new(|_| Ok(String::new())), answer });
        drop(orders);
        let waiting = &mut ended;
        let _ = py.detach(move || waiting.recv());
        Ok(())
    }
}

impl Arm {
    fn carry_out_stop(&self, py: Python<'_>) -> PyResult<()> {
        let stop = Arc::clone(&self.stop);
        self.ask(py, move |arm| {
            stop.store(false, Ordering::Relaxed);
            arm.arm.operator.connect()?;
            let stopped = arm.arm.operator.stop();
            arm.arm.operator.heed_stops_from_now();
            stopped?;
            Ok(String::new())
        })
        .map(drop)
    }

    pub(crate) const fn is_simulated(&self) -> bool {
        self.is_simulated
    }

    /// Gives an order and does not wait.
    pub(crate) fn begin(&self, work: Work, answer: SyncSender<Answered>) -> PyResult<()> {
        let stop = Arc::clone(&self.stop);
        let unless_stopped = move |arm: &mut Connected<'_>| {
            if stop.load(Ordering::Relaxed) { Err(stopped()) } else { work(arm) }
        };
        let orders = self.orders.as_ref().ok_or_else(|| bad(&"the connection is closed"))?;
        orders.send(Asked { work: Box::new(unless_stopped), answer }).map_err(|_| refused(&lost()))
    }

    /// Does an order. If a signal handler raises, as that of Ctrl-C does, the arm comes to rest before the exception is passed on.
    fn order(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&mut Connected<'_>) -> Answered + Send + 'static,
    ) -> PyResult<String> {
        self.ask(py, |arm| {
            if arm.stop.load(Ordering::Relaxed) {
                return Err(stopped());
            }
            work(arm).inspect_err(|_| {
                // A stop of somebody else is reported once.
                arm.arm.operator.heed_stops_from_now();
            })
        })
    }

    fn ask(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&mut Connected<'_>) -> Answered + Send + 'static,
    ) -> PyResult<String> {
        let orders = self.orders.as_ref().ok_or_else(|| bad(&"the connection is closed"))?;
        let (answer, mut answered) = sync_channel(1);
        orders.send(Asked { work: Box::new(work), answer }).map_err(|_| refused(&lost()))?;
        let mut raised = None;
        loop {
            let waiting = &mut answered;
            match py.detach(move || waiting.recv_timeout(LOOK)) {
                Ok(done) => match raised {
                    None => return done.map_err(|error| refused(&error)),
                    Some(error) => {
                        self.carry_out_stop(py)?;
                        return Err(error);
                    }
                },
                Err(RecvTimeoutError::Timeout) => {
                    if let Err(error) = py.check_signals() {
                        self.stop.store(true, Ordering::Relaxed);
                        raised.get_or_insert(error);
                    }
                }
                Err(RecvTimeoutError::Disconnected) => return Err(refused(&lost())),
            }
        }
    }
}

fn stopped() -> ExpectedError {
    ExpectedError::new(exit::INTERRUPTED, "stopped before it began")
}

pub(crate) fn lost() -> ExpectedError {
    ExpectedError::new(exit::BUG, "the thread of the connection has ended")
}

/// How a motion is made.
#[derive(FromPyObject)]
pub(crate) struct How {
    #[pyo3(item)]
    speed_share: f64,
    #[pyo3(item)]
    seed: u64,
    /// Centre and half edges, m, base frame.
    #[pyo3(item)]
    obstacles: Vec<[f64; 6]>,
    #[pyo3(item)]
    ball: bool,
}

impl How {
    pub(crate) const fn speed_share(&self) -> f64 {
        self.speed_share
    }

    pub(crate) fn scene(&self) -> Scene {
        scene(&self.obstacles, self.ball)
    }

    fn travel(&self) -> Travel {
        Travel { share: self.speed_share, seed: self.seed, range: None }
    }
}

impl<'a> Connected<'a> {
    /// The arm stands and may move; where the next motion begins, rad.
    pub(crate) fn ready(&mut self, homes: bool) -> Result<JointVec, ExpectedError> {
        self.shown(|arm, ui| arm.ready(homes, ui))
    }

    /// Does `work`; the step at work is shown meanwhile.
    fn shown<R>(&mut self, work: impl FnOnce(&mut OneArm<'a, 'a>, OnProgress<'_>) -> R) -> R {
        let step = self.step;
        let show = |text: &str| text.clone_into(&mut step.lock().unwrap_or_else(PoisonError::into_inner));
        let done = work(&mut self.arm, &mut |progress| {
            if let Progress::Begin(step) = progress {
                show(step.name());
            }
            Answer::Yes
        });
        show("");
        done
    }

    fn go(&mut self, target: &Target, how: &How) -> Answered {
        let scene = how.scene();
        let from = self.shown(|arm, ui| arm.begin(false, ui))?;
        let (robot, mut way) = (self.arm.robot, Ok(None));
        self.arm.operator.meanwhile(&mut || way = target.way(robot, &scene, &how.travel(), &from))?;
        match way.map_err(|error| no_way(&error))? {
            Some(motion) => self.move_along(&Order { scene, ..self.arm.order(motion, Extent::Run) }),
            None => Ok(json!({
                "duration_s": 0.0, "q_rad": from.as_slice(), "off_rad": 0.0, "end_off_rad": 0.0,
                "text": "the arm is there; nothing has moved",
            })
            .to_string()),
        }
    }

    fn follow(&mut self, t_s: Option<&[f64]>, q_rad: &[f64], blend_rad: f64, how: &How) -> Answered {
        let (robot, mut found) = (self.arm.robot, Ok(Motion::default()));
        self.arm.operator.meanwhile(&mut || found = motion_of(robot, t_s, q_rad, blend_rad, how))?;
        let travel = Some(Travel { share: how.speed_share.min(1.0), ..how.travel() });
        self.move_along(&Order { scene: how.scene(), travel, ..self.arm.order(found?, Extent::Run) })
    }

    fn move_along(&mut self, order: &Order<'_>) -> Answered {
        let record = self.shown(|arm, ui| arm.run(order, ui))?;
        let motion = order.program.motion();
        Ok(json!({
            "duration_s": motion.duration_s(),
            "q_rad": motion.stop_rad().as_slice(),
            "off_rad": record.reached.as_ref().map(|reached| reached.off_rad),
            "end_off_rad": record.reached.as_ref().map(|reached| reached.end_off_rad),
            "text": record.verdict.text,
        })
        .to_string())
    }
}

/// The motion through rows of angles, at their times if there are any.
fn motion_of(
    robot: &RobotModel,
    t_s: Option<&[f64]>,
    q_rad: &[f64],
    blend_rad: f64,
    how: &How,
) -> Result<Motion, ExpectedError> {
    let bad = |error: &dyn Cause| ExpectedError::bad_input(error);
    let rows: Vec<&[f64]> = q_rad.chunks_exact(robot.n()).collect();
    let limits = Limits::of_arm(robot, if t_s.is_some() { 1.0 } else { how.speed_share })
        .ok_or_else(|| bad(&"a share of the limits is above 0 and at most 1"))?;
    for (row, number) in rows.iter().zip(1..) {
        let outside = |j: &usize| !(robot.q_min()[*j]..=robot.q_max()[*j]).contains(&row[*j]);
        if let Some(j) = (0..row.len()).find(outside) {
            let name = &robot.joints()[j].name;
            return Err(bad(&format!("point {number}: {name} at {} rad is outside its range", row[j])));
        }
    }
    let motion = match t_s {
        Some(t_s) => {
            let rows: Vec<Row> = t_s
                .iter()
                .zip(&rows)
                .map(|(t_s, q_rad)| Row { t_s: *t_s, q_rad: q_rad.to_vec(), qd_rad_s: None })
                .collect();
            motion_of_rows(&rows, &limits).map_err(|error| bad(&error))?
        }
        None => {
            let path = Path::through(&rows, blend_rad).map_err(|error| bad(&error))?;
            along(&path, &limits).ok_or_else(|| bad(&"no times were found: take points out"))?
        }
    };
    require_free_motion(robot, &how.scene(), &motion).map_err(|error| no_way(&error))?;
    Ok(motion)
}

/// The thread: joins the bus, does what is asked until nobody can ask any more, and leaves.
fn serve(
    connection: &Connection,
    stop: &Arc<AtomicBool>,
    step: &Mutex<String>,
    asked: &Receiver<Asked>,
    ready: &SyncSender<Result<usize, ExpectedError>>,
) {
    let (mut link, machine) = match open(connection, stop) {
        Ok(opened) => opened,
        Err(error) => {
            let _ = ready.send(Err(error));
            return;
        }
    };
    let _ = ready.send(Ok(machine.arm.n()));
    let fingerprint = fingerprint_of(&machine.arm);
    link.with(|operator| {
        let waits = operator.needs_times();
        let arm = OneArm::new(operator, &machine.arm, &fingerprint);
        answer(&mut Connected { arm, step, stop }, waits, asked);
    });
    // What fails now has no say in what was done.
    drop(link.end());
}

/// Does what is asked until nobody can ask any more.
fn answer(arm: &mut Connected<'_>, waits: bool, asked: &Receiver<Asked>) {
    loop {
        // Between orders the time of a simulated cell does not pass. A real bus is read all the time.
        let next =
            if waits { asked.recv().map_err(|_| TryRecvError::Disconnected) } else { asked.try_recv() };
        match next {
            Ok(Asked { work, answer }) => {
                let _ = answer.send(work(arm));
            }
            Err(TryRecvError::Empty) => {
                if arm.arm.operator.pass(IDLE).is_err() {
                    // The next order reports it.
                    thread::sleep(LOOK);
                }
            }
            Err(TryRecvError::Disconnected) => break,
        }
    }
}

fn open(connection: &Connection, stop: &Arc<AtomicBool>) -> Result<(Link, Machine), ExpectedError> {
    let (record, rsi) = (connection.record.clone(), connection.rsi.clone());
    let on = On {
        bus: BusArgs { record, rsi, ..connection.bus.args()? },
        key: KeyArgs { key_file: connection.key_file.clone() },
        controller: connection.controller.and_then(|node| NodeId::new(node).ok()),
    };
    let machine = Machine::of(&on)?;
    Ok((Link::open_until(&on, &machine, None, true, Arc::clone(stop))?, machine))
}
