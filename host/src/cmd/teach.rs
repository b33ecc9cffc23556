//! `cubectl teach`: a person leads the arm with keys and saves the steps of a program.

use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::time::{Duration as WallSpan, Instant as WallTime};

use nalgebra::{Vector3, Vector6};
use operator::dialogue::operator::OperatorError;
use operator::port::Interactive;
use operator::servo::{Keeps, Next, ServoError, Stream, follow};
use planner::plan::{Arm, Joints};
use planner::servo::{Command, Limited, Refused, Servo};
use planner::store::fingerprint_of;
use protocol::Duration;

use super::arm::jog::SPEED_MAX_RAD_S;
use super::connected::Connected;
use super::consent::Consent;
use super::held_key::{Keys, Pace, Pressed};
use super::link::{Link, Machine};
use super::program_file::{ArmProgram, ProgramFile, Written, is_program};
use super::progress::{ProgressView, Ui};
use super::servo::limit_text;
use super::target::{Target, scene};
use super::values::at_most;
use super::{counted, fixed};
use crate::advice::{Place, quoted};
use crate::error::ExpectedError;
use crate::exit;

/// Fastest hand, m/s: reduced speed by ISO 10218.
const HAND_SPEED_MAX_M_S: f64 = 0.25;
/// Share of the accelerations and jerks of the arm while it is led.
const SHARE: f64 = 0.2;
/// Without a tick of the keys for this long the arm comes to rest.
const HOLD: Duration = Duration::from_millis(200);
/// Ticks from one writing of the status line to the next.
const SHOWN_EACH: u32 = 5;
/// Between two looks at the keys while nothing moves.
const MOMENT: WallSpan = WallSpan::from_millis(5);
/// Pause that `w` saves, s.
const WAIT_S: f64 = 1.0;
const HELP: &str = "1-8 joint   x y z hand along the base   X Y Z along itself   hold + l or - h to move   s save   o c gripper   w wait 1 s   u undo   q end";

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  cubectl teach pick.toml --home                # the simulated cell\n  cubectl teach pick.toml --bus can0 && cubectl run pick.toml --bus can0 --repeat 10\n\n\
Keys: 1 to 8 choose a joint, x y z a direction of the hand in the frame of the base, X Y Z in its own. Hold + or l to move up, - or h to move down; let go to stop. s saves where\n\
the arm stands; o and c open and close the gripper and save that, w saves a pause of 1 s. u removes the last step, q ends.\n\
The file is written after each step. A step that `cubectl run` would refuse is not saved. The arm keeps its joint ranges and 10 mm from everything;\n\
the pause before a held key repeats may be at most 0.6 s."
)]
pub struct Args {
    /// Program that is written (TOML); `cubectl run` does it.
    pub file: PathBuf,
    #[command(flatten)]
    pub on: Target,
    /// Speed of a joint while a key is held, rad/s, at most 0.25.
    #[arg(long = "speed-rad-s", alias = "speed", default_value_t = 0.1, value_name = "RAD_S", value_parser = at_most(SPEED_MAX_RAD_S, "rad/s"))]
    pub speed: f64,
    /// Speed of the hand while a key is held, m/s, at most 0.25; no joint is faster than 0.25 rad/s.
    #[arg(long = "hand-speed-m-s", alias = "hand-speed", default_value_t = 0.05, value_name = "M_S", value_parser = at_most(HAND_SPEED_MAX_M_S, "m/s"))]
    pub hand_speed: f64,
    /// Share of the robot's speeds, accelerations and jerks that the program has.
    #[arg(long, default_value_t = 0.2, value_name = "SHARE", value_parser = super::values::share)]
    pub speed_share: f64,
    /// Box that nothing may touch: centre and half edge lengths in m, base frame. May be given more than once.
    #[arg(long, value_name = "X,Y,Z,HX,HY,HZ", allow_hyphen_values = true, value_parser = super::values::numbers::<6>)]
    pub obstacle: Vec<[f64; 6]>,
    /// Overwrite the file if it is there.
    #[arg(long)]
    pub force: bool,
    /// Home what is not homed first.
    #[arg(long)]
    pub home: bool,
    /// Do not ask before the arm moves.
    #[arg(long)]
    pub yes: bool,
}

