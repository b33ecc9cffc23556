//! Damiao motors: each is asked for its state in the form of the robot file, classical CAN or CAN FD, and if that fails in the others. A
//! request for a state moves nothing.

use std::cell::RefCell;
use std::io;
use std::rc::Rc;

use operator::bus::Session;
use operator::drives::mit::is_order_to_motor;
use operator::tap::{Tap, Way};
use protocol::mit::{DATA_RATES, Register, RegisterAnswer, RegisterRequest, RegisterValue, State};
use protocol::{Duration, FdFlags, Frame, Instant};
use robot_model::{MitMotor, MitMotors};

use super::errors;
use crate::cmd::finding::{Finding, Level, finding};
use crate::error::ExpectedError;

/// A group of motors gets commands in each of its periods.
const LISTEN: Duration = Duration::from_millis(300);
/// Far longer than a motor takes, also behind a USB adapter.
const ANSWER: Duration = Duration::from_millis(20);
/// A frame may be lost.
const TRIES: usize = 3;

/// No answer, and what to do.
const SILENT: (&str, &str) = (
    "no answer, in whatever form it was asked",
    "check supply, cable and ids (registers 7, 8), and that bus and motor have the same rates (register 35)",
);

/// How a frame goes over the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Form {
    Classical,
    /// With or without bit rate switch.
    Fd {
        brs: bool,
    },
}

impl Form {
    fn of(frame: &Frame) -> Self {
        frame.fd().map_or(Self::Classical, |flags| Self::Fd { brs: flags.brs })
    }

    fn on(self, frame: Frame) -> Frame {
        match self {
            Self::Classical => frame,
            Self::Fd { brs } => frame.with_fd(FdFlags { brs, esi: false }),
        }
    }

    const fn words(self) -> &'static str {
        match self {
            Self::Classical => "classical frames",
            Self::Fd { brs: true } => "CAN FD frames with bit rate switch",
            Self::Fd { brs: false } => "CAN FD frames without bit rate switch",
        }
    }
}

/// Frames since the last look.
#[derive(Clone, Default)]
struct Listener(Rc<RefCell<Vec<(Way, Frame)>>>);

impl Tap for Listener {
    fn frame(&mut self, _: Instant, way: Way, frame: &Frame) -> io::Result<()> {
        self.0.borrow_mut().push((way, *frame));
        Ok(())
    }
}

impl Listener {
    fn heard(&self) -> Vec<Frame> {
        let all = self.0.take().into_iter();
        all.filter(|(way, _)| *way == Way::Received).map(|(_, frame)| frame).collect()
    }
}

/// What a motor answered to one form: in which form, and what its register 35 holds.
type Answer = (Form, Option<u32>);

/// Looks at the motors, and at the frames of others. If another program speaks to the motors, nothing is asked.
pub(super) fn find(session: &mut Session, motors: &MitMotors) -> Result<Vec<Finding>, ExpectedError> {
    let listener = Listener::default();
    session.add_tap(Box::new(listener.clone()));
    session.sleep_until(session.now() + LISTEN)?;
    let heard = listener.heard();
    let mut findings = vec![interface(session, motors.data_bit_rate_bit_s)];
    if let Some(busy) = others(&heard, motors) {
        findings.push(busy);
        findings.extend(errors(session, true));
        return Ok(findings);
    }
    // The others only if that one fails: a classical node of another kind takes CAN FD frames for errors.
    let wanted = expected(motors.data_bit_rate_bit_s);
    let all = [Form::Classical, Form::Fd { brs: true }, Form::Fd { brs: false }];
    let mut forms = vec![wanted];
    forms.extend(all.into_iter().filter(|form| *form != wanted));
    let takes_fd = session.takes_fd().is_ok();
    forms.retain(|form| takes_fd || *form == Form::Classical);
    let (mut fine, mut wrong) = (0, Vec::<(Verdict, Vec<String>)>::new());
    for (index, motor) in motors.all().enumerate() {
        let mut answers = Vec::new();
        for form in &forms {
            let answer = ask(session, &listener, motor, *form)?;
            answers.push((*form, answer));
            if answer.is_some_and(|(own, _)| (own, *form) == (wanted, wanted)) {
                break;
            }
        }
        let place =
            if index < motors.joints.len() { format!("joint {}", index + 1) } else { "gripper".to_owned() };
        let name = format!("{place} (motor {})", motor.id);
        let Some(verdict) = verdict(&answers, motors.data_bit_rate_bit_s) else {
            fine += 1;
            continue;
        };
        match wrong.iter_mut().find(|(other, _)| *other == verdict) {
            Some((_, names)) => names.push(name),
            None => wrong.push((verdict, vec![name])),
        }
    }
    for ((what, next), names) in wrong {
        findings.push(finding(Level::Problem, "motors", format!("{}: {what}", names.join(", ")), next));
    }
    if fine > 0 {
        let what = format!("{fine} answer to {}, and in the same form", wanted.words());
        findings.push(finding(Level::Ok, "motors", what, ""));
    }
    findings.extend(errors(session, false));
    Ok(findings)
}

