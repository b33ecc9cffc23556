//! A cell behind a socketcand port of this process, in real time, and the program that is tested.
//!
//! Other processes and other machines on the same computer hold a test up now and then. What happens on the wire is then
//! not what the test is about: [`in_real_time`] measures that, and asks again.
#![allow(dead_code, reason = "each test file uses its own part")]

use std::process::{Command, Output};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use can_link::{Clock, Link, Relay, ServerEvent, ServerOptions, wait};
use hil_sim::bus::BusConfig;
use hil_sim::crew::{Crew, Solo};
use hil_sim::{Cell, CellOptions, World};
use protocol::{Duration, Frame, Instant, Node};
use robot_model::AnyRobot;

/// Stands for all clients on the simulated bus.
#[derive(Default)]
struct Gateway {
    out: std::collections::VecDeque<Frame>,
    received: Vec<Frame>,
}

impl Node for Gateway {
    fn handle_frame(&mut self, _: Instant, frame: &Frame) {
        self.received.push(*frame);
    }
    fn handle_timeout(&mut self, _: Instant) {}
    fn poll_frame(&mut self) -> Option<Frame> {
        self.out.pop_front()
    }
    fn poll_timeout(&self) -> Option<Instant> {
        None
    }
}

/// A served cell; ends when dropped.
pub(crate) struct Served {
    pub(crate) spec: String,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Served {
    /// Serves what `make` builds; it is built in the serving thread.
    pub(crate) fn new<C: Crew + 'static>(make: impl FnOnce() -> C + Send + 'static) -> Self {
        let clock = Clock::start();
        let options = ServerOptions { relay: Relay::ByOwner, ..ServerOptions::default() };
        let mut server =
            can_link::socketcand::Server::listen("127.0.0.1", 0, "can0", clock, options).unwrap();
        let spec = format!("socketcand://{}/can0", server.local_addr());
        let stop = Arc::new(AtomicBool::new(false));
        let flag = Arc::clone(&stop);
        let thread = std::thread::spawn(move || {
            let crew = (make(), Solo::new("clients", Gateway::default()));
            let mut world = World::new(crew, BusConfig::default(), 1, Vec::new()).unwrap();
            while !flag.load(Ordering::Relaxed) {
                while let Some(event) = server.next_event() {
                    if let ServerEvent::Frame { frame, .. } = event {
                        world.with_crew(|crew, _| crew.1.node.out.push_back(frame)).unwrap();
                    }
                }
                let now = clock.now().max(world.now());
                world.run_until(now, &mut ()).unwrap();
                let frames = world.with_crew(|crew, _| std::mem::take(&mut crew.1.node.received)).unwrap();
                for frame in frames {
                    server.broadcast(now, &frame, None);
                }
                let nap = clock.now() + Duration::from_millis(1);
                wait(&[&server as &dyn Link], &clock, Some(nap)).unwrap();
            }
        });
        Self { spec, stop, thread: Some(thread) }
    }

    /// The arm of six.
    pub(crate) fn arm(options: CellOptions) -> Self {
        Self::new(move || Cell::new(&AnyRobot::load("powercube6").unwrap(), &options, 1).unwrap())
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap();
        }
    }
}

/// Runs `cubectl` with these words.
pub(crate) fn cubectl(words: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_cubectl")).args(words).output().unwrap()
}

pub(crate) fn out(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

pub(crate) fn err(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

pub(crate) fn code(output: &Output) -> i32 {
    output.status.code().unwrap()
}

/// From here on a failure is one of the program's, ms: clients wait longer for answers.
const HELD_UP_MS: u128 = 20;
/// Waits before the next try, s.
const PAUSES_S: [u64; 5] = [1, 3, 9, 27, 27];

/// Runs a check that needs real time. If it fails while the machine was held up, that proves nothing: it is tried again
/// after a pause, five times. A failure on a machine that kept time is one at once.
pub(crate) fn in_real_time(check: impl Fn() + std::panic::RefUnwindSafe) {
    for pause_s in PAUSES_S {
        let done = Arc::new(AtomicBool::new(false));
        let watch = std::thread::spawn({
            let done = Arc::clone(&done);
            move || {
                let mut longest_ms = 0;
                while !done.load(Ordering::Relaxed) {
                    let from = std::time::Instant::now();
                    std::thread::sleep(std::time::Duration::from_millis(1));
                    longest_ms = longest_ms.max(from.elapsed().as_millis());
                }
                longest_ms
            }
        });
        let outcome = std::panic::catch_unwind(&check);
        done.store(true, Ordering::Relaxed);
        let longest_ms = watch.join().unwrap();
        match outcome {
            Ok(()) => return,
            Err(panic) if longest_ms < HELD_UP_MS => std::panic::resume_unwind(panic),
            Err(_) => println!("this machine was held up for {longest_ms} ms: again in {pause_s} s"),
        }
        std::thread::sleep(std::time::Duration::from_secs(pause_s));
    }
    check();
}

/// A fresh folder that is removed when dropped.
pub(crate) struct Folder(pub(crate) std::path::PathBuf);

impl Folder {
    pub(crate) fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("cubectl-{name}-{}", std::process::id()));
        // What a try before left.
        let _ = std::fs::remove_dir_all(&path);
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    pub(crate) fn file(&self, name: &str) -> String {
        self.0.join(name).to_str().unwrap().to_owned()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}
