//! `cubectl servo`

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::time::Duration as WallTime;

use console::{Fetched, TypedInput};
use nalgebra::{Vector3, Vector6};
use operator::dialogue::operator::OperatorError;
use operator::servo::{Keeps, Next, ServoError, Stream, Streamed, follow};
use planner::plan::Joints;
use planner::servo::{Command, JointState, Limited, NoServo, Refused, Servo};
use planner::store::fingerprint_of;
use protocol::Duration;
use robot_model::Pose;
use serde::Deserialize;
use serde_json::{Value, json};

use super::connected::Connected;
use super::link::{Link, Machine};
use super::rows::Rows;
use super::target::{Bounds, Moving};
use super::{fixed, print_json};
use crate::error::{Cause, ExpectedError};
use crate::exit;

/// Lines that are not taken and are shown one by one; the rest is counted.
const SHOWN_MAX: u64 = 5;
/// Time between two looks at the input where the stream is ahead of it.
const LOOK: WallTime = WallTime::from_millis(1);

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl servo path.jsonl --home                       # the simulated cell; each line has its time\n  ./my_program | cubectl servo --bus can0 --yes         # as the lines come, 10 to 200 a second\n\n\
One JSON object per line, with one of these keys, and with t_s for a command that is not for now:\n  \
{\"q_rad\": [..]}            to these joint angles\n  \
{\"qd_rad_s\": [..]}         with these joint speeds\n  \
{\"point_m\": [x,y,z]}       the hand to a place (base frame)\n  \
{\"pose_m_rad\": [x,y,z,roll,pitch,yaw]}  the hand in a pose\n  \
{\"twist_m_s_rad_s\": [vx,vy,vz,wx,wy,wz]}  the hand with a speed and a turning speed\n\n\
The arm keeps speed, acceleration, jerk, joint ranges and 10 mm from everything, whatever is asked for. It comes to rest at the end of the\ninput, \
on Ctrl-C, and when no command comes for --hold-s. From a command to the arm it takes 80 ms, and the lag of the drives."
)]
pub struct Args {
    /// File with commands; without it they are read from standard input.
    pub file: Option<PathBuf>,
    /// The arm; on the bus `sim` each command needs its t_s.
    #[command(flatten)]
    pub moving: Moving,
    #[command(flatten)]
    pub bounds: Bounds,
    /// The arm comes to rest when no command has come for this long, s.
    #[arg(long = "hold-s", alias = "hold", default_value_t = 0.2, value_name = "SECONDS", value_parser = super::values::positive)]
    pub hold: f64,
    /// Write the states that were sent, one row per 20 ms (CSV).
    #[arg(long, value_name = "FILE")]
    pub states: Option<PathBuf>,
}

/// A line of the input.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Line {
    t_s: Option<f64>,
    #[serde(flatten)]
    command: Asked,
}

#[derive(Deserialize)]
#[serde(rename_all = "snake_case")]
enum Asked {
    QRad(Vec<f64>),
    QdRadS(Vec<f64>),
    PointM([f64; 3]),
    PoseMRad([f64; 6]),
    TwistMSRadS([f64; 6]),
}

impl Asked {
    fn command(self) -> Result<Command, String> {
        let joints = |q: Vec<f64>| {
            let fits = (1..=robot_model::JOINTS_MAX).contains(&q.len());
            fits.then(|| Joints::from_slice(&q)).ok_or_else(|| format!("{} numbers for the joints", q.len()))
        };
        Ok(match self {
            Self::QRad(q) => Command::Joints(joints(q)?),
            Self::QdRadS(qd) => Command::JointSpeeds(joints(qd)?),
            Self::PointM(p) => Command::Point(Vector3::from(p)),
            Self::PoseMRad([x, y, z, roll, pitch, yaw]) => {
                Command::Pose(Pose::from_rpy([roll, pitch, yaw], Vector3::new(x, y, z)))
            }
            Self::TwistMSRadS(twist) => Command::HandSpeed(Vector6::from(twist)),
        })
    }
}

/// Reads a line: its time, if it has one, and its command.
pub fn parse(line: &str) -> Result<(Option<f64>, Command), String> {
    let Line { t_s, command } = serde_json::from_str(line).map_err(|error| error.to_string())?;
    Ok((t_s, command.command()?))
}

