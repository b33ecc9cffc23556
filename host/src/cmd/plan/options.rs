//! Options that all planning verbs share.

use nalgebra::Vector3;
use robot_model::{Pose, RobotModel};

use super::super::meaning::Deed;
use crate::cmd::request::readers;
use crate::cmd::values::numbers;
use crate::error::ExpectedError;
use planner::flight::{COURSE_MAX, Course};
use planner::plan::opening::Opening;
use planner::plan::problem::{Arrival, DelayWindow, Form, Obstacle, Options, Weights, short};
use planner::plan::{AskedBounds, GivenUp, Kept, seeds};
use planner::store::Index;

/// What is thrown how.
#[derive(Debug, Clone, Default, clap::Args, serde::Deserialize)]
pub struct PlanOptions {
    /// Robot, by name or file.
    #[arg(long, default_value = "powercube6")]
    pub robot: String,
    /// Which throws are allowed.
    #[arg(long, value_enum, default_value = "best", help_heading = "Throws that are allowed")]
    pub form: FormName,
    /// Part of the speed limits a plan may use [paper: 1, best: 0.98].
    #[arg(long, help_heading = "Throws that are allowed")]
    pub speed_use: Option<f64>,
    /// Part of the acceleration limits a plan may use; the rest is the controller's [paper: 1, best: 0.8].
    #[arg(long, help_heading = "Throws that are allowed")]
    pub acceleration_use: Option<f64>,
    /// Whether the hand may turn freely at the release [paper: no, best: yes].
    #[arg(long, help_heading = "Throws that are allowed")]
    pub free_spin: Option<bool>,
    /// Whether a late release must not move the landing [paper: no, best: yes].
    #[arg(long, help_heading = "Throws that are allowed")]
    pub null_delay: Option<bool>,
    /// How far the landing may move when the gripper opens late or early: ms and mm, up to four times [paper: none,
    /// best: 10,2 and 25,10].
    #[arg(long, value_name = "MS,MM", value_parser = numbers::<2>, help_heading = "Throws that are allowed")]
    pub delay_window: Vec<[f64; 2]>,
    /// Whether the released ball must stay clear of the arm [paper: no, best: yes].
    #[arg(long, help_heading = "Throws that are allowed")]
    pub clean_release: Option<bool>,
    /// Clearance of arm, base, floor, obstacles and ball in m [paper: 0, best: 0.005].
    #[arg(long, help_heading = "Throws that are allowed")]
    pub clearance_m: Option<f64>,
    /// Distance kept from both ends of every joint range in rad [paper: 0, best: 0.02].
    #[arg(long, help_heading = "Throws that are allowed")]
    pub range_margin_rad: Option<f64>,
    /// Drag of the ball in 1/m.
    #[arg(long, default_value_t = 0.0, help_heading = "Flight")]
    pub drag_per_m: f64,
    /// Spin of the ball times its lift constant (Magnus force m × v), in 1/s.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = crate::cmd::values::numbers::<3>, default_value = "0,0,0", help_heading = "Flight")]
    pub magnus_rad_s: [f64; 3],
    /// Also predict the landing of a ball that leaves between fingers that open, as the table `fingers` of the robot file
    /// says, and simulate it on the bus `sim`; the plan stays the same.
    #[arg(long, help_heading = "Flight")]
    pub finger_release: bool,
    /// Weights of time, braking ratio and jerk in the objective.
    #[arg(long, value_name = "T,B,J", value_parser = crate::cmd::values::numbers::<3>, help_heading = "Search")]
    pub weights: Option<[f64; 3]>,
    /// A box in the way: centre and half edges in m; may be given several times.
    #[arg(long, value_name = "X,Y,Z,HX,HY,HZ", allow_hyphen_values = true, value_parser = numbers::<6>, help_heading = "Throws that are allowed")]
    pub obstacle: Vec<[f64; 6]>,
    /// The target is an opening: direction out of it, to the side from which the ball comes; the ball passes its centre.
    #[arg(long, value_name = "NX,NY,NZ", allow_hyphen_values = true, value_parser = crate::cmd::values::numbers::<3>, help_heading = "Target")]
    pub opening_normal: Option<[f64; 3]>,
    /// Radius of the opening in m; the ball keeps the clearance from its rim.
    #[arg(long, value_name = "M", help_heading = "Target")]
    pub opening_radius_m: Option<f64>,
    /// Largest angle between the path of the ball and the axis of the opening, in degrees.
    #[arg(long, value_name = "DEG", default_value_t = 60.0, help_heading = "Target")]
    pub incidence_max_deg: f64,
    /// Velocity of a target that moves, in m/s; --target is where it is at the release.
    #[arg(long, value_name = "VX,VY,VZ", allow_hyphen_values = true, value_parser = velocity, conflicts_with = "target_course", help_heading = "Target")]
    #[serde(default, deserialize_with = "velocity_of")]
    pub target_velocity: Option<Course>,
    /// Way of a target that moves, as a polynomial of the time since the release: coefficients of t, t², … in m/s, m/s²,
    /// …, at most five.
    #[arg(long, value_name = "X,Y,Z;X,Y,Z;...", allow_hyphen_values = true, value_parser = course, help_heading = "Target")]
    #[serde(default, deserialize_with = "course_of")]
    pub target_course: Option<Course>,
    /// Range of the speed at the target in m/s.
    #[arg(long, alias = "arrival-speed", value_name = "MIN,MAX", value_parser = numbers::<2>, help_heading = "Throws that are allowed")]
    pub arrival_speed_m_s: Option<[f64; 2]>,
    /// Range of the steepness at the target in degrees below the horizontal.
    #[arg(long, value_name = "MIN,MAX", allow_hyphen_values = true, value_parser = numbers::<2>, help_heading = "Throws that are allowed")]
    pub arrival_descent_deg: Option<[f64; 2]>,
    /// Range of the release's distance from the shoulder in m [default: from the robot; paper: 0.5,1].
    #[arg(long, value_name = "MIN,MAX", value_parser = numbers::<2>, help_heading = "Where the search looks")]
    pub radius_m: Option<[f64; 2]>,
    /// Range of the release's elevation seen from the shoulder in degrees [default: any; paper: -72,90].
    #[arg(long, value_name = "MIN,MAX", allow_hyphen_values = true, value_parser = numbers::<2>, help_heading = "Where the search looks")]
    pub elevation_deg: Option<[f64; 2]>,
    /// Range of the time of flight in s [default: from the robot; paper: 0.3,3].
    #[arg(long, value_name = "MIN,MAX", value_parser = numbers::<2>, help_heading = "Where the search looks")]
    pub flight_s: Option<[f64; 2]>,
    /// Range of the duration of the motion in s [default: from the robot; paper: 0.2,2].
    #[arg(long, value_name = "MIN,MAX", value_parser = numbers::<2>, help_heading = "Where the search looks")]
    pub duration_s: Option<[f64; 2]>,
    /// Range of braking time over the duration of the motion [default: 0.04,0.6; paper: 0.04,0.4].
    #[arg(long, value_name = "MIN,MAX", value_parser = numbers::<2>, help_heading = "Where the search looks")]
    pub braking_ratio: Option<[f64; 2]>,
}

