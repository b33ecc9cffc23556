//! Prints the DBC file of the six drives of the arm, for SavvyCAN and cantools:
//!
//! `cargo run -p protocol --example powercube_dbc > powercube.dbc`

use protocol::ModuleId;
use protocol::powercube::dbc::write_dbc;

fn main() {
    let mut text = String::new();
    write_dbc(&mut text, ModuleId::all().take(6)).expect("a String takes everything");
    print!("{text}");
}
