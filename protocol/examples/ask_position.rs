//! A request to a drive and its answer as frames and as lines of a candump log:
//! `cargo run -p protocol --example ask_position`.

use protocol::powercube::{Parameter, Reply, Request, Value};
use protocol::{Frame, ModuleId};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let module = ModuleId::new(3)?;
    let request = Request::Get(Parameter::ActPos).encode(module);
    println!("ask module {module} for its position: {}", hex(&request));

    // What the drive answers: the same parameter with an f32 in radians.
    let answer = Reply::Value(Parameter::ActPos, Value::F32(-0.75)).encode(module);
    println!("its answer:                     {}", hex(&answer));

    match Reply::decode(&answer)? {
        (from, Reply::Value(Parameter::ActPos, Value::F32(q_rad))) => {
            println!("module {from} is at {q_rad} rad");
            if (from, q_rad) == (module, -0.75) { Ok(()) } else { Err("another answer was decoded".into()) }
        }
        other => Err(format!("not a position: {other:?}").into()),
    }
}

/// Identifier and data as `candump` writes them.
fn hex(frame: &Frame) -> String {
    let data: String = frame.data().iter().map(|byte| format!("{byte:02X}")).collect();
    format!("{:03X}#{data}", frame.id().raw())
}
