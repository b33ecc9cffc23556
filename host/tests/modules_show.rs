//! CANopen servos beside their electronic data sheet.

use std::process::Output;

use crate::bus_common::{Folder, code, cubectl, err, out};
use crate::side_by_side::interpolating;

const ROBOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../robots/canopen6.toml");
const SHEET: &str = include_str!("../../hil-sim/src/drive/cia402/simulated_servo.eds");

fn show(folder: &Folder, sheet: &str, more: &[&str]) -> Output {
    let file = folder.file("servo.eds");
    std::fs::write(&file, sheet).unwrap();
    cubectl(&[&["modules", "show", "--eds", &file], more].concat())
}

/// The sheet with the first `from` behind `section` replaced.
fn changed(section: &str, from: &str, to: &str) -> String {
    let (before, after) = SHEET.split_once(&format!("[{section}]")).expect("a section");
    assert!(after.contains(from), "[{section}] has no {from}");
    format!("{before}[{section}]{}", after.replacen(from, to, 1))
}

#[test]
fn servos_that_are_as_their_sheet_says_are_reported_with_the_number_of_objects() {
    let folder = Folder::new("sheet-same");
    let done = show(&folder, SHEET, &["--robot", ROBOT]);
    assert_eq!(code(&done), 0, "{}{}", out(&done), err(&done));
    for node in 3..=8 {
        let line = format!("node {node}: ");
        let read: usize = out(&done)
            .lines()
            .find_map(|said| said.strip_prefix(&line)?.split(' ').next()?.parse().ok())
            .unwrap_or_else(|| panic!("{}", out(&done)));
        assert!((40..60).contains(&read), "{read} objects");
    }
}

#[test]
fn servos_are_compared_with_the_sheets_that_they_store() {
    let done = cubectl(&["modules", "show", "--robot", ROBOT]);
    assert_eq!(code(&done), 0, "{}{}", out(&done), err(&done));
    for node in 3..=8 {
        let line = format!("node {node}: ");
        let said = out(&done).lines().find(|said| said.starts_with(&line)).map(str::to_owned);
        assert!(said.is_some_and(|said| said.ends_with(" objects as in its own sheet")), "{}", out(&done));
    }
    // SCHUNK's modules store none.
    let folder = Folder::new("sheet-of-module");
    let robot = interpolating(ROBOT, &folder);
    let done = cubectl(&["modules", "show", "--robot", &robot, "--node", "5"]);
    assert_eq!(code(&done), 8, "{}{}", out(&done), err(&done));
    let said = "node 5: its sheet (object 1021): the node refuses: no such object (0x06020000)";
    assert!(err(&done).contains(said) && err(&done).contains("--eds FILE"), "{}", err(&done));
}

#[test]
fn each_difference_is_named_with_object_meaning_and_next_step() {
    let folder = Folder::new("sheet-differs");
    for (sheet, said, next) in [
        (
            changed("DeviceInfo", "ProductNumber=0x61500000", "ProductNumber=0x61500001"),
            "node 3, 1018:02: the product of the node is 0x61500000, that of the sheet 0x61500001",
            "take the sheet of this device",
        ),
        (
            changed("6065", "AccessType=rw", "AccessType=ro"),
            "node 3, 6065:00 Following error window: the controller writes it; by the sheet it can only be read",
            "the node decides",
        ),
        (
            changed("60C2sub1", "HighLimit=255", "HighLimit=1"),
            "60C2:01 Interpolation time period value: the controller writes 3, the sheet allows 1 to 1",
            "change the limits of the joint or the period",
        ),
        (
            changed("6066", "DataType=0x0006", "DataType=0x0007"),
            "6066:00 Following error time out: the node gives 2 bytes, the sheet says 4",
            "take the sheet of this revision",
        ),
        (
            changed("607A", "PDOMapping=1", "PDOMapping=0"),
            "607A:00 Target position: it is in process data of the controller; by the sheet it cannot be",
            "the node decides",
        ),
        (
            SHEET.replace("[605E]", "[305E]"),
            "605E:00: the controller needs it; the node has it, the sheet does not",
            "the controller goes by the node",
        ),
        // A DCF: an object that the controller does not use counts, too.
        (
            changed("607C", "DefaultValue=0", "DefaultValue=0\r\nParameterValue=-5"),
            "607C:00 Home offset: the node holds 0, the sheet -5",
            "write the value with the maker's tool",
        ),
    ] {
        let done = show(&folder, &sheet, &["--robot", ROBOT, "--node", "3"]);
        assert_eq!(code(&done), 9, "{said}: {}{}", out(&done), err(&done));
        assert!(out(&done).contains(said), "{said}: {}", out(&done));
        assert!(out(&done).contains(next), "{next}: {}", out(&done));
        assert!(err(&done).contains("1 difference"), "{}", err(&done));
    }
}

