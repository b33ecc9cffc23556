//! Position, velocity and current of a drive over time in each of its modes, as one HTML file that opens offline.
//!
//! `cargo run --release -p hil-sim --example drive-modes -- drive-modes.html`
//!
//! The drive is the second one of the throwing arm: it lifts the whole arm, so load, gravity and friction show.

use std::error::Error;
use std::fmt::Write as _;

use hil_sim::fault::{FaultTarget, PhysicalFault, Place};
use hil_sim::participants::Participants;
use hil_sim::{Cell, CellOptions};
use plotters::prelude::*;
use protocol::powercube::{
    Broadcast, Config, CubeState, MotionCommand, MotionRequest, Parameter, Request, SimpleCommand, Value,
};
use protocol::units::{Amperes, RadPerSec, Radians};
use protocol::{Duration, Frame, Instant, ModuleId};
use robot_model::AnyRobot;

/// The drive looked at, index from 0.
const AXIS: usize = 1;
const SAMPLE: Duration = Duration::from_millis(1);

/// One line of a figure's log.
struct Sample {
    t_s: f64,
    set_q_rad: f64,
    q_rad: f64,
    set_v_rad_s: f64,
    v_rad_s: f64,
    current_a: f64,
    state: CubeState,
}

/// A drive mode: title, what to see, and what is sent when.
struct Mode {
    title: &'static str,
    text: &'static str,
    homed: bool,
    length_ms: u64,
    script: Vec<(u64, Order)>,
}

/// What happens at a time.
enum Order {
    Send(Request),
    All(Broadcast),
    Fault(PhysicalFault),
}

fn set(parameter: Parameter, value: f32) -> Order {
    Order::Send(Request::Set(parameter, Value::F32(value)))
}

fn go(command: MotionCommand) -> Order {
    Order::Send(Request::Move(MotionRequest::extended(command)))
}

fn ramp(target: f64) -> Order {
    go(MotionCommand::Ramp { target: Radians::new(target as f32) })
}

/// Upright pose of the joint, rad: the start is 0.1 rad above.
const UPRIGHT: f64 = -std::f64::consts::FRAC_PI_2;