/// What to say about a throw that does not keep all that was asked for.
#[must_use]
pub fn note(given_up: GivenUp) -> Option<&'static str> {
    match given_up {
        GivenUp::Nothing => None,
        GivenUp::ShiftLimits => Some(
            "no throw keeps the landing in place for a gripper that opens 25 ms late; this one does to first order",
        ),
        GivenUp::Nulling => Some(
            "no throw keeps the landing in place for a gripper that opens late; here it moves with the delay",
        ),
    }
}

/// Name of a form.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, clap::ValueEnum, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FormName {
    /// The paper's eight parameters and constraints.
    Paper,
    #[default]
    /// Free spin, insensitive to a late release, currents over the whole motion, clean release.
    Best,
}

impl FormName {
    /// How a throw that follows the flight is searched in this form.
    pub(in crate::cmd) const fn search_of_following(self) -> Deed {
        match self {
            Self::Paper => Deed::PaperGrid,
            Self::Best => Deed::Starts,
        }
    }
}

readers! {
    velocity_of: velocity => Course;
    course_of: course => Course;
}

fn velocity(text: &str) -> Result<Course, String> {
    Course::new(&[numbers(text)?]).ok_or_else(|| format!("\"{text}\" is not three finite numbers"))
}

/// A course given as `x,y,z;x,y,z;…`.
fn course(text: &str) -> Result<Course, String> {
    let coefficients: Vec<[f64; 3]> = text.split(';').map(numbers).collect::<Result<_, _>>()?;
    Course::new(&coefficients).ok_or_else(|| {
        format!(
            "\"{text}\" is not one to {COURSE_MAX} groups of three finite numbers, with semicolons between"
        )
    })
}

impl PlanOptions {
    /// What is asked, where some options mean nothing; the rows of a list say more than the command line.
    pub(in crate::cmd) fn deeds(&self, is_list: bool) -> Vec<Deed> {
        let asked = [
            (!is_list && self.opening_normal.is_none(), Deed::NoOpening),
            (self.opening_normal.is_none(), Deed::NoNormal),
            (self.opening_radius_m.is_none(), Deed::NoRadius),
        ];
        asked.into_iter().filter(|(asked, _)| *asked).map(|(_, deed)| deed).collect()
    }

