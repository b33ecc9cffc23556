//! What a commit and an arming refer to: the content of the file, and the settings that it runs with.

use super::keyed::{KEY, Keyed};
use super::*;
use firmware::authority::{Key, Source, code_of};
use protocol::cyphal::crc::Crc64;
use sha2::{Digest as _, Sha256};

/// Offset of number `field` (0: position, 1: velocity) of a joint in a knot of a file of version 1 with six joints.
const fn at(knot: usize, joint: usize, field: usize) -> usize {
    24 + 52 * knot + 4 + 8 * joint + 4 * field
}

/// The file with a correct checksum at its end.
fn ended(mut file: Vec<u8>) -> Vec<u8> {
    let body = file.len() - 4;
    let crc = firmware::crc::Crc32::of(&file[..body]);
    file[body..].copy_from_slice(&crc.to_le_bytes());
    file
}

/// `file` with low bits of its positions changed so that its CRC-64 is `wanted`: 64 linear equations.
fn forged(file: &[u8], wanted: u64) -> Vec<u8> {
    let bits: Vec<(usize, u8)> = (0..3)
        .flat_map(|knot| (0..6).map(move |joint| at(knot, joint, 0)))
        .flat_map(|byte| (0..8).map(move |bit| (byte, 1 << bit)))
        .collect();
    let crc = |file: Vec<u8>| Crc64::of(&ended(file));
    let now = crc(file.to_vec());
    // Rows in echelon form: the change of the checksum by a set of bits, and these bits.
    let mut rows: Vec<(u64, Vec<bool>)> = Vec::new();
    let reduce = |rows: &[(u64, Vec<bool>)], mut row: (u64, Vec<bool>)| {
        for (value, set) in rows {
            if row.0 >> value.ilog2() & 1 == 1 {
                row.0 ^= value;
                row.1.iter_mut().zip(set).for_each(|(a, b)| *a ^= b);
            }
        }
        row
    };
    for (index, (byte, bit)) in bits.iter().enumerate() {
        let mut changed = file.to_vec();
        changed[*byte] ^= bit;
        let set = (0..bits.len()).map(|i| i == index).collect();
        let row = reduce(&rows, (crc(changed) ^ now, set));
        if row.0 != 0 {
            rows.push(row);
            rows.sort_by_key(|(value, _)| core::cmp::Reverse(*value));
        }
    }
    let (left, set) = reduce(&rows, (now ^ wanted, vec![false; bits.len()]));
    assert_eq!(left, 0, "{} independent equations", rows.len());
    let mut forged = file.to_vec();
    for ((byte, bit), _) in bits.iter().zip(&set).filter(|(_, taken)| **taken) {
        forged[*byte] ^= bit;
    }
    ended(forged)
}

/// The throw with joint 1 turned 0.30 rad away at its end, of the same length and the same CRC-64.
fn impostor(file: &[u8]) -> Vec<u8> {
    let get = |place: usize| f32::from_le_bytes(file[place..place + 4].try_into().unwrap());
    let mut other = file.to_vec();
    let mut put = |place: usize, x: f32| other[place..place + 4].copy_from_slice(&x.to_le_bytes());
    let start = get(at(0, 0, 0));
    let share = 1.0 - 0.30 / (get(at(2, 0, 0)) - start);
    for knot in [1, 2] {
        put(at(knot, 0, 0), start + share * (get(at(knot, 0, 0)) - start));
        put(at(knot, 0, 1), share * get(at(knot, 0, 1)));
    }
    let other = forged(&other, Crc64::of(file));
    assert_eq!(
        (other.len(), Crc64::of(&other)),
        (file.len(), Crc64::of(file)),
        "the checksums see no difference"
    );
    assert_ne!(other, file);
    other
}

fn send(bench: &mut Bench, peer: Peer, file: &[u8]) -> Result<(), Refusal> {
    let now = bench.instant();
    file.chunks(256).enumerate().try_for_each(|(i, piece)| bench.controller.upload(now, peer, 256 * i, piece))
}

#[test]
fn a_file_of_equal_length_and_checksum_put_in_place_of_the_signed_one_is_refused() {
    let mut keyed = Keyed::new();
    let (file, name) = (keyed.file.clone(), keyed.name);
    let other = impostor(&file);
    send(&mut keyed.bench, FIRST, &file).unwrap();
    // Sent with the node-ID of the host, by a node without the key.
    send(&mut keyed.bench, FIRST, &other).unwrap();
    assert_eq!(keyed.bench.controller.uploaded(), Some(name));
    assert_eq!(cause(keyed.order(FIRST, Order::Commit(name))), Cause::CodeWrong);
    send(&mut keyed.bench, FIRST, &file).unwrap();
    keyed.order(FIRST, Order::Commit(name)).unwrap();
}

