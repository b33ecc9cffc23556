//! Throws with a simulated KR 16 over UDP in real time, and tells answer times and landing.
//!
//! ```sh
//! cargo run -p operator --example rsi_real_time
//! ```

use std::error::Error;
use std::net::UdpSocket;

use hil_sim::krc::bench::RobotFaults;
use hil_sim::krc::serve::{Mode, ServeOptions, serve};
use hil_sim::krc::{Event, KrcScenario};
use nalgebra::Vector3;
use operator::rsi::program::{Lag, prepare, station};
use operator::rsi::udp;
use planner::follow::best::{self, BestOptions, HandFreedom};
use planner::follow::limits::{Arm, LimitSource, Limits};
use planner::follow::plan::{FollowPlan, Form};
use planner::follow::setting::Setting;
use planner::plan::file::RobotId;
use planner::store::robot_fingerprint;

fn main() -> Result<(), Box<dyn Error>> {
    let arm = Arm::load("kr16_2")?;
    let target = Vector3::new(2.5, 0.0, 0.6);
    let mut scenario = KrcScenario::kr_c2()?;
    let lag = &scenario.options.lag;
    let lag = Lag { dead_time: lag.dead_time, time_constant: lag.time_constant };
    let source = LimitSource::ControllerModel;
    let lag_s = lag.time_constant.as_secs_f64();
    let setting = Setting { lag_s, ..Setting::new(&arm, target, Limits::of(&arm, source)) };
    let options = BestOptions { starts: 24, kicks: 0, ..BestOptions::default() };
    let found = best::plan(&setting, &options).map_err(|none| none.to_string())?;
    let fingerprint = format!("{:016x}", robot_fingerprint(&arm));
    let robot = RobotId { name: arm.name().to_owned(), source: arm.name().to_owned(), fingerprint };
    let plan = FollowPlan::new(&setting, source, robot, Form::Best(HandFreedom::TangentAndRoll), &found, 0.0);
    prepare(&mut scenario, &arm, &plan);

    let socket = UdpSocket::bind("127.0.0.1:0")?;
    let pc = socket.local_addr()?;
    let mut station = station(&scenario, &arm, &plan, lag)?;
    let robot = std::thread::spawn(move || {
        let mut krc = scenario.controller().map_err(|error| error.to_string())?;
        let options = ServeOptions {
            pc,
            mode: Mode::RealTime,
            cycles: Some(600),
            answer_limit: protocol::Duration::from_secs(1),
        };
        let mut faults = RobotFaults::new(&scenario.robot_faults);
        let mut observe = |_: &Event| {};
        let served = serve(&mut krc, &mut scenario.link(), &mut faults, &options, &|| true, &mut observe)
            .map_err(|error| error.to_string())?;
        Ok::<_, String>((served, krc.landing()))
    });
    let exchange = udp::serve(&socket, &mut station, &|| true)?;
    let (served, landing) = robot.join().map_err(|_| "the robot ended with a panic")??;
    let mut times = exchange.answer_us;
    times.sort_unstable();
    let at = |share: f64| times.get((share * (times.len().max(1) - 1) as f64).round() as usize).copied();
    println!("station {:?}", station.stage());
    // The robot goes on when the client has ended, and then stops for want of answers.
    println!("the robot ended with {:?}, {} answers late", served.fault, served.late);
    println!(
        "{} answers, own time median {:?} us, 99 % {:?} us, largest {:?} us",
        times.len(),
        at(0.5),
        at(0.99),
        at(1.0)
    );
    println!(
        "path delay {:.2} ms, computer held the robot up {} times",
        1e3 * station.path_delay_s(),
        served.held_up
    );
    match landing {
        Some(landing) => println!("landing error {:.1} mm", 1e3 * (landing.p_m - target).xy().norm()),
        None => println!("no landing"),
    }
    Ok(())
}
