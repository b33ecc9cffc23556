//! Scenario files: what they mean, and every way to get them wrong.

use hil_sim::bus::{Recovery, TxOrder};
use hil_sim::checker::Check;
use hil_sim::fault::{FaultKind, PhysicalFault, Place, Target, WireFault, WrongPart};
use hil_sim::scenario::{Problem, Scenario, ScriptedHost, fault_from_line};
use protocol::{Duration, Instant, ModuleId, Node};

const HEAD: &str = "schema_version = 1\nduration_s = 2.0\n";

fn read(body: &str) -> Scenario {
    Scenario::from_toml("test.toml", &format!("{HEAD}{body}")).unwrap_or_else(|error| panic!("{error}"))
}

#[test]
fn full_file_is_read_as_written() {
    let scenario = read(
        r#"
        name = "all of it"
        robot = "powercube6"
        seed = 7
        [bus]
        bit_rate_bit_s = 500_000
        queue_depth = 8
        tx_order = "priority"
        recovery = "on-request"
        [[action]]
        at_s = 0.1
        send = ["0C1#0A62", "0E1#01"]
        every_s = 0.01
        count = 3
        [[fault]]
        kind = "drop"
        target = "module 3"
        id = "0C3"
        id_mask = 0x7FF
        start_s = 0.5
        length_s = 0.25
        every_s = 1
        probability = 0.5
        label = "mine"
        [expect]
        answers_within_s = 0.005
        trips = ["answers"]
        "#,
    );
    assert_eq!((scenario.name.as_str(), scenario.seed), ("all of it", 7));
    assert_eq!(scenario.duration, Duration::from_secs(2));
    assert_eq!(scenario.bus.bit_rate_bit_s, 500_000);
    assert_eq!((scenario.bus.tx_order, scenario.bus.recovery), (TxOrder::Priority, Recovery::OnRequest));
    assert_eq!(scenario.actions[0].frames[1].to_string(), "0E1#01");
    let fault = &scenario.faults[0];
    assert_eq!((fault.label.as_str(), fault.probability), ("mine", 0.5));
    assert_eq!(fault.target, Target::Module(ModuleId::new(3).unwrap()));
    assert_eq!(fault.start, Instant::from_micros(500_000));
    assert_eq!(fault.filter.unwrap().mask, 0x7FF);
    assert_eq!(scenario.expect.trips, [Check::Answers]);
}

#[test]
fn every_kind_of_fault_has_a_form() {
    let m3 = Place::Module(ModuleId::new(3).unwrap());
    let wire = FaultKind::Wire;
    let ms = Duration::from_millis;
    for (body, kind) in [
        ("kind = \"drop\"", wire(WireFault::Drop)),
        ("kind = \"delay\", by_s = 0.002", wire(WireFault::Delay(ms(2)))),
        ("kind = \"duplicate\"", wire(WireFault::Duplicate)),
        ("kind = \"corrupt\"", wire(WireFault::Corrupt)),
        ("kind = \"wrong-answer\", target = \"module 3\"", wire(WireFault::WrongAnswer(WrongPart::Value))),
        (
            "kind = \"wrong-answer\", target = \"bus\", part = \"length\"",
            wire(WireFault::WrongAnswer(WrongPart::Length)),
        ),
        ("kind = \"stuck\", target = \"bus\"", wire(WireFault::StuckDominant)),
        ("kind = \"stuck\", target = \"module 3\"", FaultKind::Physical(m3, PhysicalFault::Frozen)),
        (
            "kind = \"slow\", target = \"module 3\", by_s = 0.004",
            FaultKind::Physical(m3, PhysicalFault::Slow(ms(4))),
        ),
        (
            "kind = \"intermittent\", target = \"module 3\", on_mean_s = 0.1, off_mean_s = 0.02",
            wire(WireFault::Intermittent { on_mean: ms(100), off_mean: ms(20) }),
        ),
        ("kind = \"silent\", target = \"module 3\"", wire(WireFault::Silent)),
        ("kind = \"restart\", target = \"module 3\"", FaultKind::Physical(m3, PhysicalFault::Restart)),
        (
            "kind = \"supply-loss\", target = \"supply 1\", remaining = 0.5",
            FaultKind::Physical(Place::Supply(1), PhysicalFault::SupplyLoss { remaining: 0.5 }),
        ),
        (
            "kind = \"over-current\", target = \"module 3\"",
            FaultKind::Physical(m3, PhysicalFault::OverCurrent),
        ),
        ("kind = \"tow-error\", target = \"module 3\"", FaultKind::Physical(m3, PhysicalFault::Blocked)),
        ("kind = \"hall-error\", target = \"module 3\"", FaultKind::Physical(m3, PhysicalFault::HallError)),
        (
            "kind = \"encoder-error\", target = \"module 3\", offset_deg = 180",
            FaultKind::Physical(m3, PhysicalFault::EncoderOffset { offset_rad: std::f64::consts::PI }),
        ),
        ("kind = \"bus-off\", target = \"module 3\"", wire(WireFault::BusOff)),
        ("kind = \"stuck-gripper\"", FaultKind::Physical(Place::Gripper, PhysicalFault::StuckGripper)),
        (
            "kind = \"late-release\", by_s = 0.005",
            FaultKind::Physical(Place::Gripper, PhysicalFault::LateRelease(ms(5))),
        ),
    ] {
        let fault = fault_from_line(body, 0).unwrap_or_else(|error| panic!("{body}: {error}"));
        assert_eq!(fault.kind, kind, "{body}");
        assert!(body.contains(&format!("\"{}\"", fault.kind_name())), "{body}: {}", fault.kind_name());
    }
    let babble = fault_from_line("kind = \"babble\", frame = \"000#\", period_s = 0.0002", 0).unwrap();
    assert!(
        matches!(babble.kind, FaultKind::Wire(WireFault::Babble { period, .. }) if period.as_micros() == 200)
    );
}

