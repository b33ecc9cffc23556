//! Scenario files of the simulated controller.

use std::path::{Path, PathBuf};

use hil_sim::krc::options::{KrcOptions, Space};
use hil_sim::krc::{Direction, KrcScenario, LinkFault, LinkFaultKind, RobotFault};
use protocol::{Duration, Instant};
use rsi_protocol::{Generation, Protocol};

const CONFIG: &str = include_str!("../scenarios/krc/axis_absolute.xml");

fn read(text: &str) -> Result<KrcScenario, String> {
    KrcScenario::from_toml("a.toml", text, |name| {
        assert_eq!(name, "c.xml");
        Ok(CONFIG.to_owned())
    })
    .map_err(|error| error.to_string())
}

const HEAD: &str = "schema_version = 1\ngeneration = \"kr-c2\"\nrsi_config = \"c.xml\"\n";

#[test]
fn scenarios_that_come_with_the_program_make_a_controller() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/krc");
    let expected = [
        ("kr_c2", Generation::KrC2, Protocol::Udp, 12),
        ("kr_c2_tcp", Generation::KrC2, Protocol::Tcp, 12),
        ("kr_c4", Generation::KrC4, Protocol::Udp, 4),
    ];
    for (name, generation, protocol, cycle_ms) in expected {
        let path: PathBuf = folder.join(format!("{name}.toml"));
        let scenario = KrcScenario::load(&path).unwrap_or_else(|error| panic!("{error}"));
        let options =
            scenario.controller().unwrap_or_else(|error| panic!("{name}: {error}")).options().clone();
        assert_eq!((options.generation, scenario.config.protocol), (generation, protocol));
        assert_eq!(options.cycle, Duration::from_millis(cycle_ms));
        assert_eq!(options.correction.space, Space::Axes);
    }
}

#[test]
fn file_with_the_required_keys_only_has_the_defaults() {
    let scenario = read(HEAD).unwrap();
    assert_eq!(scenario.options, KrcOptions::new(Generation::KrC2));
    assert_eq!((scenario.robot.as_str(), scenario.seed), ("kr16_2", 0));
    assert!(scenario.link_faults.is_empty() && scenario.robot_faults.is_empty());
}

#[test]
fn every_key_is_read() {
    let text = format!(
        "{HEAD}robot = \"r\"\nseed = 9\n[controller]\ncycle_s = 0.008\nwindow_s = 0.002\nipoc_start = 5\ndecimals = 6\n\
         tcp_line_feeds = 2\nstrict_type = false\nstart_deg = [1, 2, 3, 4, 5, 6]\noutputs = \"O\"\nstop = \"S\"\n\
         [correction]\nspace = \"tool\"\nrelative = true\nlower = [-1, -2, -3, -4, -5, -6]\nupper = [1, 2, 3, 4, 5, 6]\n\
         overall_axis_deg = 7\noverall_mm = 8\noverall_rotation_deg = 9\n\
         [late]\nlimit = 3\nconsecutive = true\npercent = 20\nfield_of_view = 50\npercent_stops = true\n\
         [drives]\ndead_time_s = 0.05\ntime_constant_s = 0\nsmoothing_cycles = 4\nnoise_deg = 0.1\n\
         [cut_out]\nvelocity_deg_s = [1, 1, 1, 1, 1, 1]\nbase_s = 0.024\nacceleration_deg_s2 = [2, 2, 2, 2, 2, 2]\n\
         jerk_deg_s3 = [3, 3, 3, 3, 3, 3]\nbraking_deg_s2 = 4\n\
         [gripper]\noutput_bit = 3\ndelay_s = 0.03\njitter_s = 0.001\ndrag_1_m = 0.1\nlanding_z_m = 0.6\n\
         [network]\ndelay_s = 0.0001\njitter_s = 0.0002\n\
         [[fault]]\nkind = \"late\"\ndirection = \"to-robot\"\nby_s = 0.02\nstart_s = 1\nlength_s = 2\nprobability = 0.5\n\
         [[fault]]\nkind = \"wrong-ipoc\"\ndirection = \"to-client\"\nby = -4\n\
         [[fault]]\nkind = \"without-axes\"\ndirection = \"to-client\"\n\
         [[fault]]\nkind = \"cut-out\"\nstart_s = 3\n[[fault]]\nkind = \"restart\"\nstart_s = 4\npause_s = 0.1\n"
    );
    let scenario = read(&text).unwrap();
    let o = &scenario.options;
    assert_eq!((o.cycle, o.window, o.ipoc_start), (Duration::from_millis(8), Duration::from_millis(2), 5));
    assert_eq!((o.decimals, o.tcp_line_feeds, o.strict_type), (6, 2, false));
    assert_eq!((o.outputs_name.as_str(), o.stop_name.as_str(), o.start_deg[5]), ("O", "S", 6.0));
    assert_eq!((o.correction.space, o.correction.relative), (Space::Tool, true));
    assert_eq!((o.correction.lower[0], o.correction.upper[5]), (-1.0, 6.0));
    let overall = (o.correction.overall_axis_deg, o.correction.overall_mm, o.correction.overall_rotation_deg);
    assert_eq!(overall, (7.0, 8.0, 9.0));
    assert_eq!((o.late.limit, o.late.consecutive, o.late.percent), (3, true, 20.0));
    assert_eq!((o.late.field_of_view, o.late.percent_stops), (50, true));
    assert_eq!((o.lag.dead_time, o.lag.time_constant), (Duration::from_millis(50), Duration::ZERO));
    assert_eq!((o.lag.smoothing_cycles, o.lag.noise_deg), (4, 0.1));
    assert_eq!((o.cut_out.velocity_deg_s, o.cut_out.base), (Some([1.0; 6]), Duration::from_millis(24)));
    assert_eq!((o.cut_out.acceleration_deg_s2, o.cut_out.jerk_deg_s3), ([2.0; 6], [3.0; 6]));
    assert_eq!((o.cut_out.braking_deg_s2, o.hand.output_bit), (4.0, Some(3)));
    let g = o.hand.gripper;
    assert_eq!((g.delay, g.jitter), (Duration::from_millis(30), Duration::from_millis(1)));
    assert_eq!((g.drag_1_m, g.landing_z_m), (Some(0.1), Some(0.6)));
    assert_eq!(scenario.network.delay + scenario.network.jitter, Duration::from_micros(300));
    let at = |s| Instant::ZERO + Duration::from_secs(s);
    let late = LinkFault {
        kind: LinkFaultKind::Late(Duration::from_millis(20)),
        direction: Direction::ToRobot,
        from: at(1),
        until: at(3),
        probability: 0.5,
    };
    let wrong = LinkFault {
        kind: LinkFaultKind::WrongIpoc(-4),
        direction: Direction::ToClient,
        from: at(0),
        until: Instant::FAR_FUTURE,
        probability: 1.0,
    };
    let bare = LinkFault { kind: LinkFaultKind::WithoutAxes, ..wrong };
    assert_eq!(scenario.link_faults, [late, wrong, bare]);
    let restart = RobotFault::Restart { at: at(4), pause: Duration::from_millis(100) };
    assert_eq!(scenario.robot_faults, [RobotFault::CutOut { at: at(3) }, restart]);
}

