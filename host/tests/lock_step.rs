//! Programs in lock step with a simulated cell: what the machine does to them changes nothing.

use std::process::{Command, Stdio};
use std::time::Duration;

use crate::bus_common::{Folder, Served};
use hil_sim::CellOptions;

/// The recording of a throw over a socket; with `held_up`, the program is stopped for a moment again and again.
fn recording(folder: &Folder, name: &str, held_up: bool) -> Vec<u8> {
    let served = Served::arm(CellOptions::default());
    let out = folder.file(name);
    let mut child = Command::new(env!("CARGO_BIN_EXE_cubectl"))
        .args(["throw", "--yes", "--target", "1,1,-1", "--controller", "soft"])
        .args(["--bus", &served.spec, "--out", &out])
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let mut stops = 0;
    let status = loop {
        if let Some(status) = child.try_wait().unwrap() {
            break status;
        }
        std::thread::sleep(Duration::from_millis(20));
        if held_up && stops < 10 {
            let pid = child.id();
            let stop = format!("kill -STOP {pid} && sleep 0.1; kill -CONT {pid}");
            let _ = Command::new("sh").args(["-c", &stop]).stderr(Stdio::null()).status();
            stops += 1;
        }
    };
    assert_eq!(status.code(), Some(0), "{name}");
    assert_eq!(stops > 0, held_up);
    std::fs::read(folder.0.join(name).join("bus.log")).unwrap()
}

#[test]
fn throw_of_a_program_that_is_held_up_is_the_same_frame_for_frame() {
    let folder = Folder::new("lock-step");
    let undisturbed = recording(&folder, "a", false);
    assert!(undisturbed.len() > 1_000_000, "{} bytes", undisturbed.len());
    let held_up = recording(&folder, "b", true);
    let first = undisturbed.iter().zip(&held_up).position(|(a, b)| a != b);
    assert_eq!((first, undisturbed.len()), (None, held_up.len()), "the recordings part at byte {first:?}");
}
