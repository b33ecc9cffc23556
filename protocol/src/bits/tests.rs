//! Hand-worked frames, an outside program's figures, and the definition bit by bit.

use super::*;
use crate::text::candump::Record;
use proptest::prelude::*;

fn frame(text: &str) -> Frame {
    Record::parse(format!("(0) can0 {text}").as_bytes()).unwrap().frame
}

/// The definition, bit by bit: nothing shared with the code above.
fn naive(frame: &Frame) -> (Vec<bool>, u16, u32) {
    let mut bits = vec![false];
    let push = |bits: &mut Vec<bool>, value: u32, len: u32| {
        bits.extend((0..len).rev().map(|place| value >> place & 1 == 1));
    };
    let rtr = u32::from(frame.is_remote());
    if frame.is_extended() {
        push(&mut bits, frame.id().raw() >> 18, 11);
        push(&mut bits, 0b11, 2);
        push(&mut bits, frame.id().raw() & 0x3_FFFF, 18);
        push(&mut bits, rtr, 1);
        push(&mut bits, 0, 2);
    } else {
        push(&mut bits, frame.id().raw(), 11);
        push(&mut bits, rtr, 1);
        push(&mut bits, 0, 2);
    }
    push(&mut bits, frame.dlc() as u32, 4);
    for byte in frame.data() {
        push(&mut bits, u32::from(*byte), 8);
    }
    let mut crc = 0_u16;
    for bit in &bits {
        let feedback = bit ^ (crc & 0x4000 != 0);
        crc = (crc << 1) & 0x7FFF;
        if feedback {
            crc ^= 0x4599;
        }
    }
    push(&mut bits, u32::from(crc), 15);
    let (mut wire, mut run) = (Vec::new(), 0);
    for bit in &bits {
        run = if wire.last() == Some(bit) { run + 1 } else { 1 };
        wire.push(*bit);
        if run == 5 {
            wire.push(!bit);
            run = 1;
        }
    }
    let stuff = (wire.len() - bits.len()) as u32;
    wire.extend([true; 10]);
    (wire, crc, stuff)
}

#[test]
fn hand_worked_base_frame_of_zeros() {
    // SOF, id, RTR, IDE, r0, DLC: 19 dominant bits, which the generator divides with remainder 0,
    // so the CRC is 15 more of them. A stuff bit follows the 5th, 10th, … 30th of the 34.
    let zeros = frame("000#");
    assert_eq!(crc(&zeros), 0);
    assert_eq!(length(&zeros), Length { unstuffed: 44, stuff: 6, fast: 0 });
    assert_eq!(length(&zeros).with_interframe_space(), 53);
}

#[test]
fn hand_worked_base_remote_frame_of_ones() {
    // SOF, eleven id bits and RTR recessive, IDE, r0 and DLC dominant, divided by 1100010110011001:
    //
    //   0111111111111000000000000000000000
    //    1100010110011001
    //   0001110100110100100000000000000000
    //      1100010110011001
    //   0000010110000111101000000000000000
    //        1100010110011001
    //   0000001110101011011010000000000000
    //         1100010110011001
    //   0000000010111101000011000000000000
    //           1100010110011001
    //   0000000001111000100101010000000000
    //            1100010110011001
    //   0000000000011010010110011000000000
    //              1100010110011001
    //   0000000000000010111010101010000000
    //                 1100010110011001
    //   0000000000000001111111001100010000
    //                  1100010110011001
    //   0000000000000000011101111111011000
    //                    1100010110011001
    //   0000000000000000000101010011101010   remainder 54EA
    let ones = frame("7FF#R");
    assert_eq!(crc(&ones), 0x54EA);
    // Ones: stuffed behind the 5th and 10th. IDE, r0 and DLC are six zeros: stuffed behind the 5th.
    assert_eq!(length(&ones), Length { unstuffed: 44, stuff: 3, fast: 0 });
}