#[test]
fn a_sheet_of_servos_of_mode_8_does_not_fit_modules_that_interpolate() {
    let folder = Folder::new("sheet-mode-7");
    let robot = interpolating(ROBOT, &folder);
    let done = show(&folder, SHEET, &["--robot", &robot, "--node", "5"]);
    assert_eq!(code(&done), 9, "{}{}", out(&done), err(&done));
    for said in [
        "node 5, 608F:01 Encoder increments: the controller needs it; the node refuses: no such object",
        "node 5, 60C0:00: the controller needs it; the node has it, the sheet does not",
        "node 5, 60C1:01: the controller needs it; the node has it, the sheet does not",
    ] {
        assert!(out(&done).contains(said), "{said}: {}", out(&done));
    }
}

/// Objects of a module that interpolates, beside those of the sheet.
const INTERPOLATION: &str = "
[60C0]
ParameterName=interpolation_sub_mode_select
ObjectType=0x7
DataType=0x0003
AccessType=rw
LowLimit=-1
HighLimit=0

[60C1]
ParameterName=interpolation_data_record
ObjectType=0x8
SubNumber=2

[60C1sub1]
ParameterName=setpoint_1
ObjectType=0x7
DataType=0x0004
AccessType=rww
PDOMapping=1

[60C4]
ParameterName=interpolation_data_configuration
ObjectType=0x9
SubNumber=7

[60C4sub2]
ParameterName=actual_buffer_size
ObjectType=0x7
DataType=0x0007
AccessType=rw
DefaultValue=0
";

#[test]
fn modules_without_what_schunks_sheet_does_not_name_are_as_such_a_sheet_says() {
    let folder = Folder::new("sheet-module");
    let robot = interpolating(ROBOT, &folder);
    let mut sheet = SHEET.to_owned() + INTERPOLATION;
    for index in ["1029", "6007", "603F", "605A", "605E", "6066", "6076", "6085", "608F", "6091"] {
        assert!(sheet.contains(&format!("[{index}]")), "{index}");
        // A section that is no object of the node and of the controller.
        sheet = sheet.replace(&format!("[{index}"), &format!("[5{}", &index[1..]));
    }
    let done = show(&folder, &sheet, &["--robot", &robot]);
    assert_eq!(code(&done), 0, "{}{}", out(&done), err(&done));
    assert!(out(&done).contains("node 8: "), "{}", out(&done));
}

#[test]
fn what_cannot_be_compared_ends_with_its_code_and_a_next_step() {
    let folder = Folder::new("sheet-refused");
    let damaged = SHEET.replacen("DataType=0x0007", "DataType=seven", 1);
    let scenario = folder.file("cell.toml");
    let text = "schema_version = 1\nduration_s = 60\n\n[[fault]]\nkind = \"silent\"\ntarget = \"module 4\"\nstart_s = 0.0\n";
    std::fs::write(&scenario, text).unwrap();
    for (sheet, words, exit, said) in [
        (damaged.as_str(), &["--robot", ROBOT][..], 4, "is not a number"),
        ("nothing = here\n", &["--robot", ROBOT], 4, "a value before the first section"),
        (SHEET, &[], 4, "robot powercube6 has no CANopen servos"),
        (SHEET, &["--robot", ROBOT, "--node", "9"], 4, "name one of 3, 4, 5, 6, 7, 8"),
        (SHEET, &["--robot", ROBOT, "--scenario", &scenario], 8, "node 4: the node does not answer"),
    ] {
        let done = show(&folder, sheet, words);
        assert_eq!(code(&done), exit, "{said}: {}{}", out(&done), err(&done));
        assert!(err(&done).contains(said) && err(&done).contains("next"), "{said}: {}", err(&done));
    }
}
