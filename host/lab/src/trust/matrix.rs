//! Every kind of fault, in every phase, at every joint, lasting and short.

use hil_sim::fault::{Fault, FaultKind, PhysicalFault, Place, Target, WireFault, WrongPart};
use protocol::{Duration, Frame, Instant, ModuleId, StandardId};

use planner::plan::Arm;

use super::bench::{Bench, Family};
use super::phases::Phase;

/// Length of a short fault.
pub const SHORT: Duration = Duration::from_millis(50);
const SUPPLIES: u8 = 2;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Where {
    Joints,
    Bus,
    Supplies,
    Gripper,
}

/// A kind of fault with its parameters.
#[derive(Clone, Copy, Debug)]
pub struct Variant {
    /// In one word, with the parameter.
    pub name: &'static str,
    kind: Kind,
    acts_on: Where,
    probability: f64,
}

#[derive(Clone, Copy, Debug)]
enum Kind {
    Wire(WireFault),
    Physical(PhysicalFault),
}

const fn wire(name: &'static str, acts_on: Where, kind: WireFault) -> Variant {
    Variant { name, kind: Kind::Wire(kind), acts_on, probability: 1.0 }
}

const fn rare(name: &'static str, acts_on: Where, kind: WireFault, probability: f64) -> Variant {
    Variant { name, kind: Kind::Wire(kind), acts_on, probability }
}

const fn physical(name: &'static str, acts_on: Where, kind: PhysicalFault) -> Variant {
    Variant { name, kind: Kind::Physical(kind), acts_on, probability: 1.0 }
}

const fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

/// The variants of PowerCubes.
fn variants() -> Vec<Variant> {
    use PhysicalFault as P;
    use Where::{Bus, Gripper, Joints, Supplies};
    use WireFault as W;
    let babble = Frame::from_array(StandardId::from_low_bits(0x001), [0; 8]);
    vec![
        wire("drop", Joints, W::Drop),
        rare("drop 30 %", Joints, W::Drop, 0.3),
        rare("drop bus 5 %", Bus, W::Drop, 0.05),
        wire("delay 2 ms", Joints, W::Delay(ms(2))),
        wire("delay 20 ms", Joints, W::Delay(ms(20))),
        wire("duplicate", Joints, W::Duplicate),
        wire("duplicate bus", Bus, W::Duplicate),
        wire("corrupt", Joints, W::Corrupt),
        rare("corrupt bus 5 %", Bus, W::Corrupt, 0.05),
        wire("wrong value", Joints, W::WrongAnswer(WrongPart::Value)),
        rare("wrong value 5 %", Joints, W::WrongAnswer(WrongPart::Value), 0.05),
        wire("wrong parameter", Joints, W::WrongAnswer(WrongPart::Parameter)),
        wire("wrong command", Joints, W::WrongAnswer(WrongPart::Command)),
        wire("wrong length", Joints, W::WrongAnswer(WrongPart::Length)),
        wire("silent", Joints, W::Silent),
        wire("intermittent", Joints, W::Intermittent { on_mean: ms(20), off_mean: ms(5) }),
        wire("bus-off", Joints, W::BusOff),
        wire("stuck bus", Bus, W::StuckDominant),
        wire("babble", Bus, W::Babble { frame: babble, period: Duration::from_micros(200) }),
        physical("stuck", Joints, P::Frozen),
        physical("slow 1 ms", Joints, P::Slow(ms(1))),
        physical("slow 20 ms", Joints, P::Slow(ms(20))),
        physical("restart", Joints, P::Restart),
        physical("over-current", Joints, P::OverCurrent),
        physical("tow-error", Joints, P::Blocked),
        physical("hall-error", Joints, P::HallError),
        physical(
            "encoder 5 deg",
            Joints,
            P::EncoderOffset { offset_rad: 5.0 * std::f64::consts::PI / 180.0 },
        ),
        physical("encoder 90 deg", Joints, P::EncoderOffset { offset_rad: std::f64::consts::FRAC_PI_2 }),
        physical("supply-loss", Supplies, P::SupplyLoss { remaining: 0.0 }),
        physical("supply-loss 60 %", Supplies, P::SupplyLoss { remaining: 0.6 }),
        physical("stuck-gripper", Gripper, P::StuckGripper),
        physical("late-release 10 ms", Gripper, P::LateRelease(ms(10))),
        physical("late-release 300 ms", Gripper, P::LateRelease(ms(300))),
    ]
}

#[derive(Clone, Debug)]
pub struct Entry {
    pub variant: &'static str,
    pub phase: Phase,
    /// The fault; its start is that of the phase.
    pub fault: Fault,
}

impl Variant {
    /// Whether drives of this family have it: lost counts, an axis that is held, hall sensors, slow answers and supplies are simulated for
    /// PowerCubes only.
    fn is_of(&self, family: Family) -> bool {
        use PhysicalFault as P;
        family == Family::PowerCube
            || match self.kind {
                Kind::Wire(_) => true,
                Kind::Physical(fault) => {
                    matches!(
                        fault,
                        P::Frozen | P::Restart | P::OverCurrent | P::StuckGripper | P::LateRelease(_)
                    )
                }
            }
    }

    /// The faults of this variant at each of its places, from `start` on.
    fn faults(&self, arm: &Arm, start: Instant, length: Option<Duration>) -> Vec<Fault> {
        let modules = arm.addresses().unwrap_or_default();
        let module = |n: u8| ModuleId::new(n).ok();
        let places: Vec<(Target, Option<Place>)> = match self.acts_on {
            Where::Bus => vec![(Target::Bus, None)],
            Where::Joints => modules
                .into_iter()
                .filter_map(module)
                .map(|module| (Target::Module(module), Some(Place::Module(module))))
                .collect(),
            Where::Supplies => (0..SUPPLIES).map(|n| (Target::Supply(n), Some(Place::Supply(n)))).collect(),
            Where::Gripper => vec![(Target::Gripper, Some(Place::Gripper))],
        };
        places
            .into_iter()
            .filter_map(|(target, place)| {
                let kind = match (self.kind, place) {
                    (Kind::Wire(wire), _) => FaultKind::Wire(wire),
                    (Kind::Physical(fault), Some(place)) => FaultKind::Physical(place, fault),
                    (Kind::Physical(_), None) => return None,
                };
                Some(Fault {
                    label: format!("{} {target}", self.name),
                    kind,
                    target,
                    filter: None,
                    start,
                    at: None,
                    length,
                    every: None,
                    probability: self.probability,
                })
            })
            .collect()
    }
}

/// All runs of a bench; `at` gives the instant of each phase.
pub fn entries(bench: &Bench, at: impl Fn(Phase) -> Option<Instant>) -> Vec<Entry> {
    let mut all = Vec::new();
    for variant in variants().into_iter().filter(|variant| variant.is_of(bench.family)) {
        for (phase, start) in Phase::ALL.into_iter().filter_map(|phase| Some((phase, at(phase)?))) {
            for length in [None, Some(SHORT)] {
                let faults = variant.faults(&bench.arm, start, length);
                all.extend(faults.into_iter().map(|fault| Entry { variant: variant.name, phase, fault }));
            }
        }
    }
    all
}
