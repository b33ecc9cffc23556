//! `hil-sim serve-motors`: Damiao motors, ODrive axes and CANopen servos in real time, for programs that speak to such motors.

use can_link::{BusSpec, Role, Urgent};
use hil_sim::drive::bench::Bench;
use hil_sim::drive::cia402::{CanopenServo, ServoOptions};
use hil_sim::drive::mit::{MitMotor, MitOptions};
use hil_sim::drive::odrive::{OdriveAxis, OdriveOptions};
use hil_sim::realtime::{Endpoint, Realtime, RealtimeError, shared_time};
use protocol::mit::MotorId;
use protocol::odrive::{NodeId, Version};
use protocol::{Duration, Instant, StandardId};

use super::exit::{Code, Failure};
use super::progress::{Interrupt, say};

/// Between two looks at Ctrl-C.
const TURN: Duration = Duration::from_millis(100);

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  hil-sim serve-motors --damiao 8009:1:0x11 --damiao 4310:2:0x12 --bus socketcand://127.0.0.1:29540/can0\n  \
                  hil-sim serve-motors --odrive 0:0.6 --odrive 1:0.6:index\n  hil-sim serve-motors --canopen 3 --canopen 4\n\n\
                  Each motor turns an inertia of its own; there is no arm.",
    group = clap::ArgGroup::new("motors").args(["damiao", "odrive", "canopen"]).multiple(true).required(true)
)]
pub(super) struct Args {
    /// A Damiao motor: type, id to which it listens, id on which it answers. Types: 4310, 4340, 8009.
    #[arg(long, value_name = "TYPE:ID:ANSWERS", value_parser = motor)]
    damiao: Vec<MitOptions>,
    /// An axis of an ODrive: number, version 0.5 or 0.6, and `:index` if it must search its index first.
    #[arg(long, value_name = "NODE:VERSION[:index]", value_parser = axis)]
    odrive: Vec<OdriveOptions>,
    /// A CANopen servo of profile CiA 402: its node, 1 to 127. It has homing and cyclic synchronous position.
    #[arg(long, value_name = "NODE", value_parser = servo)]
    canopen: Vec<ServoOptions>,
    /// The ODrives give no torque after this time without an order; without it their watchdog is off, as shipped.
    #[arg(long, value_name = "MS")]
    odrive_watchdog_ms: Option<u64>,
    /// Inertia at each shaft, kg·m².
    #[arg(long, default_value_t = 0.1, value_parser = inertia)]
    inertia_kg_m2: f64,
    /// Where, as `hil-sim serve`.
    #[arg(long, value_parser = can_link::bus_of_option, default_value = "socketcand://127.0.0.1:29540/can0")]
    bus: Vec<BusSpec>,
    /// End after this many seconds.
    #[arg(long, value_name = "SECONDS")]
    duration_s: Option<f64>,
    /// Print events as JSON lines.
    #[arg(long)]
    json: bool,
}

fn motor(text: &str) -> Result<MitOptions, String> {
    let number = |text: &str| match text.strip_prefix("0x") {
        Some(hex) => u16::from_str_radix(hex, 16).ok(),
        None => text.parse().ok(),
    };
    let mut parts = text.split(':');
    let (Some(name), Some(id), Some(master), None) = (parts.next(), parts.next(), parts.next(), parts.next())
    else {
        return Err("a motor is TYPE:ID:ANSWERS, for example 8009:1:0x11".to_owned());
    };
    let id = number(id).and_then(|id| MotorId::new(u8::try_from(id).ok()?)).ok_or("the id is 1 to 127")?;
    let master =
        number(master).and_then(|id| StandardId::new(id).ok()).ok_or("answers come on 0 to 0x7ff")?;
    MitOptions::of(name, id, master).ok_or_else(|| format!("no figures for motor '{name}': 4310, 4340, 8009"))
}

fn axis(text: &str) -> Result<OdriveOptions, String> {
    let mut parts = text.split(':');
    let node =
        parts.next().and_then(|node| NodeId::new(node.parse().ok()?)).ok_or("the number is 0 to 62")?;
    let version = match parts.next() {
        Some("0.5") => Version::V05,
        Some("0.6") => Version::V06,
        _ => return Err("an axis is NODE:VERSION, for example 0:0.6; versions: 0.5, 0.6".to_owned()),
    };
    let absolute = match (parts.next(), parts.next()) {
        (None, _) => true,
        (Some("index"), None) => false,
        _ => return Err("after the version only `:index` may stand".to_owned()),
    };
    Ok(OdriveOptions { absolute, ..OdriveOptions::new(node, version) })
}

fn servo(text: &str) -> Result<ServoOptions, String> {
    let node = text.parse().ok().and_then(protocol::canopen::NodeId::new).ok_or("a node is 1 to 127")?;
    Ok(ServoOptions::of(node))
}

fn inertia(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| "a number of kg·m²".to_owned())?;
    (value.is_finite() && value > 0.0).then_some(value).ok_or_else(|| "must be above zero".to_owned())
}

pub(super) fn run(args: &Args) -> Result<(), Failure> {
    let (clock, in_step) =
        shared_time(&args.bus).map_err(|error| Failure::new(Code::BadFile, &error).next(error.next()))?;
    let endpoints = args.bus.iter().map(|spec| {
        Endpoint::open(spec, clock).map_err(|error| Failure::new(Code::Bus, &error).next(error.next()))
    });
    let endpoints: Vec<Endpoint> = endpoints.collect::<Result<_, _>>()?;
    let watchdog = args.odrive_watchdog_ms.map(Duration::from_millis);
    let damiao = args.damiao.iter().map(|options| MitMotor::new(*options, options.zero_rad)).collect();
    let odrives = args
        .odrive
        .iter()
        .map(|options| OdriveAxis::new(OdriveOptions { watchdog, ..*options }, 0.0))
        .collect();
    let servos = args.canopen.iter().map(|options| CanopenServo::new(*options, 0.0)).collect();
    let inertia_kg_m2 = args.inertia_kg_m2;
    let bench = (Bench::new(damiao, inertia_kg_m2), Bench::new(odrives, inertia_kg_m2));
    let bench = (bench, Bench::new(servos, inertia_kg_m2));
    let mut realtime =
        Realtime::new(bench, hil_sim::bus::BusConfig::default(), 1, Vec::new(), endpoints, clock)
            .map_err(|error| Failure::new(Code::BadFile, &error))?;
    let end = args.duration_s.map(|s| Instant::ZERO + Duration::from_secs_f64(s));
    if let Some(end) = end {
        realtime = realtime.ending_at(end);
    }
    if let Some(clients) = in_step {
        realtime = realtime.in_lock_step(clients);
    }
    let interrupt = Interrupt::listen();
    for endpoint in realtime.endpoints() {
        say(args.json, "serving", endpoint.name());
    }
    say(args.json, "real time", &Urgent::request(Role::Plant).granted().to_string());
    while !interrupt.came() && end.is_none_or(|end| realtime.world().now() < end) {
        let until = realtime.world().now() + TURN;
        realtime.turn(end.map_or(until, |end| end.min(until)), &mut ()).map_err(|error| match error {
            RealtimeError::Run(error) => Failure::from(error),
            other => Failure::new(Code::Bus, &other).next(other.next()),
        })?;
    }
    Ok(())
}