const fn expected(data_bit_rate_bit_s: Option<u32>) -> Form {
    match data_bit_rate_bit_s {
        Some(_) => Form::Fd { brs: true },
        None => Form::Classical,
    }
}

fn interface(session: &Session, data_bit_rate_bit_s: Option<u32>) -> Finding {
    const NAME: &str = "interface";
    match (session.takes_fd(), data_bit_rate_bit_s) {
        (Ok(()), Some(rate)) => {
            finding(Level::Ok, NAME, format!("takes CAN FD; the motors need {rate} bit/s"), "")
        }
        (Ok(()), None) => {
            finding(Level::Ok, NAME, "takes CAN FD; the motors of the robot file are classical", "")
        }
        (Err(_), None) => finding(Level::Ok, NAME, "classical CAN, as the robot file says", ""),
        (Err(error), Some(_)) => {
            let what = "takes classical CAN only, and the robot file says CAN FD: motors were asked classically only";
            finding(Level::Problem, NAME, what, error.next().unwrap_or_default())
        }
    }
}

/// Commands that this program did not send.
fn others(heard: &[Frame], motors: &MitMotors) -> Option<Finding> {
    const NAME: &str = "other programs";
    let command = heard.iter().find(|frame| is_order_to_motor(motors, frame))?;
    let form = Form::of(command);
    let found = format!(
        "another program sends {} to the motors (id {}): nothing was asked",
        form.words(),
        command.id()
    );
    let wanted = expected(motors.data_bit_rate_bit_s);
    Some(if form == wanted {
        finding(Level::Note, NAME, found, "end it for the other checks")
    } else {
        let next = format!(
            "the robot file needs {}: switch it in that program (in python-can `is_fd`, `bitrate_switch`), or in the file",
            wanted.words()
        );
        finding(Level::Problem, NAME, found, next)
    })
}

/// `None`: no answer.
fn ask(
    session: &mut Session,
    listener: &Listener,
    motor: &MitMotor,
    form: Form,
) -> Result<Option<Answer>, ExpectedError> {
    let mut wait = |request: &RegisterRequest| -> Result<Vec<Frame>, ExpectedError> {
        listener.heard();
        session.host_node().send(form.on(request.encode(motor.id)));
        session.sleep_until(session.now() + ANSWER)?;
        Ok(listener.heard())
    };
    for _ in 0..TRIES {
        let frames = wait(&RegisterRequest::State)?;
        let state =
            |frame: &&Frame| State::decode(frame, motor.id, motor.answers_on, &motor.motor.ranges).is_some();
        let Some(answer) = frames.iter().find(state) else { continue };
        let request = RegisterRequest::Read(Register::BitRate);
        let rate = wait(&request)?.iter().find_map(|frame| {
            match RegisterAnswer::decode(frame, motor.id, motor.answers_on, &request)?.value {
                RegisterValue::Whole(value) => Some(value),
                RegisterValue::Float(_) => None,
            }
        });
        return Ok(Some((Form::of(answer), rate)));
    }
    Ok(None)
}

/// What is wrong with a motor, and the next step.
type Verdict = (String, String);

