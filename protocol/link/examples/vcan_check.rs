//! The SocketCAN link against a real kernel: run by `.ci/vcan-vm`, as root, where `ip` and the module
//! `vcan` are at hand and no interface is up yet.
//!
//! A program and not a test, because it makes and removes interfaces of the machine it runs on.

#[cfg(target_os = "linux")]
fn main() {
    linux::run();
}

#[cfg(not(target_os = "linux"))]
fn main() {}

#[cfg(target_os = "linux")]
mod linux {
    use std::process::Command;
    use std::sync::atomic::AtomicBool;

    use can_link::{
        BusSpec, CanLink, Cause, Clock, LinkError, LinkEvent, OpenError, Runner, SendError, SocketCan, open,
        wait,
    };
    use protocol::{Duration, ExtendedId, FdFlags, Frame, Instant, Node, StandardId};
    use socketcan::{CanErrorFrame, CanSocket, Socket};

    const BURST: u32 = 20_000;

    pub(super) fn run() {
        check("a missing interface is named, with the command that makes it", missing);
        ip("link add vcan0 type vcan");
        check("an interface that is down is named, with the command that brings it up", down);
        ip("link set vcan0 mtu 16");
        ip("link set vcan0 up");
        check("the spec opens the interface", by_spec);
        check("a classical interface refuses CAN FD with the command that helps", classical_only);
        ip("link set vcan0 down");
        ip("link set vcan0 mtu 72");
        ip("link set vcan0 up");
        check("frames of every kind cross, in order, not back to their sender", all_kinds);
        check("arrivals are between sending and now and never decrease", stamps);
        check("a burst beyond every queue arrives whole and in order", burst);
        check("error frames arrive decoded", error_frames);
        check("two runners keep a node's time on the bus", runners);
        check("an interface that goes down ends the link with the command that helps", goes_down);
        println!("all checks passed");
    }

    fn check(name: &str, work: fn()) {
        print!("{name} … ");
        work();
        println!("ok");
    }

    fn ip(arguments: &str) {
        let status = Command::new("ip").args(arguments.split(' ')).status().expect("ip runs");
        assert!(status.success(), "ip {arguments}");
    }

    fn vcan0(clock: Clock) -> SocketCan {
        SocketCan::open("vcan0", clock).unwrap()
    }

    fn missing() {
        let error = SocketCan::open("vcan0", Clock::start()).map(|_| ()).unwrap_err();
        let OpenError::NoInterface { command, .. } = &error else { panic!("{error}") };
        assert!(command.contains("ip link add vcan0 type vcan"), "{error}");
    }

    fn down() {
        let error = SocketCan::open("vcan0", Clock::start()).map(|_| ()).unwrap_err();
        let OpenError::InterfaceDown { command, .. } = &error else { panic!("{error}") };
        assert_eq!(command, "sudo ip link set vcan0 up");
    }

    fn by_spec() {
        let spec: BusSpec = "vcan0".parse().unwrap();
        assert_eq!(open(&spec, Clock::start()).unwrap().name(), "vcan0");
    }

    fn classical_only() {
        let error = vcan0(Clock::start()).send(&samples()[6]).unwrap_err();
        let SendError::Link(LinkError::ClassicalOnly { advice, .. }) = &error else { panic!("{error}") };
        assert!(advice.contains("sudo ip link set vcan0 mtu 72 up"), "{error}");
        let error = open(&"vcan0".parse().unwrap(), Clock::start()).unwrap().takes_fd().unwrap_err();
        assert!(error.next().unwrap().contains("mtu 72 up"), "{error}");
    }

    fn samples() -> [Frame; 9] {
        [
            Frame::from_array(StandardId::new(0x0A5).unwrap(), [0x08, 0x4F, 0x64]),
            Frame::from_array(StandardId::MAX, []),
            Frame::from_array(ExtendedId::new(0x7F).unwrap(), [0xFF; 8]),
            Frame::from_array(ExtendedId::MAX, [1]),
            Frame::remote(StandardId::new(0x123).unwrap(), 4).unwrap(),
            Frame::remote(ExtendedId::ZERO, 0).unwrap(),
            Frame::from_array(StandardId::new(1).unwrap(), [0xFF; 8]).with_fd(FdFlags::BRS),
            Frame::new_fd(ExtendedId::MAX, FdFlags { brs: true, esi: true }, &[0xA5; 64]).unwrap(),
            Frame::new_fd(StandardId::MAX, FdFlags::default(), &[1; 12]).unwrap(),
        ]
    }

    /// The next event within a second.
    fn next(link: &mut SocketCan, clock: &Clock) -> LinkEvent {
        let until = clock.now() + Duration::from_secs(1);
        loop {
            if let Some(event) = link.receive().unwrap() {
                return event;
            }
            assert!(clock.now() < until, "nothing arrives");
            wait(&[&*link], clock, Some(until)).unwrap();
        }
    }