/// (lines after the two head lines, line, key, part of the message)
#[test]
fn every_mistake_names_line_key_and_what_would_be_right() {
    for (body, line, key, message) in [
        ("sed = 1", 3, "sed", "unknown key (known here: schema_version, duration_s"),
        ("seed = -1", 3, "seed", "-1 must not be negative"),
        ("seed = \"x\"", 3, "seed", "expected an integer, found a string"),
        ("name = 3", 3, "name", "expected a string, found an integer"),
        ("bus = 3", 3, "bus", "expected a table, found an integer"),
        ("[bus]\nbit_rate_bit_s = 300_007", 4, "bus.bit_rate_bit_s", "a whole number of nanoseconds"),
        ("[bus]\nbit_rate_bit_s = 2_000_000", 4, "bus.bit_rate_bit_s", "outside 10000 to 1000000"),
        ("[bus]\nqueue = 3", 4, "bus.queue", "known here: bit_rate_bit_s, queue_depth"),
        ("[bus]\ntx_order = \"lifo\"", 4, "bus.tx_order", "unknown value `lifo` (known: fifo, priority)"),
        ("[action]\nat_s = 1", 3, "action", "an array of tables ([[..]])"),
        ("[[action]]\nat_s = 1", 3, "action[0].send", "missing"),
        ("[[action]]\nsend = []", 4, "action[0].send", "at least one frame"),
        ("[[action]]\nsend = \"1234#\"", 4, "action[0].send", "is no frame; write it as 0E5#084F0000803E"),
        ("[[action]]\nsend = [\"0C1#0A62\", 3]", 4, "action[0].send[1]", "expected a string"),
        ("[[action]]\nsend = \"0C1#\"\ncount = 3", 5, "action[0].count", "needs every_s"),
        ("[[action]]\nsend = \"0C1#\"\nevery_s = 0", 5, "action[0].every_s", "a period is above zero"),
        ("[[fault]]\ntarget = \"bus\"", 3, "fault[0].kind", "missing"),
        ("[[fault]]\nkind = \"gremlin\"", 4, "fault[0].kind", "unknown value `gremlin` (known: drop, delay"),
        ("[[fault]]\nkind = \"silent\"", 3, "fault[0].target", "missing"),
        (
            "[[fault]]\nkind = \"silent\"\ntarget = \"joint 3\"",
            5,
            "fault[0].target",
            "write \"bus\", \"module 3\"",
        ),
        ("[[fault]]\nkind = \"silent\"\ntarget = \"module 32\"", 5, "fault[0].target", "is no target"),
        ("[[fault]]\nkind = \"slow\"\ntarget = \"bus\"\nby_s = 1", 5, "fault[0].target", "cannot act on bus"),
        (
            "[[fault]]\nkind = \"supply-loss\"\ntarget = \"module 1\"",
            5,
            "fault[0].target",
            "cannot act on module-1",
        ),
        ("[[fault]]\nkind = \"delay\"", 3, "fault[0].by_s", "missing"),
        ("[[fault]]\nkind = \"drop\"\nprobability = 1.5", 5, "fault[0].probability", "1.5 is outside 0 to 1"),
        (
            "[[fault]]\nkind = \"drop\"\nprobability = nan",
            5,
            "fault[0].probability",
            "NaN is not a finite number",
        ),
        ("[[fault]]\nkind = \"drop\"\nstart_s = -1", 5, "fault[0].start_s", "-1 is outside 0 to"),
        ("[[fault]]\nkind = \"drop\"\nid = \"0x0A3\"", 5, "fault[0].id", "three hexadecimal digits"),
        ("[[fault]]\nkind = \"drop\"\nid_mask = 1", 5, "fault[0].id_mask", "needs id"),
        (
            "[[fault]]\nkind = \"bus-off\"\ntarget = \"module 1\"\nid = \"0A3\"",
            6,
            "fault[0].id",
            "unknown key",
        ),
        ("[[fault]]\nkind = \"babble\"", 3, "fault[0].frame", "missing"),
        (
            "[[fault]]\nkind = \"babble\"\nframe = [\"000#\", \"001#\"]",
            5,
            "fault[0].frame",
            "one frame, not a list",
        ),
        ("[[fault]]\nkind = \"drop\"\nlabel = \"\"", 5, "fault[0].label", "cannot be empty"),
        (
            "[[fault]]\nkind = \"drop\"\nlabel = \"a\"\n[[fault]]\nkind = \"drop\"\nlabel = \"a\"",
            8,
            "fault[1].label",
            "'a' is taken by an earlier fault",
        ),
        (
            "[expect]\ntrips = [\"everything\"]",
            4,
            "expect.trips[0]",
            "unknown value `everything` (known: answers",
        ),
        ("[expect]\nutilisation_max = 2", 4, "expect.utilisation_max", "2 is outside 0 to 1"),
        ("x = [1,", 3, "", "not valid TOML"),
    ] {
        let error = Scenario::from_toml("test.toml", &format!("{HEAD}{body}\n")).unwrap_err();
        assert_eq!((error.line, error.key.as_str()), (Some(line), key), "{body}: {error}");
        let text = error.to_string();
        assert!(text.contains(message), "{body}: {text}");
        assert!(text.starts_with("test.toml:"), "{text}");
    }
}

