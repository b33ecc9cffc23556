//! The control period of a controller that runs as a program: measured, requested, or refused before anything moves.

use firmware::settings::Settings;
use protocol::{Duration, JointIndex};
use robot_model::RobotModel;

use crate::bus::cycle_timing::CycleTiming;
use crate::bus::settings::{NoSettings, settings_of};
use crate::bus::sim::SimSetup;
use tuner::gains::choose::{GainsFrom, NoGains, PERIODS_US, gains_for};
use tuner::gains::gains_file::GainsFile;

/// Shortest and longest control period of a controller, µs: the range of its register `cycle.period_us`.
pub const PERIOD_MIN_US: u32 = 1_000;
/// See [`PERIOD_MIN_US`].
pub const PERIOD_MAX_US: u32 = 40_000;

/// Who decides the period.
#[derive(Clone, Debug, PartialEq)]
pub enum PeriodRequest {
    /// Any period that the machine keeps with a margin: the shortest one that the program has gains for.
    Any,
    /// This one, µs, with the gains that come with the program.
    Period(u32),
    Gains(Box<GainsFile>),
}

/// What was decided.
#[derive(Clone, Debug, PartialEq)]
pub struct Choice {
    /// Control period, µs.
    pub period_us: u32,
    pub gains: GainsFile,
    /// Where they come from.
    pub gains_from: GainsFrom,
    /// `measured`, `given` or `virtual time`.
    pub why: &'static str,
}

/// Why there is no period.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NoPeriod {
    /// The requested period cannot be kept here.
    #[error("a control period of {} ms does not hold here: {timing}\n  {granted}", f64::from(*.period_us) * 1e-3, timing = .timing, granted = .timing.granted)]
    TooShort {
        /// Requested period, µs.
        period_us: u32,
        timing: Box<CycleTiming>,
        /// What would hold.
        next: String,
    },
    /// No period up to the longest one can be kept.
    #[error("no control period holds here: {timing}; the longest one is {} ms\n  {granted}", f64::from(*.longest_us) * 1e-3, timing = .timing, granted = .timing.granted)]
    None { longest_us: u32, timing: Box<CycleTiming> },
    #[error(transparent)]
    NoGains(#[from] NoGains),
}

impl NoPeriod {
    /// What to do.
    #[must_use]
    pub fn next(&self) -> Option<String> {
        Some(match self {
            Self::TooShort { next, .. } => format!("{next}; nothing has moved"),
            Self::None { .. } => "end what else \
         runs on this machine, or let a controller of its own close the loop (`cubectl throw --controller NODE-ID`); \
         nothing has moved".to_owned(),
            Self::NoGains(error) => return error.next(),
        })
    }
}

/// Bits of one joint in a control cycle, stuff bits included. At 1 Mbit/s six joints fit into 3 ms, seven do not.
pub(super) const CYCLE_BITS: u32 = 450;

/// The shortest period with gains that come with the program in which `cycle` fits; at least `least_us`.
#[must_use]
pub fn period_for(cycle: Duration, least_us: u32) -> u32 {
    let fits = PERIODS_US.into_iter().find(|us| u64::from(*us) >= cycle.as_micros());
    least_us.max(fits.unwrap_or(PERIOD_MAX_US))
}

/// Decides. `usual_us` is the least period of the settings, used in virtual time.
pub fn choose(
    wish: PeriodRequest,
    timing: Option<&CycleTiming>,
    robot: &RobotModel,
    usual_us: u32,
) -> Result<Choice, NoPeriod> {
    let holds =
        |period_us: u32| timing.is_none_or(|timing| timing.holds(Duration::from_micros(period_us.into())));
    let too_short = |period_us: u32, timing: &CycleTiming| NoPeriod::TooShort {
        period_us,
        timing: Box::new(timing.clone()),
        next: advice(timing),
    };
    let (period_us, why) = match (wish, timing) {
        (PeriodRequest::Gains(gains), timing) => {
            let period_us = (gains.period_s * 1e6).round() as u32;
            if let Some(timing) = timing.filter(|_| !holds(period_us)) {
                return Err(too_short(period_us, timing));
            }
            return Ok(Choice { period_us, gains: *gains, gains_from: GainsFrom::Given, why: "given" });
        }
        (PeriodRequest::Period(period_us), Some(timing)) if !holds(period_us) => {
            return Err(too_short(period_us, timing));
        }
        (PeriodRequest::Period(period_us), _) => (period_us, "given"),
        (PeriodRequest::Any, None) => {
            let bits = CYCLE_BITS * robot.n() as u32;
            (period_for(Duration::from_micros(bits.into()), usual_us), "virtual time")
        }
        (PeriodRequest::Any, Some(timing)) => {
            let comfortable = |us: &u32| timing.comfortable() <= Duration::from_micros((*us).into());
            // Without a comfortable one the longest, if it holds.
            let chosen = PERIODS_US.iter().copied().find(comfortable).or(PERIODS_US.last().copied());
            let period_us = chosen.filter(|us| holds(*us)).ok_or_else(|| NoPeriod::None {
                longest_us: PERIODS_US.last().copied().unwrap_or(PERIOD_MAX_US),
                timing: Box::new(timing.clone()),
            })?;
            (period_us, "measured")
        }
    };
    let (gains, gains_from) = gains_for(robot, period_us)?;
    Ok(Choice { period_us, gains, gains_from, why })
}

