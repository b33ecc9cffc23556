//! Numbered causes of faults, of stops and of refusals. The numbers go over the wire and never change their
//! meaning; a number that is no longer used stays free.
//!
//! | band | about |
//! |---|---|
//! | 1..=99 | stops that are no fault |
//! | 100..=199 | drives on the bus: silent, refusing, answering nonsense |
//! | 200..=299 | what a drive reports about itself |
//! | 300..=399 | limits, of what is commanded and of what is measured |
//! | 400..=499 | supervision: host, timing |
//! | 500..=599 | start-up, homing, settings, storage |
//! | 600..=699 | a trajectory file was refused |
//! | 700..=799 | an order was refused |

use protocol::JointIndex;

/// What the group does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Reaction {
    /// Nothing moves and nothing stops: an order, a file or a register write was refused.
    Refuse,
    /// Ramp down along the path, then halt broadcast.
    PathStop,
    /// Every joint brakes on its own as hard as allowed, then halt broadcast.
    QuickStop,
    /// Halt broadcast at once.
    Halt,
}

/// Row of the table, for `explain`.
#[derive(Clone, Copy, Debug)]
pub struct CauseInfo {
    /// The cause.
    pub cause: Cause,
    /// Number on the wire.
    pub code: u16,
    /// Name in the code, for logs and searches.
    pub name: &'static str,
    /// What the group does.
    pub reaction: Reaction,
    /// What happened.
    pub what: &'static str,
    /// What to do.
    pub recovery: &'static str,
}

macro_rules! causes {
    ($($code:literal $name:ident $reaction:ident $what:literal, $recovery:literal;)*) => {
        /// Why the group stopped, faulted or refused.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
        #[repr(u16)]
        pub enum Cause {
            $(#[doc = concat!($what, ".")] $name = $code,)*
        }

        impl Cause {
            /// All causes in ascending order of the number.
            pub const TABLE: &[CauseInfo] = &[$(CauseInfo {
                cause: Self::$name,
                code: $code,
                name: stringify!($name),
                reaction: Reaction::$reaction,
                what: $what,
                recovery: $recovery,
            },)*];

            /// The cause with this number on the wire.
            pub const fn from_code(code: u16) -> Option<Self> {
                match code {
                    $($code => Some(Self::$name),)*
                    _ => None,
                }
            }

            /// Name in the code. Unlike the table's texts it costs a board little flash.
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$name => stringify!($name),)*
                }
            }

            /// [`Self::name`] of a cause that can be latched. Empty for a refusal: a board need not store its name.
            pub const fn latched_name(self) -> &'static str {
                match self {
                    $(Self::$name if !matches!(Reaction::$reaction, Reaction::Refuse) => stringify!($name),)*
                    _ => "",
                }
            }

            /// What the group does.
            pub const fn reaction(self) -> Reaction {
                match self {
                    $(Self::$name => Reaction::$reaction,)*
                }
            }
        }
    };
}

