//! The files of `robots/kr16_2` agree: programs of the robot, configuration files, descriptions.

use hil_sim::krc::KrcScenario;
use rsi_protocol::{Protocol, Source};

const KR_C2: &str = include_str!("../../../robots/kr16_2/throw_kr_c2.src");
const KR_C4: &str = include_str!("../../../robots/kr16_2/throw_kr_c4.src");

/// The number behind `name[axis] =`.
fn limit(program: &str, name: &str, axis: usize) -> f64 {
    let start = format!("{name}[{axis}] = ");
    let found: Vec<f64> =
        program.lines().filter_map(|line| line.trim().strip_prefix(&start)?.parse().ok()).collect();
    assert_eq!(found.len(), 1, "{start}");
    found[0]
}

/// The first `PTP {A1 ..., A6 ...}`.
fn start_deg(program: &str) -> Vec<f64> {
    let pose = program.split("PTP {").nth(1).and_then(|rest| rest.split('}').next()).expect("a motion");
    pose.split(',')
        .map(|axis| axis.split_whitespace().nth(1).expect("a value").parse().expect("deg"))
        .collect()
}

#[test]
fn start_pose_and_limits_of_the_programs_are_those_of_the_descriptions() {
    for (name, program) in [("kr-c2", KR_C2), ("kr-c2-tcp", KR_C2), ("kr-c4", KR_C4), ("kr-c4-12ms", KR_C4)] {
        let options = KrcScenario::open(name).expect("built in").options;
        assert_eq!(start_deg(program), options.start_deg, "{name}");
        for axis in 1..=6 {
            if name.starts_with("kr-c2") {
                assert_eq!(limit(program, "low", axis), options.correction.lower[axis - 1], "{name} A{axis}");
                assert_eq!(
                    limit(program, "high", axis),
                    options.correction.upper[axis - 1],
                    "{name} A{axis}"
                );
            }
        }
    }
}

#[test]
fn program_of_a_kr_c2_names_both_configuration_files_and_the_numbers_of_their_signals() {
    for (name, file, protocol) in
        [("kr-c2", "rsi_udp.xml", Protocol::Udp), ("kr-c2-tcp", "rsi_tcp.xml", Protocol::Tcp)]
    {
        assert!(KR_C2.contains(file), "{file}");
        let scenario = KrcScenario::open(name).expect("built in");
        assert_eq!(scenario.config.protocol, protocol);
        for (number, signal) in [(7, &scenario.options.outputs_name), (8, &scenario.options.stop_name)] {
            let place = scenario.config.scalar(signal).expect("received");
            assert_eq!(scenario.config.receive[place].source, Source::Object(number), "{signal}");
            assert!(
                KR_C2.contains(&format!("Output {number} of the Ethernet object is {signal}")),
                "{signal}"
            );
        }
        let sensor = scenario.options.sensor_name.as_deref().expect("a sensor");
        let entry = scenario.config.send.iter().find(|entry| entry.tag.to_string() == sensor).expect("sent");
        assert_eq!(entry.source, Source::Object(1));
        assert!(KR_C2.contains(&format!("input 1 of the Ethernet object ({sensor})")));
    }
}

#[test]
fn program_of_a_kr_c2_stops_before_it_moves_until_its_outputs_are_wired() {
    let place = |what: &str| KR_C2.find(what).unwrap_or_else(|| panic!("{what}"));
    assert!(place("wired = FALSE") < place("IF NOT wired THEN\n    HALT") && place("HALT") < place("PTP {"));
}
