//! Doors of a world in real time, without sockets: links that live in memory.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex};

use can_link::{Clock, Event, Link, LinkError, LinkStats, PollSet, SendError};
use hil_sim::bus::BusConfig;
use hil_sim::crew::Solo;
use hil_sim::realtime::{Door, Gateway, Realtime, RealtimeError};
use protocol::{Duration, Frame, Instant, StandardId};

/// The far end of a link in memory.
#[derive(Default)]
struct Wire {
    to_world: VecDeque<Frame>,
    from_world: Vec<Frame>,
    broken: bool,
}

#[derive(Clone, Default)]
struct Memory(Arc<Mutex<Wire>>);

impl Memory {
    fn door(&self) -> Door {
        Door::Member(Box::new(self.clone()))
    }

    fn heard(&self) -> Vec<u32> {
        self.0.lock().unwrap().from_world.iter().map(|frame| frame.id().raw()).collect()
    }
}

impl Link for Memory {
    fn name(&self) -> &str {
        "memory"
    }

    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        self.0.lock().unwrap().from_world.push(*frame);
        Ok(())
    }

    fn receive(&mut self) -> Result<Option<Event>, LinkError> {
        let mut wire = self.0.lock().unwrap();
        if wire.broken {
            return Err(LinkError::Closed { link: "memory".to_owned() });
        }
        let frame = wire.to_world.pop_front();
        Ok(frame.map(|frame| Event::Frame { at: Instant::ZERO, stamp: None, frame }))
    }

    fn register<'a>(&'a self, _: &mut PollSet<'a>) {}

    fn stats(&self) -> LinkStats {
        LinkStats::default()
    }
}

fn world(doors: &[Memory], bit_rate_bit_s: u32) -> Realtime<Vec<Solo<Gateway>>> {
    let config = BusConfig { bit_rate_bit_s, ..BusConfig::default() };
    let doors = doors.iter().map(Memory::door).collect();
    Realtime::new(Vec::new(), config, 0, Vec::new(), doors, Clock::start()).unwrap()
}

fn burst(base: u16) -> Vec<Frame> {
    (0..20).map(|n| Frame::from_array(StandardId::new(base + n).unwrap(), [0x55; 8])).collect()
}

/// Turns until `done`.
fn run(realtime: &mut Realtime<Vec<Solo<Gateway>>>, done: impl Fn() -> bool) {
    let end = Instant::ZERO + Duration::from_secs(30);
    while !done() {
        assert!(realtime.world().now() < end, "the world hangs");
        realtime.turn(end, &mut ()).unwrap();
    }
}

#[test]
fn doors_arbitrate_against_each_other_by_identifier() {
    let (weak, strong, ear) = (Memory::default(), Memory::default(), Memory::default());
    weak.0.lock().unwrap().to_world.extend(burst(0x700));
    strong.0.lock().unwrap().to_world.extend(burst(0x100));
    // 11 ms a frame: long after the first weak one has started, all strong ones are waiting.
    let mut realtime = world(&[weak, strong, ear.clone()], 10_000);
    run(&mut realtime, || ear.heard().len() == 40);
    let expected: Vec<u32> = [0x700].into_iter().chain(0x100..0x114).chain(0x701..0x714).collect();
    assert_eq!(ear.heard(), expected);
}

#[test]
fn more_frames_than_the_backlog_wait_at_the_door_and_none_is_lost() {
    let (sender, ear) = (Memory::default(), Memory::default());
    let flood = burst(0x200).into_iter().cycle().take(3_000);
    sender.0.lock().unwrap().to_world.extend(flood.clone());
    let mut realtime = world(&[sender, ear.clone()], 1_000_000);
    run(&mut realtime, || ear.heard().len() == 3_000);
    assert_eq!(ear.heard(), flood.map(|frame| frame.id().raw()).collect::<Vec<_>>());
    let report = realtime.world().bus_report();
    assert!(report.nodes[0].queue_peak <= 1_024 && report.nodes[0].dropped == 0, "{report}");
    assert_eq!(realtime.lost(), 0);
}

#[test]
fn joined_bus_that_goes_away_ends_the_run() {
    let (gone, other) = (Memory::default(), Memory::default());
    let mut realtime = world(&[other, gone.clone()], 1_000_000);
    realtime.turn(Instant::ZERO, &mut ()).unwrap();
    gone.0.lock().unwrap().broken = true;
    let error = realtime.turn(Instant::ZERO, &mut ()).unwrap_err();
    assert!(matches!(error, RealtimeError::Link(_)), "{error}");
}
