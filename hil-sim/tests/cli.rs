//! The program from the command line: verbs, exit codes, messages for errors.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::PathBuf;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

fn hil_sim(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_hil-sim")).args(args).stdin(Stdio::null()).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// A file of this test's own, in cargo's folder for such files.
fn file(name: &str, content: &str) -> PathBuf {
    let path = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(name);
    std::fs::write(&path, content).unwrap();
    path
}

const POLL: &str = "schema_version = 1\nname = \"poll\"\nduration_s = 0.1\nseed = 5\n[[action]]\nsend = [\"0C1#0A62\", \"0C6#0A1D\"]\nevery_s = 0.01\n[expect]\nanswers_within_s = 0.005\n";

#[test]
fn run_prints_a_report_writes_a_log_and_repeats_itself() {
    let scenario = file("poll.toml", POLL);
    let logs: Vec<Vec<u8>> = ["a.log", "b.log"]
        .iter()
        .map(|name| {
            let log = file(name, "");
            let out = hil_sim(&["run", scenario.to_str().unwrap(), "--log", log.to_str().unwrap()]);
            assert!(out.status.success(), "{}", text(&out.stderr));
            assert!(text(&out.stdout).contains("check answers: held"), "{}", text(&out.stdout));
            assert!(text(&out.stderr).contains("seed 5"));
            std::fs::read(log).unwrap()
        })
        .collect();
    assert!(logs[0] == logs[1]);
    let lines = text(&logs[0]);
    assert!(lines.lines().count() >= 38, "{lines}");
    assert!(lines.lines().any(|line| line.contains(" can0 0A6#0A1D1935")), "{lines}");
}

#[test]
fn json_report_is_json_and_carries_the_seed() {
    let scenario = file("json.toml", POLL);
    let out = hil_sim(&["run", scenario.to_str().unwrap(), "--json", "--seed", "77"]);
    let report: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
    assert_eq!(report["seed"], 77);
    assert_eq!(report["checks"][0]["violations"], 0);
    assert!(report["bus"]["utilisation"].as_f64().is_some_and(|u| (0.01..0.2).contains(&u)));
    assert_eq!(report["drives"].as_array().map(Vec::len), Some(6));
}

#[test]
fn broken_check_ends_with_code_3_and_one_that_must_break_with_0() {
    let silent = "[[fault]]\nkind = \"silent\"\ntarget = \"module 1\"\n";
    let broken = file("broken.toml", &format!("{POLL}{silent}"));
    let out = hil_sim(&["run", broken.to_str().unwrap()]);
    assert_eq!(out.status.code(), Some(3));
    assert!(text(&out.stdout).contains("check answers: BROKE"), "{}", text(&out.stdout));
    let demanded = file("demanded.toml", &format!("{POLL}trips = \"answers\"\n{silent}"));
    assert_eq!(hil_sim(&["run", demanded.to_str().unwrap()]).status.code(), Some(0));
    let missed = file("missed.toml", &format!("{POLL}trips = \"answers\"\n"));
    let out = hil_sim(&["run", missed.to_str().unwrap()]);
    assert_eq!(out.status.code(), Some(3));
    assert!(text(&out.stdout).contains("HELD, BUT MUST BREAK"));
}

#[test]
fn swarm_runs_its_seeds_and_prints_options_of_a_single_one() {
    let out = hil_sim(&["swarm", "--seeds", "20", "--first", "100", "--duration-s", "0.1"]);
    assert!(out.status.success(), "{}", text(&out.stdout));
    assert!(text(&out.stdout).contains("20 seeds of 0.1 s"), "{}", text(&out.stdout));
    let out = hil_sim(&["swarm", "--seeds", "1", "--first", "7", "--duration-s", "0.05"]);
    assert!(text(&out.stdout).contains("seed 7: Scenario {"), "{}", text(&out.stdout));
}

#[test]
fn every_mistake_has_its_code_and_says_where() {
    let bad_key = file("bad_key.toml", "schema_version = 1\nduration_s = 1\n[bus]\nspeed = 3\n");
    let bad_drive = file("bad_drive.toml", "schema_version = 1\nduration_s = 1\n[drive]\nboot_time_s = -1\n");
    let no_module = file(
        "no_module.toml",
        "schema_version = 1\nduration_s = 1\n[[fault]]\nkind = \"silent\"\ntarget = \"module 20\"\n",
    );
    let no_supply = file(
        "no_supply.toml",
        "schema_version = 1\nduration_s = 1\n[[fault]]\nkind = \"supply-loss\"\ntarget = \"supply 9\"\n",
    );
    let no_robot = file("no_robot.toml", "schema_version = 1\nduration_s = 1\nrobot = \"r2d2\"\n");
    let p = |path: &PathBuf| path.to_str().unwrap().to_owned();
    for (args, code, message) in [
        (vec!["run".to_owned(), "/no/such.toml".into()], 4, "/no/such.toml: cannot read the file"),
        (vec!["run".into(), p(&bad_key)], 4, "bad_key.toml:4: bus.speed: unknown key"),
        (vec!["run".into(), p(&bad_drive)], 4, "bad_drive.toml:4: drive.boot_time_s: -1 is outside 0"),
        (vec!["run".into(), p(&no_module)], 4, "no module 20 on this bus"),
        (vec!["run".into(), p(&no_supply)], 4, "the robot has no such supply"),
        (vec!["run".into(), p(&no_robot)], 4, "r2d2"),
        (vec!["serve".into(), "--bus".into(), "novcan9".into()], 5, "novcan9"),
        (vec!["serve".into(), "--bus".into(), "tcp://x".into()], 2, "no kind of bus"),
        (vec!["serve".into(), "--bus".into(), "sim".into()], 5, "'sim' is the cell inside this program"),
        (vec!["dance".into()], 2, "unrecognized subcommand"),
    ] {
        let args: Vec<&str> = args.iter().map(String::as_str).collect();
        let out = hil_sim(&args);
        assert_eq!(out.status.code(), Some(code), "{args:?}: {}", text(&out.stderr));
        assert!(text(&out.stderr).contains(message), "{args:?}: {}", text(&out.stderr));
    }
}

#[test]
fn serve_answers_a_socketcand_client_takes_typed_faults_and_ends_cleanly() {
    let mut server = Command::new(env!("CARGO_BIN_EXE_hil-sim"))
        .args(["serve", "--bus", "socketcand://127.0.0.1:0/can0", "--json", "--duration-s", "60"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(server.stdout.take().unwrap()).lines();
    let first = lines.next().unwrap().unwrap();
    let address =
        first.split("socketcand://").nth(1).and_then(|rest| rest.split('/').next()).unwrap().to_owned();
    let mut client = TcpStream::connect(&address).unwrap();
    // Only a hang lasts as long.
    client.set_read_timeout(Some(Duration::from_secs(120))).unwrap();
    let mut heard = String::new();
    let mut until = |client: &mut TcpStream, wanted: &str| {
        let mut chunk = [0; 512];
        while !heard.contains(wanted) {
            match client.read(&mut chunk) {
                Ok(count) if count > 0 => heard.push_str(&text(&chunk[..count])),
                other => panic!("waiting for {wanted}: {other:?}, heard {heard}"),
            }
        }
        heard.clear();
    };
    until(&mut client, "< hi >");
    client.write_all(b"< open can0 >").unwrap();
    until(&mut client, "< ok >");
    client.write_all(b"< rawmode >").unwrap();
    until(&mut client, "< ok >");
    client.write_all(b"< send 0C6 2 0A 1D >").unwrap();
    until(&mut client, "0A1D1935 >");

    let mut input = server.stdin.take().unwrap();
    writeln!(input, "fault kind = \"silent\", target = \"module 6\"").unwrap();
    let taken = lines.by_ref().map(Result::unwrap).find(|line| line.contains("\"fault\"")).unwrap();
    assert!(taken.contains("silent module-6"), "{taken}");
    writeln!(input, "fault kind = \"gremlin\"").unwrap();
    let refused = lines.by_ref().map(Result::unwrap).find(|line| line.contains("\"refused\"")).unwrap();
    assert!(refused.contains("unknown value `gremlin`"), "{refused}");
    client.write_all(b"< send 0C6 2 0A 1D >< send 0C5 2 0A 1D >").unwrap();
    // Module 5 answers, module 6 does not.
    until(&mut client, "< frame 0A5");

    writeln!(input, "quit").unwrap();
    let report = lines.map(Result::unwrap).last().unwrap();
    let report: serde_json::Value = serde_json::from_str(&report).unwrap();
    assert_eq!(report["event"], "report");
    assert_eq!(report["latency_us"]["count"], 2);
    assert!(server.wait().unwrap().success());
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_behind_standard_output_is_reported_with_the_code_of_output() {
    let full = std::fs::File::options().write(true).open("/dev/full").unwrap();
    let ended = Command::new(env!("CARGO_BIN_EXE_hil-sim"))
        .arg("faults")
        .stdout(full)
        .stderr(Stdio::piped())
        .output()
        .unwrap();
    assert_eq!(ended.status.code(), Some(7));
    assert!(String::from_utf8_lossy(&ended.stderr).contains("standard output is not whole"), "{ended:?}");
}

/// An hour of simulated time whose report goes to `stdout`. It handles signals once it has printed what it runs.
fn long_run(name: &str, stdout: Stdio) -> Child {
    let hour = file(name, &POLL.replace("duration_s = 0.1", "duration_s = 3600"));
    let mut run = Command::new(env!("CARGO_BIN_EXE_hil-sim"));
    let mut child = run.arg("run").arg(hour).stdout(stdout).stderr(Stdio::piped()).spawn().unwrap();
    let mut said = String::new();
    BufReader::new(child.stderr.as_mut().unwrap()).read_line(&mut said).unwrap();
    assert!(said.contains("seed 5"), "{said}");
    child
}

fn signal(name: &str, pids: &[String]) {
    // `kill` fails if the process has already ended.
    let _ = Command::new("kill").arg(name).args(pids).stderr(Stdio::null()).status();
}

#[test]
fn signals_that_come_together_end_a_run_in_order_with_its_report() {
    // Not SIGHUP: it stays ignored where the tests run under `nohup`.
    for name in ["-INT", "-TERM"] {
        let child = long_run(&format!("together{name}.toml"), Stdio::piped());
        signal(name, &vec![child.id().to_string(); 40]);
        let out = child.wait_with_output().unwrap();
        assert_eq!(out.status.code(), Some(0), "{name}: {}", text(&out.stderr));
        assert!(text(&out.stdout).contains("stopped by a signal at "), "{name}: {}", text(&out.stdout));
    }
}

/// No program reads the report, and the pipe for it is full: the run cannot end by itself.
#[cfg(target_os = "linux")]
#[test]
fn a_signal_half_a_second_after_the_first_ends_a_run_that_hangs_with_code_130() {
    let (_reader, mut writer) = std::io::pipe().unwrap();
    writer.write_all(&[b'.'; 1 << 16]).unwrap();
    let mut child = long_run("insists.toml", writer.into());
    let first = Instant::now();
    let status = loop {
        signal("-INT", &[child.id().to_string()]);
        if let Some(status) = child.try_wait().unwrap() {
            break status;
        }
        std::thread::sleep(Duration::from_millis(20));
    };
    assert_eq!(status.code(), Some(130));
    assert!(first.elapsed() >= Duration::from_millis(500), "{:?}", first.elapsed());
}
