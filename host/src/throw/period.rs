//! The control period of a controller that runs as a program: measured, wished, or refused before anything moves.

use firmware::settings::Settings;
use protocol::{Duration, JointIndex};

use crate::bus::pace::Pace;
use crate::tune::gains_file::GainsFile;

/// Gains of `powercube6` that come with the program, shortest period first. Each is the certified saturated design of
/// `cubectl tune --period …` for the initial errors of the firmware's start tolerance.
const BUILT_IN: [(u32, &str); 5] = [
    (3_000, include_str!("../../gains/powercube6-3ms.toml")),
    (5_000, include_str!("../../gains/powercube6-5ms.toml")),
    (10_000, include_str!("../../gains/powercube6-10ms.toml")),
    (17_000, include_str!("../../gains/powercube6-17ms.toml")),
    (30_000, include_str!("../../gains/powercube6-30ms.toml")),
];

/// The gains for a period of exactly `period_us`, if the program has some for the robot.
#[must_use]
pub fn built_in_gains(robot: &str, period_us: u32) -> Option<GainsFile> {
    let (_, text) = BUILT_IN.iter().find(|(us, _)| *us == period_us)?;
    GainsFile::from_toml(text, robot).ok()
}

/// Who decides the period.
#[derive(Clone, Debug, PartialEq)]
pub enum Wish {
    /// Whatever is comfortable: the shortest one that the program has gains for.
    Any,
    /// This one, µs, with the gains that come with the program.
    Period(u32),
    /// That of these gains.
    Gains(Box<GainsFile>),
}

/// What was decided.
#[derive(Clone, Debug, PartialEq)]
pub struct Choice {
    /// Control period, µs.
    pub period_us: u32,
    /// Gains for it; `None` if the program has none for the robot and the settings' own are used.
    pub gains: Option<GainsFile>,
    /// `measured`, `given` or `virtual time`.
    pub why: &'static str,
}

/// Why there is no period.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NoPeriod {
    /// The one that was asked for does not hold here.
    #[error(
        "a control period of {} ms does not hold here: {pace}\n  {granted}\n  next: {next}; nothing has moved",
        f64::from(*.period_us) * 1e-3, pace = .pace, granted = .pace.granted
    )]
    TooShort {
        /// Asked for, µs.
        period_us: u32,
        /// Measured.
        pace: Box<Pace>,
        /// What would hold.
        next: String,
    },
    /// None that the program has gains for.
    #[error(
        "no control period holds here: {pace}; the longest one with gains is {} ms\n  {granted}\n  next: end what else \
         runs on this machine, or let a controller of its own close the loop (`--controller NODE-ID`); nothing has moved",
        f64::from(*.longest_us) * 1e-3, pace = .pace, granted = .pace.granted
    )]
    None {
        /// Longest, µs.
        longest_us: u32,
        /// Measured.
        pace: Box<Pace>,
    },
    /// No gains for the period that was asked for.
    #[error("the program has no gains for {} ms and {robot}\n  next: {}", f64::from(*.period_us) * 1e-3, tune(*.period_us))]
    NoGains {
        /// Asked for, µs.
        period_us: u32,
        /// The robot.
        robot: String,
    },
}

fn tune(period_us: u32) -> String {
    let s = f64::from(period_us) * 1e-6;
    format!("`cubectl tune --period {s} --out gains.toml`, then --gains gains.toml")
}