fn modes() -> Vec<Mode> {
    let q = |offset: f64| UPRIGHT + offset;
    let step =
        |offset: f64, time_ms| go(MotionCommand::Step { target: Radians::new(q(offset) as f32), time_ms });
    let velocity = |v| go(MotionCommand::Velocity(RadPerSec::new(v)));
    vec![
        Mode {
            title: "Ramp to a position",
            text: "FRAMP by 1.2 rad with at most 1.5 rad/s and 5 rad/s². The axis is 5 ms behind its set-point.",
            homed: true,
            length_ms: 2_000,
            script: vec![
                (100, set(Parameter::TargetVel, 1.5)),
                (110, set(Parameter::TargetAcc, 5.0)),
                (120, ramp(q(1.3))),
            ],
        },
        Mode {
            title: "Ramps re-targeted in flight",
            text: "A new target every 300 ms, the last one back beyond the start: it brakes, turns and comes back. Velocity and \
                   acceleration never exceed their maxima.",
            homed: true,
            length_ms: 4_400,
            script: vec![
                (100, set(Parameter::TargetVel, 1.5)),
                (110, set(Parameter::TargetAcc, 4.0)),
                (120, ramp(q(1.3))),
                (420, ramp(q(0.7))),
                (720, ramp(q(1.5))),
                (1_020, set(Parameter::TargetVel, 0.6)),
                (1_022, ramp(q(-0.3))),
            ],
        },
        Mode {
            title: "Acceleration control, as the throwing paper drives its arm",
            text: "Every 17 ms: SET acceleration, then FRAMP to the actual position ± 3 rad. The acceleration asked for is a \
                   cosine of 6 rad/s², so the velocity is a sine.",
            homed: true,
            length_ms: 1_300,
            script: std::iter::once((90, set(Parameter::TargetVel, 2.6)))
                .chain((0..60_u64).flat_map(move |k| {
                    let at = 100 + 17 * k;
                    let a = 6.0 * (std::f64::consts::TAU * (k as f64) / 60.0).cos();
                    let target = q(0.1 + 3.0_f64.copysign(a));
                    [(at, set(Parameter::TargetAcc, a.abs() as f32)), (at + 2, ramp(target))]
                }))
                .collect(),
        },
        Mode {
            title: "Steps with one in the buffer",
            text: "FSTEP of 0.15 rad in 150 ms each; the next one is sent before the one before ends and waits in the buffer.",
            homed: true,
            length_ms: 1_200,
            script: (0..5_u64).map(|k| (100 + 145 * k, step(0.1 + 0.15 * (k + 1) as f64, 150))).collect(),
        },
        Mode {
            title: "Velocity, into the soft limit",
            text: "FVEL of 0.8, then 1.4 rad/s toward a MaxPos 1 rad ahead: BEYOND_SOFT stops the module, the brake closes.",
            homed: true,
            length_ms: 1_900,
            script: vec![
                (100, set(Parameter::MaxPos, q(1.1) as f32)),
                (110, set(Parameter::TargetAcc, 5.0)),
                (120, velocity(0.8)),
                (620, velocity(1.4)),
            ],
        },
        Mode {
            title: "Current",
            text: "FCUR of 9 A, then -12 A: friction and gravity first, then the running current K_B v limits the speed. Modules \
                   report the magnitude.",
            homed: true,
            length_ms: 1_100,
            script: vec![
                (100, go(MotionCommand::Current(Amperes::new(9.0)))),
                (500, go(MotionCommand::Current(Amperes::new(-12.0)))),
            ],
        },
        Mode {
            title: "Cosine loop",
            text: "FCOSLOOP between the start and 0.6 rad above, period 1.2 s.",
            homed: true,
            length_ms: 2_600,
            script: vec![(
                100,
                go(MotionCommand::CosLoop { position: Radians::new(q(0.7) as f32), period_ms: 1_200 }),
            )],
        },
        Mode {
            title: "Homing",
            text: "HOME: down to the switch's edge, latched on the encoder index, then to rest. The coordinate of the module jumps from \
                   its power-on zero to the true one.",
            homed: false,
            length_ms: 1_500,
            script: vec![(100, Order::Send(Request::Simple(SimpleCommand::Home)))],
        },
        Mode {
            title: "Watchdog",
            text: "Refreshed every 20 ms until 0.7 s: 50 ms later the module brakes with its largest acceleration and is HALTED \
                   with COMM_ERROR.",
            homed: true,
            length_ms: 1_400,
            script: std::iter::once((
                90,
                Order::Send(Request::Set(
                    Parameter::Config,
                    Value::U32((Config::WATCHDOG_ENABLE | Config::BRAKE_PRESENT).bits()),
                )),
            ))
            .chain([(110, velocity(1.0))])
            .chain((0..30_u64).map(|k| (100 + 20 * k, Order::All(Broadcast::Watchdog))))
            .collect(),
        },
        Mode {
            title: "Axis held from outside",
            text: "The axis is blocked at 0.6 s: the following error grows to MaxDeltaPos = 0.1 rad, TOW_ERROR.",
            homed: true,
            length_ms: 1_400,
            script: vec![(100, velocity(0.8)), (600, Order::Fault(PhysicalFault::Blocked))],
        },
    ]
}

fn run(mode: &Mode) -> Result<Vec<Sample>, Box<dyn Error>> {
    let robot = AnyRobot::load("powercube6")?;
    let mut options = CellOptions::default();
    options.drive.starts_homed = mode.homed;
    let mut cell = Cell::new(&robot, &options, 1)?;
    cell.advance(Instant::from_micros(150_000));
    let origin = cell.grid();
    let module = ModuleId::new(AXIS as u8 + 1)?;
    let mut script: Vec<&(u64, Order)> = mode.script.iter().collect();
    script.sort_by_key(|(at, _)| *at);
    let mut script = script.into_iter().peekable();
    let mut samples = Vec::new();
    for k in 0..=mode.length_ms {
        let now = origin + SAMPLE * k;
        serve(&mut cell, now);
        cell.advance(now);
        while let Some((_, order)) = script.next_if(|(at, _)| *at <= k) {
            match order {
                Order::Send(request) => offer(&mut cell, now, &request.encode(module)),
                Order::All(broadcast) => offer(&mut cell, now, &broadcast.encode()),
                Order::Fault(fault) => cell.begin_fault(now, Place::Module(module), fault)?,
            }
        }
        let drive = &cell.drives()[AXIS];
        let set_point = drive.set_point(now);
        samples.push(Sample {
            t_s: k as f64 * 1e-3,
            set_q_rad: set_point.q_rad,
            q_rad: drive.believed_q_rad(now),
            set_v_rad_s: set_point.v_rad_s,
            v_rad_s: cell.plant().axis(AXIS).v_rad_s,
            current_a: drive.current_a(),
            state: drive.state_word(now),
        });
    }
    Ok(samples)
}

