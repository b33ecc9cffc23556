//! `hil-sim serve-krc` as a program.

use std::net::UdpSocket;
use std::process::{Command, Output, Stdio};
use std::thread::JoinHandle;

use crate::krc_rig::between;

/// Answers every telegram with zeros until an empty datagram comes; gives its address.
fn client() -> (String, JoinHandle<()>) {
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let address = socket.local_addr().unwrap().to_string();
    let run = move || {
        let mut buffer = [0; 2048];
        while let Ok((length @ 1.., from)) = socket.recv_from(&mut buffer) {
            let text = String::from_utf8_lossy(&buffer[..length]).into_owned();
            let ipoc = between(&text, "<IPOC>", "</IPOC>").unwrap();
            let zeros = "A1=\"0\" A2=\"0\" A3=\"0\" A4=\"0\" A5=\"0\" A6=\"0\"";
            let answer =
                format!("<Sen Type=\"ImFree\"><AKorr {zeros}/><DiO>1</DiO><IPOC>{ipoc}</IPOC></Sen>");
            let _ = socket.send_to(answer.as_bytes(), from);
        }
    };
    (address, std::thread::spawn(run))
}

fn hil_sim(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_hil-sim"));
    command.arg("serve-krc").args(arguments).stdin(Stdio::null()).output().unwrap()
}

fn scenario(name: &str) -> String {
    format!("{}/scenarios/krc/{name}", env!("CARGO_MANIFEST_DIR"))
}

#[test]
fn lock_step_run_reports_as_json_and_writes_the_same_log_twice() {
    let folder = std::env::temp_dir().join(format!("serve-krc-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let log = folder.join("log");
    let mut logs = Vec::new();
    for _ in 0..2 {
        let (pc, client) = client();
        let scenario = scenario("kr_c2.toml");
        let places = ["--scenario", &scenario, "--pc", &pc, "--log", log.to_str().unwrap()];
        let output = hil_sim(&[&places[..], &["--lock-step", "--cycles", "300", "--json"]].concat());
        UdpSocket::bind("127.0.0.1:0").unwrap().send_to(&[], &pc).unwrap();
        client.join().unwrap();
        assert!(output.status.success(), "{output:?}");
        let text = String::from_utf8(output.stdout).unwrap();
        let report: serde_json::Value = serde_json::from_str(text.lines().last().unwrap()).unwrap();
        assert_eq!((&report["event"], &report["telegrams"]), (&"report".into(), &300.into()), "{text}");
        assert_eq!(
            (&report["late"], &report["refused"], &report["fault"]),
            (&0.into(), &0.into(), &().into())
        );
        // The ball falls from the hand at rest: straight down.
        let (x, z) = (report["landing_m"][0].as_f64().unwrap(), report["landing_m"][2].as_f64().unwrap());
        assert!((x - 0.93).abs() < 1e-6 && z.abs() < 1e-9, "{text}");
        logs.push(std::fs::read_to_string(&log).unwrap());
    }
    assert_eq!(logs[0], logs[1]);
    assert_eq!(logs[0].matches(" cycle ").count(), 300);
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn failures_have_their_exit_codes_and_a_next_step() {
    let (pc, client) = client();
    // No client listens on this port; UDP does not report that, TCP does.
    let output = hil_sim(&["--scenario", &scenario("kr_c2_tcp.toml"), "--pc", "127.0.0.1:1", "--lock-step"]);
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(5), "{text}");
    assert!(
        text.contains("127.0.0.1:1 cannot be reached") && text.contains("next: start the client first"),
        "{text}"
    );
    let output = hil_sim(&["--scenario", &scenario("nothing.toml")]);
    assert_eq!(output.status.code(), Some(4), "{output:?}");
    let output = hil_sim(&["--scenario", &scenario("kr_c2.toml"), "--pc", "nonsense"]);
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(5));
    assert!(text.contains("next: give --pc HOST:PORT"), "{text}");
    // A fault ends the run with its own code.
    let folder = std::env::temp_dir().join(format!("serve-krc-fault-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::copy(scenario("axis_absolute.xml"), folder.join("axis_absolute.xml")).unwrap();
    let text = std::fs::read_to_string(scenario("kr_c2.toml")).unwrap();
    let faulty = folder.join("faulty.toml");
    std::fs::write(&faulty, format!("{text}\n[[fault]]\nkind = \"cut-out\"\nstart_s = 1.0\n")).unwrap();
    let output = hil_sim(&["--scenario", faulty.to_str().unwrap(), "--pc", &pc, "--lock-step"]);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert_eq!(output.status.code(), Some(3), "{text}");
    assert!(text.contains("fault: drives cut out by the scenario"), "{text}");
    std::fs::remove_dir_all(&folder).unwrap();
    UdpSocket::bind("127.0.0.1:0").unwrap().send_to(&[], &pc).unwrap();
    client.join().unwrap();
}
