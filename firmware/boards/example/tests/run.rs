//! The example program as a whole.

#[test]
fn the_program_prints_pins_and_angle() {
    let output = std::process::Command::new(env!("CARGO_BIN_EXE_board-example")).output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success(), "{text}{}", String::from_utf8_lossy(&output.stderr));
    for line in ["pin enable: high", "pin enable: low", "joint 6 has turned by 0.2"] {
        assert!(text.contains(line), "{line} in {text}");
    }
}
