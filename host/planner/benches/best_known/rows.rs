//! Rows of a file of best known throws: `index,x_m,y_m,z_m,level,objective,starts,solved,at_best,throw`.
//!
//! `level` is the relaxation level: 0 with the limits of the landing's shift, 1 nulled, 2 without both; it is empty
//! if no throw is known. `throw` has the time of flight and the two phases in s, then angles, speeds and
//! accelerations of the joints at the release in rad and s, with `;` between; it may be missing.

use nalgebra::Vector3;
use planner::throw::Throw;
use robot_model::JointVec;

/// A target with a throw to it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Row {
    pub(crate) target: Vector3<f64>,
    /// Relaxation level, and the price there; `None` if no throw is known.
    pub(crate) known: Option<(usize, f64)>,
    /// Numbers of the throw as in the file; empty if it is missing.
    pub(crate) throw: Vec<f64>,
}

impl Row {
    /// Reads a line.
    ///
    /// # Errors
    /// The line has too few fields, or one that is not a number.
    pub(crate) fn read(line: &str) -> Result<Self, String> {
        let bad = |what: &str| format!("\"{line}\" is no row of best known throws: {what}");
        let number = |text: &str| text.parse::<f64>().map_err(|e| bad(&format!("\"{text}\": {e}")));
        let fields: Vec<&str> = line.split(',').collect();
        let [_, x, y, z, level, price, rest @ ..] = &fields[..] else { return Err(bad("too few fields")) };
        let known = match level.is_empty() {
            true => None,
            false => Some((level.parse().map_err(|e| bad(&format!("level: {e}")))?, number(price)?)),
        };
        let throw = rest.get(3).filter(|text| !text.is_empty());
        Ok(Self {
            target: Vector3::new(number(x)?, number(y)?, number(z)?),
            known,
            throw: throw.map_or(Ok(Vec::new()), |text| text.split(';').map(number).collect())?,
        })
    }

    /// Reads a file with its line of names.
    ///
    /// # Errors
    /// A line is not a row.
    pub(crate) fn read_all(text: &str) -> Result<Vec<Self>, String> {
        text.lines().skip(1).map(Self::read).collect()
    }

    /// The throw for an arm of `n` joints; `None` if it is missing or has another number of joints.
    pub(crate) fn throw(&self, n: usize) -> Option<Throw> {
        let [flight_s, ha_s, hb_s, joints @ ..] = &self.throw[..] else { return None };
        let all = |k: usize| joints.get(k * n..(k + 1) * n).map(JointVec::from_slice);
        (joints.len() == 3 * n).then_some(Throw {
            q_rad: all(0)?,
            qd_rad_s: all(1)?,
            qdd_rad_s2: all(2)?,
            flight_s: *flight_s,
            ha_s: *ha_s,
            hb_s: *hb_s,
        })
    }
}

/// The last column for a throw, rounded to 1e-9.
pub(crate) fn throw_column(throw: &Throw) -> String {
    let joints = [throw.q_rad, throw.qd_rad_s, throw.qdd_rad_s2];
    let numbers = [throw.flight_s, throw.ha_s, throw.hb_s].into_iter();
    let texts: Vec<String> =
        numbers.chain(joints.iter().flat_map(|v| v.iter().copied())).map(|x| format!("{x:.9}")).collect();
    texts.join(";")
}
