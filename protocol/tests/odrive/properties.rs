//! Properties over all frames and values.

use proptest::prelude::*;
use protocol::odrive::{NodeId, Order, Report, Request, Version};
use protocol::{ExtendedId, Frame, Id, StandardId};

fn frames() -> impl Strategy<Value = Frame> {
    let ids = prop_oneof![
        (0..0x800_u16).prop_map(|id| Id::Standard(StandardId::new(id).unwrap())),
        (0..0x2000_0000_u32).prop_map(|id| Id::Extended(ExtendedId::new(id).unwrap())),
    ];
    (ids, prop::collection::vec(any::<u8>(), 0..=8), any::<bool>()).prop_map(|(id, data, remote)| {
        if remote { Frame::remote(id, data.len()).unwrap() } else { Frame::new(id, &data).unwrap() }
    })
}

proptest! {
    #[test]
    fn any_frame_is_read_or_refused_and_what_is_read_is_written_to_be_read_the_same(frame in frames()) {
        for version in [Version::V05, Version::V06] {
            let order = Order::decode(&frame, version);
            if let Some((node, order)) = order {
                let (written, clipped) = order.encode(node, version).unwrap();
                prop_assert_eq!(clipped, Default::default());
                prop_assert_eq!(Order::decode(&written, version), Some((node, order)));
            }
            if let Some((node, report)) = Report::decode(&frame, version) {
                prop_assert!(order.is_none(), "both an order and a report: {:?}", frame);
                // Numbers may be NaN: frames are compared.
                let written = report.encode(node, version);
                let (same, again) = Report::decode(&written, version).unwrap();
                prop_assert_eq!((same, again.encode(node, version)), (node, written));
            }
            if let Some((node, request)) = Request::decode(&frame, version) {
                prop_assert_eq!(Request::decode(&request.encode(node), version), Some((node, request)));
            }
        }
    }

    #[test]
    fn a_position_is_read_as_it_was_meant_to_half_a_thousandth(
        node in 0..63_u8, rev in -1e4..1e4_f32, rev_s in -40.0..40.0_f32, nm in -40.0..40.0_f32,
    ) {
        let node = NodeId::new(node).unwrap();
        let (frame, clipped) = Order::Position { rev, rev_s, nm }.encode(node, Version::V06).unwrap();
        let Some((to, Order::Position { rev: r, rev_s: v, nm: t })) = Order::decode(&frame, Version::V06) else {
            return Err(TestCaseError::fail("no position"));
        };
        prop_assert_eq!((to, r.to_bits()), (node, rev.to_bits()));
        for (meant, read, clipped) in [(rev_s, v, clipped.velocity), (nm, t, clipped.torque)] {
            prop_assert!((read - meant.clamp(-32.768, 32.767)).abs() <= 0.00051, "{} {}", meant, read);
            prop_assert!(clipped == (meant.abs() > 32.768) || (meant.abs() - 32.7675).abs() < 0.001, "{}", meant);
        }
    }
}
