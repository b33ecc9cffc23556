//! What a step of the simulated cell costs, and where it goes. Prints; asserts nothing.
//!
//! `cargo bench -p hil-sim --bench cell`

use std::hint::black_box;
use std::time::Instant as Wall;

use hil_sim::drive::ramp::Ramp;
use hil_sim::mechanics::perturb::Scatter;
use hil_sim::mechanics::{AxisInput, MechanicsOptions, Plant};
use hil_sim::participants::Participants;
use hil_sim::{Cell, CellOptions};
use protocol::powercube::{MotionCommand, MotionRequest, Parameter, Request, Value};
use protocol::units::Radians;
use protocol::{Duration, Instant, ModuleId};
use robot_model::{AnyRobot, JointVec, RobotModel};

/// Median over `rounds` of the nanoseconds per call of `calls` calls.
fn median_ns(rounds: usize, calls: usize, mut f: impl FnMut()) -> f64 {
    let mut times: Vec<f64> = (0..rounds)
        .map(|_| {
            let start = Wall::now();
            for _ in 0..calls {
                f();
            }
            start.elapsed().as_secs_f64() * 1e9 / calls as f64
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[rounds / 2]
}

fn main() {
    let text = robot_model::built_in_text("powercube6").expect("built in");
    let model: RobotModel<6> = RobotModel::from_toml("powercube6", text).expect("valid");
    let (q, v) = (JointVec::<6>::repeat(0.3), JointVec::<6>::repeat(0.5));

    println!("one call, median of 301 rounds:");
    let print = |what: &str, ns: f64| println!("  {what:<44} {ns:>8.0} ns");
    print(
        "mass matrix",
        median_ns(301, 100, || {
            black_box(model.mass_matrix(black_box(&q)));
        }),
    );
    print(
        "bias torques",
        median_ns(301, 100, || {
            black_box(model.bias_torques(black_box(&q), &v));
        }),
    );
    let deviations = std::array::from_fn(|i| Scatter::default().draw(1, i));
    for (what, elastic) in
        [("step of the mechanism, stiff gears", false), ("step of the mechanism, elastic gears", true)]
    {
        let elasticity = elastic
            .then_some(hil_sim::mechanics::Elasticity { stiffness_nm_rad: 20e3, damping_nms_rad: 20.0 });
        let options = MechanicsOptions { elasticity, ..MechanicsOptions::default() };
        let tuned = options.servo_inertia_kg_m2(&model);
        let mut arm = options.build(&model, q, &deviations);
        let inputs: Vec<AxisInput> = (0..6)
            .map(|i| AxisInput {
                reference_rad: q[i],
                stiffness_nm_rad: tuned[i] * 320.0 * 320.0,
                damping_nms_rad: tuned[i] * 512.0,
                torque_max_nm: 200.0,
                ..AxisInput::default()
            })
            .collect();
        print(what, median_ns(301, 100, || arm.step(5e-4, &inputs)));
    }
    print(
        "ramp made",
        median_ns(301, 1_000, || {
            black_box(Ramp::to_position(black_box(0.1), 0.2, 1.0, 2.0, 8.0));
        }),
    );

    println!("\nsix drives on the arm, no bus, median of 301 rounds of 20 simulated milliseconds:");
    for (what, period_us) in [
        ("no traffic", None),
        ("3 requests per joint, 17 ms", Some(17_000)),
        ("3 requests per joint, 2.7 ms", Some(2_700)),
    ] {
        let mut cell = cell(1_000);
        let ns = median_ns(301, 1, || chunk(&mut cell, period_us));
        println!("  {what:<44} {:>8.0} x real time", 2e7 / ns);
    }
    println!("\nby step of the grid, no traffic:");
    for step_us in [250, 500, 1_000] {
        let mut cell = cell(step_us);
        let ns = median_ns(301, 1, || chunk(&mut cell, None));
        println!("  {step_us:>5} us {:>42.0} x real time", 2e7 / ns);
    }
}

const CHUNK: Duration = Duration::from_millis(20);

fn cell(step_us: u64) -> Cell {
    let robot = AnyRobot::load("powercube6").expect("built in");
    let mut options = CellOptions { step: Duration::from_micros(step_us), ..CellOptions::default() };
    options.drive.starts_homed = true;
    let mut cell = Cell::new(&robot, &options, 1).expect("valid");
    cell.advance(Instant::from_micros(200_000));
    cell
}

/// 20 simulated milliseconds: short enough to be over before the machine turns to something else. Every period each joint gets SET velocity, SET acceleration and a ramp.
fn chunk(cell: &mut Cell, period_us: Option<u64>) {
    let start = cell.grid();
    let end = start + CHUNK;
    let Some(period_us) = period_us else {
        cell.advance(end);
        return;
    };
    let mut now = start;
    let mut k = 0_u32;
    while now < end {
        let sway = 0.15 * (1.0 + (2.0 * now.as_secs_f64()).sin());
        for i in 0..6 {
            let module = ModuleId::new(i as u8 + 1).expect("1..=6");
            let target = cell.drives()[i].nameplate().home_edge_rad + sway;
            let requests = [
                Request::Set(Parameter::TargetVel, Value::F32(1.0)),
                Request::Set(Parameter::TargetAcc, Value::F32(5.0)),
                Request::Move(MotionRequest::extended(MotionCommand::Ramp {
                    target: Radians::new(target as f32),
                })),
            ];
            for request in requests {
                let frame = request.encode(module);
                cell.advance(now);
                // On a bus every node is offered every frame.
                for node in 0..cell.len() {
                    cell.node(node).handle_frame(now, &frame);
                }
                now += Duration::from_micros(125);
                serve(cell, now);
            }
        }
        now = (start + Duration::from_micros(period_us * u64::from(k + 1))).max(now);
        k += 1;
        serve(cell, now);
    }
    cell.advance(end);
}

fn serve(cell: &mut Cell, until: Instant) {
    for node in 0..cell.len() {
        while let Some(at) = cell.node(node).poll_timeout().filter(|at| *at <= until) {
            cell.node(node).handle_timeout(at);
            while let Some(frame) = cell.node(node).poll_frame() {
                black_box(frame);
            }
        }
    }
}