#[test]
fn version_duration_and_file_are_checked_first() {
    let error = Scenario::from_toml("f", "duration_s = 1").unwrap_err();
    assert_eq!((error.key.as_str(), &error.problem), ("schema_version", &Problem::Missing));
    let error = Scenario::from_toml("f", "schema_version = 2\nnew_key = 1").unwrap_err();
    assert_eq!(error.problem, Problem::Schema { found: 2, supported: 1 });
    let error = Scenario::from_toml("f", "schema_version = 1").unwrap_err();
    assert_eq!((error.key.as_str(), &error.problem), ("duration_s", &Problem::Missing));
    let error = Scenario::load("/nonexistent/x.toml".as_ref()).unwrap_err();
    assert!(error.to_string().starts_with("/nonexistent/x.toml: cannot read the file"), "{error}");
}

#[test]
fn unlabelled_faults_get_labels_that_differ() {
    let scenario = read("[[fault]]\nkind = \"drop\"\n[[fault]]\nkind = \"drop\"");
    assert_eq!(scenario.faults[0].label, "drop bus #1");
    assert_eq!(scenario.faults[1].label, "drop bus #2");
}

#[test]
fn scripted_host_sends_at_its_times_and_as_often_as_it_says() {
    let scenario = read(
        "[[action]]\nat_s = 0.001\nsend = [\"001#\", \"002#\"]\nevery_s = 0.002\ncount = 2\n[[action]]\nat_s = 0.002\nsend = \"003#\"",
    );
    let mut host = ScriptedHost::new(&scenario.actions);
    let mut sent = Vec::new();
    while let Some(at) = host.poll_timeout() {
        host.handle_timeout(at);
        while let Some(frame) = host.poll_frame() {
            sent.push((at.as_micros(), frame.id().raw()));
        }
    }
    assert_eq!(sent, [(1_000, 1), (1_000, 2), (2_000, 3), (3_000, 1), (3_000, 2)]);
}