/// Decides. `usual_us` is the period of the settings, used in virtual time and for robots without gains of the program.
///
/// # Errors
/// [`NoPeriod`].
pub fn choose(wish: Wish, pace: Option<&Pace>, robot: &str, usual_us: u32) -> Result<Choice, NoPeriod> {
    let fixed = match wish {
        Wish::Gains(gains) => Some(((gains.period_s * 1e6).round() as u32, Some(*gains))),
        Wish::Period(period_us) => {
            let gains = built_in_gains(robot, period_us);
            if gains.is_none() && period_us != usual_us {
                return Err(NoPeriod::NoGains { period_us, robot: robot.to_owned() });
            }
            Some((period_us, gains))
        }
        Wish::Any => None,
    };
    let holds = |period_us: u32| pace.is_none_or(|pace| pace.holds(Duration::from_micros(period_us.into())));
    if let Some((period_us, gains)) = fixed {
        return match pace {
            Some(pace) if !holds(period_us) => {
                Err(NoPeriod::TooShort { period_us, pace: Box::new(pace.clone()), next: advice(pace, robot) })
            }
            _ => Ok(Choice { period_us, gains, why: "given" }),
        };
    }
    let usual = || (usual_us, built_in_gains(robot, usual_us));
    let Some(pace) = pace else {
        let (period_us, gains) = usual();
        return Ok(Choice { period_us, gains, why: "virtual time" });
    };
    let candidates = BUILT_IN.iter().filter_map(|(us, _)| Some((*us, Some(built_in_gains(robot, *us)?))));
    let mut candidates = candidates.peekable();
    let comfortable = |us: u32| pace.comfortable() <= Duration::from_micros(us.into());
    // Without a comfortable one the longest, if it holds.
    let mut last = None;
    let (period_us, gains) = match candidates.peek() {
        Some(_) => candidates.find(|(us, gains)| {
            last = Some((*us, gains.clone()));
            comfortable(*us)
        }),
        None => Some(usual()),
    }
    .or(last)
    .filter(|(us, _)| holds(*us))
    .ok_or_else(|| {
        let longest_us = if built_in_gains(robot, usual_us).is_some() { longest_us() } else { usual_us };
        NoPeriod::None { longest_us, pace: Box::new(pace.clone()) }
    })?;
    Ok(Choice { period_us, gains, why: "measured" })
}

fn longest_us() -> u32 {
    BUILT_IN.iter().map(|(us, _)| *us).max().unwrap_or(0)
}

/// What would hold instead, with the word that says it.
fn advice(pace: &Pace, robot: &str) -> String {
    let shortest_us = pace.shortest().as_micros();
    let built_in = BUILT_IN.iter().map(|(us, _)| *us).find(|us| u64::from(*us) >= shortest_us);
    match built_in.filter(|us| built_in_gains(robot, *us).is_some()) {
        Some(us) => format!(
            "{} ms would hold: `--period {}`, or neither --period nor --gains to let it be chosen",
            us / 1_000,
            us / 1_000
        ),
        None => {
            // Whole milliseconds, with a fifth of room.
            let us = (shortest_us * 6 / 5).div_ceil(1_000) * 1_000;
            let us = u32::try_from(us).unwrap_or(u32::MAX);
            format!("{} ms would hold: {}", us / 1_000, tune(us))
        }
    }
}

