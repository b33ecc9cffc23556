//! Host and controller core on one simulated bus in virtual time: services, repetition, loss.

use crate::common::cyphal_app::{COMMAND_FILE_CRC, COMMAND_REVERSE, DemoApp};
use crate::common::cyphal_rig::{Dice, HOST, Rig, SERVER, node};
use proptest::prelude::*;
use protocol::cyphal::bits::{Decode, Encode};
use protocol::cyphal::client::{NoAnswer, Policy, StartError};
use protocol::cyphal::crc::Crc64;
use protocol::cyphal::cubecell::{TRAJECTORY_PATH, command as cell_command, stop};
use protocol::cyphal::host::REQUESTS_MAX;
use protocol::cyphal::id::{Priority, Route, ServiceId, SubjectId, TransferId};
use protocol::cyphal::rx::Dropped;
use protocol::cyphal::server::{Application, ControllerCore, Publication, Server};
use protocol::cyphal::tx::{TxMeta, TxQueue};
use protocol::cyphal::uavcan::command::{self, CommandRequest, Status};
use protocol::cyphal::uavcan::file::{self, FileError, ReadRequest, ReadResponse};
use protocol::cyphal::uavcan::heartbeat::{self, Health, Heartbeat, Mode};
use protocol::cyphal::uavcan::info::{self, NodeInfo};
use protocol::cyphal::uavcan::port_list::{self, PortList};
use protocol::cyphal::uavcan::register::{self, ListRequest, ListResponse};
use protocol::cyphal::uavcan::value::{Value, ValueBuf};
use protocol::{Duration, Frame, Id, Instant, Node};

fn text(bytes: &[u8]) -> &str {
    str::from_utf8(bytes).unwrap()
}

// ---- periodic messages ---------------------------------------------------------------------------

#[test]
fn heartbeat_comes_at_once_and_every_second_with_uptime_and_rising_number() {
    let mut rig = Rig::new(0);
    rig.run(Duration::from_millis(3500));
    let heartbeats: Vec<_> =
        rig.host.listener.messages.iter().filter(|(_, subject, ..)| *subject == heartbeat::SUBJECT).collect();
    assert_eq!(heartbeats.len(), 4);
    for (n, (at, _, transfer_id, payload)) in heartbeats.iter().enumerate() {
        let expected = Heartbeat {
            uptime_s: n as u32,
            health: Health::Advisory,
            mode: Mode::MAINTENANCE,
            vendor_status: 7,
        };
        assert_eq!(Heartbeat::from_bytes(payload), Ok(expected));
        assert_eq!(transfer_id.get(), n as u8);
        let late = at.saturating_since(Instant::from_micros(n as u64 * 1_000_000));
        assert!(late < Duration::from_millis(50), "{late}");
    }
}

#[test]
fn heartbeat_of_a_watched_host_comes_in_its_set_period_and_at_least_once_a_second() {
    for (asked_ms, expected) in [(30, 34), (5000, 2), (0, 1001)] {
        let mut core = ControllerCore::new(Instant::ZERO, node(SERVER));
        core.set_heartbeat_period(Duration::from_millis(asked_ms));
        let app = DemoApp::new();
        let mut beats = 0;
        while core.poll_timeout() <= Instant::from_micros(1_000_000) {
            core.handle_timeout(core.poll_timeout(), &app);
            while let Some(frame) = core.poll_frame() {
                beats += usize::from(frame.id().raw() == 0x107D_552A);
            }
        }
        assert_eq!(beats, expected, "{asked_ms} ms");
    }
}

#[test]
fn late_call_sends_one_heartbeat_and_not_a_burst() {
    let mut core = ControllerCore::new(Instant::ZERO, node(SERVER));
    let app = DemoApp::new();
    core.handle_timeout(Instant::from_micros(10_500_000), &app);
    let frames: Vec<Frame> = std::iter::from_fn(|| core.poll_frame()).collect();
    let beats = frames.iter().filter(|frame| frame.id().raw() == 0x107D_552A).count();
    assert_eq!(beats, 1);
    assert_eq!(core.poll_timeout(), Instant::from_micros(11_500_000));
}

