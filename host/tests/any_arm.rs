//! Any arm from its URDF file in three commands: a newcomer imports it with its meshes, checks it, moves it and throws with it.

use std::fmt::Write as _;

use crate::bus_common::{Folder, code, cubectl, err, out};
use serde_json::Value;

/// Corners of a block from `low` to `high`, and its twelve triangles.
fn block(low: [f64; 3], high: [f64; 3]) -> (Vec<[f64; 3]>, Vec<[usize; 3]>) {
    let pick = |bits: usize, k: usize| if bits >> k & 1 == 0 { low[k] } else { high[k] };
    let corners = (0..8).map(|bits| [0, 1, 2].map(|k| pick(bits, k))).collect();
    let faces = [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]];
    (corners, faces.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect())
}

/// The block in the format that the ending of the name says.
fn mesh(name: &str, low: [f64; 3], high: [f64; 3]) -> Vec<u8> {
    let (corners, triangles) = block(low, high);
    let list = |all: &mut dyn Iterator<Item = String>| all.collect::<Vec<_>>().join(" ");
    let mut text = String::new();
    match name.rsplit_once('.').unwrap() {
        (_, "stl") => {
            let mut bytes = vec![b's'; 80];
            bytes.extend((triangles.len() as u32).to_le_bytes());
            for triangle in &triangles {
                bytes.extend([0; 12]);
                let numbers = triangle.iter().flat_map(|k| corners[*k]);
                bytes.extend(numbers.flat_map(|v| (v as f32).to_le_bytes()));
                bytes.extend([0; 2]);
            }
            return bytes;
        }
        (_, "STL") => {
            writeln!(text, "solid block").unwrap();
            for triangle in &triangles {
                writeln!(text, "facet normal 0 0 0\nouter loop").unwrap();
                for [x, y, z] in triangle.map(|k| corners[k]) {
                    writeln!(text, "  vertex {x:e} {y} {z}").unwrap();
                }
                writeln!(text, "endloop\nendfacet").unwrap();
            }
            writeln!(text, "endsolid block").unwrap();
        }
        (_, "obj") => {
            for [x, y, z] in &corners {
                writeln!(text, "v {x} {y} {z}").unwrap();
            }
            for t in &triangles {
                writeln!(text, "f {}//1 {}//1 {}//1", t[0] + 1, t[1] + 1, t[2] + 1).unwrap();
            }
        }
        _ => {
            // In millimetres, behind a shift of the scene.
            let numbers = list(&mut corners.iter().flatten().map(|v| format!("{}", 1e3 * v)));
            let indices = list(&mut triangles.iter().flatten().map(|k| format!("{k} 0")));
            write!(
                text,
                "<COLLADA xmlns=\"http://www.collada.org/2005/11/COLLADASchema\"><asset><unit meter=\"0.001\"/></asset>\
                 <library_geometries><geometry id=\"g\"><mesh><source id=\"p\"><float_array>{numbers}</float_array></source>\
                 <vertices id=\"v\"><input semantic=\"POSITION\" source=\"#p\"/></vertices>\
                 <triangles count=\"12\"><input semantic=\"VERTEX\" source=\"#v\" offset=\"0\"/>\
                 <input semantic=\"NORMAL\" source=\"#n\" offset=\"1\"/><p>{indices}</p></triangles></mesh></geometry>\
                 </library_geometries><library_visual_scenes><visual_scene><node><translate>0 0 10</translate>\
                 <instance_geometry url=\"#g\"/></node></visual_scene></library_visual_scenes></COLLADA>"
            )
            .unwrap();
        }
    }
    text.into_bytes()
}

fn link(name: &str, kg: f64, com_z_m: f64, mesh: &str) -> String {
    format!(
        "<link name=\"{name}\"><inertial><origin xyz=\"0 0 {com_z_m}\"/><mass value=\"{kg}\"/>\
         <inertia ixx=\"{i}\" ixy=\"0\" ixz=\"0\" iyy=\"{i}\" iyz=\"0\" izz=\"{i}\"/></inertial>\
         <collision><geometry><mesh filename=\"{mesh}\"/></geometry></collision></link>\n",
        i = 0.01 * kg
    )
}

fn joint(name: &str, kind: &str, ends: [&str; 2], z_m: f64, more: &str) -> String {
    let [parent, child] = ends;
    format!(
        "<joint name=\"{name}\" type=\"{kind}\"><parent link=\"{parent}\"/><child link=\"{child}\"/>\
         <origin xyz=\"0 0 {z_m}\" rpy=\"0 0 0\"/>{more}</joint>\n"
    )
}