causes! {
    1 StopOrdered PathStop "a stop was ordered", "arm again when it is clear why";
    2 StopMessage Halt "a stop message was on the bus", "remove its reason, then arm again";
    3 JogReleased PathStop "the jog order was not repeated", "none needed";

    100 DriveMissing Halt "a drive did not answer during start-up", "check power, cable, address and bit rate of the drive; clear the fault to search again";
    101 DriveSilent QuickStop "a drive missed more replies in a row than allowed", "check the cable and supply of the drive; look at the bus load and error counters";
    102 DriveRefused QuickStop "a drive did not accept a parameter or a motion", "read the drive's state word and limits: its own limits may be narrower than the settings";
    103 ReplyImplausible QuickStop "positions from a drive jumped farther than it can move", "check the encoder, and that no two drives share an address";
    104 PositionFrozen QuickStop "positions from a drive stand still although its commands move it", "look whether the joint moved: if not, free it; if it did, its encoder or the drive's electronics hang: switch it off and on";
    105 MotionReversed QuickStop "positions from a drive run against its commands", "check the direction of the encoder and the sign in the settings";
    106 PositionJumped QuickStop "positions from a drive jumped away from where its commands lead", "check the encoder and the clamping of the joint; home the group again";
    107 MotionNotFollowed QuickStop "positions from a drive do not follow its commands", "free the joint, check load, current limit and supply; look for another controller";
    108 MovesUnordered Halt "a joint was measured moving without an order to move", "look for another controller or a person at the arm; read the drive's state word; clear the fault when the arm stands";
    109 GripperUnanswered PathStop "the module with the gripper's output did not answer its writes", "look at the gripper: it may be open or closed; check the module and its address, then clear the fault";

    200 DriveError QuickStop "a drive reports an error or is halted while it should move", "read the drive's state word; clear the fault when its cause is gone";
    201 DriveTowError QuickStop "a drive's following error was too large", "less acceleration or load, free the joint, check the drive's own limit";
    202 DriveWatchdog Halt "a drive's watchdog has expired", "the controller or the bus was held up: look at the bus load and the late cycles";
    203 DrivePowerFault Halt "a drive's power stage reports a fault", "switch the drive off and on; check temperature, supply and motor cable";
    204 DriveSupply QuickStop "a drive's motor voltage is out of range", "check the supply and the contactor";
    205 DriveHardLimit Halt "a drive has passed its hard limit", "move it back by the maker's procedure";
    206 DriveSoftLimit QuickStop "a drive has passed its own soft limit", "clear the fault and jog it back";
    207 DriveLostHome QuickStop "a drive that had found its zero has lost it", "home the group again";
    208 DriveAltered PathStop "a drive's current limit or configuration is not the one that was written to it", "find the node that writes to the drives; clear the fault to write them again";
    209 DriveSettingsDiffer Halt "a drive's ids, ranges, mode, time-out or bit rate are not those of the settings", "read the drive's registers: nothing on the wire shows a wrong range; correct the drive or the settings, then clear the fault";

    300 PositionLimit QuickStop "a joint was measured outside its soft limits", "jog it back; check the plan and the gains";
    301 VelocityLimit QuickStop "a joint was measured faster than allowed", "check the plan, the gains and the drive's parameters";
    302 FollowingError QuickStop "a joint is too far from its reference", "check load and gains; start from the planned position";
    303 OverCurrent QuickStop "a drive's current stayed above the limit", "free the joint; check the load";
    304 NearLimit QuickStop "a command had to be turned into braking before a soft limit", "check the plan's distance to the limits";

    400 HostLost PathStop "the host's heartbeat stayed away", "start the host again; check its load and the bus load";
    401 CycleOverrun QuickStop "control cycles could not be finished in time, several in a row", "longer period, fewer other frames on the bus, or a quieter computer";
    402 RestNotReached Halt "a joint was not measured at rest in time after a motion or a stop", "look whether the arm stands; read the drive's state word and position; clear the fault when it does";
    403 HaltedByOther Halt "another node sent a halt broadcast while the group moved", "find out who stopped the drives and why, then clear the fault";
    404 AnswersLate PathStop "the robot counted too many late answers during a run", "look at the load of the computer and the network; clear the fault and arm again";
    405 RobotLags PathStop "the axes stay away from where their set points lead", "identify lag and dead time again; look at load and overrides of the robot";
    406 RobotRestarted Halt "the robot began a new program run, or its connection was lost for long", "look at the pendant for the cause; clear the fault to take the new start pose";
    407 PathRanDry PathStop "the next segment of the plan did not come in time", "look at the load of the host and of the bus; clear the fault, go back to the start of the path";

    500 WatchdogUnproven Halt "a drive's watchdog did not stop it when it was tested", "check the drive's configuration word; a drive without watchdog must not be run";
    501 HomingTimeout Halt "a joint did not find its zero in time", "check the home switch and the direction of homing";
    502 HomingFailed Halt "a drive reported an error during homing", "read the drive's state word";
    503 FirmwareTooOld Halt "a drive's firmware cannot report position with its state", "use a drive with firmware 0x2518 to 0x2FFF, or 0x3518 and newer";
    504 SettingsInvalid Refuse "a value is out of range or does not go with the others", "look at the register's range; limits must be in order";
    505 StorageFailed Refuse "permanent storage could not be written or read back", "try again; replace the board if it stays";
    506 DuplicateAddress Refuse "two joints have the same drive address", "give each joint its own address";

    600 FileIncomplete Refuse "the file in the upload bank is not as long as the order says", "upload it again";
    601 FileTooLong Refuse "the file is longer than the bank", "fewer knots";
    602 FileChecksum Refuse "a checksum of the file is wrong", "upload it again";
    603 FileVersion Refuse "not a trajectory file of a version this controller reads", "make it with a host of the same version";
    604 FileJoints Refuse "the file is for another number of joints", "plan for this robot";
    605 FileKnots Refuse "the file has too few or too many knots, or its length does not fit their number", "at least two knots, at most 256 (seven joints 221, eight 195)";
    606 FileNumbers Refuse "the file has a number that is not finite", "plan again";
    607 FileTime Refuse "knot times do not grow by at least the shortest segment, the plan is too long, or one that goes on with segments is too short", "at least 2 ms per segment; before the first segment comes, as long as a stop along the path may take";
    608 FileEnds Refuse "the plan does not begin and end at rest", "first and last knot with zero velocity";
    609 PlanPosition Refuse "the plan leaves the soft limits of a joint", "plan within the limits";
    610 PlanVelocity Refuse "the plan is faster than a joint may be", "plan with lower speed";
    611 PlanAcceleration Refuse "the plan uses more acceleration than a joint may", "plan with lower acceleration";
    612 FileRelease Refuse "an event of the plan, such as the release, is not within it", "events between start and end";
    613 FilePeriod Refuse "the plan was checked for another control period", "plan and tune for the period in the register";
    614 FileOtherRobot Refuse "the plan is for another robot", "plan with the robot file whose checksum is in the register";
    615 UploadOutOfOrder Refuse "a piece of the file does not continue the last one", "start again at offset 0";
    616 BankBusy Refuse "the trajectory cannot be changed now", "wait until the motion has ended, disarm";
    617 FileEvent Refuse "the file has more events than fit, or one that this controller does not know", "at most 8 events; use a controller of the same version";
    618 FileEnvelope Refuse "the envelope for new end states is empty, or wider than the limits of a joint less the control reserve", "at most 95 % of speed and acceleration, and a millimetre of arc inside the soft limits";
    619 UploadOfOther Refuse "the upload belongs to another node; a write of any other one voids it", "one host at a time: upload the whole file again, from offset 0";

    700 OrderNotNow Refuse "the order is not allowed in the present state", "look at the state";
    701 TokenWrong Refuse "the arming token is not the one offered, or has expired", "ask for a new offer";
    702 NoTrajectory Refuse "no trajectory is committed", "upload and commit one";
    703 OtherTrajectory Refuse "another trajectory is committed than the order names", "commit that one, or name this one";
    704 NotHomed Refuse "a joint has not found its zero", "home the group";
    705 NotAtStart Refuse "a joint is not where the plan begins", "move there first";
    706 GainPeriod Refuse "the gains were designed for another period", "write gains for this period";
    707 NoHost Refuse "no host heartbeat is seen", "the host must send heartbeats before and during a motion";
    708 OtherFault Refuse "another fault is latched than the order names", "read the latched fault first";
    709 JointUnknown Refuse "no such joint", "joints count from 0";
    710 BadValue Refuse "a value of the order is out of range", "see the order's description";
    711 DriveNotReady Refuse "a drive is silent, in error or halted, or has not taken the current limit of the settings yet", "look at the drive; clear the fault";
    712 GripperBusy Refuse "the gripper cannot be operated during a run", "the release is part of the plan";
    713 CycleTooShort Refuse "the drives' answers of a cycle do not fit into the control period; the index is the period that would do, in us", "tune and plan for that period, or set the drives to answer faster";
    714 StillMoving Refuse "a joint still moves", "wait until the arm stands";
    715 OtherHost Refuse "another node holds the session: it asked for an offer to arm, armed the group, or moves it", "wait until it has ended, or disarm (any node may), then begin again";
    716 GainsUncertified Refuse "the gains have no certificate, or theirs is about other gains, weights, limits of acceleration, lags or robots than those in force", "tune for this robot and period, then write the gains with their certificate, last";
    717 GainsOtherRobot Refuse "the gains were designed for another robot than the one of the plan", "tune for the robot of the plan, or plan for the robot of the gains";
    718 LimitCeiling Refuse "the limit is wider than the limit of the robot that the controller was started for", "stay within it, or unlock the limits by naming the robot's checksum";
    719 WrongRobot Refuse "the unlock names another robot than the one whose limits are in force", "read register limits.robot_crc32";
    720 CodeMissing Refuse "the controller has a key, and the order came without an authentication code", "name the key file";
    721 CodeWrong Refuse "the authentication code does not fit the key, the challenge, the node, the order, or the file and the settings that it is about, or came too late", "look at the key file and for other nodes that upload or write registers; upload and arm again";
    722 NoKey Refuse "an authentication code was given, but the controller has no key", "set a key, or leave the key file out";
    723 StartPassed Refuse "the start time of the run has passed, or is nearer than the drives need", "read the controller's clock and order a later start";
    724 StartTooFar Refuse "the start time of the run is more than 30 s ahead", "order the run later, or an earlier start";
    725 NoEnvelope Refuse "the trajectory that runs has no envelope: no new end states are taken", "upload one with an envelope";
    726 TargetTooSoon Refuse "the new end state is to be reached sooner than anything can still change", "aim at least 20 ms past the set points that the drives have";
    727 TargetTooFar Refuse "the new end state is to be reached more than 10 s from now", "an earlier time";
    728 TargetPosition Refuse "the way to the new end state, or the braking after it, leaves the envelope of a joint", "another end state, a slower one, or a wider envelope";
    729 TargetVelocity Refuse "the way to the new end state needs more speed than the envelope of a joint has", "a nearer end state, or a later time";
    730 TargetAcceleration Refuse "the way to the new end state needs more acceleration than the envelope of a joint has", "a nearer end state, or a later time";
    731 TargetEvent Refuse "an event of the new end state has passed, or comes after its motion", "an event between now and the end of the motion";
    732 GainDelay Refuse "the gains were designed for another delay than the loop has, which acts one period after it measures", "tune with the delay left out, or with a range that ends with the period";
    733 SegmentOther Refuse "the segment is not the one that follows in the plan that was armed", "send the segments of this plan in their order";
    734 SegmentEarly Refuse "there is no room yet for the segment", "send it again when the plan has gone on";
}

