//! Scenario files of the simulated controller: everything that a run depends on, in TOML.
//!
//! ```toml
//! schema_version = 1
//! generation = "kr-c2"             # or "kr-c4"
//! robot = "kr16_2"                 # name of a built-in robot, or a path; six axes
//! rsi_config = "axis_absolute.xml" # the configuration file, relative to this file
//! seed = 1
//!
//! [controller]
//! cycle_s = 0.012
//! window_s = 0.010
//! start_deg = [0, -90, 90, 0, 90, 0]
//!
//! [correction]                     # also [late], [drives], [cut_out], [gripper], [network]
//! space = "axes"                   # or "base", "tool"
//! upper = [100, 100, 100, 100, 100, 100]
//!
//! [[fault]]
//! kind = "lost"                    # late (by_s), doubled, reordered, torn, wrong-ipoc (by), without-axes, cut-out, restart (pause_s)
//! direction = "to-robot"           # or "to-client"; not for cut-out and restart
//! start_s = 2.0
//! length_s = 0.5                   # to the end if left out
//! probability = 0.2
//! ```
//!
//! `[gripper] sensor` names an element of the configuration file that shows whether the fingers are open.
//!
//! Every key but `schema_version`, `generation` and `rsi_config` is optional. Units are in the keys, unknown keys are
//! refused, and every refusal names file, line and key.

use std::path::{Path, PathBuf};

use protocol::{Duration, Instant};
use robot_model::RobotModel;
use rsi_protocol::{Config, Generation, Protocol};
use toml_reader::{DESCRIPTION_MAX_BYTES, DocumentError, Problem, Section, Source, Value, quoted, read_text};

use super::bench::RobotFault;
use super::controller::Krc;
use super::link::{DatagramLink, Direction, LinkFault, LinkFaultKind, LinkOptions};
use super::options::{CorrectionOptions, CutOut, HandOptions, KrcOptions, LagOptions, LateOptions, Space};
use super::state::KrcError;
use crate::mechanics::GripperOptions;
use crate::scenario::values::{period, seconds};

/// Version of these files that this program reads.
pub const SCHEMA_VERSION: i64 = 1;

/// Longest time a scenario can name: eleven days.
const MAX_S: f64 = 1e6;

/// A file was refused: where, and why.
pub type KrcScenarioError = DocumentError<Problem>;

/// Everything that a run depends on.
#[derive(Clone, Debug, PartialEq)]
pub struct KrcScenario {
    pub file: String,
    /// Built-in name or path of the robot file.
    pub robot: String,
    pub config: Config,
    pub config_text: String,
    /// Parameters of the controller.
    pub options: KrcOptions,
    /// Delay of the network.
    pub network: LinkOptions,
    /// What goes wrong on the network.
    pub link_faults: Vec<LinkFault>,
    /// What goes wrong with the robot.
    pub robot_faults: Vec<RobotFault>,
    /// Feeds all random streams.
    pub seed: u64,
}

impl KrcScenario {
    /// Reads a file and the configuration file that it names.
    pub fn load(path: &Path) -> Result<Self, KrcScenarioError> {
        let file = path.display().to_string();
        let text = read(path)?;
        Self::from_toml(&file, &text, |name| {
            let beside: PathBuf = path.parent().unwrap_or(Path::new("")).join(name);
            read(&beside)
        })
    }

    /// A controller that comes with this program, with the program of `robots/kr16_2`: `kr-c2` (UDP), `kr-c2-tcp`,
    /// `kr-c4` (4 ms) or `kr-c4-12ms`. Each has 120 ms of lag, some noise, and a gripper whose delay varies by 10
    /// ms. Any other name is the path of a file.
    pub fn open(source: &str) -> Result<Self, KrcScenarioError> {
        const UDP: &str = include_str!("../../../robots/kr16_2/rsi_udp.xml");
        const TCP: &str = include_str!("../../../robots/kr16_2/rsi_tcp.xml");
        let (text, config) = match source {
            "kr-c2" => (include_str!("../../../robots/kr16_2/kr_c2.toml"), UDP),
            "kr-c2-tcp" => (include_str!("../../../robots/kr16_2/kr_c2_tcp.toml"), TCP),
            "kr-c4" => (include_str!("../../../robots/kr16_2/kr_c4.toml"), UDP),
            "kr-c4-12ms" => (include_str!("../../../robots/kr16_2/kr_c4_12ms.toml"), UDP),
            path => return Self::load(Path::new(path)),
        };
        Self::from_toml(source, text, |_| Ok(config.to_owned()))
    }

