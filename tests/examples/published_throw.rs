//! `published_throw PERIOD_US DIR` writes the published throw as `DIR/throw.ctrj`, and `DIR/cell.toml`: the simulated
//! cell with the arm at its start.

use std::path::PathBuf;

use cell_tests::published_throw;

fn main() -> std::io::Result<()> {
    let mut args = std::env::args().skip(1);
    let (Some(Ok(period_us)), Some(dir)) = (args.next().map(|text| text.parse()), args.next()) else {
        eprintln!("usage: published_throw PERIOD_US DIR");
        std::process::exit(2);
    };
    let dir = PathBuf::from(dir);
    std::fs::create_dir_all(&dir)?;
    std::fs::write(dir.join("throw.ctrj"), published_throw::file(period_us))?;
    let start = published_throw::start_rad().map(|q| q.to_string()).join(", ");
    // The opening of the fingers varies by a millisecond in the default cell: 4 mm on the floor that are not the
    // controller's.
    let cell = format!(
        "schema_version = 1\nname = \"published throw\"\nseed = 1\nduration_s = 10.0\n\n\
         [cell]\nstart_q_rad = [{start}]\n\n[drive]\nstarts_homed = true\n\n[gripper]\njitter_s = 0.0\n"
    );
    std::fs::write(dir.join("cell.toml"), cell)
}
