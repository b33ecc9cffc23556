//! Standard output that cannot be written does not end a verb, and is reported when it matters.

use std::process::{Command, Stdio};

const CUBECTL: &str = env!("CARGO_BIN_EXE_cubectl");

#[test]
fn a_reader_that_leaves_is_no_failure() {
    // The pipe is closed before the program writes.
    let mut child = Command::new(CUBECTL)
        .args(["explain", "exit"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let ended = child.wait_with_output().unwrap();
    assert!(ended.status.success(), "{ended:?}");
    assert_eq!(String::from_utf8_lossy(&ended.stderr), "");
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_behind_standard_output_is_reported_with_the_code_of_output() {
    let full = std::fs::File::options().write(true).open("/dev/full").unwrap();
    let ended =
        Command::new(CUBECTL).args(["explain", "exit"]).stdout(full).stderr(Stdio::piped()).output().unwrap();
    assert_eq!(ended.status.code(), Some(i32::from(host::exit::OUTPUT)));
    let reported = String::from_utf8_lossy(&ended.stderr).into_owned();
    assert!(reported.contains("standard output") && reported.contains("next:"), "{reported}");
}