/// By its answer to each form; `None`: nothing is wrong.
fn verdict(answers: &[(Form, Option<Answer>)], data_bit_rate_bit_s: Option<u32>) -> Option<Verdict> {
    let wanted = expected(data_bit_rate_bit_s);
    let code = match data_bit_rate_bit_s {
        Some(rate) => DATA_RATES.iter().find(|(_, bit_s)| *bit_s == rate).map_or(0, |(code, _)| *code),
        None => 4,
    };
    let set =
        format!("write {code} to its register 35 with the maker's tool, store it, and switch it off and on");
    let to_wanted = answers.iter().find(|(asked, _)| *asked == wanted).and_then(|(_, answer)| *answer);
    let any = answers.iter().find_map(|(asked, answer)| Some((*asked, (*answer)?)));
    let (asked, (form, rate)) = match to_wanted {
        Some((form, _)) if form == wanted => return None,
        Some(answer) => (wanted, answer),
        None => match any {
            Some(any) => any,
            None => return Some((SILENT.0.to_owned(), SILENT.1.to_owned())),
        },
    };
    let holds = rate.map_or(String::new(), |rate| format!("; its register 35 holds {rate}"));
    let what = format!("asked by {}, it answers by {}{holds}", asked.words(), form.words());
    let what = if asked == wanted { what } else { format!("does not answer to {}; {what}", wanted.words()) };
    let own = DATA_RATES.iter().find(|(code, _)| Some(*code) == rate).map(|(_, bit_s)| *bit_s);
    let next = match own.filter(|_| wanted == Form::Classical) {
        Some(bit_s) => format!("give the robot file `[bus]` with `data_bit_rate_bit_s = {bit_s}`, or {set}"),
        None => set,
    };
    Some((what, next))
}

#[cfg(test)]
mod tests {
    use super::*;

    const BRS: Form = Form::Fd { brs: true };

    #[test]
    fn a_motor_is_fine_if_it_answers_in_the_form_of_the_robot_file_and_else_the_step_is_named() {
        let fd = Some(5_000_000);
        let classical = Some((Form::Classical, Some(4)));
        let switched = Some((BRS, Some(9)));
        let bare = Some((Form::Fd { brs: false }, Some(9)));
        for (answers, rate, what, next) in [
            (
                [classical, classical],
                fd,
                "it answers by classical frames; its register 35 holds 4",
                "write 9 to",
            ),
            ([None, bare], fd, "it answers by CAN FD frames without bit rate switch", "write 9 to"),
            (
                [None, switched],
                None,
                "does not answer to classical frames",
                "`data_bit_rate_bit_s = 5000000`",
            ),
            ([classical, None], fd, "does not answer to CAN FD frames with bit rate switch", "write 9 to"),
            ([None, None], fd, "no answer, in whatever form", "register 35"),
        ] {
            let answers = [(Form::Classical, answers[0]), (BRS, answers[1])];
            let (found, step) = verdict(&answers, rate).unwrap();
            assert!(found.contains(what) && step.contains(next), "{found}: {step}");
        }
        for (answers, rate) in [([None, switched], fd), ([classical, classical], None)] {
            let answers = [(Form::Classical, answers[0]), (BRS, answers[1])];
            assert_eq!(verdict(&answers, rate), None);
        }
    }

    #[test]
    fn a_program_that_leaves_the_bit_rate_switch_out_is_named() {
        let robot = format!("{}/../robots/openarm7.toml", env!("CARGO_MANIFEST_DIR"));
        let mut motors = robot_model::RobotModel::load(&robot).unwrap().mit_motors().unwrap().clone();
        motors.data_bit_rate_bit_s = Some(5_000_000);
        let command = RegisterRequest::State.encode(motors.joints[0].id);
        let of = |form: Form| others(&[form.on(command)], &motors).unwrap();
        assert_eq!(of(BRS).level, Level::Note);
        for form in [Form::Classical, Form::Fd { brs: false }] {
            let found = of(form);
            assert_eq!(found.level, Level::Problem);
            assert!(found.what.contains(form.words()) && found.next.contains("bitrate_switch"), "{found:?}");
        }
        let answer = Frame::from_array(motors.joints[0].answers_on, [0; 8]);
        assert_eq!(others(&[answer], &motors), None);
    }
}
