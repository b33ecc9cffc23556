//! Any byte stream of a server: the size of the pieces changes nothing, and every pose is valid.
#![no_main]

use libfuzzer_sys::fuzz_target;
use tracker_protocol::vrpn::{VrpnClient, VrpnError, VrpnItem};

fn read(bytes: &[u8], size: usize) -> (Vec<VrpnItem>, Option<VrpnError>) {
    let mut client = VrpnClient::new("T");
    let (mut items, mut error) = (Vec::new(), None);
    for chunk in bytes.chunks(size) {
        match client.push(chunk) {
            Ok(more) => items.extend(more),
            Err(why) => error = Some(why),
        }
    }
    if error.is_none() {
        error = client.push(&[]).err();
    }
    (items, error)
}

fuzz_target!(|bytes: &[u8]| {
    let (items, error) = read(bytes, bytes.len().max(1));
    for item in &items {
        if let VrpnItem::Pose(pose) = item {
            let norm = pose.rotation_wxyz.iter().map(|q| q * q).sum::<f64>();
            assert!((norm - 1.0).abs() < 1e-9 && pose.position_m.iter().all(|p| p.is_finite()));
        }
    }
    let size = usize::from(bytes.first().copied().unwrap_or(0) % 16) + 1;
    let (pieces, piece_error) = read(bytes, size);
    // The text of a server that does not speak VRPN is shown as far as it has arrived.
    if !matches!(error, Some(VrpnError::Cookie(_))) {
        assert_eq!((items, error), (pieces, piece_error));
    }
});