pub fn run(args: &Args) -> Result<(), ExpectedError> {
    let Args { moving, bounds, .. } = args;
    let mut ui = moving.ui("The arm follows the commands. Nobody near?", true)?;
    let machine = Machine::of(&moving.on)?;
    let arm = &machine.arm;
    let opened = |path: &PathBuf| File::open(path).map_err(|error| ExpectedError::io(path, &error));
    let file = args.file.as_ref().map(opened).transpose()?;
    let mut states = args.states.as_deref().map(States::create).transpose()?;
    let link = Link::open(&moving.on, &machine, None, moving.json)?;
    let mut link = link.watched(&moving.web, &machine)?;
    let fingerprint = fingerprint_of(arm);
    let streamed = link.with(|operator| {
        let mut connected = Connected::new(operator, arm, &fingerprint);
        let ready = connected.ready(moving.home, &mut |step| ui.answer(step));
        let agreed = ready.and_then(|_| ui.agree(connected.operator));
        ui.progress.quiet();
        agreed?;
        let input = file.map_or_else(console::typed_lines, |file| console::lines_of(BufReader::new(file)));
        let keeps = Keeps {
            share: bounds.speed_share,
            v_max_rad_s: f64::INFINITY,
            hold: Duration::from_secs_f64(args.hold),
            scene: bounds.scene(),
        };
        let needs_times = connected.operator.needs_times();
        let mut lines = Lines { input, needs_times, ahead: None, unread: 0, states: states.as_mut() };
        let streamed = follow(connected.operator, arm, &keeps, &mut lines);
        streamed.map(|streamed| (streamed, lines.unread)).map_err(|error| ExpectedError::from(&error))
    });
    let ended = link.end();
    ended.show(if streamed.is_ok() { "the arm stands" } else { "ended early" }, None);
    let finished = ended.finished;
    let written = states.map_or(Ok(()), |states| states.rows.finish());
    let (streamed, unread) = streamed?;
    say(args, &streamed, unread);
    finished.and(written)?;
    if streamed.interrupted {
        return Err(ExpectedError::new(exit::INTERRUPTED, "interrupted; the arm stands"));
    }
    Ok(())
}

impl Cause for ServoError {
    fn next(&self) -> Option<String> {
        Some(match self {
            Self::Operator(error) => return error.next(),
            Self::NoServo(NoServo::OutsideRange { .. } | NoServo::Blocked { .. }) => {
                "`cubectl jog` frees the arm".to_owned()
            }
            Self::Share { .. } => "--speed-share 0.2".to_owned(),
            Self::Plan => return None,
        })
    }
}

impl From<&ServoError> for ExpectedError {
    fn from(error: &ServoError) -> Self {
        match error {
            ServoError::Operator(error @ OperatorError::Stopped { .. }) => Self::of(exit::STOPPED, error),
            ServoError::Operator(error) => error.into(),
            ServoError::NoServo(_) => Self::of(exit::DRIVE, error),
            ServoError::Share { .. } | ServoError::Plan => Self::bad_input(error),
        }
    }
}

/// The commands of the input, each at its time.
struct Lines<'a> {
    input: TypedInput<String>,
    /// Time does not pass by itself: without a time a command is for no time at all.
    needs_times: bool,
    /// A command that is for later, and when.
    ahead: Option<(f64, Command)>,
    /// Lines that were not taken.
    unread: u64,
    states: Option<&'a mut States>,
}

impl Lines<'_> {
    fn refuse(&mut self, what: &str) {
        self.unread += 1;
        if self.unread <= SHOWN_MAX {
            console::note!("a command is not taken: {what}");
        }
    }
}

impl Stream for Lines<'_> {
    fn next(&mut self, t_s: f64) -> Next {
        loop {
            match self.ahead {
                Some((due_s, _)) if due_s > t_s => return Next::Nothing,
                Some((_, command)) => {
                    self.ahead = None;
                    return Next::Command(command);
                }
                None => {}
            }
            let line = match self.input.fetch() {
                Fetched::Item(line) => line,
                Fetched::Ended => return Next::End,
                Fetched::Nothing if self.needs_times => {
                    std::thread::sleep(LOOK);
                    continue;
                }
                Fetched::Nothing => return Next::Nothing,
            };
            match parse(&line) {
                Ok((None, _)) if self.needs_times => {
                    self.refuse("on the bus sim it needs t_s, its time in s after the begin");
                }
                Ok((t_s, command)) => self.ahead = Some((t_s.unwrap_or(f64::NEG_INFINITY), command)),
                Err(_) if line.trim().is_empty() => {}
                Err(what) => self.refuse(&what),
            }
        }
    }

    fn refused(&mut self, t_s: f64, why: Refused) {
        self.refuse(&format!("{why} (at {} s)", fixed(t_s, 2)));
    }

    fn ticked(&mut self, t_s: f64, servo: &Servo<'_>, limited: Option<&Limited>) {
        if let Some(states) = &mut self.states {
            states.row(t_s, servo, limited);
        }
    }
}

