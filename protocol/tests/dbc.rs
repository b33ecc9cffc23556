//! The committed DBC file is the one that the tables give.
//!
//! `UPDATE_DBC=1 cargo test -p protocol --test dbc` writes it again.

use protocol::ModuleId;
use protocol::powercube::dbc::write_dbc;

#[test]
fn committed_dbc_file_is_the_generated_one() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/dbc/powercube.dbc");
    let mut generated = String::new();
    // The six drives of the arm; other addresses come from the same function.
    write_dbc(&mut generated, ModuleId::all().take(6)).expect("a String takes everything");
    if std::env::var_os("UPDATE_DBC").is_some() {
        std::fs::write(path, &generated).expect("the DBC file is writable");
    }
    let committed = std::fs::read_to_string(path).expect("protocol/dbc/powercube.dbc is committed");
    assert!(
        committed == generated,
        "protocol/dbc/powercube.dbc is stale: run with UPDATE_DBC=1 and commit it"
    );
}