/// Six joints, meshes in every format, and a hand with two fingers that slide.
fn urdf(folder: &Folder) -> String {
    let meshes: [(&str, [f64; 3], [f64; 3]); 5] = [
        ("base.stl", [-0.08, -0.08, 0.0], [0.08, 0.08, 0.1]),
        ("upper.STL", [-0.05, -0.05, 0.03], [0.05, 0.05, 0.4]),
        ("fore.obj", [-0.04, -0.04, 0.03], [0.04, 0.04, 0.3]),
        ("wrist.dae", [-0.03, -0.03, -0.04], [0.03, 0.03, 0.03]),
        ("finger.stl", [-0.01, -0.01, 0.0], [0.01, 0.01, 0.05]),
    ];
    std::fs::create_dir_all(folder.0.join("my_arm/meshes")).unwrap();
    std::fs::create_dir_all(folder.0.join("my_arm/urdf")).unwrap();
    for (name, low, high) in meshes {
        std::fs::write(folder.0.join("my_arm/meshes").join(name), mesh(name, low, high)).unwrap();
    }
    let at = |name: &str| format!("package://my_arm/meshes/{name}");
    let turn = |axis: &str, nm: f64| {
        format!(
            "<axis xyz=\"{axis}\"/><limit lower=\"-2.6\" upper=\"2.6\" velocity=\"3.14\" effort=\"{nm}\"/>"
        )
    };
    let slide = "<axis xyz=\"0 1 0\"/><limit lower=\"0\" upper=\"0.04\" velocity=\"0.2\" effort=\"20\"/>";
    let mut text = "<?xml version=\"1.0\"?>\n<robot name=\"my_arm\">\n".to_owned();
    for (name, kg, com, file) in [
        ("base", 5.0, 0.05, "base.stl"),
        ("shoulder", 3.0, 0.0, "wrist.dae"),
        ("upper", 4.0, 0.2, "upper.STL"),
        ("fore", 2.0, 0.15, "fore.obj"),
        ("wrist_1", 0.8, 0.0, "wrist.dae"),
        ("wrist_2", 0.8, 0.0, "wrist.dae"),
        ("hand", 0.5, 0.0, "wrist.dae"),
        ("left", 0.1, 0.02, "finger.stl"),
        ("right", 0.1, 0.02, "finger.stl"),
    ] {
        text += &link(name, kg, com, &at(file));
    }
    text += "<link name=\"tool\"/>\n";
    text += &joint("pan", "revolute", ["base", "shoulder"], 0.16, &turn("0 0 1", 150.0));
    text += &joint("lift", "revolute", ["shoulder", "upper"], 0.05, &turn("0 1 0", 150.0));
    text += &joint("elbow", "revolute", ["upper", "fore"], 0.42, &turn("0 1 0", 100.0));
    text += &joint("roll", "revolute", ["fore", "wrist_1"], 0.34, &turn("0 0 1", 30.0));
    text += &joint("pitch", "revolute", ["wrist_1", "wrist_2"], 0.09, &turn("0 1 0", 30.0));
    text += &joint("flange", "continuous", ["wrist_2", "hand"], 0.09, "<axis xyz=\"0 0 1\"/>");
    text += &joint("tool_mount", "fixed", ["hand", "tool"], 0.1, "");
    text += &joint("left_slide", "prismatic", ["hand", "left"], 0.03, slide);
    let mimic = format!("{slide}<mimic joint=\"left_slide\"/>");
    text += &joint("right_slide", "prismatic", ["hand", "right"], 0.03, &mimic);
    text += "</robot>\n";
    let path = folder.file("my_arm/urdf/arm.urdf");
    std::fs::write(&path, text).unwrap();
    path
}