/// The states that were sent, as a table.
struct States {
    rows: Rows,
    begun: bool,
}

impl States {
    fn create(path: &Path) -> Result<Self, ExpectedError> {
        Ok(Self { rows: Rows::create(path)?, begun: false })
    }

    fn row(&mut self, t_s: f64, servo: &Servo<'_>, limited: Option<&Limited>) {
        let state = servo.state();
        let mut text = String::new();
        if !std::mem::replace(&mut self.begun, true) {
            let names = |of: &str| (1..=state.len()).map(|k| format!(",{of}_{k}")).collect::<String>();
            text = format!("t_s{}{}{},limited\n", names("q_rad"), names("qd_rad_s"), names("qdd_rad_s2"));
        }
        text += &fixed(t_s, 3);
        let of_all = |of: fn(&JointState) -> f64| state.iter().map(of);
        let numbers = of_all(|s| s.q_rad).chain(of_all(|s| s.qd_rad_s)).chain(of_all(|s| s.qdd_rad_s2));
        numbers.for_each(|number| text += &format!(",{}", fixed(number, 6)));
        text += &format!(",{}\n", limited.map(limit_text).unwrap_or_default());
        self.rows.line(&text);
    }
}

/// What became of a stream, as programs read it; `refused` lines were not taken.
#[must_use]
pub fn found(streamed: &Streamed, refused: u64) -> Value {
    let off_rad = streamed.end_rad.iter().zip(&streamed.measured_rad).map(|(a, b)| (a - b).abs());
    json!({
        "outcome": if streamed.interrupted { "interrupted" } else { "at_rest" },
        "duration_s": streamed.duration_s,
        "commands_taken": streamed.taken,
        "commands_refused": refused,
        "ticks_limited": streamed.limited,
        "end_states_sent": streamed.sent,
        "end_states_unsent": streamed.unsent,
        "end_states_refused": streamed.late,
        "restarts": streamed.restarts,
        "end_rad": streamed.end_rad,
        "measured_rad": streamed.measured_rad,
        "end_off_rad": off_rad.reduce(f64::max),
    })
}

/// What keeps the arm from what it was asked for, in words.
#[must_use]
pub fn limit_text(limited: &Limited) -> String {
    match limited {
        Limited::Range(joint) => format!("range of joint {}", joint + 1),
        Limited::Contact(a, b) => format!("{a} near {b}"),
    }
}

fn say(args: &Args, streamed: &Streamed, unread: u64) {
    let found = found(streamed, unread);
    if args.moving.json {
        print_json(&found);
        return;
    }
    console::line!("{} commands in {} s; the arm stands", streamed.taken, fixed(streamed.duration_s, 1));
    if let Some(off_rad) = found["end_off_rad"].as_f64() {
        console::line!("at its end it is {} mrad from where the stream ended", fixed(1e3 * off_rad, 1));
    }
    if unread > 0 {
        console::line!("{unread} lines were not taken");
    }
    if streamed.limited > 0 {
        console::line!(
            "for {} s it was kept from what was asked for: the end of a range, or a body in the way",
            fixed(streamed.limited as f64 * planner::servo::TICK_S, 1)
        );
    }
    if streamed.restarts > 0 {
        console::line!(
            "{} times it came to rest because this program or the bus was late",
            streamed.restarts
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_form_of_a_line_is_read_and_anything_else_is_refused_with_what_is_wrong() {
        let joints = Command::Joints(Joints::from_slice(&[0.0, 1.0]));
        assert_eq!(parse(r#"{"t_s": 0.5, "q_rad": [0, 1]}"#), Ok((Some(0.5), joints)));
        let twist = Command::HandSpeed(Vector6::new(0.1, 0.0, 0.0, 0.0, 0.0, 0.2));
        assert_eq!(parse(r#"{"twist_m_s_rad_s": [0.1,0,0,0,0,0.2]}"#), Ok((None, twist)));
        assert_eq!(parse(r#"{"point_m": [1,2,3]}"#), Ok((None, Command::Point(Vector3::new(1.0, 2.0, 3.0)))));
        for (line, what) in [
            (r#"{"q_rad": [NaN]}"#, "expected value"),
            (r#"{"q_rad": []}"#, "0 numbers"),
            (r#"{"q_rad": [1e999]}"#, "out of range"),
            (r#"{"q_rad": [0,0,0,0,0,0,0,0,0]}"#, "9 numbers"),
            (r#"{"point_m": [1,2]}"#, "length 2"),
            (r#"{"t_s": 1}"#, "variant"),
            ("hello", "expected value"),
        ] {
            let refused = parse(line).unwrap_err();
            assert!(refused.contains(what), "{line}: {refused}");
        }
    }
}
