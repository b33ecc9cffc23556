//! What the controller asks before it moves anything, and while nothing may move.

use protocol::powercube::{CubeState, ShortState};
use protocol::{Duration, Instant, JointIndex};

use super::PowerCubes;
use super::words::error_of;
use crate::fault::{Cause, Refusal};
use crate::group::{Readings, Standing};
use crate::rest;
use crate::settings::Settings;

/// Drives take time after a reset; hosts of the field wait 0.2 to 0.5 s.
pub(super) const RESET_SETTLE: Duration = Duration::from_millis(200);
/// State words with MOTION in a row at which a drive counts as moving.
const MOTION_WORDS: u8 = 2;

/// A position of this age is too old: standing drives are asked every second look.
fn rest_age_max(settings: &Settings) -> Duration {
    rest::WINDOW + Duration::from_micros(2 * u64::from(settings.monitor_period_us))
}

/// The same for a state word: every fourth look.
fn word_age_max(settings: &Settings) -> Duration {
    rest::WINDOW + Duration::from_micros(4 * u64::from(settings.monitor_period_us))
}

impl PowerCubes {
    /// True if a joint is measured at rest, and a state word read in that time shows no MOTION.
    pub(super) fn stands(&self, now: Instant, settings: &Settings, joint: JointIndex) -> bool {
        let drive = self.drives.at(joint);
        let Some(since) = drive.rest.since(now, rest_age_max(settings)) else { return false };
        drive.state.is_some_and(|(word, at)| at >= since && !word.intersects(CubeState::MOTION))
    }

    pub(super) fn moves(&self, now: Instant, settings: &Settings, joint: JointIndex) -> bool {
        let drive = self.drives.at(joint);
        let read = drive.state.is_some_and(|(_, at)| now.saturating_since(at) <= word_age_max(settings));
        (read && drive.motion_words > 0) || drive.rest.is_moving(now, rest_age_max(settings))
    }

    pub(super) fn report_of(&self, joint: JointIndex) -> Standing {
        let drive = self.drives.at(joint);
        let word = drive.state.filter(|(_, at)| *at >= self.reset_at);
        Standing {
            cause: word.and_then(|(word, _)| error_of(word)),
            halted: word.is_some_and(|(word, _)| word.intersects(CubeState::HALTED)),
            reports_motion: drive.motion_words >= MOTION_WORDS,
            yields: drive.state.is_some_and(|(word, _)| word.intersects(CubeState::BRAKEACTIVE)),
        }
    }

    pub(super) fn read(&self, joint: JointIndex) -> Readings {
        let (drive, axis) = (self.drives.at(joint), self.axes.at(joint));
        let word = drive.state.map(|(word, _)| word);
        let shows = |bits| word.is_some_and(|word| word.intersects(bits));
        Readings {
            current_a: drive.current_a,
            qdd_command_rad_s2: axis.planned.qdd_rad_s2,
            speed_limited: axis.speed_limited,
            position_limited: axis.position_limited,
            error: shows(CubeState::ERROR),
            halted: shows(CubeState::HALTED),
            missed_in_row: drive.missed_in_row,
            state: word.map(CubeState::bits),
            short_state: drive.short_state.bits(),
        }
    }

    /// A control cycle fits into its period: known before a motion, not found out in it.
    fn require_time(&self, settings: &Settings) -> Result<(), Refusal> {
        // Without a timing check the drives have not been read since they were found; it comes with the next few looks.
        let (_, cycle_us) = self.cycle_times(settings);
        let cycle_us = cycle_us.ok_or(Refusal::of(Cause::DriveNotReady))?;
        if cycle_us <= settings.cycle_period_us {
            return Ok(());
        }
        let period_us = cycle_us.div_ceil(100).saturating_mul(100);
        let index = u16::try_from(period_us).unwrap_or(u16::MAX);
        Err(Refusal { cause: Cause::CycleTooShort, joint: None, index })
    }

    pub(super) fn is_group_ready(&self, now: Instant, settings: &Settings) -> Result<(), Refusal> {
        self.require_time(settings)?;
        if let Some(joint) = settings.joints().find(|&joint| !self.stands(now, settings, joint)) {
            return Err(Refusal::at(Cause::DriveNotReady, joint));
        }
        // A drive that was reset opens its brake first; a motion ordered before begins later than ordered.
        if now < self.reset_at + RESET_SETTLE {
            return Err(Refusal::of(Cause::DriveNotReady));
        }
        Ok(())
    }

    pub(super) fn is_drive_ready(
        &self,
        now: Instant,
        settings: &Settings,
        joint: JointIndex,
    ) -> Result<(), Refusal> {
        let drive = self.drives.at(joint);
        let not_ready = Err(Refusal::at(Cause::DriveNotReady, joint));
        let Some((state, at)) = drive.state else { return not_ready };
        let bad = CubeState::ERROR.union(CubeState::HALTED).union(CubeState::MOTION);
        // Four things are read in turn, so nothing is older than four periods and a few.
        let age_max = Duration::from_micros(8 * u64::from(settings.monitor_period_us));
        let stale = at < self.reset_at || now.saturating_since(at) > age_max;
        if stale || state.intersects(bad) || drive.missed_in_row > 0 {
            return not_ready;
        }
        if !state.contains(CubeState::HOME_OK) {
            return Err(Refusal::at(Cause::NotHomed, joint));
        }
        if !self.holds_settings(settings, joint) {
            return not_ready;
        }
        let Some(position) = drive.position else { return not_ready };
        let old = position.at < self.reset_at || now.saturating_since(position.at) > age_max;
        if old || drive.short_state.intersects(ShortState::NOT_OK) { not_ready } else { Ok(()) }
    }
}