#[test]
fn hand_worked_extended_frame_of_zeros() {
    // Twelve zeros (stuffed behind the 5th and 10th), SRR and IDE, 25 zeros (stuffed five times, the
    // last time right before the CRC), CRC 4610 = 100 0110 0001 0000.
    let zeros = frame("00000000#");
    assert_eq!(crc(&zeros), 0x4610);
    assert_eq!(length(&zeros), Length { unstuffed: 64, stuff: 7, fast: 0 });
}

#[test]
fn lengths_agree_with_can_utils() {
    // CRC and length (interframe space included) by `canframelen.c` of can-utils in its exact mode,
    // run outside of this project; of remote frames its data bytes were left out.
    for (text, expected_crc, expected_length) in [
        ("000#", 0x0000, 53),
        ("7FF#", 0x272F, 50),
        ("7FF#R", 0x54EA, 50),
        ("555#5555555555555555", 0x1B04, 112),
        ("000#0000000000000000", 0x145B, 127),
        ("7FF#FFFFFFFFFFFFFFFF", 0x4C89, 126),
        ("0A5#084F64", 0x5E35, 72),
        ("123#R4", 0x4352, 47),
        ("014#01", 0x7753, 58),
        ("00000000#", 0x4610, 74),
        ("1FFFFFFF#FFFFFFFFFFFFFFFF", 0x1B69, 149),
        ("00000000#0000000000000000", 0x3DAF, 150),
        ("1FFFFFFF#R8", 0x1B4A, 74),
        ("0000007F#0102030405060708", 0x36E3, 144),
        ("10007D55#000000000000E0", 0x1246, 136),
        ("0F0#1F0F83E0F8", 0x352E, 95),
        ("026E6076#74CC8D360C05", 0x6BDE, 120),
        ("379#8A60D4100448AA", 0x3CAD, 106),
        ("315#FD11A7ADF8", 0x6724, 89),
        ("01F#30", 0x470F, 58),
        ("08AE9A19#EF9A31", 0x7F9F, 97),
        ("1DE#", 0x66FE, 49),
        ("0993082D#3781ED6C1E6E71", 0x7331, 127),
        ("18869B5A#4012D8C030", 0x5F76, 111),
        ("509#20BFBC0CFFFFCBBF", 0x43F8, 120),
        ("5C2#A8009A20888C8804", 0x7C2A, 117),
        ("40D#B98AEE41F84C67", 0x68B5, 107),
        ("35F#024029", 0x63DC, 75),
        ("026#79CBF02A9BE23A4A", 0x01C5, 116),
        ("102B52C6#0049AA80", 0x0368, 105),
        ("030D2B73#BE1FE279BC14", 0x5019, 120),
        ("1AE813A9#094800980B42", 0x47A5, 120),
    ] {
        let frame = frame(text);
        assert_eq!(
            (crc(&frame), length(&frame).with_interframe_space()),
            (expected_crc, expected_length),
            "{text}"
        );
    }
}

/// CAN FD by the definition, bit by bit: bits before and from ESI on, with stuff bits, up to the CRC.
fn naive_fd(frame: &Frame) -> (usize, usize) {
    let flags = frame.fd().unwrap();
    let digits = |value: u32, len: u32| format!("{value:0len$b}", len = len as usize);
    let raw = frame.id().raw();
    let mut header = "0".to_owned();
    if frame.is_extended() {
        header += &(digits(raw >> 18, 11) + "11" + &digits(raw & 0x3_FFFF, 18) + "0");
    } else {
        header += &(digits(raw, 11) + "00");
    }
    header += if flags.brs { "101" } else { "100" };
    let codes = [12, 16, 20, 24, 32, 48, 64];
    let code = codes.iter().position(|len| *len == frame.dlc()).map_or(frame.dlc(), |place| 9 + place);
    let mut text = header.clone() + if flags.esi { "1" } else { "0" } + &digits(code as u32, 4);
    frame.data().iter().for_each(|byte| text += &digits((*byte).into(), 8));
    let (mut run, mut last, mut lengths) = (0, ' ', [0, 0]);
    for (place, bit) in text.chars().enumerate() {
        let part = usize::from(place >= header.len());
        run = if bit == last { run + 1 } else { 1 };
        last = bit;
        lengths[part] += 1;
        // No stuff bit behind the last one: a fixed one comes there.
        if run == 5 && place + 1 < text.len() {
            (run, last) = (1, if bit == '0' { '1' } else { '0' });
            lengths[part] += 1;
        }
    }
    let fields = if frame.dlc() <= 16 { 4 + 17 } else { 4 + 21 };
    (lengths[0], lengths[1] + fields + fields / 4 + 1)
}