#[test]
fn port_list_names_what_the_node_sends_hears_and_answers() {
    let mut rig = Rig::new(0);
    rig.run(Duration::from_secs(6));
    let lists: Vec<_> =
        rig.host.listener.messages.iter().filter(|(_, subject, ..)| *subject == port_list::SUBJECT).collect();
    assert_eq!(lists.len(), 2, "at the start and after five seconds");
    let list = PortList::from_bytes(&lists[0].3).unwrap();
    for subject in [7509, 7510, 8184] {
        assert!(list.publishers.contains(SubjectId::new(subject).unwrap()));
    }
    assert!(list.subscribers.contains(stop::SUBJECT));
    assert!(!list.subscribers.contains(heartbeat::SUBJECT));
    let servers = (0..512).filter(|id| list.servers.contains(ServiceId::new(*id).unwrap()));
    assert_eq!(servers.collect::<Vec<_>>(), [384, 385, 406, 408, 409, 430, 435]);
    assert!((0..512).all(|id| !list.clients.contains(ServiceId::new(id).unwrap())));
}

// ---- services ------------------------------------------------------------------------------------

#[test]
fn node_info_is_answered() {
    let mut rig = Rig::new(0);
    let bytes = rig.ask(info::SERVICE, &()).unwrap();
    let answer = NodeInfo::from_bytes(&bytes).unwrap();
    assert_eq!(text(answer.name), "org.cubecell.demo");
    assert_eq!(answer.software_image_crc, Some(0xFEDC_BA98_7654_3210));
}

#[test]
fn registers_are_listed_without_gaps_and_end_with_an_empty_name() {
    let mut rig = Rig::new(0);
    let mut names = Vec::new();
    for index in 0..100 {
        let bytes = rig.ask(register::LIST, &ListRequest { index }).unwrap();
        let name = ListResponse::from_bytes(&bytes).unwrap().name;
        if name.is_empty() {
            break;
        }
        names.push(text(name).to_string());
    }
    assert_eq!(names.len(), 19);
    assert_eq!(names[0], "uavcan.node.description");
    assert_eq!(names[16], "file.crc64");
}

#[test]
fn register_of_every_type_is_read_written_and_read_back() {
    let mut rig = Rig::new(0);
    for index in 0..14 {
        let bytes = rig.ask(register::LIST, &ListRequest { index }).unwrap();
        let name = text(ListResponse::from_bytes(&bytes).unwrap().name).to_string();
        let (mutable, persistent, value) = rig.access(&name, Value::EMPTY);
        assert!(mutable && persistent, "{name}");
        // Another value of the same type and length: all elements zero.
        let mut wire = vec![0; 300];
        let len = value.as_value().to_bytes(&mut wire).unwrap();
        let prefix = if value.as_value().kind().element_bits() <= 8 { 3 } else { 2 };
        wire[prefix..len].fill(0);
        let zero: ValueBuf = Value::from_bytes(&wire[..len]).unwrap().into();
        assert_ne!(zero, value);
        assert_eq!(rig.access(&name, zero.as_value()).2, zero, "{name}");
        assert_eq!(rig.access(&name, Value::EMPTY).2, zero, "{name}");
    }
}

#[test]
fn unknown_immutable_and_misfitting_registers_keep_what_they_are() {
    let mut rig = Rig::new(0);
    assert_eq!(rig.access("no.such", ValueBuf::from(1_u8).as_value()), (false, false, ValueBuf::EMPTY));
    let constant = ValueBuf::from(42_u8);
    let other = ValueBuf::from(1_u8);
    assert_eq!(rig.access("demo.constant", other.as_value()), (false, false, constant));
    let before = rig.access("demo.real32", Value::EMPTY).2;
    assert_eq!(rig.access("demo.real32", other.as_value()).2, before);
}

#[test]
fn commands_answer_with_status_and_output() {
    let mut rig = Rig::new(0);
    assert_eq!(rig.command(COMMAND_REVERSE, b"abc"), (Status::SUCCESS, b"cba".to_vec()));
    let longest = [7; command::OUTPUT_LEN_MAX];
    assert_eq!(rig.command(COMMAND_REVERSE, &longest), (Status::SUCCESS, longest.to_vec()));
    // An output that does not fit is left out, not cut.
    assert_eq!(rig.command(COMMAND_REVERSE, &[7; 47]), (Status::SUCCESS, vec![]));
    assert_eq!(rig.command(9999, &[]), (Status::BAD_COMMAND, vec![]));
}