#[test]
fn wrong_files_are_refused_with_file_line_and_key() {
    let table = [
        ("[late]\nlimits = 3", "a.toml:5: late.limits"),
        ("[drives]\ndead_time_s = -1", "a.toml:5: drives.dead_time_s"),
        ("[correction]\nspace = \"world\"", "a.toml:5: correction.space"),
        ("[controller]\nstart_deg = [1, 2]", "a.toml:5: controller.start_deg"),
        ("[[fault]]\nkind = \"late\"\ndirection = \"to-robot\"", "a.toml:4: fault[0].by_s: missing"),
        ("[[fault]]\nkind = \"lost\"", "a.toml:4: fault[0].direction: missing"),
        ("[[fault]]\nkind = \"cut-out\"\ndirection = \"to-robot\"", "a.toml:6: fault[0].direction"),
        ("[[fault]]\nkind = \"cut-out\"\nprobability = 0.5", "a.toml:6: fault[0].probability"),
    ];
    for (text, begins) in table {
        let error = read(&format!("{HEAD}{text}\n")).unwrap_err();
        assert!(error.starts_with(begins), "{text}\n{error}");
    }
    let tcp = KrcScenario::from_toml(
        "a.toml",
        &format!("{HEAD}[[fault]]\nkind = \"reordered\"\ndirection = \"to-robot\"\n"),
        |_| Ok(CONFIG.replace("UDP", "TCP")),
    );
    let error = tcp.unwrap_err().to_string();
    assert!(error.contains("TCP keeps the order"), "{error}");
    let broken = KrcScenario::from_toml("a.toml", HEAD, |_| Ok(CONFIG.replace("49152", "0")));
    let error = broken.unwrap_err().to_string();
    assert!(error.starts_with("a.toml:3: rsi_config: c.xml: line 6: PORT is '0'"), "{error}");
}

#[test]
fn description_of_every_controller_that_comes_with_the_program_reads_back() {
    for name in ["kr-c2", "kr-c2-tcp", "kr-c4", "kr-c4-12ms"] {
        let scenario = KrcScenario::open(name).unwrap_or_else(|error| panic!("{error}"));
        scenario.controller().unwrap_or_else(|error| panic!("{name}: {error}"));
        let text = scenario.description("one line\nand another", "c.xml");
        let again = KrcScenario::from_toml("b.toml", &text, |_| Ok(scenario.config_text.clone())).unwrap();
        assert_eq!((again.options, again.config), (scenario.options, scenario.config), "{name}");
    }
    assert!(KrcScenario::open("no-such-robot.toml").is_err());
}
