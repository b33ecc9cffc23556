//! Recordings of programs that were killed, and files that are too long to read.

use std::io::Write;
use std::path::Path;
use std::process::{Child, Command, Stdio};

use crate::bus_common::{Folder, code, cubectl, err, out};
use mcap::read::{MessageStream, Options};
use operator::log::candump;

/// As started by a terminal, also if these tests are run under `nohup`.
const ATTACHED: &str = "exec env --default-signal=HUP";
/// As started under `nohup`.
const DETACHED: &str = "trap '' HUP; exec";

/// `cubectl log record` of a starting controller in the simulated cell, without an end of its own.
fn recorder(folder: &Folder, name: &str, begin: &str) -> Child {
    let script = format!("{begin} \"$0\" record \"$1\" --controller --for-s 1000000");
    let mut child = Command::new("sh")
        .args(["-c", &script, env!("CARGO_BIN_EXE_cubectl"), &folder.file(name)])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    wait_for_length(&mut child, &folder.0.join(format!("{name}.log")), 300_000);
    child
}

/// Waits until the log of a recorder is longer than this, however long a busy machine takes; a recorder that ends is a
/// failure.
fn wait_for_length(recorder: &mut Child, log: &Path, bytes: u64) {
    while !log.metadata().is_ok_and(|file| file.len() > bytes) {
        assert!(recorder.try_wait().unwrap().is_none(), "the recorder has ended");
        std::thread::sleep(std::time::Duration::from_millis(10));
    }
}

fn signal(child: &Child, name: &str) {
    let status = Command::new("kill").args([&format!("-{name}"), &child.id().to_string()]).status();
    assert!(status.unwrap().success());
}

/// Times of the frames in an MCAP file that may be unfinished, s.
fn frames_of(path: &Path) -> Vec<f64> {
    let bytes = std::fs::read(path).unwrap();
    MessageStream::new_with_options(&bytes, Options::IgnoreEndMagic.into())
        .unwrap()
        .map_while(Result::ok)
        .filter(|message| message.channel.topic == "/bus/frames")
        .map(|message| message.log_time as f64 * 1e-9)
        .collect()
}

#[test]
fn a_recorder_that_is_killed_loses_at_most_what_the_flush_interval_holds() {
    let folder = Folder::new("record-kill");
    let mut child = recorder(&folder, "a", ATTACHED);
    signal(&child, "KILL");
    child.wait().unwrap();
    let log = folder.0.join("a.log");
    let recording = candump::read_file(&log).unwrap();
    let text_end_s = recording.lines.last().unwrap().at.as_secs_f64();
    let frames = frames_of(&folder.0.join("a.mcap"));
    let viewer_end_s = *frames.last().unwrap();
    println!("text to {text_end_s} s, viewer to {viewer_end_s} s, {:?}", recording.tear);
    // Both were flushed at the same times; what is beyond the last one is a buffer that ran full.
    assert!((text_end_s - viewer_end_s).abs() <= 0.25, "{text_end_s} against {viewer_end_s}");
    assert!(frames.len() > 1_000 && recording.lines.len() > 1_000);
    let replayed = cubectl(&["log", "replay", &folder.file("a.log")]);
    assert_eq!(code(&replayed), 0, "{}{}", out(&replayed), err(&replayed));
}

#[test]
fn a_log_with_a_torn_last_line_is_replayed_and_reported_up_to_it_and_the_tear_is_reported() {
    let folder = Folder::new("record-torn");
    let dir = folder.file("a");
    let thrown = cubectl(&["throw", "--target", "1,1,-1", "--yes", "--out", &dir]);
    assert_eq!(code(&thrown), 0, "{}", err(&thrown));
    let log = folder.0.join("a/bus.log");
    let mut bytes = std::fs::read(&log).unwrap();
    let lines = bytes.iter().filter(|byte| **byte == b'\n').count();
    bytes.truncate(bytes.len() - 20);
    std::fs::write(&log, &bytes).unwrap();
    let tear = format!("the log is cut off in line {lines} ");
    let replayed = cubectl(&["log", "replay", &dir]);
    assert_eq!(code(&replayed), 0, "{}{}", out(&replayed), err(&replayed));
    assert!(err(&replayed).contains(&tear), "{}", err(&replayed));
    let reported = cubectl(&["log", "report", &dir]);
    assert_eq!(code(&reported), 0, "{}", err(&reported));
    assert!(err(&reported).contains(&tear), "{}", err(&reported));
    assert!(std::fs::read_to_string(folder.0.join("a/report.html")).unwrap().contains(&tear));
    let analysed = cubectl(&["log", "report", &dir, "--json"]);
    let analysis: serde_json::Value = serde_json::from_str(&out(&analysed)).unwrap();
    assert_eq!(analysis["torn"]["line"], lines);
    assert_eq!(analysis["completed"], true);
    let not_a_folder = cubectl(&["log", "report", &log.display().to_string()]);
    assert_eq!(code(&not_a_folder), 4, "{}", err(&not_a_folder));
    assert!(err(&not_a_folder).contains("next: name the folder"), "{}", err(&not_a_folder));
}