/// What could be kept instead, with the option for it.
fn advice(timing: &CycleTiming) -> String {
    let shortest_us = timing.shortest().as_micros();
    if let Some(us) = PERIODS_US.into_iter().find(|us| u64::from(*us) >= shortest_us) {
        let ms = us / 1_000;
        return format!(
            "{ms} ms would hold: `--period-ms {ms}`, or leave the period out to let it be chosen"
        );
    }
    // Whole milliseconds, with a fifth of room.
    let us = (shortest_us * 6 / 5).div_ceil(1_000) * 1_000;
    match u32::try_from(us).ok().filter(|us| *us <= PERIOD_MAX_US) {
        Some(us) => format!(
            "{} ms would hold: `cubectl tune --period-ms {} --out gains.toml`, then `--gains gains.toml`",
            us / 1_000,
            us / 1_000
        ),
        None => format!(
            "no control period up to {} ms, the longest one, would hold: end what else runs on this machine, or let a \
             controller of its own close the loop (`cubectl throw --controller NODE-ID`)",
            PERIOD_MAX_US / 1_000
        ),
    }
}

/// The shortest period that has gains and in which a cycle of `robot` fits on the bus of `setup`, µs; at least that of `settings`. For
/// virtual time, where nothing is measured.
#[must_use]
pub fn usual_us(robot: &RobotModel, setup: &SimSetup, settings: &Settings) -> u32 {
    period_for(setup.cycle(robot.n()), settings.cycle_period_us)
}

/// Settings for `robot` with gains for it and the usual period on the bus of `setup`. If its file has too little data to design gains, there
/// are none, and a controller cannot be armed.
pub fn settings_with_gains(robot: &RobotModel, setup: &SimSetup) -> Result<Settings, NoSettings> {
    let mut settings = settings_of(robot)?;
    if let Ok(choice) = choose(PeriodRequest::Any, None, robot, usual_us(robot, setup, &settings)) {
        apply(&choice, &mut settings);
    }
    Ok(settings)
}

/// Sets the control period, the period of the gains, and the deadline for replies that follows from it.
pub fn set_period(settings: &mut Settings, period_us: u32) {
    settings.cycle_period_us = period_us;
    settings.gains_period_us = period_us;
    settings.reply_deadline_us = (period_us * 2 / 3).clamp(500, 20_000);
}

