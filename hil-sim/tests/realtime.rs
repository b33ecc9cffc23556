//! Endpoints (ports) of a world in real time, with links in memory and a clock that the test moves; one with sockets.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex};

use can_link::{
    BusServer, BusSpec, CanLink, ClientId, Clock, LinkError, LinkEvent, LinkStats, PollSet, SendError,
    ServerEvent,
};
use hil_sim::Observer;
use hil_sim::bus::BusConfig;
use hil_sim::participants::Solo;
use hil_sim::realtime::{Endpoint, Gateway, Realtime, RealtimeError, Visit};
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
    fn endpoint(&self) -> Endpoint {
        Endpoint::Member(Box::new(self.clone()))
    }

    fn heard(&self) -> Vec<u32> {
        self.0.lock().unwrap().from_world.iter().map(|frame| frame.id().raw()).collect()
    }
}

impl CanLink for Memory {
    fn name(&self) -> &str {
        "memory"
    }

    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        self.0.lock().unwrap().from_world.push(*frame);
        Ok(())
    }

    fn receive(&mut self) -> Result<Option<LinkEvent>, LinkError> {
        let mut wire = self.0.lock().unwrap();
        if wire.broken {
            return Err(LinkError::Closed { link: "memory".to_owned() });
        }
        let frame = wire.to_world.pop_front();
        Ok(frame.map(|frame| LinkEvent::Frame { at: Instant::ZERO, stamp: None, frame }))
    }

    fn register<'a>(&'a self, _: &mut PollSet<'a>) {}

    fn stats(&self) -> LinkStats {
        LinkStats::default()
    }
}