#[test]
fn interrupt_termination_and_hang_up_end_a_recording_in_order() {
    let folder = Folder::new("record-signals");
    for name in ["INT", "TERM", "HUP"] {
        let child = recorder(&folder, name, ATTACHED);
        signal(&child, name);
        let output = child.wait_with_output().unwrap();
        assert_eq!(code(&output), 0, "{name}: {}", err(&output));
        assert!(out(&output).contains("ended by a signal"), "{name}: {}", out(&output));
        let recording = candump::read_file(&folder.0.join(format!("{name}.log"))).unwrap();
        assert_eq!(recording.tear, None, "{name}");
        let bytes = std::fs::read(folder.0.join(format!("{name}.mcap"))).unwrap();
        assert!(mcap::Summary::read(&bytes).unwrap().is_some(), "{name}: the MCAP file is finished");
    }
    // Who is started under `nohup` goes on when the terminal is gone.
    let mut child = recorder(&folder, "nohup", DETACHED);
    signal(&child, "HUP");
    let log = folder.0.join("nohup.log");
    let long = log.metadata().unwrap().len() + 300_000;
    wait_for_length(&mut child, &log, long);
    signal(&child, "TERM");
    assert_eq!(child.wait().unwrap().code(), Some(0));
}

#[test]
fn signals_that_come_together_are_one_request_to_end() {
    let folder = Folder::new("record-many-signals");
    let child = recorder(&folder, "many", ATTACHED);
    // One program sends them all, so that no other has to start in between.
    let pid = child.id().to_string();
    let sent = Command::new("kill").arg("-TERM").args(vec![pid; 40]).status();
    assert!(sent.unwrap().success());
    let output = child.wait_with_output().unwrap();
    assert_eq!(code(&output), 0, "{}", err(&output));
    assert!(out(&output).contains("ended by a signal"), "{}", out(&output));
}

/// Reading must not take memory in proportion to what nobody bounded: 64 MiB of address space are left for it.
fn cubectl_with_little_memory(words: &[&str]) -> std::process::Output {
    Command::new("sh")
        .args(["-c", "ulimit -v 800000; exec \"$0\" \"$@\"", env!("CARGO_BIN_EXE_cubectl")])
        .args(words)
        .output()
        .unwrap()
}

#[test]
fn files_that_are_too_long_are_refused_before_they_fill_the_memory() {
    let folder = Folder::new("record-long");
    // One line of 2 GB that takes no place on the disk.
    let long = folder.file("long");
    let mut file = std::fs::File::create(&long).unwrap();
    file.write_all(b"{ \"a\": \"").unwrap();
    file.set_len(2_000_000_000).unwrap();
    let table: [(&[&str], &str); 7] = [
        (&["log", "replay", &long], "line 1"),
        (&["plan", "check", &long], "more than 16777216 bytes"),
        (&["plan", "export", &long, "--csv"], "more than 16777216 bytes"),
        (&["throw", "--plan", &long, "--out", &folder.file("out")], "more than 16777216 bytes"),
        (&["plan", "throw", "--target", "1,1,-1", "--robot", &long], "more than 4194304 bytes"),
        (&["throw", "--target", "1,1,-1", "--gains", &long], "more than 4194304 bytes"),
        (&["status", "--scenario", &long], "more than 4194304 bytes"),
    ];
    for (words, expected) in table {
        let output = cubectl_with_little_memory(words);
        assert_eq!(code(&output), 4, "{words:?}: {}", err(&output));
        assert!(err(&output).contains(expected), "{words:?}: {}", err(&output));
    }
}