#[test]
fn an_arm_is_imported_checked_moved_and_thrown_with_at_first_try() {
    let folder = Folder::new("any-arm");
    let (urdf, arm) = (urdf(&folder), folder.file("arm.toml"));
    let made =
        cubectl(&["robot", "import", &urdf, "--end-effector", "tool", "--floor-z-m", "-0.6", "--out", &arm]);
    assert_eq!(code(&made), 0, "{}", err(&made));
    let said = out(&made);
    assert!(said.contains("6 joints") && !said.contains("left out"), "{said}");
    for note in [
        "`left_slide` (prismatic) is held at zero: `left` is a part of `hand`",
        "`right_slide` (mimic) is held at zero",
        "joint `flange` has no velocity limit",
    ] {
        assert!(said.contains(note), "{note}: {said}");
    }
    // Boxes have the sizes of the blocks, in every format.
    let text = std::fs::read_to_string(&arm).unwrap();
    let file: toml::Table = text.parse().unwrap();
    let boxes = |link: usize| file["link"][link]["box"].as_array().unwrap().clone();
    for (link, half_m) in [(0, [0.03, 0.03, 0.035]), (1, [0.05, 0.05, 0.185]), (2, [0.04, 0.04, 0.135])] {
        let found = boxes(link);
        assert_eq!(found.len(), 1, "{found:?}");
        for (k, wanted) in half_m.into_iter().enumerate() {
            let half = found[0]["half_m"][k].as_float().unwrap();
            assert!((wanted..wanted + 3e-4).contains(&half), "{link}: {half} for {wanted}");
        }
    }
    // The shift of the scene counts: 10 mm.
    assert!((boxes(0)[0]["center_m"][2].as_float().unwrap() - 0.005).abs() < 1e-9, "{text}");
    assert_eq!(boxes(5).len(), 3, "palm and two fingers");
    // The ball is free of the hand: fingers end 20 mm before the tool (their boxes 0.2 mm later), the ball has a radius of 30 mm and 10 mm
    // of room, in steps of 5 mm.
    assert!(text.contains("release_origin_m = [0.0, 0.0, 0.025]"), "{text}");

    let checked = cubectl(&["robot", "check", &arm]);
    assert_eq!(code(&checked), 9, "{}{}", out(&checked), err(&checked));
    assert!(err(&checked).contains("can be used to plan and to simulate"), "{}", err(&checked));
    assert!(err(&checked).contains("0 values are implausible"), "{}{}", out(&checked), err(&checked));
    assert!(out(&checked).contains("to move drives on a real bus is missing:"), "{}", out(&checked));
    let pose = ["move", "--robot", &arm, "--joints", "30deg,-40deg,60deg,0,40deg,0", "--home"];
    let moved = cubectl(&pose);
    assert_eq!(code(&moved), 0, "{}{}", out(&moved), err(&moved));
    let dir = folder.file("thrown");
    let thrown = cubectl(&["throw", "--robot", &arm, "--target", "1.1,0.2,-0.3", "--out", &dir]);
    assert_eq!(code(&thrown), 0, "{}{}", out(&thrown), err(&thrown));
    let summary = std::fs::read_to_string(folder.0.join("thrown/summary.json")).unwrap();
    let summary: Value = serde_json::from_str(&summary).unwrap();
    assert_eq!(summary["outcome"], "landed");
}

#[test]
fn a_mesh_that_is_not_found_is_named_with_what_to_do() {
    let folder = Folder::new("any-arm-lost");
    let urdf = urdf(&folder);
    let elsewhere = folder.file("elsewhere");
    std::fs::rename(folder.0.join("my_arm/meshes"), folder.0.join("meshes")).unwrap();
    std::fs::create_dir(&elsewhere).unwrap();
    std::fs::rename(folder.0.join("meshes"), folder.0.join("elsewhere/meshes")).unwrap();
    let arm = folder.file("arm.toml");
    let words = ["robot", "import", &urdf, "--out", &arm, "--force"];
    let lost = cubectl(&words);
    let advice = "package://my_arm/meshes/upper.STL was not found; `--package my_arm=DIR`";
    assert!(code(&lost) == 0 && out(&lost).contains(advice), "{}", out(&lost));
    let option = format!("my_arm={elsewhere}");
    let found = cubectl(&[&words[..], &["--package", &option]].concat());
    assert!(code(&found) == 0 && !out(&found).contains("left out"), "{}", out(&found));
}

#[test]
fn check_names_all_that_each_use_lacks_and_its_lines_are_enough() {
    let folder = Folder::new("any-arm-uses");
    let arm = folder.file("bare.toml");
    let text = include_str!("../../docs/robots/arm.toml");
    let (before, rest) = text.split_once("[generic_drives]").unwrap();
    let (_, after) = rest.split_once("[end_effector]").unwrap();
    let bare = format!("{before}[end_effector]{after}");
    std::fs::write(&arm, &bare).unwrap();
    let checked = cubectl(&["robot", "check", &arm]);
    assert_eq!(code(&checked), 0, "{}", err(&checked));
    let said = out(&checked);
    assert!(said.contains("can be used to plan; "), "{said}");
    for what in ["to simulate is missing:", "generic_drives:", "drive_loop:", "joint[5].drive", "supply:"] {
        assert!(said.contains(what), "{what}: {said}");
    }
    let json = cubectl(&["robot", "check", &arm, "--json"]);
    let rows: Value = serde_json::from_str(&out(&json)).unwrap();
    let lines = rows.as_array().unwrap().iter().filter(|row| row["use"] == "simulate");
    let lines: Vec<&str> = lines.map(|row| row["next"].as_str().unwrap()).collect();
    assert_eq!(lines.len(), 2, "{rows}");
    // The lines as they are printed make the file one that can be simulated.
    std::fs::write(
        &arm,
        bare.replacen("[end_effector]", &format!("{}\n[end_effector]", lines.join("\n")), 1),
    )
    .unwrap();
    let checked = cubectl(&["robot", "check", &arm]);
    assert!(err(&checked).contains("to plan and to simulate; 0 values are implausible"), "{}", err(&checked));
}