/// Runs the verb.
///
/// # Errors
/// No terminal, a file that is there, the bus, a controller that refuses, a stop or a fault. Steps that were saved are in the file.
pub fn run(args: &Args) -> Result<(), ExpectedError> {
    if !(std::io::stdin().is_terminal() && std::io::stderr().is_terminal()) {
        return Err(ExpectedError::new(
            exit::USAGE,
            "the arm is led by keys, and there is no terminal; nothing has moved",
        )
        .next("run it in a terminal, or write the program by hand: docs/moving.md"));
    }
    require_free_name(&args.file, args.force)?;
    let consent = Consent::on(&args.on.bus.bus, args.yes)?;
    let machine = Machine::of(&args.on)?;
    let arm = &machine.arm;
    let mut link = Link::open(&args.on, &machine, None, false)?;
    let words = ["The arm moves while a key is held. Nobody near?"; 2];
    let mut ui = Ui { progress: ProgressView::new(false), consent, words, look: None, agreed: false };
    let fingerprint = fingerprint_of(arm);
    let mut steps = 0;
    let taught = link.with(|operator| {
        let mut connected = Connected::new(operator, arm, &fingerprint);
        let ready = connected.ready(args.home, &mut |step| ui.answer(step));
        let ready = ready.and_then(|from| ui.agree(connected.operator).map(|()| from));
        ui.progress.quiet();
        let from = ready?;
        let mut lesson = Lesson {
            args,
            arm,
            program: ProgramFile::new(&machine.source, args.speed_share, &args.obstacle),
            from,
            here: from,
            unwritten: None,
            closed: false,
            view: View { arm, chosen: Chosen::Joint(0), steps: 0, shown: String::new() },
        };
        let taught = lesson.teach(connected.operator);
        steps = if lesson.unwritten.is_some() { 0 } else { lesson.program.steps.len() };
        taught.and(lesson.unwritten.map_or(Ok(()), Err))
    });
    let finished = link.end().finished;
    if steps > 0 {
        let (file, steps) = (args.file.to_string_lossy(), counted(steps, "step"));
        let text = format!("{steps} in {file}; `cubectl run {}` does them", quoted(&file));
        console::line!("{}", Place::of_bus(&args.on.bus).complete(&text));
    } else if taught.is_ok() {
        console::line!("no step was saved");
    }
    taught.and(finished)
}

/// A program can be written to the path when the first step is saved.
fn require_free_name(path: &Path, force: bool) -> Result<(), ExpectedError> {
    let refused = |what: &str| ExpectedError::bad_input(&format!("{}: {what}", path.display()));
    if !is_program(path) {
        return Err(refused("the name of a program ends in .toml").next("name it so"));
    }
    if path.exists() && !force {
        return Err(super::robot::is_there(path).next("--force overwrites it, or name another"));
    }
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    if folder.is_some_and(|folder| !folder.is_dir()) {
        return Err(refused("there is no such folder").next("make the folder, or name another file"));
    }
    Ok(())
}

/// What the keys move.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Chosen {
    /// A joint, from 0.
    Joint(usize),
    /// The hand along x, y or z of the base.
    Hand(usize),
    /// The hand along its own x, y or z.
    Tool(usize),
}

impl Chosen {
    /// What a key chooses on an arm with so many joints.
    fn of_key(key: u8, joints: usize) -> Option<Self> {
        match key {
            b'1'..=b'8' => Some(usize::from(key - b'1')).filter(|joint| *joint < joints).map(Self::Joint),
            b'x'..=b'z' => Some(Self::Hand(usize::from(key - b'x'))),
            b'X'..=b'Z' => Some(Self::Tool(usize::from(key - b'X'))),
            _ => None,
        }
    }

    /// The motion of an arm whose joints stand at `q_rad`, in the direction `sign`; rest for 0.
    fn command(self, sign: f64, (arm, q_rad): (&Arm, &Joints), args: &Args) -> Command {
        let along = |direction: Vector3<f64>| {
            let mut twist = Vector6::zeros();
            twist.fixed_rows_mut::<3>(0).copy_from(&(direction * (sign * args.hand_speed)));
            Command::HandSpeed(twist)
        };
        let axis = |axis: usize| Vector3::from_fn(|row, _| f64::from(u8::from(row == axis)));
        match self {
            Self::Joint(joint) => {
                let of_joint = |k| if k == joint { sign * args.speed } else { 0.0 };
                Command::JointSpeeds(Joints::from_fn(arm.n(), of_joint))
            }
            Self::Hand(k) => along(axis(k)),
            Self::Tool(k) => along(arm.ee_at(q_rad).rot * axis(k)),
        }
    }
}

impl std::fmt::Display for Chosen {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Joint(joint) => write!(f, "joint {}", joint + 1),
            Self::Hand(axis) => write!(f, "hand {}", ['x', 'y', 'z'][*axis]),
            Self::Tool(axis) => write!(f, "hand's own {}", ['x', 'y', 'z'][*axis]),
        }
    }
}

/// The status line, and what is written above it.
struct View<'a> {
    arm: &'a Arm,
    chosen: Chosen,
    steps: usize,
    /// Its text.
    shown: String,
}