    /// Reads a text; `file` is its name in errors, `read_config` returns the text of the configuration file.
    pub fn from_toml(
        file: &str,
        text: &str,
        read_config: impl Fn(&str) -> Result<String, KrcScenarioError>,
    ) -> Result<Self, KrcScenarioError> {
        const GENERATIONS: [(&str, Generation); 2] =
            [("kr-c2", Generation::KrC2), ("kr-c4", Generation::KrC4)];
        let source = Source { file, text };
        let document = source.parse()?;
        let root: Section<'_> = source.root(&document);
        root.schema("schema_version", SCHEMA_VERSION)?;
        let generation = root.required("generation", |v| v.word(&GENERATIONS))?;
        let (config, config_text) = root.required("rsi_config", |value| {
            let name = value.text()?;
            let text = read_config(name)?;
            let config = Config::parse(&text)
                .map_err(|error| value.error(Problem::Invalid(format!("{name}: {error}"))))?;
            Ok((config, text))
        })?;
        let default = KrcOptions::new(generation);
        let mut options = match root.optional("controller", Value::section)? {
            Some(table) => controller(&table, &default)?,
            None => default,
        };
        part(&root, "correction", &mut options.correction, correction)?;
        part(&root, "late", &mut options.late, late)?;
        part(&root, "drives", &mut options.lag, drives)?;
        part(&root, "cut_out", &mut options.cut_out, cut_out)?;
        if let Some(table) = root.optional("gripper", Value::section)? {
            options.hand = gripper(&table, &options.hand)?;
            options.sensor_name = table.optional("sensor", Value::text)?.map(str::to_owned);
            table.finish()?;
        }
        let mut network =
            LinkOptions { in_order: config.protocol == Protocol::Tcp, ..LinkOptions::default() };
        part(&root, "network", &mut network, self::network)?;
        let (mut link_faults, mut robot_faults) = (Vec::new(), Vec::new());
        for table in root.sections("fault")? {
            match fault(&table, config.protocol)? {
                AnyFault::Link(fault) => link_faults.push(fault),
                AnyFault::Robot(fault) => robot_faults.push(fault),
            }
        }
        let scenario = Self {
            file: file.to_owned(),
            robot: root.or("robot", "kr16_2", Value::text)?.to_owned(),
            seed: root.or("seed", 0, Value::count)?,
            config,
            config_text,
            options,
            network,
            link_faults,
            robot_faults,
        };
        root.finish()?;
        Ok(scenario)
    }

    /// What a client must know of the robot and its program, as a file that [`KrcScenario::load`] reads: without faults, network
    /// and cut-out. `head` is written as a comment; `config_name` is the name of the configuration file beside it.
    #[must_use]
    pub fn description(&self, head: &str, config_name: &str) -> String {
        let options = &self.options;
        let generation = match options.generation {
            Generation::KrC2 => "kr-c2",
            Generation::KrC4 => "kr-c4",
        };
        let space = options.correction.space.word();
        let comment: String = head.lines().map(|line| format!("# {line}\n")).collect();
        let gripper = &options.hand.gripper;
        let mut text = format!(
            "{comment}schema_version = {SCHEMA_VERSION}\ngeneration = \"{generation}\"\nrobot = {}\nrsi_config = {}\n\n\
             [controller]\ncycle_s = {:?}\nwindow_s = {:?}\ndecimals = {}\nstart_deg = {:?}\noutputs = {}\nstop = {}\n\n\
             [correction]\nspace = \"{space}\"\nrelative = {}\nlower = {:?}\nupper = {:?}\noverall_axis_deg = {:?}\n\n\
             [drives]\ndead_time_s = {:?}\ntime_constant_s = {:?}\nsmoothing_cycles = {}\nnoise_deg = {:?}\n\n\
             [gripper]\ndelay_s = {:?}\njitter_s = {:?}\n",
            quoted(&self.robot),
            quoted(config_name),
            options.cycle.as_secs_f64(),
            options.window.as_secs_f64(),
            options.decimals,
            options.start_deg,
            quoted(&options.outputs_name),
            quoted(&options.stop_name),
            options.correction.relative,
            options.correction.lower,
            options.correction.upper,
            options.correction.overall_axis_deg,
            options.lag.dead_time.as_secs_f64(),
            options.lag.time_constant.as_secs_f64(),
            options.lag.smoothing_cycles,
            options.lag.noise_deg,
            gripper.delay.as_secs_f64(),
            gripper.jitter.as_secs_f64(),
        );
        if let Some(bit) = options.hand.output_bit {
            text += &format!("output_bit = {bit}\n");
        }
        if let Some(sensor) = &options.sensor_name {
            text += &format!("sensor = {}\n", quoted(sensor));
        }
        text
    }