/// Lets a controller of this program begin with the choice: its period, the deadlines that follow from it, gains with the
/// estimator and the certificate they were proven for, and no start from farther away than that is for.
pub fn apply(choice: &Choice, settings: &mut Settings) {
    let period_us = choice.period_us;
    settings.cycle_period_us = period_us;
    settings.gains_period_us = period_us;
    settings.reply_deadline_us = (period_us * 2 / 3).clamp(500, 20_000);
    let Some(gains) = &choice.gains else { return };
    (settings.estimator_alpha, settings.estimator_beta) =
        (gains.estimator.alpha as f32, gains.estimator.beta as f32);
    settings.gains_certificate_crc32 = firmware::crc::Crc32::of(gains.to_toml().as_bytes());
    // Gains for other accelerations are for another robot, whatever its name; the controller refuses to arm with them.
    let fits = gains.joint.iter().all(|tuned| {
        let index = tuned.number.checked_sub(1).and_then(|n| JointIndex::new(n).ok());
        let a_max = index.map(|index| f64::from(settings.joint.at(index).a_max_rad_s2));
        a_max.is_some_and(|a_max| (a_max - tuned.problem.acceleration_max_rad_s2).abs() < 1e-4)
    });
    settings.gains_robot_crc32 = if fits { settings.limits_robot_crc32 } else { 0 };
    for tuned in &gains.joint {
        let Some(index) = tuned.number.checked_sub(1).and_then(|n| JointIndex::new(n).ok()) else { continue };
        let joint = settings.joint.at_mut(index);
        [joint.k_error_1_s2, joint.k_rate_1_s, joint.k_last] = tuned.gains();
        let tolerance_rad = tuned.problem.error_position_rad as f32;
        joint.start_tolerance_rad = joint.start_tolerance_rad.min(tolerance_rad);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use firmware::registers;

    const ROBOT: &str = "powercube6";

    fn any(pace: &Pace) -> Result<Choice, NoPeriod> {
        choose(Wish::Any, Some(pace), ROBOT, 3_000)
    }

    #[test]
    fn every_built_in_file_proves_and_is_for_its_period_and_all_joints() {
        for (us, _) in BUILT_IN {
            let gains = built_in_gains(ROBOT, us).unwrap();
            assert_eq!((gains.period_s * 1e6).round() as u32, us);
            assert!(gains.joint.iter().map(|joint| joint.number).eq(1..=6));
        }
        assert_eq!(BUILT_IN[0].0, Settings::powercube6().cycle_period_us);
        assert!(BUILT_IN.is_sorted_by_key(|(us, _)| *us));
    }

    #[test]
    fn the_shortest_period_with_room_is_chosen_and_the_longest_if_it_only_just_holds() {
        let table = [
            (0, 3_000),
            (2_000, 3_000),
            (2_010, 5_000),
            (3_400, 10_000),
            (11_333, 17_000),
            (12_000, 30_000),
            (30_000, 30_000),
        ];
        for (needs_us, chosen_us) in table {
            let choice = any(&Pace::that_needs(needs_us)).unwrap();
            assert_eq!((choice.period_us, choice.why), (chosen_us, "measured"), "{needs_us}");
            assert_eq!((choice.gains.unwrap().period_s * 1e6).round() as u32, chosen_us);
        }
        assert!(matches!(any(&Pace::that_needs(30_100)), Err(NoPeriod::None { longest_us: 30_000, .. })));
    }

    #[test]
    fn a_wish_that_does_not_hold_is_refused_with_what_was_measured_and_what_would_hold() {
        let pace = Pace::that_needs(4_800);
        let text = choose(Wish::Period(3_000), Some(&pace), ROBOT, 3_000).unwrap_err().to_string();
        for part in
            ["3 ms does not hold", "4.0 ms at worst", "5 ms would hold", "--period 5", "nothing has moved"]
        {
            assert!(text.contains(part), "{part}: {text}");
        }
        let gains = built_in_gains(ROBOT, 3_000).unwrap();
        assert!(choose(Wish::Gains(Box::new(gains.clone())), Some(&pace), ROBOT, 3_000).is_err());
        let choice = choose(Wish::Gains(Box::new(gains)), None, ROBOT, 3_000).unwrap();
        assert_eq!((choice.period_us, choice.why), (3_000, "given"));
        assert!(matches!(choose(Wish::Period(4_000), None, ROBOT, 3_000), Err(NoPeriod::NoGains { .. })));
    }

    #[test]
    fn in_virtual_time_the_usual_period_is_kept() {
        let choice = choose(Wish::Any, None, ROBOT, 3_000).unwrap();
        assert_eq!((choice.period_us, choice.why), (3_000, "virtual time"));
        assert!(choose(Wish::Any, None, "another", 3_000).unwrap().gains.is_none());
    }

    #[test]
    fn the_settings_of_a_choice_pass_their_own_check() {
        for (us, _) in BUILT_IN {
            let choice = choose(Wish::Period(us), None, ROBOT, 3_000).unwrap();
            let mut settings = Settings::powercube6();
            apply(&choice, &mut settings);
            assert_eq!(settings.check(), Ok(()), "{us}");
            assert_eq!((settings.cycle_period_us, settings.gains_period_us), (us, us));
        }
    }

    #[test]
    fn a_controller_takes_the_gains_of_a_choice_through_its_registers() {
        for (us, _) in BUILT_IN {
            let choice = choose(Wish::Period(us), None, ROBOT, 3_000).unwrap();
            let (mut wanted, mut written) = (Settings::powercube6(), Settings::powercube6());
            apply(&choice, &mut wanted);
            for name in ["joint.k_error_1_s2", "joint.k_rate_1_s", "joint.k_last"] {
                let index = registers::find(name).unwrap();
                let numbers = registers::read(&wanted, index).unwrap();
                assert_eq!(
                    registers::write(&mut written, index, numbers.as_slice()),
                    Ok(()),
                    "{name} at {us} us"
                );
                assert_eq!(registers::read(&written, index).unwrap().as_slice(), numbers.as_slice());
            }
        }
    }
}
