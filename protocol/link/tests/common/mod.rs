//! What the suites of the text protocols share.

use can_link::{CanLink, Clock, LinkEvent, wait};
use protocol::{Duration, ExtendedId, Frame, Instant, StandardId};

/// Longer than any step here takes on a busy machine: only a hang reaches it.
pub(crate) const PATIENCE: Instant = Instant::from_micros(120_000_000);

/// One frame of every kind.
pub(crate) fn samples() -> Vec<Frame> {
    vec![
        Frame::from_array(StandardId::new(0x0A5).unwrap(), [0x08, 0x4F, 0x64]),
        Frame::from_array(StandardId::MAX, []),
        Frame::from_array(ExtendedId::new(0x7F).unwrap(), [0xFF; 8]),
        Frame::from_array(ExtendedId::MAX, [1]),
        Frame::remote(StandardId::new(0x123).unwrap(), 4).unwrap(),
        Frame::remote(ExtendedId::new(0x123).unwrap(), 0).unwrap(),
        // Bytes that a terminal would act on.
        Frame::from_array(StandardId::new(0x00D).unwrap(), [0x0D, 0x0A, 0x03, 0x04, 0x11, 0x13, 0x7F, 0x00]),
    ]
}

/// Frames that `to` has received once there are `count`, while `from` works too.
pub(crate) fn collect(from: &mut dyn CanLink, to: &mut dyn CanLink, count: usize) -> Vec<Frame> {
    let clock = Clock::start();
    let mut frames = Vec::new();
    while frames.len() < count {
        assert!(clock.now() < PATIENCE, "only {} frames", frames.len());
        while from.receive().unwrap().is_some() {}
        while let Some(event) = to.receive().unwrap() {
            if let LinkEvent::Frame { frame, .. } = event {
                frames.push(frame);
            }
        }
        wait(&[&*from, &*to], &clock, Some(clock.now() + Duration::from_millis(2))).unwrap();
    }
    frames
}

/// Every kind of frame crosses in both directions, unchanged and in order, without an error report.
pub(crate) fn assert_all_kinds_cross(server: &mut dyn CanLink, client: &mut dyn CanLink) {
    for frame in samples() {
        server.send(&frame).unwrap();
    }
    assert_eq!(collect(server, client, samples().len()), samples());
    for frame in samples() {
        client.send(&frame).unwrap();
    }
    assert_eq!(collect(client, server, samples().len()), samples());
    for stats in [server.stats(), client.stats()] {
        assert_eq!((stats.frames_in, stats.frames_out), (samples().len() as u64, samples().len() as u64));
        assert_eq!(stats.malformed_in + stats.refused_out + stats.dropped_out, 0);
    }
}