#[test]
fn can_fd_bounds_are_the_published_ones() {
    // Bits at the nominal and at the data rate, three between frames: without stuff bits, and the worst.
    for n in [0, 4, 8, 12, 16, 20, 24, 32, 48, 64] {
        for (extended, nominal, worse) in [(false, 30, 4), (true, 49, 8)] {
            let fast = if n <= 16 { 32 } else { 37 } + 8 * n;
            let (best, worst) = (fd_best_case(extended, true, n), fd_worst_case(extended, true, n));
            assert_eq!((best.with_interframe_space() - best.fast, best.fast as usize), (nominal, fast));
            assert_eq!(worst.with_interframe_space() - worst.fast, nominal + worse);
            assert_eq!(worst.fast as usize, fast + (5 + 8 * n) / 4);
        }
    }
    // Eight bytes at 1 and 5 Mbit/s; without bit rate switch they take longer than a classical frame.
    assert_eq!(fd_best_case(false, true, 8).time_ns(1_000, 200), 49_200);
    assert_eq!(fd_worst_case(false, true, 8).time_ns(1_000, 200), 56_600);
    assert_eq!(fd_best_case(false, false, 8).time_ns(1_000, 200), 126_000);
    assert_eq!(best_case(false, 8).time_ns(1_000, 200), 111_000);
}

#[test]
fn hand_worked_can_fd_frames() {
    let fd = |id: u16, flags, data: &[u8]| {
        Frame::new_fd(crate::id::StandardId::new(id).unwrap(), flags, data).unwrap()
    };
    // Zeros: fourteen up to IDE (stuffed behind the 5th and 10th), FDF, res, BRS; then ESI and DLC are five zeros, the last bits
    // before the fixed stuff bit.
    let zeros = length(&fd(0, FdFlags::BRS, &[]));
    assert_eq!(zeros, Length { unstuffed: 17 + 32 + 10, stuff: 2, fast: 32 });
    assert_eq!(zeros.before_fast(), 19);
    // Without bit rate switch res, BRS, ESI and DLC are seven zeros: stuffed behind the 5th, at the nominal rate.
    assert_eq!(length(&fd(0, FdFlags::default(), &[])), Length { unstuffed: 59, stuff: 3, fast: 0 });
    // Enabling motor 1: ESI 0, DLC 1000, then 56 ones, FC. The ones are stuffed eleven times, the last time behind the 55th;
    // the 56th and the six of FC are stuffed behind their 5th.
    let enable = length(&fd(1, FdFlags::BRS, &[0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFC]));
    // id 1: SOF and ten zeros, stuffed twice, a one, RRS and IDE.
    assert_eq!(enable, Length { unstuffed: 17 + 96 + 10, stuff: 2 + 12, fast: 96 + 12 });
}

#[test]
fn bounds_are_the_published_ones() {
    for n in 0..=8_u32 {
        let base = worst_case(false, n as usize).with_interframe_space();
        let extended = worst_case(true, n as usize).with_interframe_space();
        assert_eq!(base, 8 * n + 47 + (34 + 8 * n - 1) / 4);
        assert_eq!(extended, 8 * n + 67 + (54 + 8 * n - 1) / 4);
        assert_eq!(best_case(false, n as usize).with_interframe_space(), 8 * n + 47);
        assert_eq!(best_case(true, n as usize).with_interframe_space(), 8 * n + 67);
    }
    // The commonly published figures for eight bytes.
    assert_eq!(worst_case(false, 8).with_interframe_space(), 135);
    assert_eq!(worst_case(true, 8).with_interframe_space(), 160);
    assert_eq!(worst_case(false, 100), worst_case(false, 8));
}