impl Cause {
    /// The number on the wire.
    pub const fn code(self) -> u16 {
        self as u16
    }

    /// Row of the table.
    pub fn info(self) -> Option<&'static CauseInfo> {
        Self::TABLE.iter().find(|info| info.cause == self)
    }

    /// True for stops that need no clearing: an order, not a fault.
    pub const fn is_plain_stop(self) -> bool {
        self.code() < 100
    }
}

/// A cause with where it happened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fault {
    /// What happened.
    pub cause: Cause,
    /// Which joint; `None`: the group.
    pub joint: Option<JointIndex>,
}

impl Fault {
    /// Fault of the group.
    pub const fn group(cause: Cause) -> Self {
        Self { cause, joint: None }
    }

    /// Fault of a joint.
    pub const fn at(cause: Cause, joint: JointIndex) -> Self {
        Self { cause, joint: Some(joint) }
    }
}

/// Why an order, a write or a file was refused, with where.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Refusal {
    /// What.
    pub cause: Cause,
    /// Which joint; `None`: no joint in particular.
    pub joint: Option<JointIndex>,
    /// Segment, knot or byte, as the cause says; 0 otherwise.
    pub index: u16,
}

impl Refusal {
    /// Refusal without a joint or a place.
    pub const fn of(cause: Cause) -> Self {
        Self { cause, joint: None, index: 0 }
    }