    #[must_use]
    pub fn resolve(&self) -> Options {
        let mut o = Options::of(match self.form {
            FormName::Paper => Form::Paper,
            FormName::Best => Form::Best,
        });
        o.speed_use = self.speed_use.unwrap_or(o.speed_use);
        o.acceleration_use = self.acceleration_use.unwrap_or(o.acceleration_use);
        o.free_spin = self.free_spin.unwrap_or(o.free_spin);
        o.null_delay = self.null_delay.unwrap_or(o.null_delay);
        if !self.delay_window.is_empty() {
            o.delay_windows = self
                .delay_window
                .iter()
                .map(|[ms, mm]| DelayWindow { delay_s: ms * 1e-3, shift_m: mm * 1e-3 })
                .collect();
        } else if !o.null_delay {
            o.delay_windows.clear();
        }
        o.clean_release = self.clean_release.unwrap_or(o.clean_release);
        o.touch_allowed = self.clean_release == Some(false);
        o.range_margin_rad = self.range_margin_rad.unwrap_or(o.range_margin_rad);
        o.clearance_m = self.clearance_m.unwrap_or(o.clearance_m);
        o.drag_per_m = self.drag_per_m;
        o.finger_release = self.finger_release;
        o.magnus_rad_s = Vector3::from(self.magnus_rad_s);
        if let Some([k_t, k_b, k_j]) = self.weights {
            o.weights = Weights { k_t, k_b, k_j };
        }
        o.obstacles = self
            .obstacle
            .iter()
            .enumerate()
            .map(|(i, b)| Obstacle {
                name: format!("obstacle {}", i + 1),
                x_wo: Pose::translation(b[0], b[1], b[2]),
                half_m: Vector3::new(b[3], b[4], b[5]),
            })
            .collect();
        let range = |r: Option<[f64; 2]>| r.map(|[a, b]| a..=b);
        o.bounds = AskedBounds {
            azimuth_rad: None,
            elevation_rad: self.elevation_deg.map(|[a, b]| a.to_radians()..=b.to_radians()),
            radius_m: range(self.radius_m),
            spin_rad_s: None,
            flight_s: range(self.flight_s),
            duration_s: range(self.duration_s),
            braking_ratio: range(self.braking_ratio),
        };
        o.opening = self.opening_normal.zip(self.opening_radius_m).map(|(normal, radius_m)| Opening {
            normal: Vector3::from(normal),
            radius_m,
            incidence_max_rad: self.incidence_max_deg.to_radians(),
        });
        o.course = self.target_velocity.or(self.target_course).unwrap_or_default();
        o.arrival = Arrival {
            speed_m_s: self.arrival_speed_m_s.map(|[a, b]| a..=b),
            descent_rad: self.arrival_descent_deg.map(|[a, b]| a.to_radians()..=b.to_radians()),
        };
        o
    }

    /// What a search must keep: what was asked for by name is not given up.
    #[must_use]
    pub fn kept(&self) -> Kept {
        Kept { shift_limits: !self.delay_window.is_empty(), nulling: self.null_delay.is_some() }
    }

    /// Throws to start from: those that come with the program for this robot or a similar one.
    #[must_use]
    pub fn starts(&self, arm: &RobotModel) -> Starts {
        let index = seeds::built_in(arm);
        let of = index.lender().map_or_else(String::new, |lender| format!(" of {lender}, a similar robot"));
        let sources = vec![format!("{} built-in throws{of}", index.records().len())];
        Starts { index, sources }
    }
}

#[derive(Debug)]
pub struct Starts {
    /// The throws.
    pub index: Index,
    /// Where the throws come from, for people.
    pub sources: Vec<String>,
}

/// No ball is thrown farther than this, m.
const TARGET_MAX_M: f64 = 100.0;

/// Refuses a target that lies so far away that its numbers must be millimetres.
pub(super) fn require_metres(target_m: [f64; 3]) -> Result<(), ExpectedError> {
    let far = target_m.iter().any(|x| x.is_finite() && x.abs() > TARGET_MAX_M);
    if !far {
        return Ok(());
    }
    let ([x, y, z], [a, b, c]) = (target_m.map(short), target_m.map(|mm| short(1e-3 * mm)));
    Err(ExpectedError::bad_input(&format!(
        "target {x},{y},{z} m lies more than {TARGET_MAX_M} m away: metres?"
    ))
    .next(format!("targets are in m; if these are millimetres, --target {a},{b},{c}")))
}
