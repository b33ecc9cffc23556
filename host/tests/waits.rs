//! What a person at a terminal sees while a program works for longer than a second.

use std::fs::File;
use std::io::Read;
use std::process::{Command, Stdio};

use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};

/// Runs the program with standard error at a terminal until `wanted` is seen there, and ends it then. What was seen, if it ends
/// before.
fn sees(words: &[&str], wanted: &str) -> Result<(), String> {
    let near = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
    grantpt(&near).unwrap();
    unlockpt(&near).unwrap();
    let path = ptsname(&near, Vec::new()).unwrap();
    let far = File::options().read(true).write(true).open(path.to_str().unwrap()).unwrap();
    let mut program = Command::new(env!("CARGO_BIN_EXE_cubectl"))
        .args(words)
        .env("TERM", "xterm")
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(far)
        .spawn()
        .expect("runs");
    let (mut near, mut seen, mut some) = (File::from(near), String::new(), [0; 4096]);
    // A terminal without a program behind it is an error (EIO): the program has ended.
    while let Ok(count @ 1..) = near.read(&mut some) {
        seen += &String::from_utf8_lossy(&some[..count]);
        if seen.contains(wanted) {
            break;
        }
    }
    program.kill().expect("it runs or has ended");
    program.wait().expect("waits");
    if seen.contains(wanted) { Ok(()) } else { Err(seen) }
}

#[test]
fn long_work_says_what_it_is_and_how_long_it_takes_as_a_rule() {
    let words = ["--robot", "kr16_2", "--target", "2.5,0,0.6"];
    for verb in [&["throw"][..], &["plan", "throw"]] {
        sees(&[verb, &words].concat(), "looking for a throw, as a rule 10 to 30 s")
            .unwrap_or_else(|seen| panic!("{verb:?}: {seen}"));
    }
}