fn offer(cell: &mut Cell, now: Instant, frame: &Frame) {
    for index in 0..cell.len() {
        cell.node(index).handle_frame(now, frame);
    }
}

fn serve(cell: &mut Cell, until: Instant) {
    for index in 0..cell.len() {
        while let Some(at) = cell.node(index).poll_timeout().filter(|at| *at <= until) {
            cell.advance(at);
            cell.node(index).handle_timeout(at);
            while cell.node(index).poll_frame().is_some() {}
        }
    }
}

/// A line of a chart: its colour, and the number it takes from a sample.
type Line = (RGBColor, fn(&Sample) -> f64);

/// One chart: up to two lines over time, as SVG.
fn chart(samples: &[Sample], title: &str, lines: &[Line]) -> Result<String, Box<dyn Error>> {
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, (430, 240)).into_drawing_area();
        root.fill(&WHITE)?;
        let numbers = || lines.iter().flat_map(|(_, y)| samples.iter().map(y));
        let (low, high) = numbers().fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(v), h.max(v)));
        let room = (0.06 * (high - low)).max(1e-3);
        let end = samples.last().map_or(1.0, |sample| sample.t_s);
        let mut chart = ChartBuilder::on(&root)
            .caption(title, ("sans-serif", 14))
            .margin(6)
            .x_label_area_size(26)
            .y_label_area_size(46)
            .build_cartesian_2d(0.0..end, low - room..high + room)?;
        chart
            .configure_mesh()
            .x_labels(6)
            .y_labels(6)
            .light_line_style(TRANSPARENT)
            .bold_line_style(RGBColor(225, 225, 225))
            .label_style(("sans-serif", 11))
            .draw()?;
        for (colour, y) in lines {
            let points = samples.iter().map(|sample| (sample.t_s, y(sample)));
            chart.draw_series(LineSeries::new(points, colour.stroke_width(2)))?;
        }
        root.present()?;
    }
    Ok(svg)
}

/// The states passed through, each with the time at which it began.
fn history(samples: &[Sample]) -> String {
    let mut text = String::new();
    let mut before = None;
    for sample in samples {
        if before != Some(sample.state) {
            before = Some(sample.state);
            let _ = write!(
                text,
                "<li><b>{:.3} s</b> {}</li>",
                sample.t_s,
                sample.state.to_string().replace('|', " ")
            );
        }
    }
    text
}

const SET: RGBColor = RGBColor(200, 120, 0);
const ACTUAL: RGBColor = RGBColor(20, 80, 160);

fn page() -> Result<String, Box<dyn Error>> {
    let mut html = String::from(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><title>Drive modes</title><style>\
         body{font:15px/1.45 sans-serif;margin:2em auto;max-width:1340px;color:#222}\
         section{border-top:1px solid #ccc;padding:.6em 0}\
         h2{margin:.3em 0}p{margin:.2em 0 .6em}.row{display:flex;flex-wrap:wrap;gap:6px}\
         ul{columns:3;font-size:12px;margin:.4em 0;padding-left:1.2em}\
         .set{color:#c87800;font-weight:bold}.act{color:#1450a0;font-weight:bold}</style>\
         <h1>Drive modes</h1><p>Second drive (PR-090) of the simulated throwing arm, loaded by all links behind it. \
         <span class=\"set\">Set-point</span>, <span class=\"act\">actual</span>; time in s. Seed 1.</p>",
    );
    for mode in modes() {
        let samples = run(&mode)?;
        let _ = write!(html, "<section><h2>{}</h2><p>{}</p><div class=\"row\">", mode.title, mode.text);
        let position: [Line; 2] = [(SET, |s| s.set_q_rad), (ACTUAL, |s| s.q_rad)];
        let velocity: [Line; 2] = [(SET, |s| s.set_v_rad_s), (ACTUAL, |s| s.v_rad_s)];
        let current: [Line; 1] = [(ACTUAL, |s| s.current_a)];
        html.push_str(&chart(&samples, "position, rad", &position)?);
        html.push_str(&chart(&samples, "velocity, rad/s", &velocity)?);
        html.push_str(&chart(&samples, "current, A", &current)?);
        let _ = write!(html, "</div><ul>{}</ul></section>", history(&samples));
    }
    html.push_str("</html>\n");
    Ok(html)
}

fn main() -> Result<(), Box<dyn Error>> {
    let path = std::env::args().nth(1).unwrap_or_else(|| "drive-modes.html".to_owned());
    std::fs::write(&path, page()?).map_err(|error| format!("cannot write {path}: {error}"))?;
    println!("wrote {path}");
    Ok(())
}