impl View<'_> {
    /// Shows where the arm is, and what keeps it from what it is asked for.
    fn status(&mut self, q_rad: &Joints, limited: Option<&Limited>) {
        let degrees: Vec<String> = q_rad.iter().map(|q| fixed(q.to_degrees(), 1)).collect();
        let hand: Vector3<f64> = self.arm.ee_at(q_rad).pos;
        let hand = [hand.x, hand.y, hand.z].map(|value| fixed(value, 3));
        let why = limited.map(|limited| format!(" ({})", limit_text(limited))).unwrap_or_default();
        let (chosen, steps) = (self.chosen, counted(self.steps, "step"));
        let text = format!("{chosen}{why}  {} deg  hand {} m  {steps}", degrees.join(" "), hand.join(" "));
        if text != self.shown {
            // A line that is wider than the terminal is cut, not wrapped: it is written over by the next one.
            console::note_text!("\r\x1b[K\x1b[?7l{text}\x1b[?7h");
            self.shown = text;
        }
    }

    /// Writes a line above the status line.
    fn note(&mut self, text: &str) {
        console::note!("\r\x1b[K{text}");
        self.shown.clear();
    }
}

/// A program that grows.
struct Lesson<'a> {
    args: &'a Args,
    arm: &'a Arm,
    program: ProgramFile,
    /// Where the arm stood at the begin, and where it stands, rad.
    from: Joints,
    here: Joints,
    /// Why the steps are not in the file, if they are not.
    unwritten: Option<ExpectedError>,
    closed: bool,
    view: View<'a>,
}

impl Lesson<'_> {
    fn teach(&mut self, operator: &mut dyn Interactive) -> Result<(), ExpectedError> {
        let mut keys = Keys::of_terminal();
        self.view.note(HELP);
        let mut pressed = Pressed::Nothing;
        let taught = loop {
            self.view.status(&self.here, None);
            let done = match pressed {
                Pressed::Held(_) => self.lead(operator, &mut keys).map(|by| pressed = by),
                Pressed::Nothing => listen(operator).map(|()| pressed = keys.fetch(WallTime::now())),
                Pressed::Ended | Pressed::Other(b'q') => break Ok(()),
                Pressed::Other(key) => {
                    pressed = Pressed::Nothing;
                    self.act(key, operator)
                }
            };
            if done.is_err() {
                break done;
            }
        };
        console::note!();
        taught
    }

    /// Moves the arm by keys until another one comes, and lets it come to rest; that key is returned.
    fn lead(&mut self, operator: &mut dyn Interactive, keys: &mut Keys) -> Result<Pressed, ExpectedError> {
        let keeps = Keeps {
            share: SHARE,
            v_max_rad_s: SPEED_MAX_RAD_S,
            hold: HOLD,
            scene: scene(&self.args.obstacle, self.closed),
        };
        let (view, args) = (&mut self.view, self.args);
        let mut stream = Led {
            args,
            keys,
            view,
            q_rad: self.here,
            pace: Pace::default(),
            ticks: 0,
            asked: false,
            by: Pressed::Nothing,
        };
        match follow(operator, self.arm, &keeps, &mut stream) {
            Ok(streamed) if streamed.interrupted => Err(interrupted()),
            Ok(streamed) => {
                let by = stream.by;
                self.here = Joints::from_slice(&streamed.end_rad);
                Ok(by)
            }
            // The person may open the gripper or remove a step.
            Err(ServoError::NoServo(why)) => {
                self.view.note(&format!("no motion from here: {why}"));
                Ok(Pressed::Nothing)
            }
            Err(error) => Err((&error).into()),
        }
    }

    /// Does what a key says that moves no joint.
    fn act(&mut self, key: u8, operator: &mut dyn Interactive) -> Result<(), ExpectedError> {
        if let Some(chosen) = Chosen::of_key(key, self.arm.n()) {
            self.view.chosen = chosen;
            return Ok(());
        }
        let step = match key {
            b's' => Written::to(&self.here),
            b'o' | b'c' => Written::grip(key == b'o'),
            b'w' => Written::wait(WAIT_S),
            b'u' => {
                match self.program.steps.pop() {
                    Some(_) => self.keep(&format!("step {} removed", self.program.steps.len() + 1)),
                    None => self.view.note("there is no step"),
                }
                return Ok(());
            }
            _ => return Ok(()),
        };
        let what = step.name();
        let mut longer = self.program.clone();
        longer.steps.push(step);
        let mut done = Ok(());
        operator.meanwhile(&mut || done = self.require_runs(&longer))?;
        if done.is_ok() && matches!(key, b'o' | b'c') {
            operator.heed_stops()?;
            match operator.set_gripper(key == b'o') {
                Ok(()) => self.closed = key == b'c',
                Err(error @ OperatorError::Refused { .. }) => done = Err((&error).into()),
                Err(error) => return Err((&error).into()),
            }
        }
        match done {
            Ok(()) => {
                self.program = longer;
                self.keep(&format!("step {}: {what}", self.program.steps.len()));
            }
            Err(why) => self.view.note(&format!("not saved: {}", why.all_that_happened())),
        }
        Ok(())
    }

    /// That `cubectl run` does the program from where the arm stood at the begin.
    fn require_runs(&self, program: &ProgramFile) -> Result<(), ExpectedError> {
        let (program, _) = ArmProgram::of_file(program.clone(), &self.args.file, None)?;
        program.cycles(self.arm, self.from, 1).map(drop)
    }

    /// Writes the program, and says what has changed.
    fn keep(&mut self, text: &str) {
        self.view.steps = self.program.steps.len();
        self.unwritten = self.program.write(&self.args.file).err();
        self.view.note(text);
        if let Some(error) = &self.unwritten {
            self.view.note(&format!("the file is not written: {}", error.all_that_happened()));
        }
    }
}

