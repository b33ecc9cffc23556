//! Freeze frame and trace over the wire: the same as in the controller, in pieces of any size, while it moves too.

use crate::bench::Controlled;
use crate::bench::host::Host;
use firmware::state::StateKind;
use protocol::cyphal::bits::Decode;
use protocol::cyphal::cubecell::history::{
    FREEZE_PATH, FrozenHead, FrozenJoint, TRACE_PATH, TraceEntry, TraceHead, kind,
};
use protocol::cyphal::cubecell::{TRAJECTORY_PATH, command};
use protocol::cyphal::uavcan::command::Status;
use protocol::cyphal::uavcan::file::{self, FileError, ListRequest, ListResponse, ReadRequest, ReadResponse};

fn read(host: &mut Host, path: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    loop {
        let answer = host.ask(file::READ, &ReadRequest { offset: bytes.len() as u64, path });
        let response = ReadResponse::from_bytes(&answer).unwrap();
        assert_eq!(response.result, Ok(()));
        bytes.extend_from_slice(response.data);
        if response.data.len() < file::PIECE_LEN_MAX {
            return bytes;
        }
    }
}

fn trace(host: &mut Host) -> Vec<TraceEntry> {
    let bytes = read(host, TRACE_PATH);
    let head = TraceHead::from_bytes(&bytes).unwrap();
    let places = &bytes[TraceHead::LEN..];
    assert_eq!(places.len(), usize::from(head.places) * TraceEntry::LEN);
    let entries = places.chunks(TraceEntry::LEN).map(|place| TraceEntry::from_bytes(place).unwrap());
    let mut entries: Vec<TraceEntry> = entries.filter(|entry| entry.sequence != 0).collect();
    entries.sort_unstable_by_key(|entry| entry.sequence);
    // The head was read first: more may have happened meanwhile.
    assert!(entries.last().unwrap().sequence >= head.total);
    entries
}

#[test]
fn every_file_that_is_listed_can_be_read_and_nothing_is_listed_after_the_last_or_in_another_folder() {
    let mut host = Host::new();
    let mut names = Vec::new();
    for folder in [&b""[..], b"/"] {
        names.clear();
        loop {
            let request = ListRequest { index: names.len() as u32, folder };
            let answer = host.ask(file::LIST, &request);
            let name = ListResponse::from_bytes(&answer).unwrap().name.to_vec();
            if name.is_empty() {
                break;
            }
            names.push(name);
        }
        assert_eq!(names, [TRAJECTORY_PATH, FREEZE_PATH, TRACE_PATH]);
    }
    for name in &names {
        read(&mut host, name);
    }
    for (index, folder) in [(u32::MAX, &b"/"[..]), (0, b"trace"), (0, &[b'x'; 255])] {
        let answer = host.ask(file::LIST, &ListRequest { index, folder });
        assert_eq!(ListResponse::from_bytes(&answer).unwrap().name, []);
    }
}

#[test]
fn a_fault_in_a_run_is_read_back_with_its_joint_and_the_events_around_it() {
    let mut host = Host::new();
    assert_eq!(read(&mut host, FREEZE_PATH), [], "no fault yet");
    let name = host.armed();
    assert_eq!(host.command(command::RUN, &name).0, Status::SUCCESS);
    host.run(300_000, |_, _| {});
    host.bench.drives[2].silent = true;
    host.run(600_000, |_, _| {});
    assert_eq!(host.bench.kind(), StateKind::Fault);
    let frame = *host.bench.controller.core().freeze_frame().unwrap();
    let bytes = read(&mut host, FREEZE_PATH);
    assert_eq!(bytes.len(), FrozenHead::LEN + 6 * FrozenJoint::LEN);
    let head = FrozenHead::from_bytes(&bytes).unwrap();
    assert_eq!((head.version, head.joints, head.fault_joint), (1, 6, 3));
    assert_eq!(head.fault_cause, frame.fault.cause.code());
    assert_eq!(head.state, StateKind::Running as u8);
    assert_eq!((head.at_us, head.path_us), (frame.at.as_micros(), frame.path_us));
    for (record, joint) in bytes[FrozenHead::LEN..].chunks(FrozenJoint::LEN).zip(frame.joints.0) {
        let record = FrozenJoint::from_bytes(record).unwrap();
        assert_eq!((record.q_rad, record.e_rad), (joint.q_rad, joint.e_rad));
        assert_eq!(record.qdd_command_rad_s2, joint.qdd_command_rad_s2);
        assert_eq!(u32::from(record.missed_in_row), joint.missed_in_row);
    }
    let entries = trace(&mut host);
    let from_core: Vec<u64> =
        host.bench.controller.core().trace().iter().map(|(at, _)| at.as_micros()).collect();
    let read: Vec<u64> = entries.iter().map(|entry| entry.at_us).collect();
    assert!(read.len() > 10 && from_core.starts_with(&read), "{read:?} {from_core:?}");
    let fault = entries.iter().find(|entry| entry.kind == kind::STATE && entry.cause == head.fault_cause);
    assert_eq!(fault.unwrap().joint, 3);
}

#[test]
fn reading_during_a_run_disturbs_nothing_and_pieces_fit_together() {
    let mut host = Host::new();
    let name = host.armed();
    let missed = host.group.unwrap().replies_missed;
    assert_eq!(host.command(command::RUN, &name).0, Status::SUCCESS);
    let mut reads_in_run = 0;
    for _ in 0..4 {
        let entries = trace(&mut host);
        assert!(entries.windows(2).all(|pair| pair[0].sequence < pair[1].sequence));
        reads_in_run += u32::from(host.bench.kind() == StateKind::Running);
    }
    assert!((2..=4).contains(&reads_in_run), "{reads_in_run}");
    host.run(1_700_000, |_, _| {});
    assert_eq!(host.bench.kind(), StateKind::Ready);
    assert!(host.bench.distance_from_path() < 1e-3);
    let group = host.group.unwrap();
    assert_eq!(group.replies_missed, missed);
    assert!(group.cycles_late < 25, "{}", group.cycles_late);
}

#[test]
fn offsets_beyond_the_end_and_unknown_paths_are_answered() {
    let mut host = Host::new();
    host.run(800_000, |_, _| {});
    for offset in [1_032, 10_000, u64::from(u32::MAX), (1 << 40) - 1] {
        let answer = host.ask(file::READ, &ReadRequest { offset, path: TRACE_PATH });
        let response = ReadResponse::from_bytes(&answer).unwrap();
        assert_eq!((response.result, response.data), (Ok(()), &[][..]), "{offset}");
    }
    let answer = host.ask(file::READ, &ReadRequest { offset: 0, path: b"secret" });
    assert_eq!(ReadResponse::from_bytes(&answer).unwrap().result, Err(FileError::NOT_FOUND));
}