    /// Refusal about a joint.
    pub const fn at(cause: Cause, joint: JointIndex) -> Self {
        Self { cause, joint: Some(joint), index: 0 }
    }

    /// Refusal about a place in a file.
    pub const fn in_file(cause: Cause, joint: Option<JointIndex>, index: usize) -> Self {
        Self { cause, joint, index: if index > u16::MAX as usize { u16::MAX } else { index as u16 } }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_unique_ascending_and_round_trip() {
        assert!(Cause::TABLE.windows(2).all(|pair| pair[0].code < pair[1].code));
        for info in Cause::TABLE {
            assert_eq!(Cause::from_code(info.code), Some(info.cause));
            assert_eq!((info.cause.code(), info.cause.reaction()), (info.code, info.reaction));
            assert_eq!(info.cause.info().map(|row| row.code), Some(info.code));
        }
        assert_eq!(Cause::from_code(0), None, "0 means no fault on the wire");
    }

    #[test]
    fn bands_hold_what_they_say() {
        for info in Cause::TABLE {
            let refused = info.reaction == Reaction::Refuse;
            assert_eq!(info.cause.latched_name(), if refused { "" } else { info.name });
            assert!(!refused || info.code >= 500, "{} moves nothing but is in a band that stops", info.name);
            assert!(refused || info.code < 600, "{} stops but is in a band of refusals", info.name);
        }
    }

    #[test]
    fn every_text_says_something_and_has_no_full_stop() {
        for info in Cause::TABLE {
            assert!(info.what.len() > 10 && !info.what.ends_with('.'), "{}", info.name);
            assert!(info.recovery.len() >= 10 && !info.recovery.ends_with('.'), "{}", info.name);
        }
    }
}