    /// The controller at rest.
    ///
    /// # Errors
    /// The robot cannot be loaded, or options, robot and configuration file do not fit together.
    pub fn controller(&self) -> Result<Krc, KrcError> {
        let model = RobotModel::load_with_joints(&self.robot, 6)
            .map_err(|error| KrcError::Robot { text: error.to_string(), next: error.problem.next() })?;
        Krc::new(model, self.config.clone(), self.options.clone(), self.seed)
    }

    pub fn link(&self) -> DatagramLink {
        DatagramLink::new(self.network, &self.link_faults, self.seed)
    }
}

fn read(path: &Path) -> Result<String, KrcScenarioError> {
    read_text(path, DESCRIPTION_MAX_BYTES)
        .map_err(|error| DocumentError::of_file(&path.display().to_string(), Problem::unreadable(&error)))
}

/// Changes the options of one table, if it is there.
fn part<T: Clone>(
    root: &Section<'_>,
    key: &'static str,
    options: &mut T,
    read: fn(&Section<'_>, &T) -> Result<T, KrcScenarioError>,
) -> Result<(), KrcScenarioError> {
    if let Some(table) = root.optional(key, Value::section)? {
        *options = read(&table, options)?;
        table.finish()?;
    }
    Ok(())
}

fn controller(table: &Section<'_>, d: &KrcOptions) -> Result<KrcOptions, KrcScenarioError> {
    let options = KrcOptions {
        cycle: table.or("cycle_s", d.cycle, |v| period(v, 1.0))?,
        window: table.or("window_s", d.window, |v| period(v, 1.0))?,
        ipoc_start: table.or("ipoc_start", d.ipoc_start, Value::count)?,
        decimals: table.or("decimals", d.decimals, |v| Ok(v.integer(0..=9)? as u8))?,
        tcp_line_feeds: table.or("tcp_line_feeds", d.tcp_line_feeds, |v| Ok(v.integer(0..=8)? as usize))?,
        strict_type: table.or("strict_type", d.strict_type, Value::boolean)?,
        start_deg: table.or("start_deg", d.start_deg, Value::numbers)?,
        outputs_name: table.or("outputs", &*d.outputs_name, Value::text)?.to_owned(),
        stop_name: table.or("stop", &*d.stop_name, Value::text)?.to_owned(),
        ..d.clone()
    };
    table.finish()?;
    Ok(options)
}

fn correction(table: &Section<'_>, d: &CorrectionOptions) -> Result<CorrectionOptions, KrcScenarioError> {
    const SPACES: [(&str, Space); 3] = [
        (Space::Axes.word(), Space::Axes),
        (Space::Base.word(), Space::Base),
        (Space::Tool.word(), Space::Tool),
    ];
    Ok(CorrectionOptions {
        space: table.or("space", d.space, |v| v.word(&SPACES))?,
        relative: table.or("relative", d.relative, Value::boolean)?,
        lower: table.or("lower", d.lower, Value::numbers)?,
        upper: table.or("upper", d.upper, Value::numbers)?,
        overall_axis_deg: table.or("overall_axis_deg", d.overall_axis_deg, Value::positive)?,
        overall_mm: table.or("overall_mm", d.overall_mm, Value::positive)?,
        overall_rotation_deg: table.or("overall_rotation_deg", d.overall_rotation_deg, Value::positive)?,
    })
}

fn late(table: &Section<'_>, d: &LateOptions) -> Result<LateOptions, KrcScenarioError> {
    Ok(LateOptions {
        limit: table.or("limit", d.limit, Value::count)?,
        consecutive: table.or("consecutive", d.consecutive, Value::boolean)?,
        percent: table.or("percent", d.percent, |v| v.number_in(0.0, 100.0))?,
        field_of_view: table.or(
            "field_of_view",
            d.field_of_view,
            |v| Ok(v.integer(1..=100_000)? as usize),
        )?,
        percent_stops: table.or("percent_stops", d.percent_stops, Value::boolean)?,
    })
}

fn drives(table: &Section<'_>, d: &LagOptions) -> Result<LagOptions, KrcScenarioError> {
    Ok(LagOptions {
        dead_time: table.or("dead_time_s", d.dead_time, |v| seconds(v, 10.0))?,
        time_constant: table.or("time_constant_s", d.time_constant, |v| seconds(v, 10.0))?,
        smoothing_cycles: table
            .or("smoothing_cycles", d.smoothing_cycles, |v| Ok(v.integer(1..=1000)? as usize))?,
        noise_deg: table.or("noise_deg", d.noise_deg, |v| v.number_in(0.0, 10.0))?,
    })
}

fn cut_out(table: &Section<'_>, d: &CutOut) -> Result<CutOut, KrcScenarioError> {
    Ok(CutOut {
        velocity_deg_s: table.optional("velocity_deg_s", Value::numbers)?.or(d.velocity_deg_s),
        base: table.or("base_s", d.base, |v| period(v, 1.0))?,
        acceleration_deg_s2: table.or("acceleration_deg_s2", d.acceleration_deg_s2, Value::numbers)?,
        jerk_deg_s3: table.or("jerk_deg_s3", d.jerk_deg_s3, Value::numbers)?,
        braking_deg_s2: table.or("braking_deg_s2", d.braking_deg_s2, Value::positive)?,
    })
}

fn gripper(table: &Section<'_>, d: &HandOptions) -> Result<HandOptions, KrcScenarioError> {
    let g = d.gripper;
    Ok(HandOptions {
        output_bit: table.optional("output_bit", |v| Ok(v.integer(0..=31)? as u8))?.or(d.output_bit),
        gripper: GripperOptions {
            output: None,
            delay: table.or("delay_s", g.delay, |v| seconds(v, 10.0))?,
            jitter: table.or("jitter_s", g.jitter, |v| seconds(v, 10.0))?,
            drag_1_m: table.optional("drag_1_m", |v| v.number_in(0.0, 100.0))?.or(g.drag_1_m),
            landing_z_m: table.optional("landing_z_m", |v| v.number_in(-100.0, 100.0))?.or(g.landing_z_m),
            ..g
        },
    })
}

fn network(table: &Section<'_>, d: &LinkOptions) -> Result<LinkOptions, KrcScenarioError> {
    Ok(LinkOptions {
        delay: table.or("delay_s", d.delay, |v| seconds(v, 10.0))?,
        jitter: table.or("jitter_s", d.jitter, |v| seconds(v, 10.0))?,
        in_order: d.in_order,
    })
}

enum AnyFault {
    Link(LinkFault),
    Robot(RobotFault),
}

#[derive(Clone, Copy)]
enum Kind {
    Lost,
    Late,
    Doubled,
    Reordered,
    Torn,
    WrongIpoc,
    WithoutAxes,
    CutOut,
    Restart,
}

fn fault(table: &Section<'_>, protocol: Protocol) -> Result<AnyFault, KrcScenarioError> {
    const KINDS: [(&str, Kind); 9] = [
        ("lost", Kind::Lost),
        ("late", Kind::Late),
        ("doubled", Kind::Doubled),
        ("reordered", Kind::Reordered),
        ("torn", Kind::Torn),
        ("wrong-ipoc", Kind::WrongIpoc),
        ("without-axes", Kind::WithoutAxes),
        ("cut-out", Kind::CutOut),
        ("restart", Kind::Restart),
    ];
    const DIRECTIONS: [(&str, Direction); 2] =
        [("to-robot", Direction::ToRobot), ("to-client", Direction::ToClient)];
    let from = Instant::ZERO + table.or("start_s", Duration::ZERO, |v| seconds(v, MAX_S))?;
    let kind = match table.required("kind", |v| v.word(&KINDS))? {
        Kind::CutOut => {
            table.finish()?;
            return Ok(AnyFault::Robot(RobotFault::CutOut { at: from }));
        }
        Kind::Restart => {
            let pause = table.or("pause_s", Duration::from_millis(500), |v| seconds(v, MAX_S))?;
            table.finish()?;
            return Ok(AnyFault::Robot(RobotFault::Restart { at: from, pause }));
        }
        Kind::Lost => LinkFaultKind::Lost,
        Kind::Late => LinkFaultKind::Late(table.required("by_s", |v| period(v, 60.0))?),
        Kind::Doubled => LinkFaultKind::Doubled,
        Kind::Reordered if protocol == Protocol::Tcp => {
            return Err(table.error("kind", Problem::Invalid("TCP keeps the order of telegrams".to_owned())));
        }
        Kind::Reordered => LinkFaultKind::Reordered,
        Kind::Torn => LinkFaultKind::Torn,
        Kind::WithoutAxes => LinkFaultKind::WithoutAxes,
        Kind::WrongIpoc => {
            LinkFaultKind::WrongIpoc(table.required("by", |v| v.integer(-1_000_000..=1_000_000))?)
        }
    };
    let fault = LinkFault {
        kind,
        direction: table.required("direction", |v| v.word(&DIRECTIONS))?,
        from,
        until: table
            .optional("length_s", |v| period(v, MAX_S))?
            .map_or(Instant::FAR_FUTURE, |length| from + length),
        probability: table.or("probability", 1.0, |v| v.number_in(0.0, 1.0))?,
    };
    table.finish()?;
    Ok(AnyFault::Link(fault))
}