#[test]
fn file_is_written_read_back_and_unknown_paths_are_not_found() {
    let mut rig = Rig::new(0);
    let data: Vec<u8> = (0..1000_u32).map(|i| (i * 7) as u8).collect();
    assert_eq!(rig.upload(&data), 0);
    let mut back: Vec<u8> = Vec::new();
    loop {
        let request = ReadRequest { offset: back.len() as u64, path: TRAJECTORY_PATH };
        let bytes = rig.ask(file::READ, &request).unwrap();
        let response = ReadResponse::from_bytes(&bytes).unwrap();
        back.extend(response.data);
        if response.data.len() < file::PIECE_LEN_MAX {
            break;
        }
    }
    assert_eq!(back, data);
    let bytes = rig.ask(file::READ, &ReadRequest { offset: 0, path: b"nowhere" }).unwrap();
    assert_eq!(ReadResponse::from_bytes(&bytes).unwrap().result, Err(FileError::NOT_FOUND));
    // By the standard: index, 32 bits void, path with its length; the answer is 32 bits void and the name.
    for (index, folder, name) in
        [(0, &b"/"[..], TRAJECTORY_PATH), (0, b"", TRAJECTORY_PATH), (1, b"/", b""), (0, b"other", b"")]
    {
        let bytes = rig.ask(file::LIST, &file::ListRequest { index, folder }).unwrap();
        assert_eq!(bytes[..5], [0, 0, 0, 0, name.len() as u8]);
        assert_eq!(file::ListResponse::from_bytes(&bytes).unwrap().name, name);
    }
}

#[test]
fn stop_reaches_the_application_in_one_frame_of_priority_zero() {
    let mut rig = Rig::new(0);
    let mut publication = Publication::new(stop::SUBJECT, Priority::Exceptional, Duration::from_millis(10));
    for _ in 0..3 {
        rig.host.publish(rig.now, &mut publication, &stop::Stop::default()).unwrap();
    }
    rig.run(Duration::from_millis(5));
    assert_eq!(rig.server.app.stops, 3);
    let stops = rig.log.iter().filter(|frame| frame.id().raw() >> 26 == 0).count();
    assert_eq!(stops, 3);
}

// ---- loss, delay, repetition ---------------------------------------------------------------------

fn trajectory() -> Vec<u8> {
    let mut dice = Dice::new(7);
    (0..7680).map(|_| dice.below(256) as u8).collect()
}

#[test]
fn throw_of_7680_bytes_arrives_whole_at_any_frame_loss_up_to_one_in_twenty() {
    let data = trajectory();
    for loss in [0, 60, 20] {
        for seed in 0..10 {
            let mut rig = Rig::new(seed);
            rig.loss = loss;
            let failures = rig.upload(&data);
            let (status, output) = rig.command(COMMAND_FILE_CRC, &[]);
            assert_eq!(status, Status::SUCCESS, "loss 1/{loss}, seed {seed}");
            assert_eq!(output, Crc64::of(&data).to_le_bytes(), "loss 1/{loss}, seed {seed}");
            assert_eq!(rig.server.app.file.contents(), data);
            if loss == 0 {
                assert_eq!((failures, rig.host.client().repeated()), (0, 0));
                // 31 requests of 39 frames and their answers: 1.3 times the bus time at the most.
                assert!(rig.now < Instant::from_micros(31 * 41 * 140 * 13 / 10), "{}", rig.now);
            } else {
                assert!(rig.host.client().repeated() > 0);
            }
        }
    }
}

#[test]
fn answers_that_come_after_their_time_are_never_taken_for_another_request() {
    let mut rig = Rig::new(0);
    // Every answer comes 150 ms after the attempt was given up.
    rig.latency = Duration::from_millis(175);
    let first = rig.start(register::LIST, &ListRequest { index: 0 });
    rig.run(Duration::from_millis(120));
    let second = rig.start(register::LIST, &ListRequest { index: 1 });
    rig.run(Duration::from_secs(5));
    let answers = &rig.host.listener.answers;
    assert_eq!(answers.len(), 2);
    for (ticket, answer) in answers {
        assert!([first, second].contains(ticket));
        let failed = answer.as_ref().unwrap_err();
        assert_eq!((failed.server, failed.service, failed.attempts), (node(SERVER), register::LIST, 5));
    }
    assert_eq!(rig.host.client().unmatched(), 10, "five late answers to each of two requests");
}

