//! `cubectl catch` for programs: a request as JSON in, the result with its motions out; nothing is printed.

use nalgebra::Matrix4;
use operator::ball_catch::trial::Moment;
use planner::catch::Joints;
use serde_json::{Value, json};

use super::{Args, ball, disc, outcome};
use crate::cmd::request;
use crate::error::ExpectedError;
use crate::exit;

/// Steps of a table at most.
const ROWS_MAX: f64 = 100_000.0;

/// What `cubectl catch --ball --json` prints, and more: how the program ends, where the arm stands, the path of its cup, and a table
/// of the last motion, in steps of `step_s` from its start to its end. Times count from the release.
///
/// # Errors
/// A field is refused (exit code 2 of the program), or input is refused. A ball that is not caught is no error.
pub fn ball(request: &str, step_s: f64) -> Result<Value, ExpectedError> {
    let args = args(request, step_s)?;
    let Some(thrown) = args.ball else {
        return Err(ExpectedError::new(exit::USAGE, "no ball").next("name it with --ball"));
    };
    let trial = ball::trial(&args, &thrown)?;
    let outcome = &trial.outcome;
    let release_s = outcome.planned_s.0;
    let mut result = outcome::as_json(outcome);
    let end = outcome::ended(outcome).err();
    let x_wb = trial.pair.cell.arms[1].x_wb.to_matrix();
    result["exit_code"] = json!(end.as_ref().map_or(exit::OK, |error| error.code));
    result["text"] = json!(end.map_or_else(|| "caught".to_owned(), |error| error.to_string()));
    result["x_wb"] = json!(rows(&x_wb));
    result["within_limits"] = json!(outcome.within_limits(args.catching.jerk));
    let arm = trial.pair.catcher(args.catching.jerk);
    let mouth_m = |moment: &Moment| json!(arm.mouth(&moment.q[1], &Joints::zeros(6)).0.as_slice());
    result["trace"]["mouth_m"] = outcome.trace.iter().map(mouth_m).collect();
    result["motion"] = outcome.choice.as_ref().map_or(Value::Null, |choice| {
        let motion = &choice.motion;
        let states = steps(motion.start_s, motion.end_s(), step_s).map(|t_s| {
            let at = motion.at(t_s);
            (t_s - release_s, [at.map(|joint| joint.q), at.map(|joint| joint.v), at.map(|joint| joint.a)])
        });
        table(states)
    });
    Ok(result)
}

/// What `cubectl catch --disc --json` prints, and more: how the program ends, and tables of the flight of the disc and of the
/// motion, in steps of `step_s`. Times count from the start of the flight.
pub fn disc(request: &str, step_s: f64) -> Result<Value, ExpectedError> {
    let args = args(request, step_s)?;
    if args.ball.is_some() {
        return Err(ExpectedError::new(exit::USAGE, "--ball is no disc").next("leave --ball out"));
    }
    let looked = disc::look(&args)?;
    let mut result = looked.as_json();
    let end = looked.ended(args.air).err();
    result["exit_code"] = json!(end.as_ref().map_or(exit::OK, |error| error.code));
    let good = if looked.plan.is_some() { "caught" } else { "only the rule of the paper was looked at" };
    result["text"] = json!(end.map_or_else(|| good.to_owned(), |error| error.to_string()));
    let planned = looked.plan.as_ref().and_then(|plan| plan.as_ref().ok()).map(|(plan, _)| &plan.motion);
    let until_s = planned.map_or(looked.path.end_s(), |motion| motion.end_s().min(looked.path.end_s()));
    let flight: Vec<_> = steps(0.0, until_s, step_s).map(|t_s| (t_s, looked.path.at(t_s))).collect();
    result["flight"] = json!({
        "t_s": flight.iter().map(|(t_s, _)| *t_s).collect::<Vec<_>>(),
        "position_m": flight.iter().map(|(_, disc)| disc.p_m.as_slice()).collect::<Vec<_>>(),
        "velocity_m_s": flight.iter().map(|(_, disc)| disc.v_m_s.as_slice()).collect::<Vec<_>>(),
        "normal": flight.iter().map(|(_, disc)| disc.normal.as_slice()).collect::<Vec<_>>(),
    });
    result["motion"] = planned.map_or(Value::Null, |motion| {
        let states = steps(motion.from_s, motion.end_s(), step_s).map(|t_s| {
            let at: [_; 4] = std::array::from_fn(|joint| motion.at(joint, t_s));
            (t_s, [at.map(|joint| joint.q), at.map(|joint| joint.v), at.map(|joint| joint.a)])
        });
        table(states)
    });
    Ok(result)
}

fn args(request: &str, step_s: f64) -> Result<Args, ExpectedError> {
    let args: Args = request::read("catch", request)?;
    args.require_meaning()?;
    if !(1e-4..=1.0).contains(&step_s) {
        return Err(ExpectedError::bad_input(&format!("a step of {step_s} s is outside 0.0001 to 1")));
    }
    Ok(args)
}

/// From one time to another, the last step being shorter.
fn steps(from_s: f64, to_s: f64, step_s: f64) -> impl Iterator<Item = f64> {
    let count = ((to_s - from_s) / step_s - 1e-9).ceil().clamp(0.0, ROWS_MAX) as u32;
    (0..=count).map(move |k| (from_s + f64::from(k) * step_s).min(to_s))
}

/// Columns of a motion.
fn table<const N: usize>(states: impl Iterator<Item = (f64, [[f64; N]; 3])>) -> Value {
    let (mut t_s, mut columns) = (Vec::new(), [const { Vec::new() }; 3]);
    for (at_s, state) in states {
        t_s.push(at_s);
        for (column, values) in columns.iter_mut().zip(state) {
            column.push(values.to_vec());
        }
    }
    let [q, qd, qdd] = columns;
    json!({"t_s": t_s, "q_rad": q, "qd_rad_s": qd, "qdd_rad_s2": qdd})
}

fn rows(matrix: &Matrix4<f64>) -> Vec<Vec<f64>> {
    matrix.row_iter().map(|row| row.iter().copied().collect()).collect()
}
