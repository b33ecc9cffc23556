//! Tiny nodes with known behaviour, to run the world without drives.

use std::collections::VecDeque;

use protocol::{Duration, Frame, Instant, Node};

/// Sends a frame every period.
#[derive(Clone, Debug)]
pub(crate) struct Beacon {
    pub(crate) frame: Frame,
    pub(crate) period: Duration,
    pub(crate) next: Instant,
    pub(crate) heard: Vec<(Instant, Frame)>,
    out: VecDeque<Frame>,
}

impl Beacon {
    pub(crate) fn new(frame: Frame, first_us: u64, period_us: u64) -> Self {
        Self {
            frame,
            period: Duration::from_micros(period_us),
            next: Instant::from_micros(first_us),
            heard: Vec::new(),
            out: VecDeque::new(),
        }
    }
}

impl Node for Beacon {
    fn handle_frame(&mut self, now: Instant, frame: &Frame) {
        self.heard.push((now, *frame));
    }

    fn handle_timeout(&mut self, now: Instant) {
        if now >= self.next {
            self.next += self.period;
            self.out.push_back(self.frame);
        }
    }

    fn poll_frame(&mut self) -> Option<Frame> {
        self.out.pop_front()
    }

    fn poll_timeout(&self) -> Option<Instant> {
        Some(self.next)
    }
}

/// Answers each frame of one id with another after a fixed delay.
#[derive(Clone, Debug)]
pub(crate) struct Responder {
    pub(crate) request: u32,
    pub(crate) answer: Frame,
    pub(crate) delay: Duration,
    pub(crate) due: VecDeque<Instant>,
    out: VecDeque<Frame>,
}

impl Responder {
    pub(crate) fn new(request: u32, answer: Frame, delay_us: u64) -> Self {
        Self {
            request,
            answer,
            delay: Duration::from_micros(delay_us),
            due: VecDeque::new(),
            out: VecDeque::new(),
        }
    }
}

impl Node for Responder {
    fn handle_frame(&mut self, now: Instant, frame: &Frame) {
        if frame.id().raw() == self.request {
            self.due.push_back(now + self.delay);
        }
    }

    fn handle_timeout(&mut self, now: Instant) {
        while self.due.front().is_some_and(|due| *due <= now) {
            self.due.pop_front();
            self.out.push_back(self.answer);
        }
    }

    fn poll_frame(&mut self) -> Option<Frame> {
        self.out.pop_front()
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.due.front().copied()
    }
}

/// Breaks the contract: its deadline never moves.
#[derive(Clone, Debug)]
pub(crate) struct Stuck;

impl Node for Stuck {
    fn handle_frame(&mut self, _: Instant, _: &Frame) {}
    fn handle_timeout(&mut self, _: Instant) {}
    fn poll_frame(&mut self) -> Option<Frame> {
        None
    }
    fn poll_timeout(&self) -> Option<Instant> {
        Some(Instant::from_micros(5))
    }
}

/// Breaks the contract: this number of deadlines has come, and each call serves only one.
#[derive(Clone, Debug)]
pub(crate) struct TwoAtOnce(pub(crate) u32);

impl Node for TwoAtOnce {
    fn handle_frame(&mut self, _: Instant, _: &Frame) {}
    fn handle_timeout(&mut self, _: Instant) {
        self.0 = self.0.saturating_sub(1);
    }
    fn poll_frame(&mut self) -> Option<Frame> {
        None
    }
    fn poll_timeout(&self) -> Option<Instant> {
        (self.0 > 0).then_some(Instant::from_micros(5))
    }
}

/// Breaks the contract: never runs out of frames.
#[derive(Clone, Debug)]
pub(crate) struct Fountain(pub(crate) Frame);

impl Node for Fountain {
    fn handle_frame(&mut self, _: Instant, _: &Frame) {}
    fn handle_timeout(&mut self, _: Instant) {}
    fn poll_frame(&mut self) -> Option<Frame> {
        Some(self.0)
    }
    fn poll_timeout(&self) -> Option<Instant> {
        None
    }
}