fn world(endpoints: &[Memory], bit_rate_bit_s: u32) -> Realtime<Vec<Solo<Gateway>>> {
    let config = BusConfig { bit_rate_bit_s, ..BusConfig::default() };
    let endpoints = endpoints.iter().map(Memory::endpoint).collect();
    Realtime::new(Vec::new(), config, 0, Vec::new(), endpoints, Clock::manual()).unwrap()
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
fn endpoints_arbitrate_against_each_other_by_identifier() {
    let (weak, strong, ear) = (Memory::default(), Memory::default(), Memory::default());
    weak.0.lock().unwrap().to_world.extend(burst(0x700));
    // 11 ms a frame: the first weak one has started when the strong ones come.
    let mut realtime = world(&[weak, strong.clone(), ear.clone()], 10_000);
    while realtime.world().now() < Instant::from_micros(1_000) {
        realtime.turn(Instant::from_micros(1_000), &mut ()).unwrap();
    }
    strong.0.lock().unwrap().to_world.extend(burst(0x100));
    run(&mut realtime, || ear.heard().len() == 40);
    let expected: Vec<u32> = [0x700].into_iter().chain(0x100..0x114).chain(0x701..0x714).collect();
    assert_eq!(ear.heard(), expected);
}

#[test]
fn more_frames_than_the_backlog_wait_at_the_endpoint_and_no_frame_is_lost() {
    let (sender, ear) = (Memory::default(), Memory::default());
    let flood = burst(0x200).into_iter().cycle().take(3_000);
    sender.0.lock().unwrap().to_world.extend(flood.clone());
    let mut realtime = world(&[sender, ear.clone()], 1_000_000);
    run(&mut realtime, || ear.heard().len() == 3_000);
    assert_eq!(ear.heard(), flood.map(|frame| frame.id().raw()).collect::<Vec<_>>());
    let report = realtime.world().bus_report();
    assert_eq!((report.nodes[0].queue_peak, report.nodes[0].dropped), (2, 0), "{report}");
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

/// Counts the frames on the bus and the calls of the world.
#[derive(Default)]
struct Count {
    /// Identifiers with their times, in order.
    frames: Vec<(Instant, u32)>,
}

impl Observer for Count {
    fn on_frame(&mut self, at: Instant, _: Option<usize>, frame: &Frame) {
        self.frames.push((at, frame.id().raw()));
    }
}

/// A server in memory: client 0 always has another frame, the others have those they were given.
struct Crowd {
    given: Vec<VecDeque<Frame>>,
    next: usize,
    looks: Arc<Mutex<u64>>,
}

const FLOOD_ID: u32 = 0x7FF;

impl BusServer for Crowd {
    fn next_event(&mut self) -> Option<ServerEvent> {
        self.next_event_from(&mut |_| true)
    }

    fn next_event_from(&mut self, has_room: &mut dyn FnMut(ClientId) -> bool) -> Option<ServerEvent> {
        *self.looks.lock().unwrap() += 1;
        for step in 0..self.given.len() {
            let index = (self.next + step) % self.given.len();
            let client = ClientId::from_number(index as u64);
            if index == 0 {
                self.given[0]
                    .push_back(Frame::from_array(StandardId::new(FLOOD_ID as u16).unwrap(), [0x55; 8]));
            }
            if has_room(client)
                && let Some(frame) = self.given[index].pop_front()
            {
                self.next = index + 1;
                return Some(ServerEvent::Frame { client, at: Instant::ZERO, frame });
            }
        }
        None
    }

    fn broadcast(&mut self, _: Instant, _: &Frame, _: Option<ClientId>) {}

    fn send_to(&mut self, _: ClientId, _: Instant, _: &Frame) {}

    fn give_turn(&mut self, _: ClientId, _: Instant, _: &[(Instant, Frame)]) {}

    fn broadcast_bus_error(&mut self, _: Instant, _: u32) {}

    fn client_count(&self) -> usize {
        self.given.len()
    }
}

impl CanLink for Crowd {
    fn name(&self) -> &str {
        "crowd"
    }

    fn send(&mut self, _: &Frame) -> Result<(), SendError> {
        Ok(())
    }

    fn receive(&mut self) -> Result<Option<LinkEvent>, LinkError> {
        Ok(None)
    }

    fn register<'a>(&'a self, _: &mut PollSet<'a>) {}

    fn stats(&self) -> LinkStats {
        LinkStats::default()
    }
}

fn flooded(endpoints: Vec<Endpoint>) -> Realtime<Vec<Solo<Gateway>>> {
    Realtime::new(Vec::new(), BusConfig::default(), 0, Vec::new(), endpoints, Clock::manual()).unwrap()
}

#[test]
fn a_client_that_floods_at_a_lower_priority_costs_another_one_frame_at_the_start_and_no_more() {
    let looks = Arc::default();
    let quiet: VecDeque<Frame> = burst(0x400).into();
    let crowd = Crowd { given: vec![VecDeque::new(), quiet], next: 0, looks };
    // A node must acknowledge.
    let endpoints = vec![Endpoint::Server(Box::new(crowd)), Memory::default().endpoint()];
    let mut realtime = flooded(endpoints);
    let (mut count, end) = (Count::default(), Instant::from_micros(100_000));
    while realtime.world().now() < end {
        realtime.turn(end, &mut count).unwrap();
    }
    let places: Vec<usize> =
        (0..count.frames.len()).filter(|index| count.frames[*index].1 != FLOOD_ID).collect();
    assert_eq!(places.len(), 20);
    // At first the flood alone was there: one of its frames is on its way.
    assert!(places[0] <= 1, "{places:?}");
    // From then on no other frame comes between.
    assert!(places.windows(2).all(|pair| pair[1] - pair[0] == 1), "{places:?}");
    // All the time of the bus is used: a frame of 8 bytes takes 111 to 135 us.
    assert!((740..=900).contains(&count.frames.len()), "{}", count.frames.len());
}

#[test]
fn turns_of_a_flooded_world_are_at_most_two_for_each_frame() {
    let looks = Arc::<Mutex<u64>>::default();
    let crowd = Crowd { given: vec![VecDeque::new()], next: 0, looks: Arc::clone(&looks) };
    let member = Memory::default();
    member.0.lock().unwrap().to_world.extend(burst(0x500).into_iter().cycle().take(100_000));
    let endpoints = vec![Endpoint::Server(Box::new(crowd)), member.endpoint()];
    let mut realtime = flooded(endpoints);
    let (mut count, end) = (Count::default(), Instant::from_micros(1_000_000));
    let mut turns = 0;
    while realtime.world().now() < end {
        realtime.turn(end, &mut count).unwrap();
        turns += 1;
    }
    let frames = count.frames.len();
    assert!((7_400..=9_000).contains(&frames), "{frames}");
    assert!((frames..=2 * frames + 16).contains(&turns), "{turns} turns for {frames} frames");
    // Each turn reads until nothing more can be taken: one read more than frames. Some frames still wait in the end.
    let looks = *looks.lock().unwrap() as usize;
    assert!((turns..=turns + frames + 64 + 2).contains(&looks), "{looks} looks in {turns} turns");
}

#[test]
fn an_endpoint_of_classical_can_on_a_bus_with_can_fd_ends_with_its_name_before_anything_runs() {
    let config = BusConfig { data_bit_rate_bit_s: Some(5_000_000), ..BusConfig::default() };
    let (memory, clock) = (Memory::default(), Clock::manual());
    let mut realtime =
        Realtime::new(Vec::<Solo<Gateway>>::new(), config, 0, Vec::new(), vec![memory.endpoint()], clock)
            .unwrap();
    memory.0.lock().unwrap().to_world.extend(burst(0x100));
    let error = realtime.turn(Instant::from_micros(1_000), &mut ()).unwrap_err();
    let RealtimeError::Link(LinkError::ClassicalOnly { link, .. }) = &error else { panic!("{error}") };
    assert_eq!(link, "memory");
    assert!(error.next().unwrap().contains("data_bit_rate_bit_s"));
    assert_eq!((realtime.world().now(), memory.heard()), (Instant::ZERO, Vec::new()));
}

#[test]
fn a_client_has_a_turn_when_it_asks_for_lock_step_and_not_when_it_connects() {
    let spec: BusSpec = "lockstep://127.0.0.1:0/can0".parse().unwrap();
    let endpoint = Endpoint::open(&spec, Clock::manual()).unwrap();
    let spec: BusSpec = endpoint.name().parse().unwrap();
    let mut realtime = flooded(vec![endpoint]).in_lock_step(2);
    let mut visits_of = |count: usize| {
        let mut visits = Vec::new();
        while visits.len() < count {
            realtime.turn(Instant::FAR_FUTURE, &mut ()).unwrap();
            visits.extend(realtime.visits());
        }
        visits
    };
    let address = spec.to_string();
    let address = address.trim_start_matches("lockstep://").trim_end_matches("/can0");
    let _connected = std::net::TcpStream::connect(address).unwrap();
    assert!(matches!(visits_of(1)[..], [Visit::Joined(_)]));
    let later = std::thread::spawn(move || can_link::open(&spec, spec.clock()).map(|_| ()));
    assert!(matches!(visits_of(2)[..], [Visit::Joined(_), Visit::InStep(1), ..]));
    later.join().unwrap().unwrap();
}