#[test]
fn answer_to_an_earlier_attempt_is_not_the_answer_to_the_next_one() {
    let mut rig = Rig::new(0);
    rig.latency = Duration::from_millis(150);
    let ticket = rig.start(register::LIST, &ListRequest { index: 3 });
    // The first attempt is given up at 200 ms; its answer arrives at 300 ms.
    rig.run(Duration::from_millis(250));
    assert_eq!(rig.host.client().repeated(), 1);
    rig.latency = Duration::ZERO;
    rig.run(Duration::from_secs(1));
    let answers = &rig.host.listener.answers;
    assert_eq!(answers.len(), 1);
    assert_eq!(answers[0].0, ticket);
    assert!(answers[0].1.is_ok());
    assert!(rig.host.client().unmatched() >= 1);
}

#[test]
fn requests_in_flight_at_the_same_time_each_get_their_own_answer() {
    for seed in 0..20 {
        let mut rig = Rig::new(seed);
        rig.loss = 12;
        let tickets: Vec<_> = (0..REQUESTS_MAX as u16)
            .map(|i| (rig.start(register::LIST, &ListRequest { index: i }), i))
            .collect();
        rig.run(Duration::from_secs(5));
        assert_eq!(rig.host.listener.answers.len(), tickets.len(), "seed {seed}");
        for (ticket, index) in tickets {
            let (_, answer) = rig.host.listener.answers.iter().find(|(t, _)| *t == ticket).unwrap();
            if let Ok(bytes) = answer {
                let name = ListResponse::from_bytes(bytes).unwrap().name;
                assert_eq!(name, rig.server.app.register_name(index), "seed {seed}");
            }
        }
    }
}

#[test]
fn number_of_a_request_that_waits_long_is_not_given_to_another() {
    let mut rig = Rig::new(0);
    let patient = Policy { timeout: Duration::from_secs(50), attempts: 1, ..Policy::default() };
    // The first frame is lost, so the request waits under number 0 while 40 others come and go.
    rig.loss = 1;
    let request = ListRequest { index: 5 };
    let ticket = rig.host.request(rig.now, node(SERVER), register::LIST, patient, &request).unwrap();
    rig.run(Duration::from_millis(1));
    rig.loss = 0;
    for index in 0..40 {
        let bytes = rig.ask(register::LIST, &ListRequest { index: index % 3 }).unwrap();
        let name = ListResponse::from_bytes(&bytes).unwrap().name;
        assert_eq!(name, rig.server.app.register_name(index % 3));
    }
    assert!(rig.host.listener.answers.is_empty(), "no answer to another request was accepted");
    rig.run(Duration::from_secs(51));
    let failed = NoAnswer { server: node(SERVER), service: register::LIST, attempts: 1 };
    assert_eq!(rig.host.listener.answers, [(ticket, Err(failed))]);
}

#[test]
fn silent_server_is_reported_with_its_address_service_and_attempts() {
    let mut rig = Rig::new(0);
    let policy = Policy { timeout: Duration::from_millis(50), attempts: 3, ..Policy::default() };
    let ticket = rig.host.request(rig.now, node(9), info::SERVICE, policy, &()).unwrap();
    rig.run(Duration::from_millis(149));
    assert!(rig.host.listener.answers.is_empty());
    rig.run(Duration::from_millis(5));
    let failed = NoAnswer { server: node(9), service: info::SERVICE, attempts: 3 };
    assert_eq!(rig.host.listener.answers, [(ticket, Err(failed))]);
}

#[test]
fn full_table_of_requests_refuses_the_next_and_cancel_makes_room() {
    let mut rig = Rig::new(0);
    let tickets: Vec<_> = (0..REQUESTS_MAX).map(|_| rig.start(info::SERVICE, &())).collect();
    let refused = rig.host.request(rig.now, node(SERVER), info::SERVICE, Policy::default(), &());
    assert_eq!(refused, Err(StartError::TooManyRequests { capacity: REQUESTS_MAX }));
    rig.host.cancel(tickets[0]);
    assert!(rig.host.request(rig.now, node(SERVER), info::SERVICE, Policy::default(), &()).is_ok());
}