#[test]
fn an_upload_that_another_node_writes_to_is_void() {
    let mut bench = Bench::ready(Options::default(), &throw_start());
    let file = throw_file(3_000, false);
    let name = FileName { crc64: Crc64::of(&file), len: file.len() as u32 };
    send(&mut bench, FIRST, &file).unwrap();
    // The same bytes are refused too: bytes are not compared across nodes.
    assert_eq!(cause(send(&mut bench, SECOND, &file[..8])), Cause::UploadOfOther);
    assert!(bench.controller.trace().iter().any(|(_, event)| event == TraceEvent::UploadVoided(SECOND)));
    assert_eq!(bench.controller.uploaded(), None);
    assert_eq!(cause(bench.order_of(FIRST, Order::Commit(name))), Cause::FileIncomplete);
    // Either node may begin anew; only the node of the upload can commit it.
    send(&mut bench, SECOND, &file).unwrap();
    assert_eq!(cause(bench.order_of(FIRST, Order::Commit(name))), Cause::UploadOfOther);
    bench.order_of(SECOND, Order::Commit(name)).unwrap();
}

/// The code of the host covers the settings that it has read: other settings are refused.
#[test]
fn the_code_of_an_arming_covers_the_settings_that_run_with_the_file() {
    let mut keyed = Keyed::new();
    let confirm = keyed.confirmation();
    let of_old = keyed.covered(confirm);
    let now = keyed.bench.instant();
    let opening = [Number::Natural32(10_000)];
    let content = b"gripper.opening_us";
    let nonce = keyed.challenge(SECOND);
    let code = code_of(&Key::new(KEY), &nonce, SECOND, content);
    // The first offer holds the session: it ends, then another holder of the key writes, and the first node asks again.
    keyed.bench.order_of(FIRST, Order::Disarm).unwrap();
    keyed.authorize(SECOND, nonce, code).unwrap();
    let source = Source { peer: SECOND, content };
    keyed.bench.controller.write_register(now, source, "gripper.opening_us", &opening).unwrap();
    let confirm = keyed.confirmation();
    let nonce = keyed.challenge(FIRST);
    let digest = of_old[of_old.len() - 32..].to_vec();
    let covered = keyed.covered(confirm);
    let old = [&covered[..covered.len() - 32], &digest].concat();
    let code = code_of(&Key::new(KEY), &nonce, FIRST, &old);
    keyed.authorize(FIRST, nonce, code).unwrap();
    assert_eq!(cause(keyed.give(FIRST, confirm)), Cause::CodeWrong);
    keyed.order(FIRST, confirm).unwrap();
}

#[test]
fn an_offer_names_the_digest_of_the_file_and_of_every_setting_that_shapes_motion() {
    let (mut bench, name) = committed();
    let digest = |bench: &mut Bench| match bench
        .order_of(FIRST, Order::ArmPrepare { crc64: name.crc64, valid: VALID })
    {
        Ok(Done::Offer { digest, .. }) => digest,
        other => panic!("{other:?}"),
    };
    let first = digest(&mut bench);
    let file: [u8; 32] = Sha256::digest(throw_file(3_000, false)).into();
    assert_eq!(first, registers::run_digest(&file, bench.controller.settings()));
    assert_eq!(digest(&mut bench), first);
    write(&mut bench, FIRST, "telemetry.period_us", &[Number::Natural32(50_000)]).unwrap();
    assert_eq!(digest(&mut bench), first, "it shapes no motion");
    write(&mut bench, FIRST, "gripper.opening_us", &[Number::Natural32(10_000)]).unwrap();
    assert_ne!(digest(&mut bench), first);
}

#[test]
fn gains_for_another_delay_than_the_loop_has_are_not_armed() {
    let (mut bench, name) = committed();
    for (least_us, most_us, taken) in [(750, 1_000, false), (3_100, 4_000, false), (2_500, 3_000, true)] {
        write(&mut bench, FIRST, "gains.delay_min_us", &[Number::Natural32(least_us)]).unwrap();
        write(&mut bench, FIRST, "gains.delay_max_us", &[Number::Natural32(most_us)]).unwrap();
        certify(&mut bench);
        let token = offer(&mut bench, FIRST, name);
        bench.run_for(60_000);
        let outcome = bench.order_of(FIRST, Order::ArmConfirm { token, valid: VALID });
        let expected = if taken { Ok(Done::Taken) } else { Err(Refusal::of(Cause::GainDelay)) };
        assert_eq!(outcome, expected, "{least_us} to {most_us} us");
    }
}