fn interrupted() -> ExpectedError {
    ExpectedError::new(exit::INTERRUPTED, "interrupted; the arm stands")
}

/// A moment in which nothing moves.
fn listen(operator: &mut dyn Interactive) -> Result<(), ExpectedError> {
    if operator.needs_times() {
        // Nothing else lets this thread rest.
        std::thread::sleep(MOMENT);
    }
    operator.run_until(operator.now() + Duration::from_millis(5))?;
    operator.heed_stops()?;
    if operator.is_interrupted() { Err(interrupted()) } else { Ok(()) }
}

/// The keys as a stream of commands.
struct Led<'a, 'v> {
    args: &'a Args,
    keys: &'a mut Keys,
    view: &'a mut View<'v>,
    /// Where the joints are to be.
    q_rad: Joints,
    pace: Pace,
    ticks: u32,
    /// The keys were asked in this tick.
    asked: bool,
    /// What ended it.
    by: Pressed,
}

impl Stream for Led<'_, '_> {
    fn next(&mut self, t_s: f64) -> Next {
        if std::mem::replace(&mut self.asked, true) {
            return Next::Nothing;
        }
        self.pace.keep(t_s);
        let joints = self.view.arm.n();
        let sign = match self.keys.fetch(WallTime::now()) {
            Pressed::Held(sign) => sign,
            Pressed::Nothing => 0.0,
            Pressed::Other(key) if Chosen::of_key(key, joints).is_some() => {
                self.view.chosen = Chosen::of_key(key, joints).unwrap_or(self.view.chosen);
                0.0
            }
            other => {
                self.by = other;
                return Next::End;
            }
        };
        Next::Command(self.view.chosen.command(sign, (self.view.arm, &self.q_rad), self.args))
    }

    fn refused(&mut self, _: f64, why: Refused) {
        self.view.note(&why.to_string());
    }

    fn ticked(&mut self, _: f64, servo: &Servo<'_>, limited: Option<&Limited>) {
        self.asked = false;
        self.q_rad = servo.q_rad();
        self.ticks += 1;
        if self.ticks.is_multiple_of(SHOWN_EACH) {
            self.view.status(&self.q_rad, limited);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Words {
        #[command(flatten)]
        args: Args,
    }

    #[test]
    fn keys_lead_the_hand_along_the_base_or_along_itself_with_the_same_speed() {
        let arm = Arm::load("powercube6").unwrap();
        let args = Words::parse_from(["teach", "p.toml", "--hand-speed-m-s", "0.1"]).args;
        let q_rad = Joints::from_slice(&[0.4, -1.0, -1.2, 0.3, 0.7, -0.5]);
        let led = |key: u8| match Chosen::of_key(key, 6).unwrap().command(-1.0, (&arm, &q_rad), &args) {
            Command::HandSpeed(twist) => twist,
            other => panic!("{other:?}"),
        };
        let moved_m = |twist: &Vector6<f64>| {
            let pose = arm.ee_at(&q_rad);
            let (v, w) = (twist.fixed_rows::<3>(0).into_owned(), twist.fixed_rows::<3>(3).into_owned());
            assert_eq!(w, Vector3::zeros());
            (v, pose.rot.transpose() * v)
        };
        for (k, keys) in [(b'x', b'X'), (b'y', b'Y'), (b'z', b'Z')].into_iter().enumerate() {
            let wanted = Vector3::from_fn(|row, _| if row == k { -0.1 } else { 0.0 });
            assert!((moved_m(&led(keys.0)).0 - wanted).norm() < 1e-12);
            assert!((moved_m(&led(keys.1)).1 - wanted).norm() < 1e-12);
        }
        assert_eq!(Chosen::of_key(b'7', 6), None);
    }
}