    fn all_kinds() {
        let clock = Clock::start();
        let (mut a, mut b) = (vcan0(clock), vcan0(clock));
        for forth in [true, false] {
            let (sender, receiver) = if forth { (&mut a, &mut b) } else { (&mut b, &mut a) };
            for frame in samples() {
                sender.send(&frame).unwrap();
            }
            for expected in samples() {
                let LinkEvent::Frame { frame, .. } = next(receiver, &clock) else { panic!("no frame") };
                assert_eq!(frame, expected);
            }
            assert_eq!(sender.receive().unwrap(), None, "a sender does not hear itself");
        }
        assert_eq!((a.stats().frames_out, a.stats().frames_in), (9, 9));
    }

    fn stamps() {
        let clock = Clock::start();
        let (mut a, mut b) = (vcan0(clock), vcan0(clock));
        let (before, mut last) = (clock.now(), Instant::ZERO);
        for _ in 0..100 {
            a.send(&samples()[0]).unwrap();
        }
        for _ in 0..100 {
            let LinkEvent::Frame { at, stamp: Some(stamp), .. } = next(&mut b, &clock) else {
                panic!("no stamp")
            };
            // The kernel's clock is read at another moment than ours: allow a tenth of a second.
            assert!(at + Duration::from_millis(100) >= before && at <= clock.now() && at >= last);
            assert!(stamp.as_micros().abs_diff(clock.to_unix(at).as_micros()) < 100_000);
            last = at;
        }
    }

    fn burst() {
        let clock = Clock::start();
        let (mut a, mut b) = (vcan0(clock), vcan0(clock));
        let (mut sent, mut received) = (0, 0);
        while received < BURST {
            while sent < BURST && sent < received + 200 {
                let id = ExtendedId::from_low_bits(sent);
                match a.send(&Frame::from_array(id, sent.to_be_bytes())) {
                    Ok(()) => sent += 1,
                    Err(SendError::QueueFull { .. }) => break,
                    Err(error) => panic!("{error}"),
                }
            }
            assert_eq!(a.receive().unwrap(), None);
            while let Some(event) = b.receive().unwrap() {
                let LinkEvent::Frame { frame, .. } = event else { panic!("{event:?}") };
                assert_eq!(frame.id().raw(), received);
                received += 1;
            }
        }
        assert!(clock.now() < Instant::from_micros(30_000_000));
        print!("({} frames/s) ", u64::from(BURST) * 1_000_000 / clock.now().as_micros());
    }

    fn error_frames() {
        let clock = Clock::start();
        let mut link = vcan0(clock);
        let raw = CanSocket::open("vcan0").unwrap();
        // Bus-off with a passive transmitter, as a controller reports it.
        let frame = CanErrorFrame::new_error(0x44, &[0, 0x20, 0, 0, 0, 0, 0, 0]).unwrap();
        raw.write_frame(&frame).unwrap();
        let LinkEvent::BusError { error, .. } = next(&mut link, &clock) else { panic!("no error") };
        assert_eq!(error.causes().collect::<Vec<_>>(), [Cause::BusOff, Cause::ErrorPassive]);
    }

    /// Sends a frame every two milliseconds, or answers every frame.
    struct Player {
        due: Option<Instant>,
        frame: Option<Frame>,
        heard: u32,
    }

    impl Node for Player {
        fn handle_frame(&mut self, _: Instant, frame: &Frame) {
            self.heard += 1;
            if self.due.is_none() {
                self.frame = Some(*frame);
            }
        }
        fn handle_timeout(&mut self, now: Instant) {
            if self.due.is_some_and(|due| due <= now) {
                self.due = Some(now + Duration::from_millis(2));
                self.frame = Some(samples()[0]);
            }
        }
        fn poll_frame(&mut self) -> Option<Frame> {
            self.frame.take()
        }
        fn poll_timeout(&self) -> Option<Instant> {
            self.due
        }
    }

    fn runners() {
        let clock = Clock::start();
        let until = Some(clock.now() + Duration::from_millis(500));
        let mut metronome = Player { due: Some(Instant::ZERO), frame: None, heard: 0 };
        let echo = std::thread::spawn(move || {
            let (mut link, mut echo) = (vcan0(clock), Player { due: None, frame: None, heard: 0 });
            Runner::new(&mut link, clock).run(&mut [&mut echo], &AtomicBool::new(false), until).unwrap();
            echo.heard
        });
        let mut link = vcan0(clock);
        let mut runner = Runner::new(&mut link, clock);
        runner.run(&mut [&mut metronome], &AtomicBool::new(false), until).unwrap();
        let sent = runner.stats().sent;
        let heard = echo.join().unwrap();
        assert!(heard > 20 && metronome.heard > 20, "{heard} and {} of {sent}", metronome.heard);
        print!("(late {}) ", runner.stats().deadlines);
    }

    fn goes_down() {
        let clock = Clock::start();
        let mut link = vcan0(clock);
        ip("link set vcan0 down");
        let until = clock.now() + Duration::from_secs(2);
        let error = loop {
            match link.receive() {
                Ok(event) => assert_eq!(event, None),
                Err(error) => break error,
            }
            assert!(clock.now() < until, "the link does not notice");
            wait(&[&link], &clock, Some(until)).unwrap();
        };
        let LinkError::InterfaceDown { command, .. } = &error else { panic!("{error}") };
        assert_eq!(command, "sudo ip link set vcan0 up");
        assert!(link.send(&samples()[0]).is_err());
    }
}
