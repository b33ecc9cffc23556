//! The report of an identification on the simulated cell.

use host::report::identify::html;
use operator::bus::BusArgs;
use operator::bus::args::CellArgs;
use operator::identify::experiment::Bounds;
use operator::identify::joint::{JointExperiments, identify};
use operator::identify::mounting::Mounting;
use robot_model::RobotModel;

use crate::page_data;

#[test]
fn the_report_of_an_identification_is_a_whole_page_with_three_fits() {
    let mut cell = CellArgs { seed: Some(3), ..CellArgs::default() }.load().unwrap();
    cell.setup.cell.drive.starts_homed = true;
    let mut session = BusArgs::default().open_cell(&cell, None).unwrap();
    let bounds = Bounds { current_share: 0.8, speed_share: 0.8, bit_rate_bit_s: 1e6 };
    let wish = JointExperiments { joint: 2, bounds, level: 0.95 };
    let robot = RobotModel::load("powercube6").unwrap();
    let findings = identify(&mut session, &robot, &Mounting::assumed(), &wish, &mut |_, _| {}).unwrap();
    let page = page_data::of(&html(&findings));
    // Each fit, and what it leaves.
    let charts = page_data::charts(&page);
    let points = |k: usize, curve: usize| charts[k]["curves"][curve]["points"].as_array().unwrap().len();
    assert_eq!(charts.len(), 6);
    for k in [0, 2, 4] {
        let title = charts[k]["title"].as_str().unwrap();
        assert_eq!(charts[k + 1]["title"], format!("{title}: residuals"));
        assert!(points(k, 0) > 3 && points(k, 0) == points(k + 1, 0) && points(k, 1) >= 2, "{title}");
    }
    assert_eq!(page["answer"]["verdict"], "identified");
}
