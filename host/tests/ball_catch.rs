//! `cubectl catch --ball`: what is printed and with which code it ends.

use std::process::Output;

use crate::program;

fn cubectl(words: &str) -> Output {
    program::cubectl_line(words, &[])
}

#[test]
fn a_ball_thrown_to_the_arm_is_caught_and_reported_as_json_and_as_a_page() {
    let file = std::env::temp_dir().join(format!("ball-{}.html", std::process::id()));
    let words = "catch --robot powercube6 --ball 2.0,0.1,0.2,-2.3,-0.1,3.4 --json --report";
    let ended = cubectl(&format!("{words} {}", file.display()));
    assert!(ended.status.success(), "{ended:?}");
    let reported: serde_json::Value = serde_json::from_slice(&ended.stdout).unwrap();
    assert_eq!(reported["caught"], true);
    assert!(reported["crossing"]["miss_m"].as_f64().unwrap() < 0.04);
    assert!(!reported["decisions"].as_array().unwrap().is_empty());
    // The ball waits where it begins: nothing carries it there in a leap.
    let path = reported["trace"]["ball_m"].as_array().unwrap();
    let place = |at: &serde_json::Value| [0, 1, 2].map(|k| at[k].as_f64().unwrap());
    let step = |pair: &[serde_json::Value]| {
        let (a, b) = (place(&pair[0]), place(&pair[1]));
        (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt()
    };
    assert!(path.windows(2).map(step).fold(0.0, f64::max) < 0.06, "8 ms at 7 m/s");
    let page = std::fs::read_to_string(&file).unwrap();
    assert!(page.contains("Catching a ball") && page.contains("Decisions"));
    std::fs::remove_file(file).unwrap();
}

#[test]
fn a_ball_out_of_reach_is_declined_with_the_reason_and_a_next_step() {
    let ended = cubectl("catch --robot powercube6 --ball 2.0,0,0.2,1,0,1");
    assert_eq!(ended.status.code(), Some(i32::from(host::exit::NO_THROW)));
    let reported = String::from_utf8_lossy(&ended.stderr).into_owned();
    assert!(reported.contains("within the arm's reach") && reported.contains("next:"), "{reported}");
}

/// The ball of the first test. The arm catches it unless it counts on a cup of hard rubber.
#[test]
fn a_ball_that_would_bounce_out_of_a_hand_at_rest_is_declined_with_the_reason_and_a_next_step() {
    let words = "catch --robot powercube6 --ball 2.0,0.1,0.2,-2.3,-0.1,3.4 --hand hold";
    assert!(cubectl(words).status.success());
    let ended = cubectl(&format!("{words} --restitution 0.85"));
    assert_eq!(ended.status.code(), Some(i32::from(host::exit::NO_THROW)));
    let reason = String::from_utf8_lossy(&ended.stderr).into_owned();
    assert!(reason.contains("bounce out of the cup") && reason.contains("next:"), "{reason}");
}

/// Balls that an arm catches that knows them earlier: with eyes only the time is too short, and a posture there is.
#[test]
fn a_ball_that_is_seen_too_late_is_not_refused_for_want_of_a_posture() {
    for ball in [
        "1.738,0.155,0.273,-2.930,0.382,2.595",
        "2.004,-0.041,0.376,-3.206,1.001,2.354",
        "1.920,-0.062,0.080,-2.879,0.102,4.276",
    ] {
        let known = cubectl(&format!("catch --ball {ball} --cooperative"));
        assert!(known.status.success(), "{ball}: {known:?}");
        let ended = cubectl(&format!("catch --ball {ball}"));
        let reason = String::from_utf8_lossy(&ended.stderr).into_owned();
        assert_eq!(ended.status.code(), Some(i32::from(host::exit::NO_THROW)), "{ball}: {reason}");
        assert!(reason.contains("time left is too short"), "{ball}: {reason}");
    }
}

/// From behind the place where the other arm of the built-in cell stands.
#[test]
fn no_other_arm_stands_in_the_way_unless_a_cell_was_asked_for_and_then_it_is_named() {
    let words = "catch --ball 3.3,0,0.2,-3.6,0,3.0 --json";
    let hits = |json: &[u8]| {
        let reported: serde_json::Value = serde_json::from_slice(json).unwrap();
        let events = reported["events"].as_array().unwrap().clone();
        assert!(!reported["trace"]["ball_m"].as_array().unwrap().is_empty());
        assert_eq!(reported["trace"]["q_rad"][0].as_array().unwrap().len(), 6);
        events.iter().filter(|event| event["arm"] == "thrower").count()
    };
    assert_eq!(hits(&cubectl(words).stdout), 0);
    let cell = concat!(env!("CARGO_MANIFEST_DIR"), "/../hil-sim/src/two_arms/two_arms.toml");
    assert!(hits(&cubectl(&format!("{words} --cell {cell}")).stdout) > 0);
    let text = cubectl(&format!("catch --ball 3.3,0,0.2,-3.6,0,3.0 --cell {cell}"));
    let text = String::from_utf8_lossy(&text.stdout).into_owned();
    assert!(text.contains("the ball hit the other arm"), "{text}");
}

#[test]
fn a_ball_that_is_never_released_ends_as_not_released() {
    for cooperative in ["", " --cooperative"] {
        let ended =
            cubectl(&format!("catch --ball 2.0,0.1,0.2,-2.3,-0.1,3.4 --fault not-released{cooperative}"));
        assert_eq!(ended.status.code(), Some(i32::from(host::exit::NOT_RELEASED)), "{ended:?}");
    }
}

#[test]
fn wrong_input_is_refused_with_its_code() {
    for (words, code) in [
        ("catch --robot pincher4 --ball 2,0,0.2,-2,0,3", host::exit::BAD_INPUT),
        ("catch --ball 2,0,0.2,-2,0,300", host::exit::BAD_INPUT),
        ("catch --ball 2,0,0.2", host::exit::USAGE),
        ("catch --disc flat --cooperative", host::exit::USAGE),
        ("catch --disc flat --on-controller --no-limits", host::exit::USAGE),
    ] {
        let ended = cubectl(words);
        assert_eq!(ended.status.code(), Some(i32::from(code)), "{words}: {ended:?}");
    }
}

#[test]
fn a_verb_that_is_in_cubelab_now_says_so_with_the_same_words() {
    for words in ["rally --throws 4 --seed 2", "swarm --help", "rally"] {
        let ended = cubectl(words);
        assert_eq!(ended.status.code(), Some(i32::from(host::exit::USAGE)), "{ended:?}");
        let message = String::from_utf8_lossy(&ended.stderr).into_owned();
        let next = format!("next: `cargo run --release -p lab --bin cubelab -- {words}`");
        assert!(message.contains("is in cubelab now") && message.contains(&next), "{message}");
    }
    let help = String::from_utf8(cubectl("--help").stdout).unwrap();
    assert!(!help.contains("rally") && !help.contains("swarm"), "{help}");
}

#[test]
fn a_catch_on_a_bus_is_refused_with_the_reason_where_it_makes_no_sense() {
    let folder = std::env::temp_dir().join(format!("catch-bus-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let point = |robot_m: [f64; 3], room_m: [f64; 3]| {
        format!("[[point]]\nrobot_m = {robot_m:?}\nroom_m = {room_m:?}\nscatter_m = 0.0\n")
    };
    let corners = [[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.5, 0.5, 1.0], [1.0, 1.0, 0.2]];
    let write = |name: &str, robot: &str, room: &dyn Fn([f64; 3]) -> [f64; 3]| {
        let points: String = corners.iter().map(|at| point(*at, room(*at))).collect();
        let file = folder.join(name);
        std::fs::write(
            &file,
            format!(
                "schema_version = 1\nrobot = \"{robot}\"\nsource = \"test\"\nchanged = \"today\"\n{points}"
            ),
        )
        .unwrap();
        file.display().to_string()
    };
    let other = write("other.toml", "kr16_2", &|at| at);
    // The room lies on its side.
    let leans = write("leans.toml", "powercube6", &|[x, y, z]| [x, -z, y]);
    for (words, code, reason) in [
        ("--bus sim --tracker 127.0.0.1:0".to_owned(), host::exit::BAD_INPUT, "nobody throws"),
        ("--bus can77".to_owned(), host::exit::USAGE, "--tracker"),
        ("--bus can77 --tracker 127.0.0.1:0 --ball 2,0,0,-2,0,3".to_owned(), host::exit::USAGE, "--ball"),
        ("--bus can77 --tracker 127.0.0.1:0 --fault bias:2".to_owned(), host::exit::USAGE, "--fault"),
        ("--bus can77 --tracker 127.0.0.1:0".to_owned(), host::exit::USAGE, "--yes"),
        ("--bus can77 --tracker 127.0.0.1:0 --yes --robot pincher4".to_owned(), host::exit::BAD_INPUT, "six"),
        (
            format!("--bus can77 --tracker 127.0.0.1:0 --yes --calibration {other}"),
            host::exit::BAD_INPUT,
            "is for the robot kr16_2",
        ),
        (
            format!("--bus can77 --tracker 127.0.0.1:0 --yes --calibration {leans}"),
            host::exit::BAD_INPUT,
            "leans by 90.0 degrees",
        ),
    ] {
        let ended = cubectl(&format!("catch {words}"));
        let reported = String::from_utf8_lossy(&ended.stderr).into_owned();
        assert_eq!(ended.status.code(), Some(i32::from(code)), "{words}: {reported}");
        assert!(reported.contains(reason), "{words}: {reported}");
    }
    std::fs::remove_dir_all(folder).unwrap();
}

/// What viewers show is what `--json` prints: joints of the catcher, and the ball or the disc.
#[test]
fn a_recording_of_a_catch_has_the_joints_and_the_ball_or_disc_of_its_json() {
    let path = std::env::temp_dir().join(format!("recorded-catch-{}", std::process::id()));
    let file = path.with_extension("mcap");
    let catches = [
        ("catch --ball 2.0,0.1,0.2,-2.3,-0.1,3.4", "/ball", "/trace", "ball_m"),
        ("catch --disc flat --on-controller", "/disc", "/executed/trace", "disc_m"),
    ];
    for (words, topic, trace, place) in catches {
        let ended = cubectl(&format!("{words} --json --record {}", path.display()));
        assert!(ended.status.success(), "{words}: {ended:?}");
        let json: serde_json::Value = serde_json::from_slice(&ended.stdout).unwrap();
        let trace = json.pointer(trace).unwrap();
        let bytes = std::fs::read(&file).unwrap();
        let messages: Vec<_> = mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap).collect();
        let of = |topic: &str| {
            messages.iter().filter(|message| message.channel.topic == topic).collect::<Vec<_>>()
        };
        let (joints, thrown) = (of("/joints"), of(topic));
        let (q_rad, p_m) = (trace["q_rad"].as_array().unwrap(), trace[place].as_array().unwrap());
        assert!(q_rad.len() > 100);
        assert_eq!([joints.len(), thrown.len()], [q_rad.len(), p_m.len()], "{words}");
        // Numbers are doubles in their eight bytes.
        let holds = |data: &[u8], value: &serde_json::Value| {
            let bytes = value.as_f64().unwrap().to_le_bytes();
            bytes == [0; 8] || data.windows(8).any(|window| window == bytes)
        };
        for k in (0..q_rad.len()).step_by(17) {
            assert!(q_rad[k].as_array().unwrap().iter().all(|q| holds(&joints[k].data, q)), "{words}: {k}");
            assert!(p_m[k].as_array().unwrap().iter().all(|x| holds(&thrown[k].data, x)), "{words}: {k}");
        }
        let again = cubectl(&format!("{words} --record {}", path.display()));
        assert!(!again.status.success(), "a file that exists is not overwritten");
        std::fs::remove_file(&file).unwrap();
    }
    let ended = cubectl(&format!("catch --disc flat --record {}", path.display()));
    assert_eq!(ended.status.code(), Some(i32::from(host::exit::USAGE)), "no controller moves a joint");
}