#[test]
fn short_base_data_frames_always_have_a_stuff_bit_and_longer_ones_need_not() {
    let fewest = |n: usize| {
        let ids = 0..=0x7FF;
        let payloads: [&[u8]; 3] = [&[0x55; 8], &[0xAA; 8], &[0xA5; 8]];
        ids.flat_map(|id| payloads.map(|payload| (id, payload)))
            .map(|(id, payload)| {
                let id = crate::id::StandardId::new(id).unwrap();
                length(&Frame::new(id, &payload[..n]).unwrap()).stuff
            })
            .min()
    };
    assert_eq!([0, 1, 2, 3].map(fewest), [Some(1); 4]);
    assert_eq!([4, 5, 6, 7, 8].map(fewest), [Some(0); 5]);
}

proptest! {
    #[test]
    fn can_fd_length_agrees_with_the_definition_and_stays_within_the_bounds(
        id: u32, extended: bool, brs: bool, esi: bool, code in 0_usize..16, runs in proptest::collection::vec(1_u32..12, 520),
    ) {
        let len = [0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64][code].min(crate::frame::CAPACITY);
        let id = if extended {
            Id::Extended(crate::id::ExtendedId::from_low_bits(id))
        } else {
            Id::Standard(crate::id::StandardId::from_low_bits(id as u16))
        };
        let bits: Vec<u8> =
            runs.iter().enumerate().flat_map(|(at, run)| std::iter::repeat_n((at % 2) as u8, *run as usize)).collect();
        let data: Vec<u8> =
            bits.chunks(8).take(len).map(|byte| byte.iter().fold(0, |all, bit| all << 1 | bit)).collect();
        let frame = Frame::new_fd(id, FdFlags { brs, esi }, &data).unwrap();
        let (before, behind) = naive_fd(&frame);
        let length = length(&frame);
        prop_assert_eq!(length.frame() as usize, before + behind + 10);
        prop_assert_eq!(length.fast as usize, if brs { behind } else { 0 });
        prop_assert!(length.frame() <= fd_worst_case(extended, brs, len).frame());
        prop_assert_eq!(length.unstuffed, fd_best_case(extended, brs, len).unstuffed);
        prop_assert_eq!(length.unstuffed + 3, frame.nominal_bits());
    }

    #[test]
    fn length_and_crc_agree_with_the_definition(frame in crate::text::arbitrary::frame()) {
        let (wire, expected_crc, stuff) = naive(&frame);
        prop_assert_eq!(crc(&frame), expected_crc);
        prop_assert_eq!(length(&frame).stuff, stuff);
        prop_assert_eq!(length(&frame).frame() as usize, wire.len());
    }

    #[test]
    fn runny_frames_agree_too_and_stay_within_the_bounds(
        id: u32, extended: bool, runs in proptest::collection::vec(1_u32..12, 8..16), len in 0_usize..=8,
    ) {
        // Long runs of equal bits, which uniformly random bytes hardly have.
        let mut bits = 0_u64;
        for (index, run) in runs.iter().enumerate() {
            bits = bits << run | if index % 2 == 0 { 0 } else { (1 << run) - 1 };
        }
        let data = bits.to_be_bytes();
        let id = if extended {
            Id::Extended(crate::id::ExtendedId::from_low_bits(id))
        } else {
            Id::Standard(crate::id::StandardId::from_low_bits(id as u16))
        };
        let frame = Frame::new(id, &data[..len]).unwrap();
        let (wire, _, stuff) = naive(&frame);
        let length = length(&frame);
        prop_assert_eq!((length.stuff, length.frame() as usize), (stuff, wire.len()));
        prop_assert!(length.frame() <= worst_case(extended, len).frame());
        prop_assert!(length.frame() >= best_case(extended, len).frame());
        prop_assert_eq!(length.unstuffed, best_case(extended, len).unstuffed);
    }
}
