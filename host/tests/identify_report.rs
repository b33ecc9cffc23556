//! The report of an identification on the simulated cell.

use host::report::identify::html;
use operator::bus::BusArgs;
use operator::bus::args::CellArgs;
use operator::identify::experiment::Bounds;
use operator::identify::joint::{JointExperiments, identify};
use operator::identify::mounting::Mounting;
use robot_model::RobotModel;

#[test]
fn the_report_of_an_identification_is_a_whole_page_with_three_fits() {
    let mut cell = CellArgs { seed: Some(3), ..CellArgs::default() }.load().unwrap();
    cell.setup.cell.drive.starts_homed = true;
    let mut session = BusArgs::default().open_cell(&cell, None).unwrap();
    let bounds = Bounds { current_share: 0.8, speed_share: 0.8, bit_rate_bit_s: 1e6 };
    let wish = JointExperiments { joint: 2, bounds, level: 0.95 };
    let robot = RobotModel::load("powercube6").unwrap();
    let findings = identify(&mut session, &robot, &Mounting::assumed(), &wish, &mut |_, _| {}).unwrap();
    let html = html(&findings);
    // Each fit, and what it leaves.
    assert_eq!((html.matches("<svg").count(), html.matches(": residuals\"").count()), (6, 3));
    assert!(html.contains("Why") && html.ends_with("</html>\n"));
}
