//! The stream of a VRPN server, written here by hand.

use proptest::prelude::*;
use protocol::Instant;
use tracker_protocol::vrpn::{VrpnClient, VrpnError, VrpnItem};

fn cookie() -> Vec<u8> {
    let mut bytes = b"vrpn: ver. 07.33  0".to_vec();
    bytes.resize(24, 0);
    bytes
}

fn message(sender: i32, kind: i32, body: &[u8]) -> Vec<u8> {
    let mut bytes = (24 + body.len() as u32).to_be_bytes().to_vec();
    for word in [1_795_290_599, 994_761, sender, kind, 77] {
        bytes.extend(i32::to_be_bytes(word));
    }
    bytes.extend(body);
    bytes.resize(bytes.len().next_multiple_of(8), 0);
    bytes
}

fn name(id: i32, kind: i32, text: &str) -> Vec<u8> {
    let mut body = (text.len() as u32 + 1).to_be_bytes().to_vec();
    body.extend(text.as_bytes());
    body.push(0);
    message(id, kind, &body)
}

fn pose(sender: i32, kind: i32, sensor: i32, numbers: [f64; 7]) -> Vec<u8> {
    let mut body = sensor.to_be_bytes().to_vec();
    body.extend([0xAA; 4]);
    for x in numbers {
        body.extend(x.to_be_bytes());
    }
    message(sender, kind, &body)
}

/// Two trackers; poses are of type 5.
fn server() -> Vec<u8> {
    let mut bytes = cookie();
    bytes.extend(name(3, -1, "Tracker0"));
    bytes.extend(name(4, -1, "Other"));
    bytes.extend(name(5, -2, "vrpn_Tracker Pos_Quat"));
    bytes.extend(name(6, -2, "vrpn_Tracker Velocity"));
    bytes
}

#[test]
fn poses_of_the_named_tracker_are_read() {
    let h = 0.5_f64.sqrt();
    let numbers = [2.5, 0.05, 1.0, 0.0, 0.0, -h, -h];
    let mut stream = server();
    stream.extend(pose(4, 5, 0, numbers));
    stream.extend(pose(3, 6, 0, numbers));
    stream.extend(pose(3, 5, 2, numbers));
    stream.extend(message(3, 99, b"odd body"));
    stream.extend(pose(3, 5, 0, numbers));
    for size in [1, 7, 24, 10_000] {
        let mut client = VrpnClient::new("Tracker0");
        let items: Vec<VrpnItem> =
            stream.chunks(size).flat_map(|chunk| client.push(chunk).unwrap()).collect();
        let poses: Vec<_> = items
            .iter()
            .map(|item| match item {
                VrpnItem::Pose(pose) => *pose,
                VrpnItem::NotAPose { .. } => panic!("{item:?}"),
            })
            .collect();
        assert_eq!(poses.iter().map(|pose| pose.body).collect::<Vec<_>>(), [2, 0], "pieces of {size}");
        assert_eq!(poses[0].position_m, [2.5, 0.05, 1.0]);
        // +90 degrees about z, with w not negative.
        assert!(poses[0].rotation_wxyz.iter().zip([h, 0.0, 0.0, h]).all(|(a, b)| (a - b).abs() < 1e-15));
        assert_eq!(poses[0].stamp, Instant::from_micros(1_795_290_599_994_761));
        assert_eq!(client.senders().collect::<Vec<_>>(), ["Tracker0", "Other"]);
    }
}

#[test]
fn numbers_that_are_not_a_pose_are_reported_and_the_stream_continues() {
    let good = [1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0];
    let mut stream = server();
    for (place, value) in [(0, f64::NAN), (2, f64::INFINITY), (6, 1.01), (6, 0.0), (3, f64::NAN)] {
        let mut numbers = good;
        numbers[place] = value;
        stream.extend(pose(3, 5, 1, numbers));
    }
    stream.extend(pose(3, 5, -1, good));
    stream.extend(pose(3, 5, 1, good));
    let items = VrpnClient::new("Tracker0").push(&stream).unwrap();
    assert_eq!(items.len(), 7);
    assert!(items[..5].iter().all(|item| *item == VrpnItem::NotAPose { sensor: 1 }));
    assert_eq!(items[5], VrpnItem::NotAPose { sensor: -1 });
    assert!(matches!(items[6], VrpnItem::Pose(_)));
}

#[test]
fn other_servers_and_impossible_lengths_end_the_stream() {
    assert!(VrpnClient::greeting().starts_with(b"vrpn: ver. 07.35  0\0"));
    let mut client = VrpnClient::new("Tracker0");
    let error = client.push(b"HTTP/1.1 400 Bad Request\r\n").unwrap_err();
    assert_eq!(
        error.to_string(),
        "the server does not speak VRPN 7: it begins with 'HTTP/1.1 400 Bad Request'"
    );
    assert_eq!(client.push(&cookie()), Err(error));
    for length in [0_u32, 23, 65_537, u32::MAX] {
        let mut client = VrpnClient::new("Tracker0");
        let mut stream = server();
        stream.extend(pose(3, 5, 0, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]));
        stream.extend(length.to_be_bytes());
        assert_eq!(client.push(&stream).unwrap().len(), 1, "what came before counts");
        assert_eq!(client.push(&[0; 100]), Err(VrpnError::Length(length)));
    }
    let mut client = VrpnClient::new("Tracker0");
    let names: Vec<u8> = cookie().into_iter().chain((0..2049).flat_map(|id| name(id, -1, "x"))).collect();
    assert_eq!(client.push(&names), Err(VrpnError::TooManyNames));
}

proptest! {
    #[test]
    fn no_bytes_make_the_reader_panic(
        bytes in prop::collection::vec(prop_oneof![Just(0_u8), Just(0xFF), any::<u8>()], 0..600), greet in any::<bool>(),
    ) {
        let mut client = VrpnClient::new("Tracker0");
        if greet {
            client.push(&server()).unwrap();
        }
        let _ = client.push(&bytes);
        let _ = client.push(&bytes);
    }
}