#[cfg(test)]
mod tests {
    use super::super::drives::DriveRecord;
    use super::*;
    use crate::group::PositionSample;

    const JOINT: usize = 3;

    fn ms(ms: u64) -> Instant {
        Instant::from_micros(1_000 * ms)
    }

    /// A group that was reset a second ago and stands, at 2 s; each drive was read 10 ms ago.
    fn standing() -> (PowerCubes, Settings, JointIndex) {
        let settings = Settings::powercube6();
        let mut group = PowerCubes { reset_at: ms(1_000), ..PowerCubes::default() };
        for joint in settings.joints() {
            let drive = group.drives.at_mut(joint);
            drive.state = Some((CubeState::HOME_OK, ms(1_990)));
            drive.max_cur_a = Some(settings.joint.at(joint).current_max_a);
            for at in [1_900, 1_940, 1_990] {
                let sample = PositionSample { q_rad: 0.5, at: ms(at) };
                drive.position = Some(sample);
                drive.rest.take(sample);
            }
        }
        (group, settings, JointIndex::new(JOINT).unwrap())
    }

    #[test]
    fn drive_is_fit_to_move_only_if_each_of_its_readings_is_new_and_good() {
        let age_us = 8 * u64::from(standing().1.monitor_period_us);
        let read_ago = |us: u64| Instant::from_micros(2_000_000 - us);
        let with_word = |word: CubeState| {
            move |drive: &mut DriveRecord| drive.state = Some((CubeState::HOME_OK.union(word), ms(1_990)))
        };
        let word_at =
            |at: Instant| move |drive: &mut DriveRecord| drive.state = Some((CubeState::HOME_OK, at));
        let position_at = |at: Instant| {
            move |drive: &mut DriveRecord| drive.position = Some(PositionSample { q_rad: 0.5, at })
        };
        type Spoil<'a> = (&'a str, Box<dyn Fn(&mut DriveRecord)>, Option<Cause>);
        let cases: [Spoil<'_>; 18] = [
            ("as it is", Box::new(|_| ()), None),
            ("word never read", Box::new(|drive| drive.state = None), Some(Cause::DriveNotReady)),
            ("word just new enough", Box::new(word_at(read_ago(age_us))), None),
            ("word too old", Box::new(word_at(read_ago(age_us + 1))), Some(Cause::DriveNotReady)),
            ("word at the reset", Box::new(word_at(ms(1_000))), Some(Cause::DriveNotReady)),
            ("error", Box::new(with_word(CubeState::ERROR)), Some(Cause::DriveNotReady)),
            ("halted", Box::new(with_word(CubeState::HALTED)), Some(Cause::DriveNotReady)),
            ("in motion", Box::new(with_word(CubeState::MOTION)), Some(Cause::DriveNotReady)),
            ("brake", Box::new(with_word(CubeState::BRAKEACTIVE)), None),
            ("an answer missed", Box::new(|drive| drive.missed_in_row = 1), Some(Cause::DriveNotReady)),
            (
                "not homed",
                Box::new(|drive| drive.state = Some((CubeState::from_bits(0), ms(1_990)))),
                Some(Cause::NotHomed),
            ),
            ("current limit unknown", Box::new(|drive| drive.max_cur_a = None), Some(Cause::DriveNotReady)),
            (
                "current limit of a jog",
                Box::new(|drive| drive.max_cur_a = Some(1.0)),
                Some(Cause::DriveNotReady),
            ),
            ("no position", Box::new(|drive| drive.position = None), Some(Cause::DriveNotReady)),
            ("position just new enough", Box::new(position_at(read_ago(age_us))), None),
            ("position too old", Box::new(position_at(read_ago(age_us + 1))), Some(Cause::DriveNotReady)),
            ("position at the reset", Box::new(position_at(ms(1_000))), Some(Cause::DriveNotReady)),
            (
                "short state not ok",
                Box::new(|drive| drive.short_state = ShortState::NOT_OK),
                Some(Cause::DriveNotReady),
            ),
        ];
        for (name, spoil, expected) in cases {
            let (mut group, settings, joint) = standing();
            spoil(group.drives.at_mut(joint));
            let refused = group.is_drive_ready(ms(2_000), &settings, joint).err();
            assert_eq!(refused.map(|refusal| refusal.cause), expected, "{name}");
            assert!(refused.is_none_or(|refusal| refusal.joint == Some(joint)), "{name}");
        }
    }

    /// Values that were read before the last reset do not count, however new they are.
    #[test]
    fn readings_from_before_the_reset_make_no_drive_fit() {
        for word_is_old in [true, false] {
            let (mut group, settings, joint) = standing();
            group.reset_at = ms(1_985);
            let drive = group.drives.at_mut(joint);
            let (old, new) = (ms(1_984), ms(1_986));
            let (word_at, position_at) = if word_is_old { (old, new) } else { (new, old) };
            drive.state = Some((CubeState::HOME_OK, word_at));
            drive.position = Some(PositionSample { q_rad: 0.5, at: position_at });
            let refused = group.is_drive_ready(ms(2_000), &settings, joint).unwrap_err();
            assert_eq!(refused, Refusal::at(Cause::DriveNotReady, joint));
            group.reset_at = old;
            assert_eq!(group.is_drive_ready(ms(2_000), &settings, joint), Ok(()));
        }
    }

    #[test]
    fn group_whose_cycle_was_not_timed_or_does_not_fit_its_period_is_not_ready() {
        let (group, settings, _) = standing();
        assert_eq!(group.require_time(&settings), Err(Refusal::of(Cause::DriveNotReady)));
        assert_eq!(group.is_group_ready(ms(2_000), &settings), Err(Refusal::of(Cause::DriveNotReady)));
    }
}
