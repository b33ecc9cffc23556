//! Effect of the network on telegrams: delay, jitter, and faults. Sans-IO: a runner sends and fetches bytes.

use protocol::{Duration, Instant};

use crate::rng::Rng;

/// Most telegrams under way; more are lost, as a full queue of a switch loses them.
const MAX_UNDER_WAY: usize = 1024;

/// Which way a telegram goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Direction {
    ToClient,
    ToRobot,
}

/// What happens to a telegram.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LinkFaultKind {
    Lost,
    /// It arrives later by this much.
    Late(Duration),
    Doubled,
    /// It arrives after the next one of its direction.
    Reordered,
    /// Only its first half arrives.
    Torn,
    /// Its IPOC is changed by this much.
    WrongIpoc(i64),
    /// It arrives without the actual axes (`AIPos`).
    WithoutAxes,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinkFault {
    pub kind: LinkFaultKind,
    pub direction: Direction,
    /// From this time on.
    pub from: Instant,
    /// Until this time (excluded).
    pub until: Instant,
    /// How likely for each telegram.
    pub probability: f64,
}

/// Delay of the network without faults.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LinkOptions {
    /// Delay of every telegram.
    pub delay: Duration,
    /// Up to this much is added, evenly distributed.
    pub jitter: Duration,
    /// TCP: telegrams of one direction stay in order, so a late one holds up those behind it.
    pub in_order: bool,
}

#[derive(Clone, Debug)]
struct UnderWay {
    due: Instant,
    number: u64,
    direction: Direction,
    bytes: Vec<u8>,
}

/// The network between controller and client.
#[derive(Clone, Debug)]
pub struct DatagramLink {
    options: LinkOptions,
    faults: Vec<(LinkFault, Rng, u64)>,
    jitter: Rng,
    under_way: Vec<UnderWay>,
    held: [Option<Vec<u8>>; 2],
    last_due: [Instant; 2],
    number: u64,
    overflowed: u64,
}

impl DatagramLink {
    /// An empty network; each fault has its own random stream.
    pub fn new(options: LinkOptions, faults: &[LinkFault], seed: u64) -> Self {
        let stream = |(index, fault): (usize, &LinkFault)| {
            (*fault, Rng::stream(seed, &format!("krc link fault {index}")), 0)
        };
        Self {
            options,
            faults: faults.iter().enumerate().map(stream).collect(),
            jitter: Rng::stream(seed, "krc link jitter"),
            under_way: Vec::new(),
            held: [None, None],
            last_due: [Instant::ZERO; 2],
            number: 0,
            overflowed: 0,
        }
    }

    pub fn send(&mut self, now: Instant, direction: Direction, mut bytes: Vec<u8>) {
        let jitter = self.jitter.within(0, self.options.jitter.as_micros());
        let mut delay = self.options.delay + Duration::from_micros(jitter);
        let (mut copies, mut hold) = (1, false);
        for (fault, rng, count) in &mut self.faults {
            let applies = fault.direction == direction && (fault.from..fault.until).contains(&now);
            if !applies || !rng.chance(fault.probability) {
                continue;
            }
            *count += 1;
            match fault.kind {
                LinkFaultKind::Lost => copies = 0,
                LinkFaultKind::Late(by) => delay += by,
                LinkFaultKind::Doubled => copies *= 2,
                LinkFaultKind::Reordered => hold = true,
                LinkFaultKind::Torn => bytes.truncate(bytes.len() / 2),
                LinkFaultKind::WrongIpoc(by) => bytes = with_other_ipoc(&bytes, by),
                LinkFaultKind::WithoutAxes => bytes = without_axes(bytes),
            }
        }
        let due = now + delay;
        let slot = usize::from(direction == Direction::ToRobot);
        let overtaken = self.held.get_mut(slot).and_then(Option::take);
        if hold && copies > 0 {
            if let Some(held) = self.held.get_mut(slot) {
                *held = Some(bytes);
            }
        } else {
            for _ in 0..copies {
                self.put(due, direction, bytes.clone());
            }
        }
        if let Some(bytes) = overtaken {
            self.put(due, direction, bytes);
        }
    }

    fn put(&mut self, due: Instant, direction: Direction, bytes: Vec<u8>) {
        if self.under_way.len() == MAX_UNDER_WAY {
            self.overflowed += 1;
            return;
        }
        let last = &mut self.last_due[usize::from(direction == Direction::ToRobot)];
        let due = if self.options.in_order { due.max(*last) } else { due };
        *last = due.max(*last);
        self.number += 1;
        self.under_way.push(UnderWay { due, number: self.number, direction, bytes });
    }

    /// When the next telegram arrives.
    pub fn poll_timeout(&self) -> Option<Instant> {
        self.under_way.iter().map(|telegram| telegram.due).min()
    }

    /// The next telegram that has arrived by `now`.
    pub fn poll(&mut self, now: Instant) -> Option<(Direction, Vec<u8>)> {
        let next =
            self.under_way.iter().enumerate().min_by_key(|(_, telegram)| (telegram.due, telegram.number));
        let place = next.filter(|(_, telegram)| telegram.due <= now).map(|(place, _)| place)?;
        let telegram = self.under_way.swap_remove(place);
        Some((telegram.direction, telegram.bytes))
    }

    /// Forgets what is under way: the socket was closed.
    pub fn clear(&mut self) {
        self.under_way.clear();
        self.held = [None, None];
    }

    /// How often each fault struck, in the order they were given.
    pub fn counts(&self) -> Vec<u64> {
        self.faults.iter().map(|(_, _, count)| *count).collect()
    }

    /// Telegrams lost because too many were under way.
    pub fn overflowed(&self) -> u64 {
        self.overflowed
    }
}

/// The document with another IPOC; unchanged if it has no IPOC.
fn with_other_ipoc(bytes: &[u8], by: i64) -> Vec<u8> {
    let changed = std::str::from_utf8(bytes).ok().and_then(|text| {
        let (before, rest) = text.split_once("<IPOC>")?;
        let (number, after) = rest.split_once("</IPOC>")?;
        let number = number.trim().parse::<u64>().ok()?.wrapping_add_signed(by);
        Some(format!("{before}<IPOC>{number}</IPOC>{after}").into_bytes())
    });
    changed.unwrap_or_else(|| bytes.to_vec())
}

/// The document without its element `AIPos`; unchanged if it has no such element.
fn without_axes(bytes: Vec<u8>) -> Vec<u8> {
    let changed = std::str::from_utf8(&bytes).ok().and_then(|text| {
        let (before, rest) = text.split_once("<AIPos")?;
        let (_, after) = rest.split_once("/>")?;
        Some(format!("{before}{after}").into_bytes())
    });
    changed.unwrap_or(bytes)
}