/// Applies the choice to a controller of this program: its period, the deadlines that follow from it, the gains
/// with the estimator and the certificate that they were proven for, and the largest start distance that the
/// certificate covers.
pub fn apply(choice: &Choice, settings: &mut Settings) {
    set_period(settings, choice.period_us);
    let gains = &choice.gains;
    gains.enter(settings.limits_robot_crc32, settings);
    for tuned in &gains.joint {
        let Some(index) = tuned.number.checked_sub(1).and_then(|n| JointIndex::new(n).ok()) else { continue };
        let joint = settings.joint.at_mut(index);
        let tolerance_rad = tuned.problem.error_position_rad as f32;
        joint.start_tolerance_rad = joint.start_tolerance_rad.min(tolerance_rad);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use firmware::registers;

    fn robot() -> RobotModel {
        RobotModel::load("powercube6").unwrap()
    }

    fn any(timing: &CycleTiming) -> Result<Choice, NoPeriod> {
        choose(PeriodRequest::Any, Some(timing), &robot(), 3_000)
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
            let choice = any(&CycleTiming::that_needs(needs_us)).unwrap();
            assert_eq!((choice.period_us, choice.why), (chosen_us, "measured"), "{needs_us}");
            assert_eq!((choice.gains.period_s * 1e6).round() as u32, chosen_us);
        }
        assert!(matches!(
            any(&CycleTiming::that_needs(30_100)),
            Err(NoPeriod::None { longest_us: 30_000, .. })
        ));
    }

    #[test]
    fn a_period_that_is_too_short_is_refused_with_the_measured_duration_and_a_period_that_fits() {
        let timing = CycleTiming::that_needs(4_800);
        let error = choose(PeriodRequest::Period(3_000), Some(&timing), &robot(), 3_000).unwrap_err();
        let text = format!("{error} {}", error.next().unwrap());
        for part in
            ["3 ms does not hold", "4.0 ms at worst", "5 ms would hold", "--period-ms 5", "nothing has moved"]
        {
            assert!(text.contains(part), "{part}: {text}");
        }
        let gains = gains_for(&robot(), 3_000).unwrap().0;
        assert!(
            choose(PeriodRequest::Gains(Box::new(gains.clone())), Some(&timing), &robot(), 3_000).is_err()
        );
        let choice = choose(PeriodRequest::Gains(Box::new(gains)), None, &robot(), 3_000).unwrap();
        assert_eq!((choice.period_us, choice.why), (3_000, "given"));
        assert!(matches!(
            choose(PeriodRequest::Period(4_000), None, &robot(), 3_000),
            Err(NoPeriod::NoGains(_))
        ));
    }

    #[test]
    fn in_virtual_time_the_usual_period_is_kept() {
        let choice = choose(PeriodRequest::Any, None, &robot(), 3_000).unwrap();
        assert_eq!((choice.period_us, choice.why), (3_000, "virtual time"));
    }

    #[test]
    fn the_settings_of_a_choice_pass_their_own_check() {
        for us in PERIODS_US {
            let choice = choose(PeriodRequest::Period(us), None, &robot(), 3_000).unwrap();
            let mut settings = Settings::powercube6();
            apply(&choice, &mut settings);
            assert_eq!(settings.check(), Ok(()), "{us}");
            assert_eq!(settings.gains_certificate_crc32, registers::certificate_crc32(&settings), "{us}");
            assert_eq!((settings.cycle_period_us, settings.gains_period_us), (us, us));
        }
    }

    #[test]
    fn a_controller_takes_the_gains_of_a_choice_through_its_registers() {
        for us in PERIODS_US {
            let choice = choose(PeriodRequest::Period(us), None, &robot(), 3_000).unwrap();
            let (mut wanted, mut written) = (Settings::powercube6(), Settings::powercube6());
            apply(&choice, &mut wanted);
            for name in ["joint.k_error_1_s2", "joint.k_rate_1_s", "joint.k_last"] {
                let index = registers::find(&wanted, name).unwrap();
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

    #[test]
    fn no_advice_names_a_period_that_a_controller_does_not_take() {
        let register = registers::find(&Settings::BUILT_IN, "cycle.period_us").unwrap();
        for needs_us in (500..200_000).step_by(500) {
            let timing = CycleTiming::that_needs(needs_us);
            for wish in [PeriodRequest::Any, PeriodRequest::Period(3_000), PeriodRequest::Period(30_000)] {
                let Err(refused) = choose(wish, Some(&timing), &robot(), 3_000) else { continue };
                let text = refused.next().unwrap();
                let named = text.split(" ms would hold").next().unwrap().parse::<f64>();
                let option =
                    text.split("--period-ms ").nth(1).map(|rest| rest.split([' ', '`']).next().unwrap());
                let Ok(ms) = named else {
                    assert!(option.is_none(), "{needs_us}: {text}");
                    continue;
                };
                let us = (ms * 1e3).round() as u32;
                assert!(u64::from(us) >= timing.shortest().as_micros(), "{needs_us}: {text}");
                let number = registers::Number::Natural32(us);
                let mut settings = Settings::powercube6();
                assert_eq!(registers::write(&mut settings, register, &[number]), Ok(()), "{text}");
            }
        }
    }
}