#[test]
fn tenth_service_is_refused_with_its_number() {
    let mut rig = Rig::new(0);
    for id in 0..8 {
        rig.start(ServiceId::new(id).unwrap(), &());
    }
    let service = ServiceId::new(8).unwrap();
    let refused = rig.host.request(rig.now, node(SERVER), service, Policy::default(), &());
    assert_eq!(refused, Err(StartError::TooManyServices { service }));
}

// ---- hostile clients -----------------------------------------------------------------------------

fn request_frames(
    service: ServiceId,
    transfer_id: u8,
    priority: Priority,
    request: &dyn Encode,
) -> Vec<Frame> {
    let mut queue = TxQueue::<2, 600>::new();
    let meta = TxMeta {
        route: Route::Request { service, source: node(HOST), destination: node(SERVER) },
        priority,
        transfer_id: TransferId::new(transfer_id).unwrap(),
        deadline: Instant::FAR_FUTURE,
    };
    queue.push(&meta, request).unwrap();
    std::iter::from_fn(|| queue.pop()).collect()
}

#[test]
fn request_of_priority_zero_is_answered_below_the_drives() {
    let mut core = ControllerCore::new(Instant::ZERO, node(SERVER));
    let mut app = DemoApp::new();
    for frame in request_frames(info::SERVICE, 0, Priority::Exceptional, &()) {
        core.handle_frame(Instant::ZERO, &frame, &mut app);
    }
    let answer = core.poll_frame().unwrap();
    assert_eq!(answer.id().raw() >> 26, 1);
}

#[test]
fn request_that_cannot_be_answered_is_not_carried_out() {
    let mut core = ControllerCore::new(Instant::ZERO, node(SERVER));
    let mut app = DemoApp::new();
    let request = CommandRequest { command: COMMAND_REVERSE, parameter: b"x" };
    // The frames are not sent: five of six places fill up, the last is for urgent transfers.
    for transfer_id in 0..10 {
        for frame in request_frames(command::SERVICE, transfer_id, Priority::Nominal, &request) {
            core.handle_frame(Instant::ZERO, &frame, &mut app);
        }
    }
    assert_eq!((app.executed.len(), core.unanswered()), (5, 5));
}

#[test]
fn stop_is_carried_out_although_it_cannot_be_answered() {
    let mut core = ControllerCore::new(Instant::ZERO, node(SERVER));
    let mut app = DemoApp::new();
    for transfer_id in 0..10 {
        let request = CommandRequest { command: COMMAND_REVERSE, parameter: b"x" };
        for frame in request_frames(command::SERVICE, transfer_id, Priority::Nominal, &request) {
            core.handle_frame(Instant::ZERO, &frame, &mut app);
        }
    }
    let unanswered = core.unanswered();
    for priority in [Priority::Nominal, Priority::Optional] {
        let stop = CommandRequest { command: cell_command::STOP, parameter: b"" };
        for frame in request_frames(command::SERVICE, 20 + priority as u8, priority, &stop) {
            core.handle_frame(Instant::ZERO, &frame, &mut app);
        }
    }
    let stops = app.executed.iter().filter(|command| **command == cell_command::STOP);
    assert_eq!((stops.count(), core.unanswered()), (2, unanswered + 2));
}

#[test]
fn stop_of_a_program_that_began_anew_is_carried_out_and_other_repetitions_are_not() {
    let mut core = ControllerCore::new(Instant::ZERO, node(SERVER));
    let mut app = DemoApp::new();
    for command in [COMMAND_REVERSE, cell_command::STOP] {
        for _ in 0..2 {
            let request = CommandRequest { command, parameter: b"" };
            for frame in request_frames(command::SERVICE, 0, Priority::Nominal, &request) {
                core.handle_frame(Instant::ZERO, &frame, &mut app);
            }
        }
    }
    assert_eq!(app.executed, [COMMAND_REVERSE, cell_command::STOP, cell_command::STOP]);
}

#[test]
fn answers_that_are_too_late_to_be_used_are_dropped() {
    let mut core = ControllerCore::new(Instant::ZERO, node(SERVER));
    let mut app = DemoApp::new();
    for frame in request_frames(info::SERVICE, 0, Priority::Nominal, &()) {
        core.handle_frame(Instant::ZERO, &frame, &mut app);
    }
    core.handle_timeout(Instant::from_micros(1_000_000), &app);
    assert_eq!(core.expired(), 1);
    let first = core.poll_frame().unwrap();
    assert_ne!(first.id().raw() & 1 << 25, 1 << 25, "messages only");
}

#[test]
fn five_byte_register_access_of_a_name_that_is_not_there_is_answered_empty() {
    let mut core = ControllerCore::new(Instant::ZERO, node(SERVER));
    let mut app = DemoApp::new();
    let id = request_frames(register::ACCESS, 0, Priority::Nominal, &())[0].id();
    let hostile = Frame::new(id, &[0xFF, 0xFF, 0xFF, 0xFF, 0xE0]).unwrap();
    core.handle_frame(Instant::ZERO, &hostile, &mut app);
    assert_eq!(core.undecodable(), 0);
    // Eight bytes of answer: timestamp and flags, then the empty value; two frames.
    let frames: Vec<Frame> = std::iter::from_fn(|| core.poll_frame()).collect();
    assert_eq!(frames.len(), 2);
}

#[test]
fn another_node_with_our_address_is_counted() {
    let mut rig = Rig::new(0);
    let twin = Route::Message { subject: heartbeat::SUBJECT, source: node(SERVER) };
    let frame = Frame::new(twin.can_id(Priority::Nominal), &[0, 0, 0, 0, 0, 0, 0, 0xE0]).unwrap();
    rig.server.handle_frame(rig.now, &frame);
    assert_eq!(rig.server.core.rx_counters().dropped(Dropped::OurAddress), 1);
}

proptest! {
    #[test]
    fn any_payload_to_any_service_is_survived_and_answered_within_bounds(
        script in proptest::collection::vec(
            (
                proptest::sample::select(vec![384_u16, 385, 406, 408, 409, 430, 435, 500]),
                proptest::collection::vec(any::<u8>(), 0..560),
                0_u64..1_500_000,
            ),
            1..20,
        ),
    ) {
        struct Raw(Vec<u8>);
        impl Encode for Raw {
            fn encode(&self, out: &mut protocol::cyphal::bits::Writer<'_>) {
                out.bytes(&self.0);
            }
        }
        let mut server = Server {
            core: ControllerCore::new(Instant::ZERO, node(SERVER)),
            app: DemoApp::new(),
        };
        let mut now = Instant::ZERO;
        for (n, (service, payload, pause_us)) in script.into_iter().enumerate() {
            now += Duration::from_micros(pause_us);
            server.handle_timeout(now);
            let service = ServiceId::new(service).unwrap();
            for frame in request_frames(service, n as u8 % 32, Priority::Low, &Raw(payload)) {
                server.handle_frame(now, &frame);
            }
            let sent = std::iter::from_fn(|| server.poll_frame()).count();
            prop_assert!(sent <= 6 * 46, "{sent} frames");
            prop_assert!(server.poll_timeout().unwrap() > now);
        }
    }

    #[test]
    fn any_frame_at_any_time_leaves_the_node_working(
        frames in proptest::collection::vec(
            (0_u32..=0x1FFF_FFFF, proptest::collection::vec(any::<u8>(), 0..=8), 0_u64..100_000),
            0..100,
        ),
    ) {
        let mut rig = Rig::new(1);
        for (raw, data, pause_us) in frames {
            rig.now += Duration::from_micros(pause_us);
            let id = Id::Extended(protocol::ExtendedId::from_low_bits(raw));
            let frame = Frame::new(id, &data).unwrap();
            rig.server.handle_frame(rig.now, &frame);
            rig.host.handle_frame(rig.now, &frame);
            rig.collect();
        }
        rig.run(Duration::from_secs(3));
        let bytes = rig.ask(info::SERVICE, &()).unwrap();
        prop_assert!(NodeInfo::from_bytes(&bytes).is_ok());
    }
}
